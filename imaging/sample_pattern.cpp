#include "imaging/sample_pattern.h"

#include "base/random.h"
#include "base/sobol.h"

namespace fr {

SamplePattern::SamplePattern(int nx, int ny, bool jitter, uint32_t seed) : nx_(nx), ny_(ny) {
  period_ = !jitter ? 1 : perPixel() > 64 ? 32 : 64;
  offsets_.clear();
  const auto step = [](float p) { return int16_t(2 * int(p * float(kSubpixels / 2)) + 1); };
  for (int pixel = 0; pixel < period_ * period_; ++pixel)
    for (int s = 0; s < perPixel(); ++s) {
      const Vec2 p = jitter ? sobolOwen2(uint32_t(s), uint32_t(hashStep(seed, uint64_t(pixel))))
                            : Vec2((float(s % nx) + 0.5f) / float(nx), (float(s / nx) + 0.5f) / float(ny));
      offsets_.push_back({step(p.x), step(p.y)});
    }
}

}  // namespace fr
