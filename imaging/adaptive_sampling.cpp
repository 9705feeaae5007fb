#include "imaging/adaptive_sampling.h"

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

}  // namespace fr
