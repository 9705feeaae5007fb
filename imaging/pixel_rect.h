// Half-open rectangles of pixels.
#pragma once

#include <algorithm>

namespace fr {

/// Pixels [x0, x1) x [y0, y1) of the raster; y down.
struct PixelRect {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;

  int width() const { return std::max(0, x1 - x0); }
  int height() const { return std::max(0, y1 - y0); }
  long long area() const { return static_cast<long long>(width()) * height(); }
  bool empty() const { return x0 >= x1 || y0 >= y1; }
  bool contains(int x, int y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
  PixelRect grown(int dx, int dy) const { return {x0 - dx, y0 - dy, x1 + dx, y1 + dy}; }
  PixelRect clippedTo(const PixelRect& b) const {
    return {std::max(x0, b.x0), std::max(y0, b.y0), std::min(x1, b.x1), std::min(y1, b.y1)};
  }
  bool operator==(const PixelRect&) const = default;
};

}  // namespace fr
