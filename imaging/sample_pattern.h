// Where the samples of a frame lie within their pixels: the same for every renderer, so that their images can
// be compared sample by sample.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace fr {

/// Raster positions are snapped to this many steps a pixel, so that coverage is decided in exact integers:
/// abutting micropolygons never leave a gap nor overlap.
inline constexpr int kSubpixelBits = 10;
inline constexpr int kSubpixels = 1 << kSubpixelBits;

/// Owen-scrambled Sobol points, differently scrambled in each pixel of a block that repeats over the raster:
/// so the samples of a pixel do not depend on the tile. Without jitter: centres of nx x ny cells. With jitter
/// the first 2^k samples of a pixel are well spread by themselves, for adaptive sampling.
class SamplePattern {
 public:
  SamplePattern() = default;
  SamplePattern(int nx, int ny, bool jitter, uint32_t seed);
  int perPixel() const { return nx_ * ny_; }
  /// Index of the first sample of raster pixel (x, y) in offsets().
  size_t first(int x, int y) const {
    return (size_t(y & (period_ - 1)) * size_t(period_) + size_t(x & (period_ - 1))) * size_t(nx_ * ny_);
  }
  /// Subpixel steps from the pixel's corner, always odd: a sample never lies on the border of a pixel, where
  /// images and crop windows end.
  struct Offset {
    int16_t x, y;
  };
  const std::vector<Offset>& offsets() const { return offsets_; }

 private:
  int nx_ = 1, ny_ = 1, period_ = 1;
  std::vector<Offset> offsets_{{kSubpixels / 2 + 1, kSubpixels / 2 + 1}};
};

}  // namespace fr
