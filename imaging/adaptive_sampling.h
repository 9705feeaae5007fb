// More samples where the picture changes within a pixel, for both renderers: RiPixelVariance within limits.
//
// A pixel gets its first samples, then twice as many again and again, until its own samples say that their
// mean is good enough. So an image depends neither on threads nor on tiles.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "imaging/pixel_filter.h"
#include "scene_cache/cache.h"

namespace fr {

/// Samples are added to a pixel until the estimated variance of its mean (the largest of colour and alpha,
/// colours cut at 1) is no more than `variance`. Sample numbers are powers of two times minSamples.
struct AdaptiveSampling {
  float variance = 0.01f;
  int minSamples = 4, maxSamples = 64;
  /// Above 0: `variance` is to be found so that the picture's error (RMSE) is about this; see
  /// varianceForError().
  float pictureError = 0;
  static AdaptiveSampling toError(double error) {
    // What a pixel's first samples all miss is never looked for: there must be so many of them that it is not
    // worse than the error.
    int first = 8;
    while (first < 256 && double(first) * error < 0.3) first *= 2;
    return {0, first, 1024, float(error)};
  }
};

/// `asked`, or what the RIB asks for: a PixelVariance together with Option "render" "maxsamples".
std::optional<AdaptiveSampling> frameAdaptiveSampling(const cache::Skeleton& skeleton,
                                                      const std::optional<AdaptiveSampling>& asked);

/// The samples of one pixel so far. Welford's update, so nothing cancels; samples come in their order, so
/// that sums do not depend on anything else.
class PixelNoise {
 public:
  static constexpr int kChannels = 4;  // red green blue alpha

  /// Of one sample. What is brighter than white counts as white: its differences are not seen.
  void add(const float (&value)[kChannels]) {
    ++samples_;
    for (int c = 0; c < kChannels; ++c) {
      const float x = std::clamp(value[c], 0.0f, 1.0f), off = x - mean_[c];
      mean_[c] += off / float(samples_);
      squares_[c] += off * (x - mean_[c]);
    }
  }
  /// What comes now is held against what has come.
  void mark() {
    marked_ = samples_;
    std::copy_n(mean_, kChannels, markedMean_);
  }
  uint32_t samples() const { return samples_; }
  /// Estimated variance of the mean, as if samples were independent: the largest of the channels.
  float variance() const {
    if (samples_ < 2) return std::numeric_limits<float>::infinity();
    const float largest = *std::max_element(squares_, squares_ + kChannels);
    return largest / float((samples_ - 1) * samples_);
  }

 private:
  friend struct PixelErrors;
  uint32_t samples_ = 0, marked_ = 0;
  float mean_[kChannels] = {}, squares_[kChannels] = {}, markedMean_[kChannels] = {};
};

/// How far the pixels of a frame are from those of endless samples, from two parts of each pixel's samples:
/// unlike variance(), this knows of well spread samples. Of pixels before any filter, until filtered().
struct PixelErrors {
  /// In fixed point: the sum over a frame does not depend on who adds what first.
  uint64_t squares = 0;
  uint64_t values = 0;
  double share = 1;  // of the errors that the filter leaves

  double meanSquare() const { return values ? share * double(squares) / double(values) / kUnit : 0; }
  double rmse() const { return std::sqrt(meanSquare()); }
  void add(const PixelNoise& p) {
    if (p.marked_ == 0 || p.marked_ == p.samples_) return;
    // Parts of a and b samples differ by variance s (1/a + 1/b), and the mean of all has variance s / (a +
    // b). The mean after `a` samples and the mean of all differ by b / (a + b) of what the parts differ by.
    const double a = p.marked_, b = double(p.samples_) - a;
    for (int c = 0; c < 3; ++c) {
      const double off = double(p.mean_[c]) - double(p.markedMean_[c]);
      squares += uint64_t(off * off * a / b * kUnit);
    }
    values += 3;
  }
  PixelErrors& operator+=(const PixelErrors& o) {
    squares += o.squares, values += o.values;
    return *this;
  }
  /// A filter mixes pixels whose errors have nothing to do with each other.
  void filtered(const PixelFilter& filter);

 private:
  static constexpr double kUnit = 0x1p36;
};

/// Adaptive sampling with the variance at which the whole picture has the error `wanted.pictureError`: many
/// pixels are smooth and cost nothing, so the others may be noisier than the picture. `look` renders some of
/// the picture and says what error that has.
AdaptiveSampling varianceForError(AdaptiveSampling wanted,
                                  const std::function<PixelErrors(const AdaptiveSampling&)>& look);

/// What looks are taken at: some tiles of this size, whatever size the frame's own have, all over the frame.
inline constexpr int kLookTileSize = 16;
void keepTilesToLookAt(std::vector<int>& order);

}  // namespace fr
