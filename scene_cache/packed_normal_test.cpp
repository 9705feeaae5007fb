#include "scene_cache/packed_normal.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

namespace fr::cache {
namespace {

double angleBetween(const DVec3& a, const DVec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
}

TEST(PackedNormal, IsOffByAFifteenthOfAPixel) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  double worst = 0, longest = 0;
  for (int i = 0; i < 1000000; ++i) {
    // Some close to the seams of the square, where coordinates vanish.
    DVec3 n(normal(random), normal(random), normal(random));
    if (i % 4 == 0) n[i / 4 % 3] *= 1e-5;
    n = glm::normalize(n);
    const DVec3 m(unpackNormal(packNormal(Vec3(n))));
    worst = std::max(worst, angleBetween(n, m));
    longest = std::max(longest, std::abs(glm::length(m) - 1));
  }
  EXPECT_LT(worst, 6.5e-5);
  EXPECT_GT(worst, 1e-5);  // else more would be stored than is said
  EXPECT_LT(longest, 3e-7);
}

TEST(PackedNormal, AxesAreExactAndNoNormalStaysNone) {
  for (int axis = 0; axis < 3; ++axis)
    for (const float sign : {1.0f, -1.0f}) {
      Vec3 n(0);
      n[axis] = sign;
      EXPECT_EQ(unpackNormal(packNormal(n)), n);
    }
  EXPECT_EQ(unpackNormal(packNormal(Vec3(0))), Vec3(0));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(packNormal(Vec3(nan, 0, 1)), kNoNormal);
  EXPECT_EQ(packNormal(Vec3(0, std::numeric_limits<float>::infinity(), 0)), kNoNormal);
}

TEST(PackedNormal, WhateverBitsAreReadAreAUnitNormal) {
  std::mt19937 random(3);
  for (int i = 0; i < 100000; ++i) {
    const uint32_t bits = i == 0 ? 0x8000u : i == 1 ? 0x80000000u : uint32_t(random());
    if (bits == kNoNormal) continue;
    EXPECT_NEAR(glm::length(unpackNormal(bits)), 1, 1e-6) << bits;
  }
}

}  // namespace
}  // namespace fr::cache
