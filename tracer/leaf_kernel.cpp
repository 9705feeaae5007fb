// Compiled once per instruction set (FR_ISA).
#include "tracer/leaf_kernel.h"

#include <immintrin.h>

#include <cmath>
#include <cstring>

namespace fr::tracer::FR_ISA {
namespace {

#define FR_LEAF_INLINE inline __attribute__((always_inline))

// Eight lanes on every set: where registers are shorter the compiler takes two.
constexpr int kLanes = int(kLeafTriangles);
using F8 = float __attribute__((vector_size(32)));
using I8 = int32_t __attribute__((vector_size(32)));
using F4 = float __attribute__((vector_size(16)));
using B32 = uint8_t __attribute__((vector_size(32)));

FR_LEAF_INLINE uint32_t bitsOf(const I8& m) {
#ifdef FR_ISA_sse4
  uint32_t bits = 0;
  for (int h = 0; h < 2; ++h) {
    __m128 half;
    std::memcpy(&half, reinterpret_cast<const char*>(&m) + 16 * h, 16);
    bits |= uint32_t(_mm_movemask_ps(half)) << (4 * h);
  }
  return bits;
#else
  return uint32_t(_mm256_movemask_ps((__m256)m));
#endif
}

/// Coordinate by coordinate, one corner of all triangles.
FR_LEAF_INLINE void gather(const float* vertices, const B32& index, int corner, F8 (&p)[3]) {
  F4 row[kLanes];
  for (int i = 0; i < kLanes; ++i)
    std::memcpy(&row[i], vertices + 3 * uint32_t(index[3 * i + corner]), sizeof row[i]);
  F8 both[4];
  for (int i = 0; i < 4; ++i) both[i] = __builtin_shufflevector(row[i], row[i + 4], 0, 1, 2, 3, 4, 5, 6, 7);
  const F8 &a = both[0], &b = both[1], &c = both[2], &d = both[3];
  const F8 xyOfAB = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
  const F8 xyOfCD = __builtin_shufflevector(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
  const F8 zOfAB = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
  const F8 zOfCD = __builtin_shufflevector(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
  p[0] = __builtin_shufflevector(xyOfAB, xyOfCD, 0, 1, 8, 9, 4, 5, 12, 13);
  p[1] = __builtin_shufflevector(xyOfAB, xyOfCD, 2, 3, 10, 11, 6, 7, 14, 15);
  p[2] = __builtin_shufflevector(zOfAB, zOfCD, 0, 1, 8, 9, 4, 5, 12, 13);
}

/// A corner as the ray sees it: to the sides of the ray, and along its main axis.
struct Seen {
  F8 x, y, z;
};

/// Doubles hold products of two floats, so these signs are right. False: the triangle is not met.
bool meetExactly(const float (&x)[3], const float (&y)[3], const float (&z)[3], double perAxis, double& t,
                 double& u, double& v) {
  const auto product = [](float a, float b) { return double(a) * double(b); };
  const double first = product(x[2], y[1]) - product(y[2], x[1]);
  const double second = product(x[0], y[2]) - product(y[0], x[2]);
  const double third = product(x[1], y[0]) - product(y[1], x[0]);
  if ((first < 0 || second < 0 || third < 0) && (first > 0 || second > 0 || third > 0)) return false;
  const double all = first + second + third;
  if (!(all != 0)) return false;  // seen from the edge: whatever is beside it is met
  u = second / all, v = third / all;
  t = (first / all * double(z[0]) + u * double(z[1]) + v * double(z[2])) * perAxis;
  return true;
}

}  // namespace

void meetLeaf(const LeafRay& ray, const LeafTriangles& triangles, LeafHits& hits) {
  B32 index{};
  if (triangles.count == kLeafTriangles)
    std::memcpy(&index, triangles.indices, 3 * kLeafTriangles);
  else
    for (uint32_t i = 0; i < 3 * triangles.count; ++i) index[i] = triangles.indices[i];
  // Read once: whoever shares the memory may be writing.
  asm("" : "+m"(index));
  index &= (B32)(index <= uint8_t(triangles.vertexCount - 1));
  F8 corner[3][3];
  for (int c = 0; c < 3; ++c) {
    gather(triangles.vertices, index, c, corner[c]);
    if (!triangles.later) continue;
    F8 later[3];
    gather(triangles.later, index, c, later);
    const float part = triangles.part, rest = 1 - part;
    for (int k = 0; k < 3; ++k) corner[c][k] = corner[c][k] * rest + later[k] * part;
  }

  const float* const d = ray.direction;
  const float dx = std::abs(d[0]), dy = std::abs(d[1]), dz = std::abs(d[2]);
  const int axis = dx > dy ? (dx > dz ? 0 : 2) : (dy > dz ? 1 : 2);
  const int side = axis == 2 ? 0 : axis + 1, up = side == 2 ? 0 : side + 1;
  const float shearX = d[side] / d[axis], shearY = d[up] / d[axis], perAxis = 1 / d[axis];
  Seen p[3];
  for (int c = 0; c < 3; ++c) {
    p[c].z = corner[c][axis] - ray.origin[axis];
    p[c].x = (corner[c][side] - ray.origin[side]) - p[c].z * shearX;
    p[c].y = (corner[c][up] - ray.origin[up]) - p[c].z * shearY;
  }
  // Twice the areas opposite to the corners. Rounding keeps the order of products, so their signs are right
  // unless they are 0.
  const F8 first = p[2].x * p[1].y - p[2].y * p[1].x;
  const F8 second = p[0].x * p[2].y - p[0].y * p[2].x;
  const F8 third = p[1].x * p[0].y - p[1].y * p[0].x;
  const F8 all = first + second + third;
  const F8 perAll = 1.0f / all;
  F8 u = second * perAll, v = third * perAll;
  F8 t = (first * perAll * p[0].z + u * p[1].z + v * p[2].z) * perAxis;
  const I8 inside = ((first >= 0.0f) & (second >= 0.0f) & (third >= 0.0f)) |
                    ((first <= 0.0f) & (second <= 0.0f) & (third <= 0.0f));
  const uint32_t there = (1u << triangles.count) - 1;
  uint32_t mask = bitsOf(inside & (all != 0.0f) & (t > ray.near) & (t <= ray.far)) & there;
  // So small numbers have few bits.
  constexpr float kSmall = 1e-30f;
  const uint32_t unsure =
      bitsOf((first == 0.0f) | (second == 0.0f) | (third == 0.0f) | ((all < kSmall) & (all > -kSmall))) &
      there;
  for (uint32_t rest = unsure; rest != 0; rest &= rest - 1) {
    const int i = __builtin_ctz(rest);
    const float x[3] = {p[0].x[i], p[1].x[i], p[2].x[i]};
    const float y[3] = {p[0].y[i], p[1].y[i], p[2].y[i]};
    const float z[3] = {p[0].z[i], p[1].z[i], p[2].z[i]};
    double exact[3];
    mask &= ~(1u << i);
    if (!meetExactly(x, y, z, double(perAxis), exact[0], exact[1], exact[2])) continue;
    t[i] = float(exact[0]), u[i] = float(exact[1]), v[i] = float(exact[2]);
    if (t[i] > ray.near && t[i] <= ray.far) mask |= 1u << i;
  }
  hits.mask = mask;
  if (mask == 0) return;
  std::memcpy(hits.distance, &t, sizeof t);
  std::memcpy(hits.u, &u, sizeof u), std::memcpy(hits.v, &v, sizeof v);
  for (int k = 0; k < 3; ++k) {
    const int a = k == 2 ? 0 : k + 1, b = a == 2 ? 0 : a + 1;
    const F8 n = (corner[1][a] - corner[0][a]) * (corner[2][b] - corner[0][b]) -
                 (corner[1][b] - corner[0][b]) * (corner[2][a] - corner[0][a]);
    std::memcpy(hits.normal[k], &n, sizeof n);
  }
}

}  // namespace fr::tracer::FR_ISA
