// Kernels of noise(), pnoise() and cellnoise().
#include "shading/noise.h"

#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

void addNoiseKernels(KernelTable& t);

namespace {
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
FR_FLATTEN void noiseKernel(const KernelCall& call) {
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
