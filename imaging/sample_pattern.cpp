#include "imaging/sample_pattern.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>

#include "base/random.h"
#include "base/sobol.h"

namespace fr {
namespace {

/// A step that visits 0 ... n - 1 in leaps of about `fraction` of n.
int coprimeStep(int n, double fraction) {
  int step = std::max(1, int(std::lround(n * fraction)));
  while (std::gcd(step, n) != 1) ++step;
  return step;
}

/// Place `i` of a random order of 0 ... n - 1 (A. Kensler, "Correlated Multi-Jittered Sampling", Pixar
/// Technical Memo 13-01, 2013).
uint32_t permuted(uint32_t i, uint32_t n, uint32_t order) {
  const uint32_t w = std::bit_ceil(n) - 1;
  do {
    i ^= order, i *= 0xe170893du;
    i ^= order >> 16, i ^= (i & w) >> 4;
    i ^= order >> 8, i *= 0x0929eb3fu;
    i ^= order >> 23, i ^= (i & w) >> 1;
    i *= 1 | order >> 27, i *= 0x6935fa69u;
    i ^= (i & w) >> 11, i *= 0x74dcb303u;
    i ^= (i & w) >> 2, i *= 0x9e501cc3u;
    i ^= (i & w) >> 2, i *= 0xc860a3dfu;
    i &= w, i ^= i >> 5;
  } while (i >= n);
  return (i + order) % n;
}

/// Square to disk, areas and neighbourhoods kept (Shirley and Chiu, "A Low Distortion Map Between Disk and
/// Square", 1997).
Vec2 toDisk(const Vec2& square) {
  const float a = 2 * square.x - 1, b = 2 * square.y - 1;
  if (a == 0 && b == 0) return {0, 0};
  constexpr float kQuarter = std::numbers::pi_v<float> / 4;
  const bool wide = std::abs(a) > std::abs(b);
  const float radius = wide ? a : b, angle = wide ? kQuarter * (b / a) : kQuarter * (2 - a / b);
  return {radius * std::cos(angle), radius * std::sin(angle)};
}

/// And back, for sorting alone.
Vec2 toSquare(float x, float y) {
  const float radius = std::sqrt(x * x + y * y);
  constexpr float kQuarter = std::numbers::pi_v<float> / 4;
  float angle = std::atan2(y, x);
  if (angle < -kQuarter) angle += 2 * std::numbers::pi_v<float>;
  float a, b;
  if (angle < kQuarter)
    a = radius, b = angle * a / kQuarter;
  else if (angle < 3 * kQuarter)
    b = radius, a = -(angle - 2 * kQuarter) * b / kQuarter;
  else if (angle < 5 * kQuarter)
    a = -radius, b = (angle - 4 * kQuarter) * a / kQuarter;
  else
    b = -radius, a = -(angle - 6 * kQuarter) * b / kQuarter;
  return {0.5f * (a + 1), 0.5f * (b + 1)};
}

}  // namespace

SamplePattern::SamplePattern(int nx, int ny, bool jitter, uint32_t seed, SampleDimensions dimensions)
    : nx_(nx), ny_(ny), jitter_(jitter), seed_(seed) {
  period_ = !jitter ? 1 : perPixel() > 64 ? 32 : 64;
  offsets_.clear();
  const bool blur = dimensions.time || dimensions.lens;
  const auto step = [](float p) { return int16_t(2 * int(p * float(kSubpixels / 2)) + 1); };
  for (int pixel = 0; pixel < period_ * period_; ++pixel) {
    const auto pixelSeed = uint32_t(hashStep(seed, uint64_t(pixel)));
    const size_t first = offsets_.size();
    for (int s = 0; s < perPixel(); ++s) {
      const Vec2 p = jitter ? sobolOwen2(uint32_t(s), pixelSeed)
                            : Vec2((float(s % nx) + 0.5f) / float(nx), (float(s / nx) + 0.5f) / float(ny));
      offsets_.push_back({step(p.x), step(p.y)});
      if (blur) addBlur(s, jitter, pixelSeed, dimensions);
    }
    const auto all = size_t(perPixel());
    size_t end = dimensions.firstRound > 0 ? std::min(size_t(dimensions.firstRound), all) : all;
    for (size_t begin = 0; begin < all; begin = end, end = std::min(2 * end, all))
      blur ? sortByBlur(first + begin, end - begin, dimensions) : sortByPlace(first + begin, end - begin);
  }
}

float SamplePattern::chance(size_t index) const {
  const auto n = uint32_t(perPixel());
  const auto pixel = uint32_t(hashStep(hashStep(seed_, 0xdece), index / n));
  const auto sample = uint32_t(index % n);
  const float within = jitter_ ? toUnitFloat(mix32(pixel ^ mix32(sample + 1))) : 0.5f;
  return std::min((float(permuted(sample, n, pixel)) + within) / float(n), 0x1.fffffep-1f);
}

void SamplePattern::addBlur(int sample, bool jitter, uint32_t seed, const SampleDimensions& dimensions) {
  const int n = perPixel();
  Blur b;
  Vec2 lens;
  if (jitter) {
    // Time is the third dimension of the pixel's points; the lens has a sequence of its own, so that its two
    // dimensions are as well spread as those of the pixel.
    b.time = sobolOwen(uint32_t(sample), 2, seed);
    lens = sobolOwen2(uint32_t(sample), mix32(seed ^ 0x1e25u));
  } else {
    b.time = (float(sample * coprimeStep(n, 0.618) % n) + 0.5f) / float(n);
    const int cell = sample * coprimeStep(n, 0.382) % n;
    lens = {(float(cell % nx_) + 0.5f) / float(nx_), (float(cell / nx_) + 0.5f) / float(ny_)};
  }
  if (!dimensions.time) b.time = 0;
  if (dimensions.lens) {
    const Vec2 disk = toDisk(lens);
    b.lensX = disk.x, b.lensY = disk.y;
  }
  blurs_.push_back(b);
}

void SamplePattern::sortByPlace(size_t first, size_t n) {
  // Rows of cells of eight; in each row from left to right.
  const size_t cells = std::max<size_t>(1, n / 8),
               rows = std::bit_ceil(size_t(std::ceil(std::sqrt(double(cells)))));
  const auto at = [&](size_t i) { return offsets_.begin() + ptrdiff_t(first + i); };
  std::sort(at(0), at(n), [](Offset a, Offset b) { return a.y != b.y ? a.y < b.y : a.x < b.x; });
  for (size_t row = 0; row < rows; ++row)
    std::sort(at(n * row / rows), at(n * (row + 1) / rows),
              [](Offset a, Offset b) { return a.x != b.x ? a.x < b.x : a.y < b.y; });
}

void SamplePattern::sortByBlur(size_t first, size_t n, const SampleDimensions& dimensions) {
  std::vector<size_t> order(n);
  std::iota(order.begin(), order.end(), first);
  std::vector<float> key(n);
  if (dimensions.time) {
    for (size_t i = 0; i < n; ++i) key[i] = blurs_[first + i].time;
  } else {
    // Row by row over a grid of about n cells.
    const auto side = float(std::max(1, int(std::lround(std::sqrt(double(n))))));
    for (size_t i = 0; i < n; ++i) {
      const Vec2 square = toSquare(blurs_[first + i].lensX, blurs_[first + i].lensY);
      key[i] = std::floor(std::min(square.y, 0.99999f) * side) + 0.999f * square.x;
    }
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return key[a - first] < key[b - first]; });
  const std::vector<Offset> offsets(offsets_.begin() + ptrdiff_t(first),
                                    offsets_.begin() + ptrdiff_t(first + n));
  const std::vector<Blur> blurs(blurs_.begin() + ptrdiff_t(first), blurs_.begin() + ptrdiff_t(first + n));
  for (size_t i = 0; i < n; ++i) {
    offsets_[first + i] = offsets[order[i] - first];
    blurs_[first + i] = blurs[order[i] - first];
  }
}

}  // namespace fr
