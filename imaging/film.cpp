#include "imaging/film.h"

#include <algorithm>
#include <limits>

#include "base/error.h"

namespace fr {

/// What the pixels of one tile contribute to the pixels around them.
struct Film::Splats {
  PixelRect rect;
  /// [pixel][target row][target column][weight, filtered channels...]
  std::vector<float> sums;
  /// [pixel][minimum channels]
  std::vector<float> minima;
  size_t bytes() const { return (sums.size() + minima.size()) * sizeof(float); }
};

Film::Film(const PixelRect& crop, const PixelFilter& filter, int tileSize, std::vector<ChannelRule> channels)
    : crop_(crop),
      filter_(filter),
      rules_(std::move(channels)),
      reachX_(filter.xReach()),
      reachY_(filter.yReach()) {
  // With tiles at least as large as the reach only the eight neighbours matter.
  tileSize_ = std::clamp(tileSize, std::max({1, reachX_, reachY_}), 1024);
  sampled_ = crop_.grown(reachX_, reachY_);
  tilesX_ = (sampled_.width() + tileSize_ - 1) / tileSize_;
  tilesY_ = (sampled_.height() + tileSize_ - 1) / tileSize_;
  for (ChannelRule r : rules_) (r == ChannelRule::kFiltered ? filteredCount_ : minimumCount_)++;
  const size_t n = size_t(tileCount());
  splats_.resize(n);
  missing_ = std::make_unique<std::atomic<int>[]>(n);
  users_ = std::make_unique<std::atomic<int>[]>(n);
  for (int t = 0; t < tileCount(); ++t) {
    int count = 0;
    forNeighbours(t, [&](int) { ++count; });
    missing_[size_t(t)] = count;
    users_[size_t(t)] = count;
  }
}
Film::~Film() = default;

template <class F>
void Film::forNeighbours(int tile, F&& f) const {
  const int tx = tile % tilesX_, ty = tile / tilesX_;
  const int dx = reachX_ > 0 ? 1 : 0, dy = reachY_ > 0 ? 1 : 0;
  for (int y = std::max(0, ty - dy); y <= std::min(tilesY_ - 1, ty + dy); ++y)
    for (int x = std::max(0, tx - dx); x <= std::min(tilesX_ - 1, tx + dx); ++x) f(y * tilesX_ + x);
}

PixelRect Film::tileRect(int tile) const {
  const int x = sampled_.x0 + (tile % tilesX_) * tileSize_, y = sampled_.y0 + (tile / tilesX_) * tileSize_;
  return PixelRect{x, y, x + tileSize_, y + tileSize_}.clippedTo(sampled_);
}

std::unique_ptr<Film::Splats> Film::splat(const PixelRect& rect, const TileSamples& s) const {
  auto out = std::make_unique<Splats>();
  out->rect = rect;
  const int columns = 2 * reachX_ + 1, rows = 2 * reachY_ + 1, spp = s.samplesPerPixel;
  const size_t entry = size_t(filteredCount_ + 1);
  out->sums.assign(size_t(rect.area()) * size_t(columns * rows) * entry, 0.0f);
  out->minima.assign(size_t(rect.area()) * size_t(minimumCount_), std::numeric_limits<float>::infinity());
  std::vector<float> wx(size_t(columns * spp)), wy(size_t(rows * spp));
  const bool separable = filter_.separable();
  float* sum = out->sums.data();
  float* minimum = out->minima.data();
  for (long long pixel = 0; pixel < rect.area(); ++pixel) {
    const size_t first = size_t(pixel) * size_t(spp);
    // A target pixel d pixels to the right has its centre at d + 0.5.
    if (separable) {
      for (int d = 0; d < columns; ++d)
        for (int i = 0; i < spp; ++i)
          wx[size_t(d * spp + i)] = filter_.evaluateX(s.x[first + size_t(i)] - (float(d - reachX_) + 0.5f));
      for (int d = 0; d < rows; ++d)
        for (int i = 0; i < spp; ++i)
          wy[size_t(d * spp + i)] = filter_.evaluateY(s.y[first + size_t(i)] - (float(d - reachY_) + 0.5f));
    }
    for (int ty = 0; ty < rows; ++ty)
      for (int tx = 0; tx < columns; ++tx, sum += entry)
        for (int i = 0; i < spp; ++i) {
          const size_t k = first + size_t(i);
          const float w = separable ? wx[size_t(tx * spp + i)] * wy[size_t(ty * spp + i)]
                                    : filter_.evaluate(s.x[k] - (float(tx - reachX_) + 0.5f),
                                                       s.y[k] - (float(ty - reachY_) + 0.5f));
          if (w == 0) continue;
          sum[0] += w;
          size_t c = 1;
          for (size_t r = 0; r < rules_.size(); ++r)
            if (rules_[r] == ChannelRule::kFiltered) sum[c++] += w * s.channels[r][k];
        }
    for (size_t r = 0; r < rules_.size(); ++r) {
      if (rules_[r] != ChannelRule::kMinimum) continue;
      for (int i = 0; i < spp; ++i) *minimum = std::min(*minimum, s.channels[r][first + size_t(i)]);
      ++minimum;
    }
  }
  return out;
}

FilmTile Film::gather(int tile) const {
  FilmTile out;
  out.rect = tileRect(tile).clippedTo(crop_);
  if (out.rect.empty()) return out;
  const size_t pixels = size_t(out.rect.area());
  out.channels.assign(rules_.size(), std::vector<float>(pixels));
  const int columns = 2 * reachX_ + 1, rows = 2 * reachY_ + 1;
  const size_t entry = size_t(filteredCount_ + 1);
  std::vector<float> sum(entry);
  size_t k = 0;
  for (int y = out.rect.y0; y < out.rect.y1; ++y)
    for (int x = out.rect.x0; x < out.rect.x1; ++x, ++k) {
      std::fill(sum.begin(), sum.end(), 0.0f);
      for (int sy = y - reachY_; sy <= y + reachY_; ++sy)
        for (int sx = x - reachX_; sx <= x + reachX_; ++sx) {
          const int from = (sy - sampled_.y0) / tileSize_ * tilesX_ + (sx - sampled_.x0) / tileSize_;
          const Splats& s = *splats_[size_t(from)];
          const size_t source = size_t(sy - s.rect.y0) * size_t(s.rect.width()) + size_t(sx - s.rect.x0);
          const size_t target = size_t(y - sy + reachY_) * size_t(columns) + size_t(x - sx + reachX_);
          const float* add = s.sums.data() + (source * size_t(columns * rows) + target) * entry;
          for (size_t c = 0; c < entry; ++c) sum[c] += add[c];
        }
      const float total =
          sum[0] != 0 ? sum[0] : 1.0f;  // divided, not multiplied by 1/total: full coverage is exactly 1
      const Splats& own = *splats_[size_t(tile)];
      const size_t self = size_t(y - own.rect.y0) * size_t(own.rect.width()) + size_t(x - own.rect.x0);
      const float* minimum = own.minima.data() + self * size_t(minimumCount_);
      size_t c = 1;
      for (size_t r = 0; r < rules_.size(); ++r)
        out.channels[r][k] = rules_[r] == ChannelRule::kFiltered ? sum[c++] / total : *minimum++;
    }
  return out;
}

void Film::addTile(int tile, const TileSamples& samples, const Emit& emit) {
  FR_CHECK(tile >= 0 && tile < tileCount());
  auto made = splat(tileRect(tile), samples);
  bytesHeld_ += made->bytes();
  splats_[size_t(tile)] = std::move(made);
  forNeighbours(tile, [&](int t) {
    // acq_rel: whoever brings the count to 0 sees the splats of all that counted down before.
    if (missing_[size_t(t)].fetch_sub(1, std::memory_order_acq_rel) != 1) return;
    FilmTile done = gather(t);
    forNeighbours(t, [&](int user) {
      if (users_[size_t(user)].fetch_sub(1, std::memory_order_acq_rel) != 1) return;
      bytesHeld_ -= splats_[size_t(user)]->bytes();
      splats_[size_t(user)].reset();
    });
    if (!done.rect.empty()) emit(std::move(done));
  });
}

}  // namespace fr
