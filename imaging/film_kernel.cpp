// Compiled once per instruction set (FR_ISA).
#include "imaging/film_kernel.h"

namespace fr::FR_ISA {
namespace {

#ifdef FR_ISA_sse4
constexpr size_t kWidth = 4;
#else
constexpr size_t kWidth = kFilmLanes;
#endif
typedef float Lanes __attribute__((vector_size(kWidth * 4)));

inline Lanes load(const float* from) {
  Lanes v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
inline void store(float* to, Lanes v) { __builtin_memcpy(to, &v, sizeof v); }

/// kCount channels from `first` on, for kWidth targets; the sum of the weights too when first is 0.
template <size_t kCount>
void addChannels(const FilmPixel& p, size_t target, size_t first, float* sums) {
  Lanes weights = {}, sum[kCount > 0 ? kCount : 1] = {};
  for (size_t i = 0; i < p.samples; ++i) {
    const Lanes w = load(p.x[i] + target) * p.share * load(p.y[i] + target);
    weights += w;
    for (size_t c = 0; c < kCount; ++c) sum[c] += w * p.values[first + c][i];
  }
  if (first == 0) store(sums + target, weights);
  for (size_t c = 0; c < kCount; ++c) store(sums + (1 + first + c) * p.targets + target, sum[c]);
}

}  // namespace

void addSamples(const FilmPixel& p, float* sums) {
  for (size_t target = 0; target < p.targets; target += kWidth) {
    if (p.channels == 0) addChannels<0>(p, target, 0, sums);
    size_t c = 0;
    for (; c + 4 <= p.channels; c += 4) addChannels<4>(p, target, c, sums);
    for (; c < p.channels; ++c) addChannels<1>(p, target, c, sums);
  }
}

}  // namespace fr::FR_ISA
