// Differences between neighbours, with gathers where the instruction set has them.
#include <cstring>

#include "shading/kernel_loop.h"

namespace fr::FR_ISA {

void addDifferenceKernel(KernelTable& t);

namespace {
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
/// Neighbours mostly follow one another, and a plain load is much cheaper than a gather.
FR_INLINE V fetch(const float* x, VI index, VI lane) {
  const VI first = index[0] + lane;
  return anyLane(index != first) ? gather(x, index) : loadLoose(x + index[0]);
}

void difference(const Difference& d) {
  VI lane;
  for (uint32_t k = 0; k < kLanes; ++k) lane[k] = int32_t(k);
  for (uint32_t i = 0; i < d.lanes; i += kLanes) {
    VI lo = loadIndices(d.lo + i), hi = loadIndices(d.hi + i);
    V scale = loadLoose(d.scale + i);
    if (d.cell) scale *= loadLoose(d.cell + i);
    if (d.mask) {
      const auto* const mask = reinterpret_cast<const float*>(d.mask);
      const VI loActive = bits(gather(mask, lo)), hiActive = bits(gather(mask, hi));
      const VI self = int32_t(i) + lane, one = ~(loActive & hiActive);
      scale = select(one & (lo != self) & (hi != self), scale * 2.0f, scale);
      lo = loActive ? lo : self;
      hi = hiActive ? hi : self;
    }
    *reinterpret_cast<V*>(d.out + i) = (fetch(d.x, hi, lane) - fetch(d.x, lo, lane)) * scale;
  }
}
}  // namespace

void addDifferenceKernel(KernelTable& t) { t.difference = &difference; }

}  // namespace fr::FR_ISA
