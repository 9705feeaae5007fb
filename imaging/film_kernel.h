// The inner loop of the filter step.
#pragma once

#include <cstddef>

namespace fr {

/// Targets of a pixel's samples are padded to multiples of so many.
inline constexpr size_t kFilmLanes = 8;
/// Most padded targets that the kernel takes; wider filters go another way.
inline constexpr size_t kMostFilmTargets = 256;

/// What the samples of one pixel contribute to the pixels around it.
struct FilmPixel {
  size_t samples = 0, targets = 0;  // targets: padded
  /// Weights by sample, one for each target: the weight is x[i][t] * y[i][t] * share.
  const float* const* x = nullptr;
  const float* const* y = nullptr;
  float share = 1;
  size_t channels = 0;
  const float* const* values = nullptr;  // by channel, then by sample
};
/// sums[t] = sum of the weights, sums[(1 + c) targets + t] = sum of weight times channel c; in the order of
/// the samples, the same bits on every instruction set.
using FilmFunction = void (*)(const FilmPixel&, float* sums);
FilmFunction filmFunction();

namespace sse4 {
void addSamples(const FilmPixel&, float* sums);
}
namespace avx2 {
void addSamples(const FilmPixel&, float* sums);
}
namespace avx512 {
void addSamples(const FilmPixel&, float* sums);
}

}  // namespace fr
