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

inline constexpr float kLargest = 3.402823466e38f, kSmallestNormal = 1.17549435e-38f;

FR_INLINE V vabs(V a) { return fromBits(bits(a) & 0x7fffffff); }
FR_INLINE V copySign(V magnitude, V sign) {
  return fromBits((bits(magnitude) & 0x7fffffff) | (bits(sign) & (int32_t)0x80000000));
}
FR_INLINE V clampTo(V x, float lo, float hi) { return vmin(vmax(x, splat(lo)), splat(hi)); }
/// 1 where the comparison holds, else 0.
FR_INLINE V toFlag(VI m) { return fromBits(m & bits(splat(1.0f))); }
FR_INLINE V vceil(V x) { return -vfloor(-x); }
/// Halves go away from 0.
FR_INLINE V vround(V x) {
  const V a = vabs(x), whole = vfloor(a);
  return copySign(whole + toFlag(a - whole >= 0.5f), x);
}

/// Below 0: 0.
FR_INLINE V vsqrt(V x) { return rawSqrt(vmax(x, V{})); }
/// a / b, finite: 0 where b is 0.
FR_INLINE V divide(V a, V b) {
  const V q = clampTo(a / b, -kLargest, kLargest);
  return select(b == 0.0f, V{}, q);
}
FR_INLINE V inverseSqrt(V x) { return select(x > 0.0f, splat(1.0f) / rawSqrt(x), V{}); }

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
/// m 2^n for m near 1 and n in -151..95, rounded once, where it is too small for a normal number too.
FR_INLINE V timesExp2(V m, VI n) { return fromBits(bits(m) + ((n + 32) << 23)) * 0x1p-32f; }
/// The same for n in -150..130.
FR_INLINE V timesLargeExp2(V m, VI n) {
  const VI half = n >> 1;
  return m * exp2Int(half) * exp2Int(n - half);
}
/// e^(x + rest) as m 2^n.
FR_INLINE V expParts(V x, V rest, VI& n) {
  const V whole = vfloor(x * 1.44269504088896341f + 0.5f);
  n = toInt(whole);
  return expReduced(((x - whole * 0.693359375f) - whole * -2.12194440e-4f) + rest);
}
struct LargeExp {
  static constexpr RareCase kCase = RareCase::kLargeExp;
  static constexpr int kInputs = 2, kResults = 1;
  static void compute(const V* x, V* result) {
    VI n;
    const V m = expParts(clampTo(x[0], 0.0f, 89.0f), x[1], n);
    result[0] = vmin(timesLargeExp2(m, n), splat(kLargest));
  }
};
/// e^(x + rest), for small rests. Overflow: the largest float.
FR_INLINE V expOfSum(V x, V rest) {
  VI n;
  const V m = expParts(vmax(x, splat(-105.0f)), rest, n);
  const V in[2] = {x, rest};
  V result = timesExp2(m, n);
  rarely<LargeExp>(x > 65.0f, in, &result);
  return result;
}
FR_INLINE V vexp(V x) { return expOfSum(x, V{}); }
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
/// The same of a denormal number.
struct DenormalLog {
  static constexpr RareCase kCase = RareCase::kDenormalLog;
  static constexpr int kInputs = 1, kResults = 2;
  static void compute(const V* x, V* result) {
    result[0] = logReduced(clampTo(x[0] * 0x1p24f, kSmallestNormal, kLargest), result[1]);
    result[1] = result[1] - 24.0f;
  }
};
/// logReduced() of any number above 0 (`positive`); of others, something.
FR_INLINE V logOf(V x, VI positive, V& e) {
  V result[2];
  result[0] = logReduced(clampTo(x, kSmallestNormal, kLargest), result[1]);
  rarely<DenormalLog>((x < kSmallestNormal) & positive, &x, result);
  e = result[1];
  return result[0];
}
/// 0 and below: -1e38.
FR_INLINE V vlog(V x) {
  const VI positive = x > 0.0f;
  V e;
  const V m = logOf(x, positive, e);
  const V r = (m + e * -2.12194440e-4f) + e * 0.693359375f;
  return select(positive, r, splat(-1.0e38f));
}
/// |x|^y as m 2^n, for |x| above 0; n is not an integer's where it is huge.
FR_INLINE V powParts(V x, V y, VI isZero, V& n) {
  V e;
  const V lm = logOf(vabs(x), ~isZero, e);
  // y ln(x) = (y e) ln 2 + y lm, with the integral powers of two taken out before anything is rounded away:
  // twelve bits of y times e are exact.
  const V yc = clampTo(y, -1.0e30f, 1.0e30f);
  const V yh = fromBits(bits(yc) & (int32_t)0xfffff000);
  const V yl = yc * lm;
  n = vfloor(yc * e + yl * 1.44269504088896341f + 0.5f);
  const V k = (yh * e - n) + (yc - yh) * e;
  return expReduced((k * 0.693359375f + yl) - k * 2.12194440e-4f);
}
struct LargePow {
  static constexpr RareCase kCase = RareCase::kLargePow;
  static constexpr int kInputs = 2, kResults = 1;
  static void compute(const V* in, V* result) {
    V n;
    const V m = powParts(in[0], in[1], in[0] == 0.0f, n);
    const V p = timesLargeExp2(m, toInt(clampTo(n, 0.0f, 130.0f)));
    result[0] = select(n > 130.0f, splat(kLargest), vmin(p, splat(kLargest)));
  }
};
/// 0 for a negative base with a fractional exponent and for 0 to a negative power; overflow: the largest
/// float.
FR_INLINE V vpow(V x, V y) {
  const VI isZero = x == 0.0f;
  const V in[2] = {x, y};
  V n;
  const V m = powParts(x, y, isZero, n);
  V p = select(n < -150.0f, V{}, timesExp2(m, toInt(n)));
  rarely<LargePow>((n > 94.0f) & ~isZero, in, &p);
  const V fy = vfloor(y);
  const VI integral = fy == y;
  const VI odd = integral & ((fy - 2.0f * vfloor(fy * 0.5f)) != 0.0f);
  p = select(x < 0.0f, select(integral, select(odd, -p, p), V{}), p);
  p = select(isZero, V{}, p);
  return select(y == 0.0f, splat(1.0f), p);
}

/// Large angles: what is left of them, and in which octant, from as many bits of 2/pi as matter (Payne and
/// Hanek, "Radian reduction for trigonometric functions", 1983). NaN and infinities become 0.
struct LargeAngle {
  static constexpr RareCase kCase = RareCase::kLargeAngle;
  static constexpr int kInputs = 1, kResults = 2;
#ifndef FR_ISA_recorded
  static void compute(const V* x, V* result) {
    static constexpr uint32_t kTwoOverPi[] = {0xa2f9836e, 0x4e441529, 0xfc2757d1, 0xf534ddc0,
                                              0xdb629599, 0x3c439041, 0xfe5163ab, 0xdebbc561};
    __extension__ typedef unsigned __int128 Wide;
    const VI given = bits(x[0]);
    VI octants{};
    for (uint32_t i = 0; i < kLanes; ++i) {
      result[0][i] = 0.0f;
      const uint32_t b = uint32_t(given[i]) & 0x7fffffff;
      const int exponent = int(b >> 23) - 150;  // |x| = mantissa 2^exponent
      if (b >= 0x7f800000 || exponent < -23) continue;
      const Wide mantissa = (b & 0x7fffff) | 0x800000;
      // Bits of 2/pi that only make whole turns are left out; the next 96 matter.
      const int first = exponent > 2 ? exponent - 2 : 0;
      Wide window = 0;
      for (int k = 0; k < 4; ++k) window = window << 32 | kTwoOverPi[first / 32 + k];
      window = (window << (first % 32)) >> 32;
      const Wide product = mantissa * window;
      const int fraction = 96 + first - exponent;  // bits of the product behind the point
      int quadrant = int(product >> fraction) & 3;
      Wide rest = product << (128 - fraction);
      bool below = false;
      if (rest >> 127) rest = Wide(0) - rest, below = true, ++quadrant;
      const double r = double(uint64_t(rest >> 64)) * 0x1p-64 * 1.57079632679489661923;
      result[0][i] = float(below ? -r : r);
      octants[i] = 2 * quadrant;
    }
    result[1] = fromBits(octants);
  }
#endif
};
FR_INLINE void sinCos(V x, V& s, V& c) {
  const V size = vabs(x);
  const VI octant = (toInt(size * 1.27323954473516f) + 1) & ~1;
  const V y = toFloat(octant);
  V reduced[2] = {((size - y * 0.78515625f) - y * 2.4187564849853515625e-4f) - y * 3.77489497744594108e-8f,
                  fromBits(octant)};
  rarely<LargeAngle>(~(size <= 8000.0f), &x, reduced);
  const V a = reduced[0];
  const VI j = bits(reduced[1]);
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
/// erf(x) for |x| < 0.5, by its series.
FR_INLINE V erfNear(V x) {
  const V z = x * x;
  V q = splat(0.00085480f);
  q = q * z - 0.00522398f;
  q = q * z + 0.02686617f;
  q = q * z - 0.11283792f;
  q = q * z + 0.37612639f;
  return (1.12837917f - q * z) * x;
}
/// erfc(a) for a >= 0.47: t P(t) e^(-a^2) with t = 1 / (1 + 0.4 a). P goes through the points at Chebyshev's
/// places; relative error 6e-9 before rounding.
FR_INLINE V erfcFar(V a0) {
  const V a = vmin(a0, splat(11.0f));
  const V t = 1.0f / (a * 0.4f + 1.0f);
  V p = splat(0.06012587552890757f);
  p = p * t - 0.22047396306675104f;
  p = p * t + 0.2285459430088975f;
  p = p * t - 0.05626615448387139f;
  p = p * t + 0.1666110021195732f;
  p = p * t + 0.16114267086462833f;
  p = p * t + 0.20908449849787214f;
  p = p * t + 0.2255618097453281f;
  p = p * t + 0.22567954907693705f;
  // The square in two parts: a last place of it is many of its exponential.
  const V high = fromBits(bits(a) & (int32_t)0xfffff000);
  return p * t * expOfSum(-(high * high), (high - a) * (high + a));
}
FR_INLINE V verf(V x) {
  const V a = vabs(x);
  return copySign(select(a < 0.5f, erfNear(a), 1.0f - erfcFar(a)), x);
}
FR_INLINE V verfc(V x) {
  const V a = vabs(x), far = erfcFar(a);
  return select(a < 0.5f, 1.0f - erfNear(x), select(x < 0.0f, 2.0f - far, far));
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
/// Brings a vector whose squares are out of range into it. `back`: by what its length is to be multiplied.
FR_INLINE V3 intoRange(const V* a, V& back) {
  const V3 c = {clampTo(a[0], -kLargest, kLargest), clampTo(a[1], -kLargest, kLargest),
                clampTo(a[2], -kLargest, kLargest)};
  const VI huge = vmax(vabs(c.x), vmax(vabs(c.y), vabs(c.z))) > 1.0f;
  back = select(huge, splat(0x1p70f), splat(0x1p-100f));
  return scale(c, select(huge, splat(0x1p-70f), splat(0x1p100f)));
}
struct ExtremeLength {
  static constexpr RareCase kCase = RareCase::kLength;
  static constexpr int kInputs = 3, kResults = 1;
  static void compute(const V* a, V* result) {
    V back;
    const V3 b = intoRange(a, back);
    result[0] = vmin(rawSqrt(dot(b, b)) * back, splat(kLargest));
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
    V back;
    const V3 b = intoRange(a, back);
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
