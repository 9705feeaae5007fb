// The same picture wherever the world is, and however large: nothing has an absolute size.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/hiders/hider_pair.h"
#include "tests/stability/scenes.h"

namespace fr::test {
namespace {

/// Of colours and coverage.
double rmse(const Channels& a, const Channels& b) {
  double squares = 0;
  size_t n = 0;
  for (size_t c = 0; c < 4; ++c)
    for (size_t i = 0; i < a.values[c].size(); ++i, ++n) {
      EXPECT_TRUE(std::isfinite(b.at(c, i))) << "channel " << c << " pixel " << i;
      squares += std::pow(double(a.at(c, i)) - double(b.at(c, i)), 2);
    }
  return std::sqrt(squares / double(n));
}

class Placed : public ::testing::TestWithParam<std::pair<const char*, Placement>> {
 protected:
  static const HiderPair& reference() {
    static const HiderPair pair = renderBoth(everything({}), everythingsShaders());
    return pair;
  }
};

TEST_P(Placed, TheSamePicture) {
  const Placement& p = GetParam().second;
  const HiderPair here = renderBoth(everything(p), everythingsShaders());
  // A sample in a hundred thousand may fall on the other side of an outline: its last bits differ.
  const double reyes = rmse(reference().reyes, here.reyes), rays = rmse(reference().rays, here.rays);
  EXPECT_LT(reyes, 1e-3);
  EXPECT_LT(rays, 1e-3);
  RecordProperty("reyes", std::to_string(reyes));
  RecordProperty("rays", std::to_string(rays));
  std::printf("%-12s RMSE %.2e by REYES, %.2e by rays\n", GetParam().first, reyes, rays);
}

Placement far(double d) { return {d * 1.0, d * 0.713, -d * 0.391}; }
Placement large(double s) { return {0, 0, 0, s}; }

INSTANTIATE_TEST_SUITE_P(FarAway, Placed,
                         ::testing::Values(std::pair("E3", far(1e3)), std::pair("E4", far(1e4)),
                                           std::pair("E5", far(1e5)), std::pair("E6", far(1e6)),
                                           std::pair("E7", far(1e7)), std::pair("E8", far(1e8))),
                         [](const auto& p) { return std::string(p.param.first); });
INSTANTIATE_TEST_SUITE_P(
    OfAnySize, Placed,
    ::testing::Values(std::pair("Millionth", large(1e-6)), std::pair("TenThousandth", large(1e-4)),
                      std::pair("Hundredth", large(0.01)), std::pair("ThreeTimes", large(3)),
                      std::pair("Hundred", large(100)), std::pair("TenThousand", large(1e4)),
                      std::pair("Million", large(1e6))),
    [](const auto& p) { return std::string(p.param.first); });

}  // namespace
}  // namespace fr::test
