// Columns read at the neighbours of points, with gathers where the instruction set has them. For kernels.
#pragma once

#include <cstring>

#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

FR_INLINE VI laneNumbers(uint32_t first) {
  VI lane{};  // a constant, but for `first`
  for (uint32_t k = 0; k < kLanes; ++k) lane[k] = int32_t(k);
  return lane + int32_t(first);
}
FR_INLINE VI loadIndices(const uint16_t* at) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_cvtepu16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(at)));
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_cvtepu16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(at)));
#else
  typedef uint16_t Narrow __attribute__((vector_size(kLanes * 2)));
  Narrow narrow;
  std::memcpy(&narrow, at, sizeof narrow);
  return __builtin_convertvector(narrow, VI);
#endif
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
/// The lanes of `wanted`; others are not touched, and are `other`.
FR_INLINE V loadSome(const float* at, VI wanted, V other) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_mask_loadu_ps((__m512)other, _mm512_movepi32_mask((__m512i)wanted), at);
#elif defined(FR_ISA_avx2)
  return select(wanted, (V)_mm256_maskload_ps(at, (__m256i)wanted), other);
#else
  for (uint32_t k = 0; k < kLanes; ++k)
    if (wanted[k]) other[k] = at[k];
  return other;
#endif
}

/// The neighbours of a vector of points, the first of which is `first`. They mostly follow one another, but
/// for those at borders, who are their own; and plain loads are much cheaper than a gather.
struct Neighbours {
  VI index, others;  // the second: who has a neighbour
  uint32_t first;
  int32_t step;  // from a point to its neighbour
  bool inRow;
};
/// `in`: the column of indices, some of which have perhaps been replaced by the points themselves in `index`.
FR_INLINE Neighbours neighbours(VI index, const uint16_t* in, uint32_t first) {
  const VI self = laneNumbers(first);
  const int32_t step = int32_t(in[first + kLanes / 2]) - int32_t(first + kLanes / 2);
  const VI others = index != self;
  return {index, others, first, step, !anyLane(others & (index ^ (self + step)))};
}
FR_INLINE V fetch(const float* x, const Neighbours& n) {
  const float* const at = x + n.first;
  return n.inRow ? loadSome(at + n.step, n.others, loadLoose(at)) : gather(x, n.index);
}
FR_INLINE V3 fetch3(const float* x, uint32_t component, const Neighbours& n) {
  const float* const at[] = {x, x + component, x + 2 * size_t(component)};
  if (n.inRow) return {fetch(at[0], n), fetch(at[1], n), fetch(at[2], n)};
  return {gather(at[0], n.index), gather(at[1], n.index), gather(at[2], n.index)};
}

}  // namespace fr::FR_ISA
