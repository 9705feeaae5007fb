// The vector loops of dicing against one piece, or one point, at a time.
#include "scene_cache/dice_metric.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>

#include "base/random.h"
#include "scene_cache/grid_measure.h"

namespace fr::cache {
namespace {

class Chance {
 public:
  explicit Chance(uint64_t seed) : state_(seed) {}
  float operator()(float low, float high) {
    return low + (high - low) * toUnitFloat(uint32_t(mix64(++state_)));
  }
  Vec3 point(float size) { return {(*this)(-size, size), (*this)(-size, size), (*this)(-size, size)}; }

 private:
  uint64_t state_;
};

DiceRate someRate(Chance& chance) {
  DiceRate r;
  r.eye = chance.point(2);
  r.axis = glm::normalize(chance.point(1) + Vec3(0.01f));
  r.nearSquared = chance(0, 1) < 0.5f ? 1e-6f : 0.3f;
  r.cone = chance(0.01f, 1.5f), r.insideCone = std::cos(r.cone) + 1e-6f;
  r.scale = chance(1, 1000);
  if (chance(0, 1) < 0.2f) r.motionSide = 3;
  if (chance(0, 1) < 0.2f) r.perspective = false, r.radius = 0.5f;
  if (chance(0, 1) < 0.2f) r.focus = 2, r.sharpest = 0.4f;
  return r;
}

TEST(DiceMetric, ThePiecesOfACurveAreSegments) {
  Chance chance(1);
  for (int round = 0; round < 20000; ++round) {
    const DiceRate rate = someRate(chance);
    float x[kMetricSteps + 1], y[kMetricSteps + 1], z[kMetricSteps + 1];
    const float size = std::exp2(chance(-12, 3));
    const Vec3 middle = chance.point(3);
    for (int i = 0; i <= kMetricSteps; ++i) {
      // Some points coincide, some share coordinates.
      const Vec3 p = middle + (i > 0 && chance(0, 1) < 0.1f ? Vec3(0) : chance.point(size));
      x[i] = i > 0 && chance(0, 1) < 0.1f ? x[i - 1] : p.x, y[i] = p.y, z[i] = p.z;
    }
    float longest = 0;
    for (int i = 0; i < kMetricSteps; ++i)
      longest = std::max(longest, rate.segment({x[i], y[i], z[i]}, {x[i + 1], y[i + 1], z[i + 1]}));
    ASSERT_EQ(std::bit_cast<uint32_t>(longest), std::bit_cast<uint32_t>(rate.longestSegment(x, y, z)))
        << "round " << round;
    std::reverse(x, x + kMetricSteps + 1), std::reverse(y, y + kMetricSteps + 1);
    std::reverse(z, z + kMetricSteps + 1);
    ASSERT_EQ(longest, rate.longestSegment(x, y, z)) << "round " << round;
  }
}

/// Squared distance to a triangle by looking at many of its points: never below the true one.
float sampledSquare(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  constexpr int kSteps = 64;
  float least = kInfinity;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; i + j <= kSteps; ++j) {
      const float u = float(i) / kSteps, v = float(j) / kSteps;
      const Vec3 d = p - (a + u * (b - a) + v * (c - a));
      least = std::min(least, glm::dot(d, d));
    }
  return least;
}

TEST(GridMeasure, DeviationIsOfTheVertexThatIsFarthestFromTheFacets) {
  Chance chance(2);
  constexpr int nu = 8, nv = 4;
  for (int round = 0; round < 20; ++round) {
    std::vector<float> xyz;
    const float bend = chance(0, 0.5f), wave = chance(0, 0.2f);
    for (int j = 0; j <= nv; ++j)
      for (int i = 0; i <= nu; ++i) {
        const float u = float(i) / nu, v = float(j) / nv;
        xyz.insert(xyz.end(), {u + 0.1f * u * u, v, bend * u * v + wave * std::sin(7 * u + 3 * v)});
      }
    const auto at = [&](int i, int j) {
      const float* p = xyz.data() + 3 * (j * (nu + 1) + i);
      return Vec3(p[0], p[1], p[2]);
    };
    float deviation[kLevels] = {}, cellSize = 0;
    Box3f bound;
    measureGrid(xyz.data(), nu, nv, nu + 1, 3, deviation, &cellSize, &bound);
    for (int level = 1; level < 3; ++level) {
      const int k = 1 << level;
      float worst = 0;
      for (int j = 0; j <= nv; ++j)
        for (int i = 0; i <= nu; ++i) {
          const int x = std::min(i / k * k, nu - k), y = std::min(j / k * k, nv - k);
          const Vec3 a = at(x, y), b = at(x + k, y), c = at(x, y + k), d = at(x + k, y + k);
          worst =
              std::max(worst, std::min(sampledSquare(at(i, j), a, b, c), sampledSquare(at(i, j), d, c, b)));
        }
      EXPECT_NEAR(deviation[level], std::sqrt(worst), 2e-3f + 0.05f * deviation[level]) << "level " << level;
    }
  }
}

}  // namespace
}  // namespace fr::cache
