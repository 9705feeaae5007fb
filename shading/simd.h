// Elementary functions on vectors of points, for the kernels.
//
// Included by *_kernel.cpp files only, which are compiled once per instruction set, and once more with values
// that record what is done to them (simd_recorded.h); everything lives in a namespace of that set. Every
// function gives the same bits on every set: IEEE operations without contraction, comparisons and integer
// operations alone. No function traps, and none returns a NaN for finite arguments. Nothing here branches on
// values but rarely(). Polynomials: S. Moshier, Cephes Mathematical Library, single precision.
#pragma once

#ifndef FR_ISA
#error "compile with fr_isa_sources()"
#endif
#ifdef FR_ISA_recorded
#include "shading/simd_recorded.h"
#else
#include "shading/simd_native.h"
#endif
#include "shading/rare_case.h"

namespace fr::FR_ISA {

struct V3 {
  V x, y, z;
};

inline constexpr float kLargest = 3.402823466e38f;

FR_INLINE V vabs(V a) { return fromBits(bits(a) & 0x7fffffff); }
FR_INLINE V copySign(V magnitude, V sign) {
  return fromBits((bits(magnitude) & 0x7fffffff) | (bits(sign) & (int32_t)0x80000000));
}
FR_INLINE V clampTo(V x, float lo, float hi) { return vmin(vmax(x, splat(lo)), splat(hi)); }
/// 1 where the comparison holds, else 0.
FR_INLINE V toFlag(VI m) { return fromBits(m & bits(splat(1.0f))); }
FR_INLINE V vceil(V x) { return -vfloor(-x); }

/// Below 0: 0.
FR_INLINE V vsqrt(V x) { return rawSqrt(vmax(x, V{})); }
/// a / b, finite: 0 where b is 0.
FR_INLINE V divide(V a, V b) {
  const V q = clampTo(a / b, -kLargest, kLargest);
  return select(b == 0.0f, V{}, q);
}
FR_INLINE V inverseSqrt(V x) {
  return select(x > 0.0f, splat(1.0f) / rawSqrt(vmax(x, splat(1.17549435e-38f))), V{});
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
/// The last piece below overflow.
struct ExpTop {
  static constexpr RareCase kCase = RareCase::kExpTop;
  static constexpr int kInputs = 1, kResults = 1;
  static void compute(const V* x, V* result) {
    const V h = expReduced(vmin(x[0] - 88.0f, splat(0.72283905f)));
    result[0] = vmin(h * 1.6516363e38f, splat(kLargest));  // e^88
  }
};
FR_INLINE V vexp(V x) {
  const V c = clampTo(x, -87.0f, 88.0f);
  const V n = vfloor(c * 1.44269504088896341f + 0.5f);
  const V r = (c - n * 0.693359375f) - n * -2.12194440e-4f;
  V e = expReduced(r) * exp2Int(toInt(n));
  rarely<ExpTop>(x > 88.0f, &x, &e);
  return select(x < -87.0f, V{}, e);
}
/// x = m 2^e with m in [sqrt(1/2), sqrt(2)), x > 0 normal. Returns ln(m).
FR_INLINE V logReduced(V x, V& e) {
  const VI b = bits(x);
  VI ei = ((b >> 23) & 0xff) - 126;
  V m = fromBits((b & 0x007fffff) | 0x3f000000);  // [0.5, 1)
  const VI low = m < 0.707106781186547524f;
  e = toFloat(ei + low);
  m = select(low, m + m, m) - 1.0f;
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
  return select(x > 0.0f, r, splat(-1.0e38f));
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
  p = select(n > 127.0f, splat(kLargest), vmin(p, splat(kLargest)));
  p = select(n < -126.0f, V{}, p);
  const V fy = vfloor(y);
  const VI integral = fy == y;
  const VI odd = integral & ((fy - 2.0f * vfloor(fy * 0.5f)) != 0.0f);
  p = select(x < 0.0f, select(integral, select(odd, -p, p), V{}), p);
  p = select(x == 0.0f, V{}, p);
  return select(y == 0.0f, splat(1.0f), p);
}

/// Brings large angles into range in double precision; NaN and infinities become 0.
struct LargeAngle {
  static constexpr RareCase kCase = RareCase::kLargeAngle;
  static constexpr int kInputs = 1, kResults = 1;
#ifndef FR_ISA_recorded
  static void compute(const V* x, V* result) {
    for (uint32_t i = 0; i < kLanes; ++i) {
      const double d = double(x[0][i]);
      if (!(d > -1e15 && d < 1e15)) {
        result[0][i] = 0.0f;
      } else {
        const double t = d * 0.15915494309189533577;
        result[0][i] = float((t - double(int64_t(t))) * 6.283185307179586477);
      }
    }
  }
#endif
};
FR_INLINE void sinCos(V x, V& s, V& c) {
  const V given = x;
  rarely<LargeAngle>(~(vabs(x) <= 8000.0f), &given, &x);
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
  s = fromBits(bits(select(swap, pc, ps)) ^ signS);
  c = fromBits(bits(select(swap, ps, pc)) ^ signC);
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
  const V z = select(big, (1.0f - a) * 0.5f, a * a);
  const V r = asinPolynomial(z, select(big, rawSqrt(z), a));
  return copySign(select(big, 1.57079632679489661923f - (r + r), r), x);
}
FR_INLINE V vacos(V x0) {
  const V x = clampTo(x0, -1.0f, 1.0f);
  const V a = vabs(x);
  const VI big = a > 0.5f;
  const V z = select(big, (1.0f - a) * 0.5f, a * a);
  const V r = asinPolynomial(z, select(big, rawSqrt(z), a));
  const V nearOne = select(x < 0.0f, 3.14159265358979323846f - (r + r), r + r);
  return select(big, nearOne, 1.57079632679489661923f - copySign(r, x));
}
FR_INLINE V vatan(V x) {
  const V a = vabs(x);
  const VI big = a > 2.414213562373095f;
  const VI mid = a > 0.4142135623730950f;
  const V t = select(big, divide(splat(-1.0f), a), select(mid, (a - 1.0f) / (a + 1.0f), a));
  const V base = select(big, splat(1.57079632679489661923f), select(mid, splat(0.785398163397448310f), V{}));
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
  V r = select(x == 0.0f, splat(1.57079632679489661923f), q);
  r = select(x < 0.0f, 3.14159265358979323846f - r, r);
  r = select((y == 0.0f) & (x >= 0.0f), V{}, r);
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
  return copySign(select(a < 0.5f, q * a, large), x);
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
/// Squares of vectors outside of these limits lose digits or are infinite.
FR_INLINE VI extremeSquare(V d) { return ~((d >= 1.0e-30f) & (d <= 1.0e36f)); }
struct ExtremeLength {
  static constexpr RareCase kCase = RareCase::kLength;
  static constexpr int kInputs = 3, kResults = 1;
  static void compute(const V* a, V* result) {
    const V m = vmax(vabs(a[0]), vmax(vabs(a[1]), vabs(a[2])));
    const V inv = select(m > 0.0f, 1.0f / vmax(m, splat(1.17549435e-38f)), V{});
    const V3 b = scale({a[0], a[1], a[2]}, inv);
    result[0] = vmin(m * rawSqrt(dot(b, b)), splat(kLargest));
  }
};
/// Length without overflow or underflow for any finite vector.
FR_INLINE V length(V3 a) {
  const V d = dot(a, a);
  const V in[3] = {a.x, a.y, a.z};
  V result = rawSqrt(d);
  rarely<ExtremeLength>(extremeSquare(d), in, &result);
  return result;
}
struct ExtremeNormalize {
  static constexpr RareCase kCase = RareCase::kNormalize;
  static constexpr int kInputs = 3, kResults = 3;
  static void compute(const V* a, V* result) {
    const V m = vmax(vabs(a[0]), vmax(vabs(a[1]), vabs(a[2])));
    const V3 b = scale({a[0], a[1], a[2]}, select(m > 1.0e15f, splat(1.0e-20f),
                                                  select(m < 1.0e-12f, splat(1.0e20f), splat(1.0f))));
    const V d = dot(b, b);
    const V inv = select(d > 0.0f, 1.0f / rawSqrt(d), V{});
    result[0] = b.x * inv, result[1] = b.y * inv, result[2] = b.z * inv;
  }
};
/// 0 stays 0.
FR_INLINE V3 normalize(V3 a) {
  const V d = dot(a, a);
  const V inv = 1.0f / rawSqrt(d);
  const V in[3] = {a.x, a.y, a.z};
  V result[3] = {a.x * inv, a.y * inv, a.z * inv};
  rarely<ExtremeNormalize>(extremeSquare(d), in, result);
  return {result[0], result[1], result[2]};
}
struct Homogeneous {
  static constexpr RareCase kCase = RareCase::kHomogeneous;
  static constexpr int kInputs = 4, kResults = 3;
  static void compute(const V* p, V* result) {
    for (int k = 0; k < 3; ++k) result[k] = divide(p[k], p[3]);
  }
};

}  // namespace fr::FR_ISA
