// Columns read at the neighbours of points, with gathers where the instruction set has them. For kernels.
#pragma once

#include <cstring>

#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

FR_INLINE VI laneNumbers(uint32_t first) {
  VI lane;
  for (uint32_t k = 0; k < kLanes; ++k) lane[k] = int32_t(first + k);
  return lane;
}
FR_INLINE VI loadIndices(const uint16_t* at) {
  typedef uint16_t Narrow __attribute__((vector_size(kLanes * 2)));
  Narrow narrow;
  std::memcpy(&narrow, at, sizeof narrow);
  return __builtin_convertvector(narrow, VI);
}
FR_INLINE V loadLoose(const float* at) {
  V v;
  std::memcpy(&v, at, sizeof v);
  return v;
}
FR_INLINE void storeLoose(float* at, V v) { std::memcpy(at, &v, sizeof v); }
FR_INLINE V gather(const float* x, VI index) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_i32gather_ps((__m512i)index, x, 4);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_i32gather_ps(x, (__m256i)index, 4);
#else
  V r;
  for (uint32_t k = 0; k < kLanes; ++k) r[k] = x[index[k]];
  return r;
#endif
}

/// The neighbours of a vector of points. They mostly follow one another, and a plain load is much cheaper
/// than a gather.
struct Neighbours {
  VI index;
  bool inRow;
};
FR_INLINE Neighbours neighbours(VI index) {
  const VI row = index[0] + laneNumbers(0);
  return {index, !anyLane(index != row)};
}
FR_INLINE V fetch(const float* x, const Neighbours& n) {
  return n.inRow ? loadLoose(x + n.index[0]) : gather(x, n.index);
}
FR_INLINE V3 fetch3(const float* x, uint32_t component, const Neighbours& n) {
  return {fetch(x, n), fetch(x + component, n), fetch(x + 2 * size_t(component), n)};
}

}  // namespace fr::FR_ISA
