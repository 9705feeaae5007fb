#include "reyes/visible_points.h"

#include <bitset>

namespace fr::reyes {

size_t visiblePoints(const cache::GridRecord& grid, ShadingStride stride, const TriangleSet& seen,
                     const uint8_t* indices) {
  constexpr size_t kSide = cache::kMaxGridSide + 1;
  std::bitset<std::max(kSide * kSide, size_t(cache::kMaxMeshletVertices))> points;
  if (grid.kind == cache::GridKind::kMeshlet) {
    for (uint32_t t = 0; t < grid.nv; ++t)
      if (seen.contains(t))
        for (int c = 0; c < 3; ++c) points.set(indices[3 * t + uint32_t(c)]);
    return points.count();
  }
  for (uint32_t j = 0; j < grid.nv; ++j)
    for (uint32_t i = 0; i < grid.nu; ++i) {
      const uint32_t cell = j * grid.nu + i;
      if (!seen.contains(2 * cell) && !seen.contains(2 * cell + 1)) continue;
      const size_t x = i / stride.u, y = j / stride.v;
      for (const size_t at : {y * kSide + x, y * kSide + x + 1, (y + 1) * kSide + x, (y + 1) * kSide + x + 1})
        points.set(at);
    }
  return points.count();
}

}  // namespace fr::reyes
