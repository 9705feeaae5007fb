// Unit normals in four bytes: the sphere unfolded to a square by way of an octahedron, 16 bits a side (Meyer
// et al., "On floating-point normal vectors", 2010; Cigolle et al., "A survey of efficient representations
// for independent unit vectors", 2014). What is read back is off by at most 5e-5 radians, a twentieth of what
// a pixel of a picture 1000 pixels wide subtends. Internal to scene_cache/ and those who read its grids.
#pragma once

#include <cmath>
#include <cstdint>

#include "base/math.h"

namespace fr::cache {

/// Stands for no normal: (0, 0, 0). No unit vector packs to it.
inline constexpr uint32_t kNoNormal = 0x80008000u;

/// `n`: of length 1, or (0, 0, 0), or not finite, which is no normal either.
inline uint32_t packNormal(const Vec3& n) {
  const float sum = std::abs(n.x) + std::abs(n.y) + std::abs(n.z);
  if (!(sum > 0) || !std::isfinite(sum)) return kNoNormal;
  float x = n.x / sum, y = n.y / sum;
  if (n.z < 0) {
    const float foldedX = std::copysign(1 - std::abs(y), x);
    y = std::copysign(1 - std::abs(x), y), x = foldedX;
  }
  const auto bits = [](float a) { return uint32_t(uint16_t(int16_t(std::lround(a * 32767.0f)))); };
  return bits(x) | bits(y) << 16;
}

inline Vec3 unpackNormal(uint32_t packed) {
  if (packed == kNoNormal) return Vec3(0);
  const auto side = [](uint32_t b) { return float(int16_t(uint16_t(b))) * (1 / 32767.0f); };
  float x = side(packed & 0xffffu), y = side(packed >> 16);
  const float z = 1 - std::abs(x) - std::abs(y);
  if (z < 0) {
    const float foldedX = std::copysign(1 - std::abs(y), x);
    y = std::copysign(1 - std::abs(x), y), x = foldedX;
  }
  return Vec3(x, y, z) / std::sqrt(x * x + y * y + z * z);
}

}  // namespace fr::cache
