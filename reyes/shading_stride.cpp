#include "reyes/shading_stride.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace fr::reyes {
namespace {

/// What the raster says of a grid's cells: the largest squared sides, the largest area, and whether some are
/// seen from the front and others from the back.
struct CellsOnRaster {
  float u2 = 0, v2 = 0, area = 0;
  bool turns = false;
  bool finite = true;
};

CellsOnRaster measure(const RasterSpace& space, const cache::GridView& grid) {
  const cache::GridRecord& g = *grid.record;
  const uint32_t nu = g.nu, nv = g.nv;
  CellsOnRaster m;
  std::array<float, cache::kMaxGridSide + 1> rowX[2], rowY[2];
  float largest = 0, smallest = 0;  // signed areas
  for (uint32_t j = 0; j <= nv; ++j) {
    auto &x = rowX[j & 1], &y = rowY[j & 1];
    const auto &lastX = rowX[~j & 1], &lastY = rowY[~j & 1];
    for (uint32_t i = 0; i <= nu; ++i) {
      const Vec4 h = space.homogeneous(grid.vertex(size_t(j) * g.rowStride + i));
      x[i] = h.x / h.z, y[i] = h.y / h.z;
      if (!(h.w >= space.near()) || !(std::abs(x[i]) < kGuardBand) || !(std::abs(y[i]) < kGuardBand)) {
        m.finite = false;
        return m;
      }
      const float ux = i ? x[i] - x[i - 1] : 0.0f, uy = i ? y[i] - y[i - 1] : 0.0f;
      const float vx = j ? x[i] - lastX[i] : 0.0f, vy = j ? y[i] - lastY[i] : 0.0f;
      m.u2 = std::max(m.u2, ux * ux + uy * uy), m.v2 = std::max(m.v2, vx * vx + vy * vy);
      if (i == 0 || j == 0) continue;
      // Half the product of the diagonals.
      const float ax = x[i] - lastX[i - 1], ay = y[i] - lastY[i - 1];
      const float bx = x[i - 1] - lastX[i], by = y[i - 1] - lastY[i];
      const float area = 0.5f * (ax * by - ay * bx);
      largest = std::max(largest, area), smallest = std::min(smallest, area);
    }
  }
  m.area = std::max(largest, -smallest);
  const float little = 1e-3f * m.area;
  m.turns = largest > little && smallest < -little;
  return m;
}

}  // namespace

ShadingStride shadingStride(const RasterSpace& space, const cache::GridView& grid, float area) {
  const cache::GridRecord& g = *grid.record;
  ShadingStride s;
  if (g.kind != cache::GridKind::kGrid || g.nu > cache::kMaxGridSide || !(area > 0)) return s;
  const CellsOnRaster cells = measure(space, grid);
  if (!cells.finite) return s;
  const uint32_t most = cells.turns ? 2 : uint32_t(cache::kMaxGridSide);
  const float longest2 = 2 * area;
  // The shorter side first: cells are best square.
  for (;;) {
    const float u2 = cells.u2 * float(s.u * s.u), v2 = cells.v2 * float(s.v * s.v);
    if (2 * cells.area * float(s.u * s.v) > area) return s;
    const bool canU = 4 * u2 <= longest2 && s.u < most && g.nu % (2 * s.u) == 0;
    const bool canV = 4 * v2 <= longest2 && s.v < most && g.nv % (2 * s.v) == 0;
    if (canU && (u2 <= v2 || !canV))
      s.u *= 2;
    else if (canV)
      s.v *= 2;
    else
      return s;
  }
}

void spreadShading(const cache::GridRecord& grid, ShadingStride stride, const float* from, float* to) {
  const uint32_t nu = grid.nu, nv = grid.nv, columns = nu / stride.u + 1;
  // Where a vertex of a border stands, as in cache::collapsedParameters.
  const auto place = [](uint32_t i, uint32_t n, int shift) {
    return i == n ? i : shift > 15 ? 0u : i >> shift << shift;
  };
  const auto cellOf = [](uint32_t i, uint32_t n, uint32_t step, uint32_t& cell, float& part) {
    cell = std::min(i / step, n / step - 1);
    part = float(i - cell * step) / float(step);
  };
  for (uint32_t j = 0; j <= nv; ++j)
    for (uint32_t i = 0; i <= nu; ++i) {
      const uint32_t x = j == 0    ? place(i, nu, grid.edgeShift[0])
                         : j == nv ? place(i, nu, grid.edgeShift[2])
                                   : i;
      const uint32_t y = i == nu  ? place(j, nv, grid.edgeShift[1])
                         : i == 0 ? place(j, nv, grid.edgeShift[3])
                                  : j;
      uint32_t cellX, cellY;
      float fx, fy;
      cellOf(x, nu, stride.u, cellX, fx), cellOf(y, nv, stride.v, cellY, fy);
      const float* a = from + size_t(cellY) * columns + cellX;
      const float* b = a + columns;
      // Exact at the shaded vertices, also where a neighbouring value is huge.
      const auto mix = [](float p, float q, float t) { return t == 0 ? p : t == 1 ? q : p + t * (q - p); };
      *to++ = mix(mix(a[0], a[1], fx), mix(b[0], b[1], fx), fy);
    }
}

}  // namespace fr::reyes
