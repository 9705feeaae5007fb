// The pixels of a tile that want more samples, round by round, and what all rounds saw.
#pragma once

#include <utility>
#include <vector>

#include "imaging/adaptive_sampling.h"
#include "reyes/sample_buffer.h"
#include "reyes/tile_resolve.h"

namespace fr::reyes {

/// Memory grows with the samples that were taken, not with those that might be.
class AdaptiveTile {
 public:
  void begin(int pixels, int channels, const AdaptiveSampling& sampling);
  /// What to hide the tile for now; valid until add().
  SampleRound round() const { return {have_, want_ - have_, wanted_.data()}; }
  /// Takes the samples of round(), those of pixels that are not wanted too.
  void add(const TileColors& colors);
  bool done() const { return left_ == 0; }
  /// All samples, pixel after pixel, into `out`; returns the number of samples of each pixel.
  const int* gather(TileColors& out);
  PixelErrors errors() const;
  /// Fewest and most samples of a pixel; after gather().
  std::pair<uint64_t, uint64_t> countRange() const;

 private:
  /// Values of the wanted pixels alone: x, y, then the channels, each with `count` numbers a pixel.
  struct Round {
    int count = 0;
    std::vector<uint32_t> place;  // by pixel: which of the wanted ones; kNone
    std::vector<float> values;
    size_t wanted = 0;
  };
  static constexpr uint32_t kNone = 0xffffffffu;

  AdaptiveSampling sampling_;
  int channels_ = 0, have_ = 0, want_ = 0;
  size_t left_ = 0;
  std::vector<uint8_t> wanted_;
  std::vector<PixelNoise> noise_;
  std::vector<Round> rounds_;
  std::vector<int> counts_;
};

}  // namespace fr::reyes
