// Gradient noise in one to four dimensions, periodic noise and cell noise, on vectors of kLanes points.
//
// K. Perlin, "Improving Noise" (SIGGRAPH 2002), with the permutation table replaced by an integer hash of the
// lattice point (C. Wellons' "lowbias32"): no gathers, no repetition, and every instruction set gives the
// same bits. Included as simd.h is, once per instruction set.
#pragma once

#include "shading/simd.h"

namespace fr::FR_ISA {

inline constexpr uint32_t kNoiseStep[4] = {0x9e3779b1u, 0x85ebca77u, 0xc2b2ae3du, 0x27d4eb2fu};
// 0.5 + kNoiseAmplitude[d] * noise: chosen so that 99 % of the values of d dimensions lie in 0..1; the rest
// is clamped.
inline constexpr float kNoiseAmplitude[5] = {0.0f, 1.17f, 0.79f, 0.80f, 0.72f};

FR_INLINE VU noiseHash(VU x) {
  x ^= x >> 16;
  x *= 0x7feb352du;
  x ^= x >> 15;
  x *= 0x846ca68bu;
  return x ^ (x >> 16);
}
FR_INLINE V fade(V t) { return t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f); }
FR_INLINE V lerp(V t, V a, V b) { return a + t * (b - a); }
FR_INLINE V flipSign(V x, VU h, uint32_t bit) {
  return fromBits(bits(x) ^ (VI)((h << (31 - bit)) & 0x80000000u));
}
/// Gradient number `channel` of a lattice point, times the offset to it.
template <int D>
FR_INLINE V gradient(VU h, const V* d) {
  if constexpr (D == 1) {
    return (toFloat((VI)(h & 1023u)) * (2.0f / 1023.0f) - 1.0f) * d[0];
  } else if constexpr (D == 2) {
    // Eight directions: (+-1, +-1/2) and (+-1/2, +-1).
    const VI swap = (VI)(h & 4u) != 0;
    const V x = select(swap, d[1], d[0]), y = select(swap, d[0], d[1]);
    return flipSign(x, h, 0) + 0.5f * flipSign(y, h, 1);
  } else if constexpr (D == 3) {
    const VU k = h & 15u;
    const V x = select((VI)k < 8, d[0], d[1]);
    const V y = select((VI)k < 4, d[1], select((k == 12u) | (k == 14u), d[0], d[2]));
    return flipSign(x, h, 0) + flipSign(y, h, 1);
  } else {
    // 32 directions: one coordinate left out, signs on the others.
    const VU k = (h >> 3) & 3u;
    const V x = select(k == 0u, d[1], d[0]);
    const V y = select(k <= 1u, d[2], d[1]);
    const V z = select(k == 3u, d[2], d[3]);
    return flipSign(x, h, 0) + flipSign(y, h, 1) + flipSign(z, h, 2);
  }
}

/// `C` noise values (1 or 3) at a point of D dimensions. Periods: nullptr, or D whole numbers >= 1.
template <int D, int C>
FR_INLINE void noise(const V* p, const V* period, V* out) {
  V f[D], w[D];
  VU lo[D], hi[D];
  for (int i = 0; i < D; ++i) {
    // Beyond 2^24 there is nothing between whole numbers; the clamp keeps conversions in range.
    const V x = clampTo(p[i], -1.0e9f, 1.0e9f);
    V c = vfloor(x);
    f[i] = x - c;
    V c1 = c + 1.0f;
    if (period) {
      c = c - period[i] * vfloor(c / period[i]);
      c1 = c1 - period[i] * vfloor(c1 / period[i]);
    }
    lo[i] = (VU)toInt(c) * kNoiseStep[i];
    hi[i] = (VU)toInt(c1) * kNoiseStep[i];
    w[i] = fade(f[i]);
  }
  V corner[C][1 << D];
  for (int k = 0; k < 1 << D; ++k) {
    VU key = splatUint(0x3c6ef372u);
    V d[D];
    for (int i = 0; i < D; ++i) {
      key += (k >> i) & 1 ? hi[i] : lo[i];
      d[i] = (k >> i) & 1 ? f[i] - 1.0f : f[i];
    }
    const VU h = noiseHash(key);
    corner[0][k] = gradient<D>(h, d);
    if constexpr (C == 3) {
      corner[1][k] = gradient<D>(h >> 10, d);
      corner[2][k] = gradient<D>(h >> 20, d);
    }
  }
  for (int c = 0; c < C; ++c) {
    for (int i = 0; i < D; ++i)
      for (int k = 0; k < 1 << (D - 1 - i); ++k)
        corner[c][k] = lerp(w[i], corner[c][2 * k], corner[c][2 * k + 1]);
    out[c] = clampTo(corner[c][0] * kNoiseAmplitude[D] + 0.5f, 0.0f, 1.0f);
  }
}
template <int D, int C>
FR_INLINE void cellNoise(const V* p, V* out) {
  VU key = splatUint(0x51ed270bu);
  for (int i = 0; i < D; ++i) key += (VU)toInt(vfloor(clampTo(p[i], -1.0e9f, 1.0e9f))) * kNoiseStep[i];
  VU h = noiseHash(key);
  for (int c = 0; c < C; ++c) {
    out[c] = toFloat((VI)(h >> 8)) * 0x1p-24f;
    h = noiseHash(h + 0x632be59bu);
  }
}

}  // namespace fr::FR_ISA
