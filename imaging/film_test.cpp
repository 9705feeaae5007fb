#include "imaging/film.h"

#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "base/random.h"

namespace fr {
namespace {

struct Image {
  PixelRect rect;
  std::vector<std::vector<float>> channels;
  std::vector<int> times;  // how often each pixel came
};

/// Feeds a film with hashed sample positions and f(x, y) as values; order is a permutation by `seed`.
template <class F>
Image filterImage(const PixelRect& crop, const PixelFilter& filter, int tileSize, int spp, uint64_t seed,
                  int threads, F&& f) {
  Film film(crop, filter, tileSize, {ChannelRule::kFiltered, ChannelRule::kMinimum});
  Image image{crop, std::vector<std::vector<float>>(2, std::vector<float>(size_t(crop.area()))),
              std::vector<int>(size_t(crop.area()))};
  std::mutex mutex;
  std::vector<int> order(size_t(film.tileCount()));
  for (int i = 0; i < film.tileCount(); ++i) order[size_t(i)] = i;
  for (size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[hashStep(seed, i) % i]);
  std::atomic<size_t> next{0};
  const auto work = [&] {
    for (size_t k; (k = next++) < order.size();) {
      const int tile = order[k];
      const PixelRect r = film.tileRect(tile);
      std::vector<float> x, y, v;
      for (int py = r.y0; py < r.y1; ++py)
        for (int px = r.x0; px < r.x1; ++px)
          for (int s = 0; s < spp; ++s) {
            const uint64_t h = hashStep(hashStep(uint64_t(px + 1000), uint64_t(py + 1000)), uint64_t(s));
            x.push_back(toUnitFloat64(h)), y.push_back(toUnitFloat64(mix64(h)));
            v.push_back(f(float(px) + x.back(), float(py) + y.back()));
          }
      const float* channels[2] = {v.data(), v.data()};
      film.addTile(tile, {spp, nullptr, x.data(), y.data(), channels}, [&](FilmTile&& t) {
        const std::lock_guard lock(mutex);
        size_t i = 0;
        for (int py = t.rect.y0; py < t.rect.y1; ++py)
          for (int px = t.rect.x0; px < t.rect.x1; ++px, ++i) {
            const size_t to = size_t(py - crop.y0) * size_t(crop.width()) + size_t(px - crop.x0);
            image.times[to]++;
            for (size_t c = 0; c < 2; ++c) image.channels[c][to] = t.channels[c][i];
          }
      });
    }
  };
  std::vector<std::thread> pool;
  for (int i = 1; i < threads; ++i) pool.emplace_back(work);
  work();
  for (auto& t : pool) t.join();
  EXPECT_EQ(film.bytesHeld(), 0u);
  return image;
}

TEST(Film, OwnSamplesOfAPixel) {
  const float infinity = 1e38f, values[] = {3, 1, infinity, 2}, x[] = {0.1f, 0.6f, 0.2f, 0.7f}, y[4] = {};
  const ChannelRule rules[] = {ChannelRule::kMinimum, ChannelRule::kMaximum, ChannelRule::kAverage};
  Film film({0, 0, 1, 1}, PixelFilter(FilterKind::kBox, 1, 1), 8, {std::begin(rules), std::end(rules)});
  const float* channels[] = {values, values, values};
  film.addTile(0, {4, nullptr, x, y, channels}, [&](FilmTile&& t) {
    EXPECT_EQ(t.channels[0][0], 1);
    EXPECT_EQ(t.channels[1][0], infinity);
    EXPECT_EQ(t.channels[2][0], 2);
  });
}

TEST(Film, ConstantStaysConstantForEveryFilter) {
  for (auto name : {"box", "triangle", "catmull-rom", "sinc", "gaussian", "mitchell", "disk", "bessel",
                    "lanczos", "blackman-harris", "separable-catmull-rom"}) {
    const Image i = filterImage({3, 5, 40, 31}, *PixelFilter::byName(name, 4, 3), 8, 9, 1, 1,
                                [](float, float) { return 0.75f; });
    for (float v : i.channels[0]) EXPECT_NEAR(v, 0.75f, 2e-5f) << name;
    for (int t : i.times) EXPECT_EQ(t, 1) << name;
  }
}

TEST(Film, SameBitsForAnyTileSizeOrderAndThreads) {
  const auto f = [](float x, float y) { return std::sin(x * 0.7f) * std::cos(y * 1.3f) + 2; };
  const PixelRect crop{-4, 2, 45, 39};
  const PixelFilter filter(FilterKind::kGaussian, 3.5f, 2.5f);
  const Image reference = filterImage(crop, filter, 64, 5, 1, 1, f);
  for (int size : {2, 3, 7, 16, 32})
    for (int threads : {1, 2, 5}) {
      const Image i = filterImage(crop, filter, size, 5, uint64_t(size * threads), threads, f);
      EXPECT_EQ(i.channels, reference.channels) << size << " " << threads;
    }
}

TEST(Film, CropsAbut) {
  const auto f = [](float x, float y) { return x * 0.37f + std::sin(y); };
  const PixelFilter filter(FilterKind::kCatmullRom, 4, 4);
  const Image whole = filterImage({0, 0, 30, 20}, filter, 8, 4, 1, 1, f);
  const Image left = filterImage({0, 0, 13, 20}, filter, 8, 4, 2, 1, f);
  const Image right = filterImage({13, 0, 30, 20}, filter, 8, 4, 3, 1, f);
  for (int y = 0; y < 20; ++y)
    for (int x = 0; x < 30; ++x) {
      const float part =
          x < 13 ? left.channels[0][size_t(y * 13 + x)] : right.channels[0][size_t(y * 17 + x - 13)];
      EXPECT_EQ(part, whole.channels[0][size_t(y * 30 + x)]);
    }
}

TEST(Film, MinimumIsOfThePixelsOwnSamples) {
  const Image i = filterImage({0, 0, 8, 8}, {FilterKind::kGaussian, 4, 4}, 4, 16, 1, 1,
                              [](float x, float) { return std::floor(x); });
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x) EXPECT_EQ(i.channels[1][size_t(y * 8 + x)], float(x));
}

TEST(Film, LinearRampIsReproducedBySymmetricFilters) {
  const Image i = filterImage({0, 0, 16, 16}, {FilterKind::kTriangle, 2, 2}, 8, 1024, 1, 1,
                              [](float x, float) { return x; });
  for (int x = 0; x < 16; ++x) EXPECT_NEAR(i.channels[0][size_t(5 * 16 + x)], float(x) + 0.5f, 0.03f);
}

TEST(Film, PixelsCountAlikeHoweverManySamplesTheyHave) {
  // The same sample several times over is the same sample.
  const PixelRect crop{0, 0, 12, 9};
  for (const PixelFilter& filter :
       {PixelFilter(FilterKind::kGaussian, 3, 3), PixelFilter(FilterKind::kDisk, 3, 3)}) {
    std::vector<std::vector<float>> images;
    for (const bool adaptive : {false, true}) {
      Film film(crop, filter, 64, {ChannelRule::kFiltered, ChannelRule::kMinimum});
      const PixelRect r = film.tileRect(0);
      std::vector<float> x, y, v;
      std::vector<int> counts;
      for (int py = r.y0; py < r.y1; ++py)
        for (int px = r.x0; px < r.x1; ++px) {
          const uint64_t h = hashStep(uint64_t(px + 1000), uint64_t(py + 1000));
          counts.push_back(adaptive ? 1 + int(h % 7) : 1);
          for (int s = 0; s < counts.back(); ++s) {
            x.push_back(toUnitFloat64(h)), y.push_back(toUnitFloat64(mix64(h)));
            v.push_back(toUnitFloat64(mix64(h + 1)));
          }
        }
      const float* channels[2] = {v.data(), v.data()};
      film.addTile(0, {1, adaptive ? counts.data() : nullptr, x.data(), y.data(), channels},
                   [&](FilmTile&& t) { images.insert(images.end(), t.channels.begin(), t.channels.end()); });
    }
    ASSERT_EQ(images.size(), 4u);
    for (size_t i = 0; i < images[0].size(); ++i) EXPECT_NEAR(images[0][i], images[2][i], 1e-5f);
    EXPECT_EQ(images[1], images[3]);
  }
}

/// Pixels that are known are not emitted, tiles that only they need are not wanted, and the others stay the
/// same.
TEST(Film, KnownTilesAreLeftOut) {
  const PixelRect crop{-3, 2, 40, 37};
  const auto render = [&](const std::vector<int>& known, int* added) {
    Film film(crop, PixelFilter(FilterKind::kGaussian, 3, 3), 8, {ChannelRule::kFiltered});
    for (const int t : known) film.markKnown(t);
    std::vector<float> image(size_t(crop.area()), -1.0f);
    for (int t = 0; t < film.tileCount(); ++t) {
      if (!film.needsTile(t)) continue;
      ++*added;
      const PixelRect r = film.tileRect(t);
      std::vector<float> x, v;
      for (long long i = 0; i < r.area(); ++i) x.push_back(0.25f), v.push_back(float(t) + float(i) / 64);
      const float* channels[1] = {v.data()};
      film.addTile(t, {1, nullptr, x.data(), x.data(), channels}, [&](FilmTile&& done) {
        EXPECT_FALSE(film.isKnown(film.tileOfPixels(done.rect)));
        size_t i = 0;
        for (int py = done.rect.y0; py < done.rect.y1; ++py)
          for (int px = done.rect.x0; px < done.rect.x1; ++px)
            image[size_t((py - crop.y0) * crop.width() + px - crop.x0)] = done.channels[0][i++];
      });
    }
    return image;
  };
  int all = 0, some = 0;
  const std::vector<float> whole = render({}, &all);
  Film film(crop, PixelFilter(FilterKind::kGaussian, 3, 3), 8, {ChannelRule::kFiltered});
  std::vector<int> known;
  for (int t = 0; t < film.tileCount(); ++t)
    if (film.tileRect(t).y0 < 22) known.push_back(t);
  const std::vector<float> rest = render(known, &some);
  EXPECT_LT(some, all);
  EXPECT_GT(some, all - int(known.size()));  // neighbours of what is missing are needed again
  for (int t = 0; t < film.tileCount(); ++t) {
    const PixelRect r = film.tileRect(t).clippedTo(crop);
    const bool isKnown = film.tileRect(t).y0 < 22;
    for (int y = r.y0; y < r.y1; ++y)
      for (int x = r.x0; x < r.x1; ++x) {
        const auto i = size_t((y - crop.y0) * crop.width() + x - crop.x0);
        EXPECT_EQ(rest[i], isKnown ? -1.0f : whole[i]);
      }
    EXPECT_EQ(film.tileOfPixels(r), r.empty() ? -1 : t);
  }
  EXPECT_EQ(film.tileOfPixels({0, 0, 3, 3}), -1);
  EXPECT_EQ(film.tileOfPixels({1000, 1000, 1008, 1008}), -1);
}

}  // namespace
}  // namespace fr
