// Places along a Morton (Z-order) curve: neighbours in the order are mostly neighbours in space.
#pragma once

#include <algorithm>
#include <cstdint>

#include "base/math.h"

namespace fr::cache {

/// Spreads the low 20 bits three apart.
inline uint64_t spreadBits(uint64_t x) {
  x &= 0xfffff;
  x = (x | x << 32) & 0x1f00000000ffffull;
  x = (x | x << 16) & 0x1f0000ff0000ffull;
  x = (x | x << 8) & 0x100f00f00f00f00full;
  x = (x | x << 4) & 0x10c30c30c30c30c3ull;
  return (x | x << 2) & 0x1249249249249249ull;
}

/// 60 bits of the place of `p` in the cube over `box`; finite p.
inline uint64_t mortonCode(const Vec3& p, const Box3f& box) {
  const Vec3 size = box.max - box.min;
  const float scale = 1048575.0f / std::max({size.x, size.y, size.z, 1e-30f});
  const auto grid = [](float x) { return uint64_t(std::clamp(x, 0.0f, 1048575.0f)); };
  const Vec3 c = (p - box.min) * scale;
  return spreadBits(grid(c.x)) | spreadBits(grid(c.y)) << 1 | spreadBits(grid(c.z)) << 2;
}

}  // namespace fr::cache
