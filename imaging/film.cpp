#include "imaging/film.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "base/error.h"

namespace fr {

namespace {
constexpr size_t kMostPooled = 16;
}

/// What the pixels of one tile contribute to the pixels around them.
struct Film::Splats {
  PixelRect rect;
  /// [pixel][target row][target column][weight, filtered channels...]
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
  if (filter_.separable()) {
    // Weights by place within the pixel: evaluating filters would take longer than all the rest.
    for (int i = 0; i < kWeightSteps; ++i) {
      const float p = (float(i) + 0.5f) / float(kWeightSteps);
      for (int d = -reachX_; d <= reachX_; ++d) weightsX_.push_back(filter_.evaluateX(p - (float(d) + 0.5f)));
      for (int d = -reachY_; d <= reachY_; ++d) weightsY_.push_back(filter_.evaluateY(p - (float(d) + 0.5f)));
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

/// Adds w * value for the samples of one pixel: `values` holds `entry` numbers a sample, the first of them 1.
/// The fixed size is the common one (weight and RGBA), which compilers unroll.
template <size_t kEntry>
void addSamples(const float* wx, const float* wy, int samples, const float* values, size_t entry,
                float* sum) {
  if constexpr (kEntry > 0) {
    float local[kEntry] = {};  // in registers: `sum` might alias `values` for all the compiler knows
    for (int i = 0; i < samples; ++i, values += kEntry) {
      const float w = wx[i] * wy[i];
      for (size_t c = 0; c < kEntry; ++c) local[c] += w * values[c];
    }
    for (size_t c = 0; c < kEntry; ++c) sum[c] = local[c];
  } else {
    for (int i = 0; i < samples; ++i, values += entry) {
      const float w = wx[i] * wy[i];
      for (size_t c = 0; c < entry; ++c) sum[c] += w * values[c];
    }
  }
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
  const size_t entry = size_t(filteredCount_ + 1), mostSamples = size_t(most);
  out->sums.assign(size_t(rect.area()) * size_t(columns * rows) * entry, 0.0f);
  out->ownValues.assign(size_t(rect.area()) * size_t(ownCount_), 0.0f);
  std::vector<float> wx(size_t(columns) * mostSamples), wy(size_t(rows) * mostSamples, 1.0f),
      values(mostSamples * entry, 1.0f);
  const bool separable = filter_.separable();
  float* sum = out->sums.data();
  float* ownValue = out->ownValues.data();
  size_t first = 0;
  for (long long pixel = 0; pixel < rect.area(); ++pixel) {
    const int spp = s.counts ? s.counts[pixel] : s.samplesPerPixel;
    const size_t samples = size_t(spp);
    const float share = s.counts ? 1.0f / float(spp) : 1.0f;
    const float *px = s.x + first, *py = s.y + first;
    size_t at = 1;
    for (size_t r = 0; r < rules_.size(); ++r) {
      const float* from = s.channels[r] + first;
      if (rules_[r] == ChannelRule::kFiltered) {
        for (size_t i = 0; i < samples; ++i) values[i * entry + at] = from[i];
        ++at;
      } else {
        *ownValue++ = ofOwnSamples(rules_[r], from, samples);
      }
    }
    if (separable)
      for (size_t i = 0; i < samples; ++i) {
        const auto cell = [](float p) { return size_t(std::clamp(p, 0.0f, 0.9999f) * float(kWeightSteps)); };
        const float* tx = weightsX_.data() + cell(px[i]) * size_t(columns);
        const float* ty = weightsY_.data() + cell(py[i]) * size_t(rows);
        for (int d = 0; d < columns; ++d) wx[size_t(d) * samples + i] = tx[d] * share;
        for (int d = 0; d < rows; ++d) wy[size_t(d) * samples + i] = ty[d];
      }
    for (int ty = 0; ty < rows; ++ty)
      for (int tx = 0; tx < columns; ++tx, sum += entry) {
        const float* weights = wx.data() + size_t(tx) * samples;
        const float* others = wy.data() + size_t(ty) * samples;
        if (!separable) {  // the whole weight in wx, wy is 1
          for (size_t i = 0; i < samples; ++i)
            wx[i] =
                filter_.evaluate(px[i] - (float(tx - reachX_) + 0.5f), py[i] - (float(ty - reachY_) + 0.5f)) *
                share;
          weights = wx.data();
        }
        if (entry == 5)
          addSamples<5>(weights, others, spp, values.data(), entry, sum);
        else
          addSamples<0>(weights, others, spp, values.data(), entry, sum);
      }
    first += samples;
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
  const size_t entry = size_t(filteredCount_ + 1), pixelEntries = size_t(columns * rows) * entry;
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
          const float* add = s.sums.data() + source * pixelEntries + target * entry;
          for (size_t c = 0; c < entry; ++c) sum[c] += add[c];
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
