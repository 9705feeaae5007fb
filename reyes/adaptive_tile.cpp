#include "reyes/adaptive_tile.h"

#include <algorithm>

namespace fr::reyes {

void AdaptiveTile::begin(int pixels, int channels, const AdaptiveSampling& sampling) {
  sampling_ = sampling, channels_ = channels;
  have_ = 0, want_ = sampling.minSamples;
  left_ = size_t(pixels);
  wanted_.assign(size_t(pixels), 1);
  noise_.assign(size_t(pixels), {});
  rounds_.clear();
}

void AdaptiveTile::add(const TileColors& colors) {
  Round& r = rounds_.emplace_back();
  r.count = want_ - have_;
  r.place.assign(wanted_.size(), kNone);
  for (size_t p = 0; p < wanted_.size(); ++p)
    if (wanted_[p]) r.place[p] = uint32_t(r.wanted++);
  const auto n = size_t(r.count);
  r.values.resize(size_t(2 + channels_) * r.wanted * n);
  const auto take = [&](const std::vector<float>& from, size_t plane) {
    float* to = r.values.data() + plane * r.wanted * n;
    for (size_t p = 0; p < wanted_.size(); ++p)
      if (wanted_[p]) to = std::copy_n(from.begin() + ptrdiff_t(p * n), n, to);
  };
  take(colors.x, 0), take(colors.y, 1);
  for (size_t c = 0; c < size_t(channels_); ++c) take(colors.channels[c], 2 + c);

  for (size_t p = 0; p < wanted_.size(); ++p) {
    if (!wanted_[p]) continue;
    PixelNoise& noise = noise_[p];
    for (size_t i = 0; i < n; ++i) {
      // Half of the first round, then each round, is held against what came before.
      if (have_ == 0 ? i == (n + 1) / 2 : i == 0) noise.mark();
      float value[PixelNoise::kChannels];
      for (size_t c = 0; c < PixelNoise::kChannels; ++c) value[c] = colors.channels[c][p * n + i];
      noise.add(value);
    }
    if (want_ >= sampling_.maxSamples || noise.variance() <= sampling_.variance) wanted_[p] = 0, --left_;
  }
  have_ = want_, want_ = std::min(2 * want_, sampling_.maxSamples);
}

const int* AdaptiveTile::gather(TileColors& out) {
  counts_.assign(wanted_.size(), 0);
  size_t total = 0;
  for (size_t p = 0; p < counts_.size(); ++p) {
    counts_[p] = int(noise_[p].samples());
    total += noise_[p].samples();
  }
  out.x.resize(total), out.y.resize(total);
  out.channels.resize(size_t(channels_));
  for (auto& c : out.channels) c.resize(total);
  size_t to = 0;
  for (size_t p = 0; p < counts_.size(); ++p)
    for (const Round& r : rounds_) {
      if (r.place[p] == kNone) break;
      const auto n = size_t(r.count);
      const float* from = r.values.data() + size_t(r.place[p]) * n;
      const size_t plane = r.wanted * n;
      std::copy_n(from, n, out.x.data() + to);
      std::copy_n(from + plane, n, out.y.data() + to);
      for (size_t c = 0; c < out.channels.size(); ++c)
        std::copy_n(from + (2 + c) * plane, n, out.channels[c].data() + to);
      to += n;
    }
  rounds_.clear();
  return counts_.data();
}

PixelErrors AdaptiveTile::errors() const {
  PixelErrors all;
  for (const PixelNoise& n : noise_) all.add(n);
  return all;
}

std::pair<uint64_t, uint64_t> AdaptiveTile::countRange() const {
  const auto [fewest, most] = std::minmax_element(counts_.begin(), counts_.end());
  return {uint64_t(*fewest), uint64_t(*most)};
}

}  // namespace fr::reyes
