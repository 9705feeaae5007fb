#include "imaging/film.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "base/error.h"
#include "imaging/film_kernel.h"

namespace fr {

namespace {
constexpr size_t kMostPooled = 16;
}

/// What the pixels of one tile contribute to the pixels around them.
struct Film::Splats {
  PixelRect rect;
  /// [pixel][weight, filtered channels...][target row][target column], targets padded
  std::vector<float> sums;
  /// [pixel][channels of the pixel's own samples]
  std::vector<float> ownValues;
  size_t bytes() const { return (sums.size() + ownValues.size()) * sizeof(float); }
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
  for (ChannelRule r : rules_) (r == ChannelRule::kFiltered ? filteredCount_ : ownCount_)++;
  const size_t columns = size_t(2 * reachX_ + 1), rows = size_t(2 * reachY_ + 1);
  const size_t padded = (columns * rows + kFilmLanes - 1) / kFilmLanes * kFilmLanes;
  const bool isTabulated = filter_.separable() && padded <= kMostFilmTargets;
  targets_ = isTabulated ? padded : columns * rows;
  if (isTabulated) {
    // Weights by place within the pixel: evaluating filters would take longer than all the rest.
    weightsX_.assign(size_t(kWeightSteps) * targets_, 0.0f), weightsY_ = weightsX_;
    for (size_t i = 0; i < size_t(kWeightSteps); ++i) {
      const float p = (float(i) + 0.5f) / float(kWeightSteps);
      for (size_t t = 0; t < columns * rows; ++t) {
        const int dx = int(t % columns) - reachX_, dy = int(t / columns) - reachY_;
        weightsX_[i * targets_ + t] = filter_.evaluateX(p - (float(dx) + 0.5f));
        weightsY_[i * targets_ + t] = filter_.evaluateY(p - (float(dy) + 0.5f));
      }
    }
  }
  const size_t n = size_t(tileCount());
  splats_.resize(n);
  known_.resize(n, 0);
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

void Film::markKnown(int tile) { known_[size_t(tile)] = 1; }

bool Film::needsTile(int tile) const {
  bool needed = false;
  forNeighbours(tile, [&](int t) { needed |= !known_[size_t(t)] && !tileRect(t).clippedTo(crop_).empty(); });
  return needed;
}

int Film::tileOfPixels(const PixelRect& rect) const {
  if (rect.empty() || rect.x0 < crop_.x0 || rect.y0 < crop_.y0) return -1;
  const int x = (rect.x0 - sampled_.x0) / tileSize_, y = (rect.y0 - sampled_.y0) / tileSize_;
  if (x >= tilesX_ || y >= tilesY_) return -1;
  const int tile = y * tilesX_ + x;
  return tileRect(tile).clippedTo(crop_) == rect ? tile : -1;
}

namespace {

/// The value of a pixel by its own samples alone.
float ofOwnSamples(ChannelRule rule, const float* values, size_t n) {
  float result = values[0];
  if (rule == ChannelRule::kAverage) {
    constexpr float kNothingThere = 1e37f;
    double sum = 0;
    size_t count = 0;
    for (size_t i = 0; i < n; ++i)
      if (values[i] < kNothingThere) sum += double(values[i]), ++count;
    return count > 0 ? float(sum / double(count)) : result;
  }
  for (size_t i = 1; i < n; ++i)
    result = rule == ChannelRule::kMaximum ? std::max(result, values[i]) : std::min(result, values[i]);
  return result;
}

}  // namespace

std::unique_ptr<Film::Splats> Film::splat(const PixelRect& rect, const TileSamples& s) const {
  std::unique_ptr<Splats> out;
  {
    const std::lock_guard lock(poolMutex_);
    if (!pool_.empty()) out = std::move(pool_.back()), pool_.pop_back();
  }
  if (!out) out = std::make_unique<Splats>();
  out->rect = rect;
  const int columns = 2 * reachX_ + 1, rows = 2 * reachY_ + 1;
  int most = s.samplesPerPixel;
  if (s.counts) most = *std::max_element(s.counts, s.counts + rect.area());
  const size_t entry = size_t(filteredCount_ + 1);
  out->sums.assign(size_t(rect.area()) * targets_ * entry, 0.0f);
  out->ownValues.assign(size_t(rect.area()) * size_t(ownCount_), 0.0f);
  const auto mostSamples = size_t(most);
  std::vector<const float*> x(mostSamples), y(mostSamples), values(entry);
  const bool isTabulated = !weightsX_.empty();
  const FilmFunction addSamples = filmFunction();
  float* sum = out->sums.data();
  float* ownValue = out->ownValues.data();
  size_t first = 0;
  for (long long pixel = 0; pixel < rect.area(); ++pixel, sum += targets_ * entry) {
    FilmPixel p;
    p.samples = size_t(s.counts ? s.counts[pixel] : s.samplesPerPixel), p.targets = targets_;
    p.share = s.counts ? 1.0f / float(p.samples) : 1.0f;
    const float *px = s.x + first, *py = s.y + first;
    for (size_t r = 0; r < rules_.size(); ++r)
      if (rules_[r] == ChannelRule::kFiltered)
        values[p.channels++] = s.channels[r] + first;
      else
        *ownValue++ = ofOwnSamples(rules_[r], s.channels[r] + first, p.samples);
    p.values = values.data();
    first += p.samples;
    if (isTabulated) {
      for (size_t i = 0; i < p.samples; ++i) {
        const auto cell = [](float at) {
          return size_t(std::clamp(at, 0.0f, 0.9999f) * float(kWeightSteps));
        };
        x[i] = weightsX_.data() + cell(px[i]) * targets_, y[i] = weightsY_.data() + cell(py[i]) * targets_;
      }
      p.x = x.data(), p.y = y.data();
      addSamples(p, sum);
      continue;
    }
    size_t target = 0;
    for (int ty = 0; ty < rows; ++ty)
      for (int tx = 0; tx < columns; ++tx, ++target)
        for (size_t i = 0; i < p.samples; ++i) {
          const float w =
              filter_.evaluate(px[i] - (float(tx - reachX_) + 0.5f), py[i] - (float(ty - reachY_) + 0.5f)) *
              p.share;
          sum[target] += w;
          for (size_t c = 0; c < p.channels; ++c) sum[(1 + c) * targets_ + target] += w * values[c][i];
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
  const int columns = 2 * reachX_ + 1;
  const size_t entry = size_t(filteredCount_ + 1), pixelEntries = targets_ * entry;
  std::vector<float> sum(entry);
  // For each source column: its column of tiles and its place there.
  std::vector<std::pair<int, size_t>> sources;
  for (int sx = out.rect.x0 - reachX_; sx < out.rect.x1 + reachX_; ++sx)
    sources.emplace_back((sx - sampled_.x0) / tileSize_, size_t((sx - sampled_.x0) % tileSize_));
  size_t k = 0;
  for (int y = out.rect.y0; y < out.rect.y1; ++y)
    for (int x = out.rect.x0; x < out.rect.x1; ++x, ++k) {
      std::fill(sum.begin(), sum.end(), 0.0f);
      for (int sy = y - reachY_; sy <= y + reachY_; ++sy) {
        const int tileRow = (sy - sampled_.y0) / tileSize_ * tilesX_;
        for (int sx = x - reachX_; sx <= x + reachX_; ++sx) {
          const auto& [tileColumn, column] = sources[size_t(sx - out.rect.x0 + reachX_)];
          const Splats& s = *splats_[size_t(tileRow + tileColumn)];
          const size_t source = size_t(sy - s.rect.y0) * size_t(s.rect.width()) + column;
          const size_t target = size_t(y - sy + reachY_) * size_t(columns) + size_t(x - sx + reachX_);
          const float* add = s.sums.data() + source * pixelEntries + target;
          for (size_t c = 0; c < entry; ++c) sum[c] += add[c * targets_];
        }
      }
      const float total =
          sum[0] != 0 ? sum[0] : 1.0f;  // divided, not multiplied by 1/total: full coverage is exactly 1
      const Splats& own = *splats_[size_t(tile)];
      const size_t self = size_t(y - own.rect.y0) * size_t(own.rect.width()) + size_t(x - own.rect.x0);
      const float* ownValue = own.ownValues.data() + self * size_t(ownCount_);
      size_t c = 1;
      for (size_t r = 0; r < rules_.size(); ++r)
        out.channels[r][k] = rules_[r] == ChannelRule::kFiltered ? sum[c++] / total : *ownValue++;
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
    FilmTile done;
    if (!known_[size_t(t)]) done = gather(t);
    forNeighbours(t, [&](int user) {
      if (users_[size_t(user)].fetch_sub(1, std::memory_order_acq_rel) != 1) return;
      bytesHeld_ -= splats_[size_t(user)]->bytes();
      const std::lock_guard lock(poolMutex_);
      if (pool_.size() < kMostPooled) pool_.push_back(std::move(splats_[size_t(user)]));
      splats_[size_t(user)].reset();
    });
    if (!done.rect.empty()) emit(std::move(done));
  });
}

}  // namespace fr
