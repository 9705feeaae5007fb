#include "imaging/quantize.h"

#include <gtest/gtest.h>

#include <cmath>

namespace fr {
namespace {

TEST(Quantizer, RoundsAndClampsBySpec) {
  const Quantizer q{255, 0, 255, 0};
  EXPECT_EQ(q.quantize(0.5f, 0, 0, 0, 0), 128u);  // 127.5 + 0.5
  EXPECT_EQ(q.quantize(1.0f, 0, 0, 0, 0), 255u);
  EXPECT_EQ(q.quantize(2.0f, 0, 0, 0, 0), 255u);
  EXPECT_EQ(q.quantize(-1.0f, 0, 0, 0, 0), 0u);
  EXPECT_EQ(q.quantize(NAN, 0, 0, 0, 0), 0u);
  EXPECT_EQ(q.quantize(INFINITY, 0, 0, 0, 0), 255u);
  EXPECT_EQ((Quantizer{255, 16, 235, 0}).quantize(0, 0, 0, 0, 0), 16u);
  EXPECT_EQ((Quantizer{65535, 0, 65535, 0}).quantize(0.25f, 0, 0, 0, 0), 16384u);
}

TEST(Quantizer, FormatFollowsMax) {
  EXPECT_EQ((Quantizer{0, 0, 0, 0}).format(), SampleFormat::kFloat);
  EXPECT_EQ((Quantizer{255, 0, 255, 0}).format(), SampleFormat::kU8);
  EXPECT_EQ((Quantizer{65535, 0, 65535, 0}).format(), SampleFormat::kU16);
  EXPECT_EQ((Quantizer{1e9f, 0, 1e9f, 0}).format(), SampleFormat::kU32);
}

TEST(Quantizer, DitherIsUnbiasedUniformAndRepeatable) {
  const Quantizer q{255, 0, 255, 0.5f};
  const float v = 100.3f / 255;
  double sum = 0;
  int n = 0, low = 0, high = 0;
  for (int y = 0; y < 200; ++y)
    for (int x = 0; x < 200; ++x, ++n) {
      const uint32_t a = q.quantize(v, x, y, 1, 7);
      EXPECT_EQ(a, q.quantize(v, x, y, 1, 7));
      sum += a;
      low += a == 100, high += a == 101;
    }
  // With amplitude 1/2 the mean is the value itself: standard deviation of one sample is sqrt(.3 * .7), of
  // the mean 0.0023.
  EXPECT_NEAR(sum / n, 100.3, 0.01);
  EXPECT_EQ(low + high, n);
  EXPECT_EQ(q.quantize(0, 3, 4, 0, 0), 0u);
  int differ = 0;
  for (int x = 0; x < 100; ++x) differ += q.quantize(v, x, 0, 0, 7) != q.quantize(v, x, 0, 1, 7);
  EXPECT_GT(differ, 10);  // channels are independent: 42 expected
}

TEST(Exposure, GainThenGamma) {
  EXPECT_FLOAT_EQ((Exposure{4, 2}).apply(1), 2);
  EXPECT_FLOAT_EQ((Exposure{1, 2.2f}).apply(0.5f), std::pow(0.5f, 1 / 2.2f));
  EXPECT_EQ((Exposure{1, 2}).apply(0), 0);
  EXPECT_FALSE(std::isnan((Exposure{1, 2}).apply(-1)));
  EXPECT_EQ((Exposure{2, 1}).apply(3), 6);
}

}  // namespace
}  // namespace fr
