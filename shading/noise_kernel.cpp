// Gradient noise in one to four dimensions, periodic noise and cell noise.
//
// K. Perlin, "Improving Noise" (SIGGRAPH 2002), with the permutation table replaced by an integer hash of the
// lattice point (C. Wellons' "lowbias32"): no gathers, no repetition, and every instruction set gives the
// same bits.
#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

void addNoiseKernels(KernelTable& t);

namespace {
constexpr uint32_t kStep[4] = {0x9e3779b1u, 0x85ebca77u, 0xc2b2ae3du, 0x27d4eb2fu};
// 0.5 + kAmplitude[d] * noise: chosen so that 99 % of the values of d dimensions lie in 0..1; the rest is
// clamped.
constexpr float kAmplitude[5] = {0.0f, 1.17f, 0.79f, 0.80f, 0.72f};

FR_INLINE VU hash(VU x) {
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
    lo[i] = (VU)toInt(c) * kStep[i];
    hi[i] = (VU)toInt(c1) * kStep[i];
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
    const VU h = hash(key);
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
    out[c] = clampTo(corner[c][0] * kAmplitude[D] + 0.5f, 0.0f, 1.0f);
  }
}
template <int D, int C>
FR_INLINE void cellNoise(const V* p, V* out) {
  VU key = splatUint(0x51ed270bu);
  for (int i = 0; i < D; ++i) key += (VU)toInt(vfloor(clampTo(p[i], -1.0e9f, 1.0e9f))) * kStep[i];
  VU h = hash(key);
  for (int c = 0; c < C; ++c) {
    out[c] = toFloat((VI)(h >> 8)) * 0x1p-24f;
    h = hash(h + 0x632be59bu);
  }
}

enum class Kind { kNoise, kPeriodic, kCell };
/// Arguments in operand order: float; float float; triple; triple float. S says which.
template <int S>
inline constexpr int kDimensions = S == 0   ? 1
                                   : S == 1 ? 2
                                   : S == 2 ? 3
                                            : 4;
template <int S>
FR_INLINE void loadPoint(const Operand* a, uint32_t i, V* p) {
  if constexpr (S < 2) {
    for (int k = 0; k <= S; ++k) p[k] = load(a[k], i);
  } else {
    for (uint32_t k = 0; k < 3; ++k) p[k] = load(a[0], i, k);
    if constexpr (S == 3) p[3] = load(a[1], i);
  }
}
template <Kind K, int S, int C>
__attribute__((flatten)) void noiseKernel(const KernelCall& call) {
  constexpr int operands = S == 0 || S == 2 ? 1 : 2;
  Operand a[1 + operands * (K == Kind::kPeriodic ? 2 : 1)];
  for (uint32_t k = 0; k < sizeof(a) / sizeof(a[0]); ++k) a[k] = call.arg[k];
  constexpr int D = kDimensions<S>;
  for (uint32_t i = 0; i < call.lanes; i += kLanes) {
    V p[D], out[C];
    loadPoint<S>(a + 1, i, p);
    if constexpr (K == Kind::kPeriodic) {
      V period[D];
      loadPoint<S>(a + 1 + operands, i, period);
      for (int k = 0; k < D; ++k) period[k] = clampTo(vfloor(period[k] + 0.5f), 1.0f, 1.0e6f);
      noise<D, C>(p, period, out);
    } else if constexpr (K == Kind::kNoise) {
      noise<D, C>(p, nullptr, out);
    } else {
      cellNoise<D, C>(p, out);
    }
    for (uint32_t c = 0; c < C; ++c) store(a[0], i, out[c], c);
  }
}
template <Kind K, int C>
void addAll(KernelTable& t, Op f, Op ff, Op p, Op pf) {
  t.op[size_t(f)] = &noiseKernel<K, 0, C>;
  t.op[size_t(ff)] = &noiseKernel<K, 1, C>;
  t.op[size_t(p)] = &noiseKernel<K, 2, C>;
  t.op[size_t(pf)] = &noiseKernel<K, 3, C>;
}
}  // namespace

void addNoiseKernels(KernelTable& t) {
  addAll<Kind::kNoise, 1>(t, Op::noise_f_f, Op::noise_f_ff, Op::noise_f_t, Op::noise_f_tf);
  addAll<Kind::kNoise, 3>(t, Op::noise_t_f, Op::noise_t_ff, Op::noise_t_t, Op::noise_t_tf);
  addAll<Kind::kPeriodic, 1>(t, Op::pnoise_f_f, Op::pnoise_f_ff, Op::pnoise_f_t, Op::pnoise_f_tf);
  addAll<Kind::kPeriodic, 3>(t, Op::pnoise_t_f, Op::pnoise_t_ff, Op::pnoise_t_t, Op::pnoise_t_tf);
  addAll<Kind::kCell, 1>(t, Op::cellnoise_f_f, Op::cellnoise_f_ff, Op::cellnoise_f_t, Op::cellnoise_f_tf);
  addAll<Kind::kCell, 3>(t, Op::cellnoise_t_f, Op::cellnoise_t_ff, Op::cellnoise_t_t, Op::cellnoise_t_tf);
}

}  // namespace fr::FR_ISA
