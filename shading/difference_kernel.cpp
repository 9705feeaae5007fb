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
FR_INLINE VI gather(const int32_t* x, VI index) {
  return bits(gather(reinterpret_cast<const float*>(x), index));
}

void difference(const Difference& d) {
  for (uint32_t i = 0; i < d.lanes; i += kLanes) {
    VI lo = loadIndices(d.lo + i), hi = loadIndices(d.hi + i);
    const VI loActive = gather(d.mask, lo), hiActive = gather(d.mask, hi);
    V scale = loadLoose(d.scale + i);
    if (d.cell) scale *= loadLoose(d.cell + i);
    if (anyLane(~(loActive & hiActive))) {
      VI self;
      for (uint32_t k = 0; k < kLanes; ++k) self[k] = int32_t(i + k);
      const VI central = (lo != self) & (hi != self);
      scale = select(~(loActive & hiActive) & central, scale * 2.0f, scale);
      lo = loActive ? lo : self;
      hi = hiActive ? hi : self;
    }
    *reinterpret_cast<V*>(d.out + i) = (gather(d.x, hi) - gather(d.x, lo)) * scale;
  }
}
}  // namespace

void addDifferenceKernel(KernelTable& t) { t.difference = &difference; }

}  // namespace fr::FR_ISA
