#include "imaging/sample_pattern.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

namespace fr {
namespace {

TEST(SamplePattern, SamplesHaveNoBlurUnlessAsked) {
  EXPECT_TRUE(SamplePattern(4, 4, true, 1).blurs().empty());
  EXPECT_EQ(SamplePattern(4, 4, true, 1).offsets().size(),
            SamplePattern(4, 4, true, 1, {true, true}).offsets().size());
}

// The n-th sample of every pixel has its time in the n-th of equal parts of the shutter.
TEST(SamplePattern, TimesAreStratifiedAndSorted) {
  const SamplePattern p(4, 4, true, 7, {true, false});
  for (size_t i = 0; i < p.blurs().size(); ++i) {
    const auto slot = float(i % 16);
    EXPECT_GE(p.blurs()[i].time, slot / 16);
    EXPECT_LE(p.blurs()[i].time, (slot + 1) / 16);
    EXPECT_EQ(p.blurs()[i].lensX, 0.0f);
  }
}

// Sorting by time must not tie places to times: the mean place of each slot is the pixel's middle.
TEST(SamplePattern, TimesAndPlacesAreIndependent) {
  const SamplePattern p(4, 4, true, 7, {true, true});
  const auto pixels = double(p.offsets().size()) / 16;
  for (size_t slot = 0; slot < 16; ++slot) {
    double x = 0, y = 0, lx = 0, ly = 0;
    for (size_t i = slot; i < p.offsets().size(); i += 16)
      x += p.offsets()[i].x, y += p.offsets()[i].y, lx += double(p.blurs()[i].lensX),
          ly += double(p.blurs()[i].lensY);
    // Standard deviation of a uniform place: 0.29 pixels; of a lens coordinate: 0.5. Over 4096 pixels.
    EXPECT_NEAR(x / pixels / kSubpixels, 0.5, 4 * 0.29 / 64);
    EXPECT_NEAR(y / pixels / kSubpixels, 0.5, 4 * 0.29 / 64);
    EXPECT_NEAR(lx / pixels, 0, 4 * 0.5 / 64);
    EXPECT_NEAR(ly / pixels, 0, 4 * 0.5 / 64);
  }
}

TEST(SamplePattern, TheLensIsADiskEvenlyCovered) {
  const SamplePattern p(4, 4, true, 3, {false, true});
  double inner = 0;
  for (const SamplePattern::Blur& b : p.blurs()) {
    const float r2 = b.lensX * b.lensX + b.lensY * b.lensY;
    ASSERT_LE(r2, 1.00001f);
    inner += r2 < 0.5f;
  }
  // Half of the area; 65536 samples, stratified, so closer than random ones (standard deviation 0.002).
  EXPECT_NEAR(inner / double(p.blurs().size()), 0.5, 0.004);
  // The n-th samples of all pixels lie in one cell of a 4 x 4 grid of the lens.
  for (size_t slot = 0; slot < 16; ++slot) {
    float x0 = 2, x1 = -2;
    for (size_t i = slot; i < p.blurs().size(); i += 16)
      x0 = std::min(x0, p.blurs()[i].lensX), x1 = std::max(x1, p.blurs()[i].lensX);
    EXPECT_LT(x1 - x0, 1.0f);
  }
}

TEST(SamplePattern, RoundsAreWellSpreadAndSortedForThemselves) {
  const SamplePattern plain(16, 1, true, 5, {false, false, 4}), blurred(16, 1, true, 5, {true, true, 4});
  const auto sum = [](const SamplePattern& p, size_t begin, size_t end) {
    int s = 0;
    for (size_t i = begin; i < end; ++i) s += p.offsets()[i].x;
    return s;
  };
  for (const auto& [begin, end] : {std::pair(0, 4), std::pair(4, 8), std::pair(8, 16)}) {
    EXPECT_EQ(sum(plain, size_t(begin), size_t(end)), sum(blurred, size_t(begin), size_t(end)));
    for (int i = begin + 1; i < end; ++i)
      EXPECT_LE(blurred.blurs()[size_t(i) - 1].time, blurred.blurs()[size_t(i)].time);
  }
  // The first four of a pixel are in the four quarters of the shutter.
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(int(4 * blurred.blurs()[i].time), int(i));
}

TEST(SamplePattern, WithoutJitterTimesAreEqualSteps) {
  const SamplePattern p(3, 2, false, 1, {true, true});
  ASSERT_EQ(p.blurs().size(), 6u);
  for (size_t i = 0; i < 6; ++i) EXPECT_FLOAT_EQ(p.blurs()[i].time, (float(i) + 0.5f) / 6);
}

TEST(SamplePattern, ChancesOfAPixelAreStratified) {
  for (const bool jitter : {false, true}) {
    const SamplePattern p(3, 2, jitter, 7);
    double sum = 0;
    for (int y = 0; y < 20; ++y)
      for (int x = 0; x < 20; ++x) {
        std::vector<int> cells;
        for (size_t s = 0; s < 6; ++s) {
          const float c = p.chance(p.first(x, y) + s);
          ASSERT_TRUE(c >= 0 && c < 1);
          cells.push_back(int(c * 6)), sum += double(c) / 2400;
        }
        std::sort(cells.begin(), cells.end());
        EXPECT_EQ(cells, (std::vector<int>{0, 1, 2, 3, 4, 5}));
      }
    EXPECT_NEAR(sum, 0.5, 0.01);
  }
}

}  // namespace
}  // namespace fr
