#include "imaging/adaptive_sampling.h"

#include "base/random.h"
#include "imaging/frame_request.h"

namespace fr {

std::optional<AdaptiveSampling> frameAdaptiveSampling(const cache::Skeleton& skeleton,
                                                      const std::optional<AdaptiveSampling>& asked) {
  constexpr int kMost = 4096;
  std::optional<AdaptiveSampling> a = asked;
  const cache::OptionsRecord& o = skeleton.options();
  if (!a && o.pixelVariance > 0 && skeleton.find(o.options, "render:maxsamples")) {
    a.emplace();
    a->variance = o.pixelVariance;
    const auto samples = [&](const char* name, int otherwise) {
      return int(
          std::clamp(frameFloatOption(skeleton, o.options, name, float(otherwise)), 1.0f, float(kMost)));
    };
    a->minSamples = samples("render:minsamples", a->minSamples);
    a->maxSamples = samples("render:maxsamples", a->maxSamples);
  }
  if (!a) return a;
  a->minSamples = std::clamp(a->minSamples, 1, kMost);
  a->maxSamples = std::clamp(a->maxSamples, a->minSamples, kMost);
  return a;
}

void PixelErrors::filtered(const PixelFilter& filter) {
  // The share of each pixel in a filtered one.
  constexpr int kSteps = 8;
  const int nx = filter.xReach(), ny = filter.yReach();
  double sum = 0, sumOfSquares = 0;
  for (int j = -ny; j <= ny; ++j)
    for (int i = -nx; i <= nx; ++i) {
      double weight = 0;
      for (int b = 0; b < kSteps; ++b)
        for (int a = 0; a < kSteps; ++a)
          weight += double(filter.evaluate(float(i) + (float(a) + 0.5f) / kSteps - 0.5f,
                                           float(j) + (float(b) + 0.5f) / kSteps - 0.5f));
      sum += weight, sumOfSquares += weight * weight;
    }
  if (sum * sum > 0) share = sumOfSquares / (sum * sum);
}

AdaptiveSampling varianceForError(AdaptiveSampling wanted,
                                  const std::function<PixelErrors(const AdaptiveSampling&)>& look) {
  constexpr int kMostLooks = 3;
  // Samples that are spread well, on a picture that is partly smooth.
  constexpr double kUsual = 8;
  const double goal = double(wanted.pictureError) * double(wanted.pictureError);
  double variance = kUsual * goal, before = 0, errorBefore = 0, slope = 1.5;
  AdaptiveSampling a = wanted;
  a.pictureError = 0;
  for (int i = 0; i < kMostLooks; ++i) {
    a.variance = float(variance);
    const double error = look(a).meanSquare();
    if (!(error > 0)) break;  // nothing to be seen
    if (before > 0 && before != variance && error != errorBefore)
      slope = std::clamp(std::log(error / errorBefore) / std::log(variance / before), 0.7, 3.0);
    if (error > 0.8 * goal && error < 1.25 * goal) break;
    before = variance, errorBefore = error;
    variance = std::clamp(variance * std::pow(goal / error, 1 / slope), 1e-3 * goal, 1e3 * goal);
  }
  a.variance = float(variance);
  return a;
}

void keepTilesToLookAt(std::vector<int>& order) {
  constexpr size_t kFew = 64, kSparsest = 16;
  const uint64_t one = std::clamp(order.size() / kFew, size_t(1), kSparsest);
  std::erase_if(order, [&](int tile) { return mix64(uint64_t(tile)) % one != 0; });
}

}  // namespace fr
