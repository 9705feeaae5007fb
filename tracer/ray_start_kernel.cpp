// Compiled once per instruction set (FR_ISA).
#include "tracer/ray_start_kernel.h"

#include <cstring>

// Vectors pass between functions here alone, all of which are inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace fr::tracer::FR_ISA {
namespace {

#define FR_START_INLINE inline __attribute__((always_inline))

// Eight lanes on every set: where registers are shorter the compiler takes two.
constexpr int kLanes = int(kRaysAtOnce);
using F8 = float __attribute__((vector_size(32)));
using I8 = int32_t __attribute__((vector_size(32)));
using U8 = uint32_t __attribute__((vector_size(32)));
using F4 = float __attribute__((vector_size(16)));
using D4 = double __attribute__((vector_size(32)));

/// kRounding of tracer/hit_filter.h.
constexpr float kRounding = 0x1p-18f;

FR_START_INLINE F8 loadOnce(const float* at) {
  F8 v;
  std::memcpy(&v, at, sizeof v);
  asm volatile("" : "+m"(v));
  return v;
}
FR_START_INLINE void store(float* at, F8 v) { std::memcpy(at, &v, sizeof v); }
FR_START_INLINE F8 magnitude(F8 a) { return (F8)((I8)a & 0x7fffffff); }
FR_START_INLINE F8 larger(F8 a, F8 b) { return a > b ? a : b; }
FR_START_INLINE F8 root(F8 a) {
  for (int k = 0; k < kLanes; ++k) a[k] = __builtin_sqrtf(a[k]);
  return a;
}
FR_START_INLINE D4 root(D4 a) {
  for (int k = 0; k < 4; ++k) a[k] = __builtin_sqrt(a[k]);
  return a;
}
FR_START_INLINE D4 half(F8 a, int which) {
  F4 h;
  std::memcpy(&h, reinterpret_cast<const char*>(&a) + 16 * which, sizeof h);
  return __builtin_convertvector(h, D4);
}
FR_START_INLINE int bitsOf(I8 mask) {
  int bits = 0;
  for (int k = 0; k < kLanes; ++k) bits |= (mask[k] & 1) << k;
  return bits;
}

/// Divides directions by their lengths, in double precision; false for what is near the ends of the range.
FR_START_INLINE I8 toUnit(const F8 (&d)[3], F8 (&unit)[3]) {
  F4 parts[3][2], lengths[2];
  for (int h = 0; h < 2; ++h) {
    const D4 x = half(d[0], h), y = half(d[1], h), z = half(d[2], h);
    const D4 length = root(x * x + y * y + z * z);
    lengths[h] = __builtin_convertvector(length, F4);
    parts[0][h] = __builtin_convertvector(x / length, F4);
    parts[1][h] = __builtin_convertvector(y / length, F4);
    parts[2][h] = __builtin_convertvector(z / length, F4);
  }
  for (int k = 0; k < 3; ++k) std::memcpy(&unit[k], parts[k], sizeof unit[k]);
  F8 length;
  std::memcpy(&length, lengths, sizeof length);
  return (length > 1e-30f) & (length < 1e30f);
}

}  // namespace

uint32_t startRays(const AskedColumns& asked, uint32_t first, const LeavingRays& leaving,
                   const StartedColumns& started) {
  F8 o[3], d[3], unit[3];
  for (int k = 0; k < 3; ++k)
    o[k] = loadOnce(asked.origin[k] + first), d[k] = loadOnce(asked.direction[k] + first);
  I8 right = toUnit(d, unit);
  const F8 farthest = larger(larger(magnitude(o[0]), magnitude(o[1])), magnitude(o[2]));
  right &= (farthest < 1e17f) & (o[0] * 0.0f + o[1] * 0.0f + o[2] * 0.0f == 0.0f);
  if (leaving.onSurface) {
    F8 n[3];
    for (int k = 0; k < 3; ++k) n[k] = loadOnce(asked.normal[k] + first);
    const F8 length = root(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    right &= (length > 1e-15f) & (length < 1e15f);
    const F8 along = unit[0] * n[0] + unit[1] * n[1] + unit[2] * n[2];
    right &= magnitude(along / length) > leaving.grazing;
    const F8 one = 1.0f - F8{};
    const F8 perLength = (along < 0.0f ? -one : one) / length;
    const F8 rounding = kRounding * farthest;
    const F8 up = larger(0.125f * rounding, leaving.lift - F8{}), back = 0.0625f * rounding;
    for (int k = 0; k < 3; ++k) o[k] += up * (n[k] * perLength) - back * unit[k];
  }
  for (int k = 0; k < 3; ++k)
    store(started.origin[k] + first, o[k]), store(started.direction[k] + first, unit[k]);
  return uint32_t(bitsOf(right));
}

void nudgeRays(const StartedColumns& started, uint32_t first) {
  F8 d[3];
  for (int k = 0; k < 3; ++k) std::memcpy(&d[k], started.direction[k] + first, sizeof d[k]);
  // mix32() of base/random.h.
  const auto mix = [](U8 x) __attribute__((always_inline)) {
    x ^= x >> 16, x *= 0x7feb352du;
    x ^= x >> 15, x *= 0x846ca68bu;
    return x ^ (x >> 16);
  };
  U8 h = mix((U8)d[0] ^ ((U8)d[1] << 11 | (U8)d[1] >> 21) ^ ((U8)d[2] << 22 | (U8)d[2] >> 10));
  for (int k = 0; k < 3; ++k) {
    const F8 off = __builtin_convertvector((I8)(h & 0x3ff) - 512, F8) * 0x1p-29f;
    store(started.direction[k] + first, d[k] + off);
    h >>= 10;
  }
}

}  // namespace fr::tracer::FR_ISA
