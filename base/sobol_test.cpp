#include "base/sobol.h"

#include <gtest/gtest.h>

#include <set>

namespace fr {
namespace {

TEST(Sobol, EveryElementaryIntervalHoldsOnePoint) {
  for (uint32_t seed : {0u, 1u, 0xdeadbeefu}) {
    for (int bx = 0; bx <= 4; ++bx) {
      const int by = 4 - bx;
      std::set<std::pair<int, int>> cells;
      for (uint32_t i = 0; i < 16; ++i) {
        const Vec2 p = sobolOwen2(i, seed);
        ASSERT_GE(p.x, 0.f);
        ASSERT_LT(p.x, 1.f);
        cells.insert({int(p.x * float(1 << bx)), int(p.y * float(1 << by))});
      }
      EXPECT_EQ(cells.size(), 16u) << "seed " << seed << " split " << bx;
    }
  }
}

TEST(Sobol, EachDimensionIsStratified) {
  for (int d = 0; d < 4; ++d) {
    std::set<int> cells;
    for (uint32_t i = 0; i < 64; ++i) cells.insert(int(sobolOwen(i, d, 77) * 64));
    EXPECT_EQ(cells.size(), 64u) << "dimension " << d;
  }
}

TEST(Sobol, PairsAreTheFirstTwoDimensions) {
  for (uint32_t k = 0; k < 100000; ++k) {
    const uint32_t index = k < 1000 ? k : k * 0x9e3779b9u, seed = k * 0x85ebca6bu;
    const Vec2 p = sobolOwen2(index, seed);
    ASSERT_EQ(p.x, sobolOwen(index, 0, seed)) << index;
    ASSERT_EQ(p.y, sobolOwen(index, 1, seed)) << index;
  }
}

TEST(Sobol, MeanIsAHalfOverSeeds) {
  double sum = 0;
  for (uint32_t seed = 0; seed < 4096; ++seed) sum += sobolOwen(0, 0, seed);
  EXPECT_NEAR(sum / 4096, 0.5, 5 * 0.2887 / 64);  // five standard errors of 4096 uniform numbers
}

}  // namespace
}  // namespace fr
