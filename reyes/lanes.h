// What both rasterising kernels do with vectors, beyond shading/simd.h. For *_kernel.cpp files only.
#pragma once

#include "shading/simd.h"

namespace fr::FR_ISA {

template <class T>
FR_INLINE T load(const void* from) {
  T v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
/// Bit i: lane i is negative; of a comparison's mask: it holds.
FR_INLINE uint32_t maskBits(VI m) {
#if defined(FR_ISA_avx512)
  return uint32_t(_mm512_movepi32_mask((__m512i)m));
#elif defined(FR_ISA_avx2)
  return uint32_t(_mm256_movemask_ps((__m256)m));
#else
  return uint32_t(_mm_movemask_ps((__m128)m));
#endif
}

}  // namespace fr::FR_ISA
