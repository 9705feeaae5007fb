#include "reyes/grid_projection.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

namespace fr::reyes {
namespace {

/// Both are exact: kSubpixels is a power of two.
int32_t snap(float raster, int origin) {
  return int32_t(std::lrint(raster * float(kSubpixels))) - origin * kSubpixels;
}

struct ClipVertex {
  double x, y, w, z;
  int original;  // index of an unclipped vertex of the grid, or -1
};

ClipVertex between(ClipVertex a, ClipVertex b, double da, double db) {
  // In one order, whichever triangle asks: neighbours get the same bits.
  if (std::tie(b.x, b.y, b.w, b.z) < std::tie(a.x, a.y, a.w, a.z)) std::swap(a, b), std::swap(da, db);
  const double t = da / (da - db);
  return {a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.w + t * (b.w - a.w), a.z + t * (b.z - a.z), -1};
}

}  // namespace

void projectGrid(const RasterSpace& space, const float* positions, int columns, int rows, size_t rowStride,
                 const PixelRect& tile, ProjectedGrid& out) {
  const size_t n = size_t(columns) * size_t(rows);
  out.x.resize(n), out.y.resize(n), out.key.resize(n), out.state.resize(n);
  out.anyClipped = false;
  const float near = space.near();
  const bool perspective = space.perspective();
  int32_t x0 = INT32_MAX, x1 = INT32_MIN, y0 = INT32_MAX, y1 = INT32_MIN;
  float nearest = kInfinity;
  size_t k = 0;
  for (int row = 0; row < rows; ++row) {
    const float* p = positions + size_t(row) * rowStride * 3;
    for (int column = 0; column < columns; ++column, ++k, p += 3) {
      const Vec4 h = space.homogeneous({p[0], p[1], p[2]});
      const float rx = h.x / h.z, ry = h.y / h.z;
      const bool finite = std::isfinite(h.x) && std::isfinite(h.y) && std::isfinite(h.w);
      if (!finite || h.w < near || !(std::abs(rx) < kGuardBand) || !(std::abs(ry) < kGuardBand)) {
        out.state[k] = finite ? kVertexClipped : kVertexInvalid;
        out.x[k] = out.y[k] = 0, out.key[k] = 0;
        out.anyClipped |= finite;
        continue;
      }
      out.state[k] = kVertexDrawn;
      out.x[k] = snap(rx, tile.x0), out.y[k] = snap(ry, tile.y0);
      out.key[k] = perspective ? -1 / h.w : h.w;
      x0 = std::min(x0, out.x[k]), x1 = std::max(x1, out.x[k]);
      y0 = std::min(y0, out.y[k]), y1 = std::max(y1, out.y[k]);
      nearest = std::min(nearest, out.key[k]);
    }
  }
  if (out.anyClipped) {
    out.bounds = {-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity, false};
    return;
  }
  const auto pixel = [](int32_t s, int origin) { return float(s) / float(kSubpixels) + float(origin); };
  // Interpolated keys may round below those of the vertices.
  const float key = nearest - 1e-6f * std::abs(nearest);
  out.bounds = {pixel(x0, tile.x0), pixel(y0, tile.y0), pixel(x1, tile.x0), pixel(y1, tile.y0), key, x0 > x1};
}

ClippedPolygon clipTriangle(const RasterSpace& space, const float* positions, int columns, size_t rowStride,
                            const PixelRect& tile, const ProjectedGrid& grid, const uint32_t v[3]) {
  std::array<ClipVertex, 12> a, b;
  int n = 3;
  for (size_t i = 0; i < 3; ++i) {
    const size_t row = v[i] / uint32_t(columns), column = v[i] % uint32_t(columns);
    const float* p = positions + (row * rowStride + column) * 3;
    const Vec4 h = space.homogeneous({p[0], p[1], p[2]});
    a[i] = {double(h.x), double(h.y), double(h.z), double(h.w),
            grid.state[v[i]] == kVertexDrawn ? int(v[i]) : -1};
  }
  const double near = double(space.near()), guard = double(kGuardBand);
  for (int plane = 0; plane < 5 && n >= 3; ++plane) {
    const auto distance = [&](const ClipVertex& c) {
      switch (plane) {
        case 0:
          return c.z - near;
        case 1:
          return guard * c.w - c.x;
        case 2:
          return guard * c.w + c.x;
        case 3:
          return guard * c.w - c.y;
        default:
          return guard * c.w + c.y;
      }
    };
    int kept = 0;
    for (int i = 0; i < n; ++i) {
      const ClipVertex &from = a[size_t(i)], &to = a[size_t((i + 1) % n)];
      const double d0 = distance(from), d1 = distance(to);
      if (d0 >= 0) b[size_t(kept++)] = from;
      if ((d0 >= 0) != (d1 >= 0)) b[size_t(kept++)] = between(from, to, d0, d1);
    }
    n = kept;
    std::swap(a, b);
  }
  ClippedPolygon out;
  if (n < 3) return out;
  for (int i = 0; i < n; ++i) {
    const ClipVertex& c = a[size_t(i)];
    if (c.original >= 0) {
      const size_t k = size_t(c.original);
      out.x[i] = grid.x[k], out.y[i] = grid.y[k], out.key[i] = grid.key[k];
    } else {
      const double limit = guard + 1;
      out.x[i] = snap(float(std::clamp(c.x / c.w, -limit, limit)), tile.x0);
      out.y[i] = snap(float(std::clamp(c.y / c.w, -limit, limit)), tile.y0);
      out.key[i] = space.key(float(c.z));
    }
  }
  out.count = n;
  return out;
}

}  // namespace fr::reyes
