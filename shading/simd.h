// Vectors of kLanes floats, and elementary functions on them, for the kernels.
//
// Included by *_kernel.cpp files only, which are compiled once per instruction set; everything lives in a
// namespace of that set. Every function gives the same bits on every set: IEEE operations without
// contraction, comparisons and integer operations alone. No function traps, and none returns a NaN for finite
// arguments. Polynomials: S. Moshier, Cephes Mathematical Library, single precision.
#pragma once

#include <immintrin.h>

#include <cstdint>

#ifndef FR_ISA
#error "compile with fr_isa_sources()"
#endif
#define FR_INLINE static inline __attribute__((always_inline))

namespace fr::FR_ISA {

#if defined(FR_ISA_avx512)
inline constexpr uint32_t kLanes = 16;
#elif defined(FR_ISA_avx2)
inline constexpr uint32_t kLanes = 8;
#else
inline constexpr uint32_t kLanes = 4;
#endif

typedef float V __attribute__((vector_size(kLanes * 4)));
typedef int32_t VI __attribute__((vector_size(kLanes * 4)));
typedef uint32_t VU __attribute__((vector_size(kLanes * 4)));
struct V3 {
  V x, y, z;
};

inline constexpr float kLargest = 3.402823466e38f;

FR_INLINE V splat(float f) { return f - V{}; }
FR_INLINE VI splatInt(int32_t i) { return i - VI{}; }
FR_INLINE VU splatUint(uint32_t i) { return i - VU{}; }
FR_INLINE V select(VI m, V a, V b) { return m ? a : b; }
FR_INLINE VI bits(V v) { return (VI)v; }
FR_INLINE V fromBits(VI v) { return (V)v; }
FR_INLINE V vmin(V a, V b) { return a < b ? a : b; }
FR_INLINE V vmax(V a, V b) { return a > b ? a : b; }
FR_INLINE V vabs(V a) { return (V)((VI)a & 0x7fffffff); }
FR_INLINE V copySign(V magnitude, V sign) {
  return (V)(((VI)magnitude & 0x7fffffff) | ((VI)sign & (int32_t)0x80000000));
}
FR_INLINE V clampTo(V x, float lo, float hi) { return vmin(vmax(x, splat(lo)), splat(hi)); }
/// 1 where the comparison holds, else 0.
FR_INLINE V toFlag(VI m) { return (V)(m & (VI)splat(1.0f)); }
FR_INLINE bool anyLane(VI m) {
#if defined(FR_ISA_avx512)
  return _mm512_test_epi32_mask((__m512i)m, (__m512i)m) != 0;
#elif defined(FR_ISA_avx2)
  return _mm256_testz_si256((__m256i)m, (__m256i)m) == 0;
#else
  return _mm_testz_si128((__m128i)m, (__m128i)m) == 0;
#endif
}
FR_INLINE V rawSqrt(V x) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_maskz_sqrt_ps(0xffff, (__m512)x);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_sqrt_ps((__m256)x);
#else
  return (V)_mm_sqrt_ps((__m128)x);
#endif
}
FR_INLINE V vfloor(V x) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_maskz_roundscale_ps(0xffff, (__m512)x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_floor_ps((__m256)x);
#else
  return (V)_mm_floor_ps((__m128)x);
#endif
}
/// Truncates; out of range: INT_MIN.
FR_INLINE VI toInt(V x) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_maskz_cvttps_epi32(0xffff, (__m512)x);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_cvttps_epi32((__m256)x);
#else
  return (VI)_mm_cvttps_epi32((__m128)x);
#endif
}
FR_INLINE V toFloat(VI x) { return __builtin_convertvector(x, V); }
FR_INLINE V vceil(V x) { return -vfloor(-x); }

/// Below 0: 0.
FR_INLINE V vsqrt(V x) { return rawSqrt(vmax(x, V{})); }
/// a / b, finite: 0 where b is 0.
FR_INLINE V divide(V a, V b) {
  const V q = clampTo(a / b, -kLargest, kLargest);
  return b == 0.0f ? V{} : q;
}
FR_INLINE V inverseSqrt(V x) {
  return x > 0.0f ? splat(1.0f) / rawSqrt(vmax(x, splat(1.17549435e-38f))) : V{};
}

/// 2^n for integral n in -126..127.
FR_INLINE V exp2Int(VI n) { return fromBits((n + 127) << 23); }
/// e^r for |r| <= ln(2)/2 and a little more.
FR_INLINE V expReduced(V r) {
  V p = splat(1.9875691500e-4f);
  p = p * r + 1.3981999507e-3f;
  p = p * r + 8.3334519073e-3f;
  p = p * r + 4.1665795894e-2f;
  p = p * r + 1.6666665459e-1f;
  p = p * r + 5.0000001201e-1f;
  return p * (r * r) + r + 1.0f;
}
FR_INLINE V vexp(V x) {
  const V c = clampTo(x, -87.0f, 88.0f);
  const V n = vfloor(c * 1.44269504088896341f + 0.5f);
  const V r = (c - n * 0.693359375f) - n * -2.12194440e-4f;
  V e = expReduced(r) * exp2Int(toInt(n));
  // The last piece below overflow: e^x = (e^(x/2))^2 stays exact enough.
  const V h = expReduced((c - 88.0f) + vmin(x - c, splat(0.72283905f)));
  const V top = h * 1.6516363e38f;  // e^88
  e = x > 88.0f ? vmin(top, splat(kLargest)) : e;
  return x < -87.0f ? V{} : e;
}
/// x = m 2^e with m in [sqrt(1/2), sqrt(2)), x > 0 normal. Returns ln(m).
FR_INLINE V logReduced(V x, V& e) {
  const VI b = bits(x);
  VI ei = ((b >> 23) & 0xff) - 126;
  V m = fromBits((b & 0x007fffff) | 0x3f000000);  // [0.5, 1)
  const VI low = m < 0.707106781186547524f;
  e = toFloat(ei + low);
  m = (low ? m + m : m) - 1.0f;
  const V z = m * m;
  V p = splat(7.0376836292e-2f);
  p = p * m - 1.1514610310e-1f;
  p = p * m + 1.1676998740e-1f;
  p = p * m - 1.2420140846e-1f;
  p = p * m + 1.4249322787e-1f;
  p = p * m - 1.6668057665e-1f;
  p = p * m + 2.0000714765e-1f;
  p = p * m - 2.4999993993e-1f;
  p = p * m + 3.3333331174e-1f;
  return m + (p * m * z - z * 0.5f);
}
/// 0 and below: -1e38.
FR_INLINE V vlog(V x) {
  V e;
  const V m = logReduced(clampTo(x, 1.17549435e-38f, kLargest), e);
  const V r = (m + e * -2.12194440e-4f) + e * 0.693359375f;
  return x > 0.0f ? r : splat(-1.0e38f);
}
/// 0 for a negative base with a fractional exponent and for 0 to a negative power; overflow: the largest
/// float.
FR_INLINE V vpow(V x, V y) {
  const V ax = vabs(x);
  V e;
  const V lm = logReduced(clampTo(ax, 1.17549435e-38f, kLargest), e);
  // y ln(x) = (y e) ln 2 + y lm, with the integral powers of two taken out before anything is rounded away.
  const V yc = clampTo(y, -1.0e30f, 1.0e30f);
  const V ye = clampTo(yc * e, -1.0e6f, 1.0e6f);
  const V yl = clampTo(yc * lm, -1.0e6f, 1.0e6f);
  const V n = vfloor(ye + yl * 1.44269504088896341f + 0.5f);
  const V k = ye - n;
  const V r = (k * 0.693359375f + yl) - k * 2.12194440e-4f;
  const V nc = clampTo(n, -126.0f, 127.0f);
  V p = expReduced(clampTo(r, -1.0f, 1.0f)) * exp2Int(toInt(nc));
  p = n > 127.0f ? splat(kLargest) : vmin(p, splat(kLargest));
  p = n < -126.0f ? V{} : p;
  const V fy = vfloor(y);
  const VI integral = fy == y;
  const VI odd = integral & ((fy - 2.0f * vfloor(fy * 0.5f)) != 0.0f);
  p = x < 0.0f ? (integral ? (odd ? -p : p) : V{}) : p;
  p = x == 0.0f ? V{} : p;
  return y == 0.0f ? splat(1.0f) : p;
}

/// Brings large angles into range in double precision; NaN and infinities become 0.
static inline __attribute__((noinline)) V reduceLargeAngle(V x) {
  for (uint32_t i = 0; i < kLanes; ++i) {
    const double d = double(x[i]);
    if (!(d > -1e15 && d < 1e15)) {
      x[i] = 0.0f;
    } else if (d > 8000.0 || d < -8000.0) {
      const double t = d * 0.15915494309189533577;
      x[i] = float((t - double(int64_t(t))) * 6.283185307179586477);
    }
  }
  return x;
}
FR_INLINE void sinCos(V x, V& s, V& c) {
  if (__builtin_expect(anyLane(~(vabs(x) < 8000.0f)), 0)) x = reduceLargeAngle(x);
  V a = vabs(x);
  VI j = (toInt(a * 1.27323954473516f) + 1) & ~1;
  const V y = toFloat(j);
  a = ((a - y * 0.78515625f) - y * 2.4187564849853515625e-4f) - y * 3.77489497744594108e-8f;
  const V z = a * a;
  V pc = splat(2.443315711809948e-5f);
  pc = pc * z - 1.388731625493765e-3f;
  pc = pc * z + 4.166664568298827e-2f;
  pc = pc * z * z - z * 0.5f + 1.0f;
  V ps = splat(-1.9515295891e-4f);
  ps = ps * z + 8.3321608736e-3f;
  ps = ps * z - 1.6666654611e-1f;
  ps = ps * z * a + a;
  const VI swap = (j & 2) != 0;
  const VI signS = ((j & 4) << 29) ^ (bits(x) & (int32_t)0x80000000);
  const VI signC = ((j + 2) & 4) << 29;
  s = fromBits(bits(swap ? pc : ps) ^ signS);
  c = fromBits(bits(swap ? ps : pc) ^ signC);
}
FR_INLINE V vsin(V x) {
  V s, c;
  sinCos(x, s, c);
  return s;
}
FR_INLINE V vcos(V x) {
  V s, c;
  sinCos(x, s, c);
  return c;
}
FR_INLINE V asinPolynomial(V z, V a) {
  V p = splat(4.2163199048e-2f);
  p = p * z + 2.4181311049e-2f;
  p = p * z + 4.5470025998e-2f;
  p = p * z + 7.4953002686e-2f;
  p = p * z + 1.6666752422e-1f;
  return p * z * a + a;
}
FR_INLINE V vasin(V x0) {
  const V x = clampTo(x0, -1.0f, 1.0f);
  const V a = vabs(x);
  const VI big = a > 0.5f;
  const V z = big ? (1.0f - a) * 0.5f : a * a;
  const V r = asinPolynomial(z, big ? rawSqrt(z) : a);
  return copySign(big ? 1.57079632679489661923f - (r + r) : r, x);
}
FR_INLINE V vacos(V x0) {
  const V x = clampTo(x0, -1.0f, 1.0f);
  const V a = vabs(x);
  const VI big = a > 0.5f;
  const V z = big ? (1.0f - a) * 0.5f : a * a;
  const V r = asinPolynomial(z, big ? rawSqrt(z) : a);
  const V nearOne = x < 0.0f ? 3.14159265358979323846f - (r + r) : r + r;
  return big ? nearOne : 1.57079632679489661923f - copySign(r, x);
}
FR_INLINE V vatan(V x) {
  const V a = vabs(x);
  const VI big = a > 2.414213562373095f;
  const VI mid = a > 0.4142135623730950f;
  const V t = big ? divide(splat(-1.0f), a) : (mid ? (a - 1.0f) / (a + 1.0f) : a);
  const V base = big ? splat(1.57079632679489661923f) : (mid ? splat(0.785398163397448310f) : V{});
  const V z = t * t;
  V p = splat(8.05374449538e-2f);
  p = p * z - 1.38776856032e-1f;
  p = p * z + 1.99777106478e-1f;
  p = p * z - 3.33329491539e-1f;
  return copySign(base + (p * z * t + t), x);
}
/// atan2(0, 0) is 0.
FR_INLINE V vatan2(V y, V x) {
  const V q = vatan(vmin(divide(vabs(y), vabs(x)), splat(kLargest)));
  V r = x == 0.0f ? splat(1.57079632679489661923f) : q;
  r = x < 0.0f ? 3.14159265358979323846f - r : r;
  r = (y == 0.0f) & (x >= 0.0f) ? V{} : r;
  return copySign(r, y);
}
/// Abramowitz and Stegun 7.1.26 on erfc, with the series near 0; absolute error below 3e-7.
FR_INLINE V verf(V x) {
  const V a = vabs(x);
  const V t = 1.0f / (a * 0.3275911f + 1.0f);
  V p = splat(1.061405429f);
  p = p * t - 1.453152027f;
  p = p * t + 1.421413741f;
  p = p * t - 0.284496736f;
  p = p * t + 0.254829592f;
  const V large = 1.0f - p * t * vexp(-a * a);
  const V z = a * a;
  V q = splat(0.00085480f);
  q = q * z - 0.00522398f;
  q = q * z + 0.02686617f;
  q = q * z - 0.11283792f;
  q = q * z + 0.37612639f;
  q = 1.12837917f - q * z;
  return copySign(a < 0.5f ? q * a : large, x);
}

FR_INLINE V dot(V3 a, V3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FR_INLINE V3 add(V3 a, V3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
FR_INLINE V3 sub(V3 a, V3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
FR_INLINE V3 scale(V3 a, V f) { return {a.x * f, a.y * f, a.z * f}; }
FR_INLINE V3 cross(V3 a, V3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
FR_INLINE V3 select(VI m, V3 a, V3 b) {
  return {select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z)};
}
/// Length without overflow or underflow for any finite vector.
FR_INLINE V length(V3 a) {
  const V m = vmax(vabs(a.x), vmax(vabs(a.y), vabs(a.z)));
  const VI extreme = (m > 1.0e18f) | (m < 1.0e-15f);
  if (__builtin_expect(anyLane(extreme), 0)) {
    const V inv = m > 0.0f ? 1.0f / vmax(m, splat(1.17549435e-38f)) : V{};
    const V3 b = scale(a, inv);
    return select(extreme, vmin(m * rawSqrt(dot(b, b)), splat(kLargest)), rawSqrt(dot(a, a)));
  }
  return rawSqrt(dot(a, a));
}
/// 0 stays 0.
FR_INLINE V3 normalize(V3 a) {
  const V m = vmax(vabs(a.x), vmax(vabs(a.y), vabs(a.z)));
  const VI extreme = (m > 1.0e18f) | (m < 1.0e-15f);
  if (__builtin_expect(anyLane(extreme), 0)) {
    const V down = m > 1.0e18f ? splat(1.0e-20f) : (m < 1.0e-15f ? splat(1.0e20f) : splat(1.0f));
    a = scale(a, down);
  }
  const V d = dot(a, a);
  const V inv = d > 0.0f ? 1.0f / rawSqrt(d) : V{};
  return scale(a, inv);
}

}  // namespace fr::FR_ISA
