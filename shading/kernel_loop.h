// How a *_kernel.cpp file states a kernel: a function of one vector's lanes, looped over the batch.
#pragma once

#include "shading/kernels.h"
#include "shading/simd.h"
#ifdef FR_ISA_recorded
#include "shading/recorded_kernels.h"
#endif

namespace fr::FR_ISA {

#ifdef FR_ISA_recorded
FR_INLINE V load(const Operand& a, uint32_t, uint32_t c = 0) { return V(a.recorder->read(a.index, c)); }
FR_INLINE void store(const Operand& a, uint32_t, V v, uint32_t c = 0) {
  a.recorder->write(a.index, c, v.node);
}
FR_INLINE VI loadMask(const int32_t*, uint32_t) { return splatInt(-1); }
#define FR_LANE_FUNCTION
#define FR_FLATTEN
#else
FR_INLINE V load(const Operand& a, uint32_t i, uint32_t c = 0) {
  return *reinterpret_cast<const V*>(a.data + size_t(c) * a.component + (i & a.indexMask));
}
FR_INLINE void store(const Operand& a, uint32_t i, V v, uint32_t c = 0) {
  *reinterpret_cast<V*>(a.data + size_t(c) * a.component + (i & a.indexMask)) = v;
}
FR_INLINE VI loadMask(const int32_t* mask, uint32_t i) { return *reinterpret_cast<const VI*>(mask + i); }
#define FR_LANE_FUNCTION __attribute__((always_inline))
#define FR_FLATTEN __attribute__((flatten))
#endif
FR_INLINE V3 load3(const Operand& a, uint32_t i) { return {load(a, i, 0), load(a, i, 1), load(a, i, 2)}; }
FR_INLINE void store3(const Operand& a, uint32_t i, V3 v) {
  store(a, i, v.x, 0), store(a, i, v.y, 1), store(a, i, v.z, 2);
}

/// Runs `F()(operands, lane)` over the batch with a local copy of the first K operands, which the compiler
/// keeps in registers.
template <int K, class F>
FR_FLATTEN void loopKernel(const KernelCall& k) {
  Operand a[K];
  for (int j = 0; j < K; ++j) a[j] = k.arg[j];
  const uint32_t n = k.lanes;
  for (uint32_t i = 0; i < n; i += kLanes) F()(a, i);
}
/// As loopKernel, for functions that also look at the call (mask, matrix, mode, further operands).
template <int K, class F>
FR_FLATTEN void loopKernelCall(const KernelCall& k) {
  Operand a[K];
  for (int j = 0; j < K; ++j) a[j] = k.arg[j];
  const KernelCall call = k;
  for (uint32_t i = 0; i < call.lanes; i += kLanes) F()(a, i, call);
}

}  // namespace fr::FR_ISA

// FR_KERNEL(table slot, operand count, expression over `a` and `i`)
#define FR_KERNEL(slot, K, ...)                                                             \
  {                                                                                         \
    auto laneFunction = [](const Operand* a, uint32_t i) FR_LANE_FUNCTION { __VA_ARGS__; }; \
    (slot) = &loopKernel<K, decltype(laneFunction)>;                                        \
  }
#define FR_KERNEL_CALL(slot, K, ...)                                          \
  {                                                                           \
    auto laneFunction = [](const Operand* a, uint32_t i, const KernelCall& k) \
                            FR_LANE_FUNCTION { __VA_ARGS__; };                \
    (slot) = &loopKernelCall<K, decltype(laneFunction)>;                      \
  }
