#include "imaging/pixel_filter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace fr {
namespace {

/// Midpoint rule over the support, `steps` per axis.
double integrate(const PixelFilter& f, int steps = 400) {
  double sum = 0;
  const double wx = f.xWidth(), wy = f.yWidth();
  for (int j = 0; j < steps; ++j)
    for (int i = 0; i < steps; ++i)
      sum += double(f.evaluate(float(wx * ((i + 0.5) / steps - 0.5)), float(wy * ((j + 0.5) / steps - 0.5))));
  return sum * wx * wy / (double(steps) * steps);
}

TEST(PixelFilter, IntegralsMatchClosedForms) {
  EXPECT_NEAR(integrate({FilterKind::kBox, 2, 3}), 6.0, 1e-3);
  EXPECT_NEAR(integrate({FilterKind::kTriangle, 2, 4}), 1.0 * 2.0, 1e-3);
  const double pi = std::numbers::pi;
  EXPECT_NEAR(integrate({FilterKind::kDisk, 2, 3}), pi * 1.0 * 1.5, 2e-2);
  // exp(-2 (2x/w)^2) over [-w/2, w/2]: w/2 sqrt(pi/2) erf(sqrt 2).
  const double gauss = std::sqrt(pi / 2) * std::erf(std::sqrt(2.0));
  EXPECT_NEAR(integrate({FilterKind::kGaussian, 2, 2}), gauss * gauss, 1e-3);
  // Interpolating cubic times 2 has integral 2; Mitchell with B + 2C = 1, not divided by 6, has integral 6
  // over |x| < 2.
  EXPECT_NEAR(integrate({FilterKind::kSeparableCatmullRom, 4, 4}), 4.0, 1e-3);
  EXPECT_NEAR(integrate({FilterKind::kMitchell, 4, 4}), 36.0, 1e-2);
  EXPECT_NEAR(integrate({FilterKind::kBlackmanHarris, 3, 3}), 0.35875 * 0.35875 * 9, 1e-4);
}

TEST(PixelFilter, SupportIsHalfOpenAndFull) {
  const PixelFilter box(FilterKind::kBox, 1, 1);
  EXPECT_EQ(box.evaluate(-0.5f, 0), 1.0f);
  EXPECT_EQ(box.evaluate(0.5f, 0), 0.0f);
  EXPECT_EQ(box.xReach(), 0);
  EXPECT_EQ(PixelFilter(FilterKind::kGaussian, 2, 3).xReach(), 1);
  EXPECT_EQ(PixelFilter(FilterKind::kCatmullRom, 4, 4).yReach(), 2);
}

TEST(PixelFilter, SymmetricAndPeakAtCentre) {
  for (auto name : {"box", "triangle", "catmull-rom", "sinc", "gaussian", "mitchell", "disk", "bessel",
                    "lanczos", "blackman-harris", "separable-catmull-rom"}) {
    auto f = PixelFilter::byName(name, 4, 4);
    ASSERT_TRUE(f) << name;
    const float peak = f->evaluate(0, 0);
    EXPECT_GT(peak, 0) << name;
    for (float x = 0.1f; x < 2; x += 0.3f)
      for (float y = 0.1f; y < 2; y += 0.3f) {
        EXPECT_NEAR(f->evaluate(x, y), f->evaluate(-x, y), 1e-5f) << name;
        EXPECT_NEAR(f->evaluate(x, y), f->evaluate(y, x), 1e-5f) << name;
        EXPECT_LE(f->evaluate(x, y), peak + 1e-6f) << name;
        EXPECT_TRUE(!f->separable() || f->evaluate(x, y) == f->evaluateX(x) * f->evaluateY(y)) << name;
      }
    EXPECT_EQ(f->evaluate(2.01f, 0), 0.0f) << name;
  }
}

TEST(PixelFilter, BadInputIsAnErrorOrCut) {
  EXPECT_FALSE(PixelFilter::byName("gausian", 2, 2));
  const PixelFilter f(FilterKind::kBox, NAN, 1e9f);
  EXPECT_EQ(f.xWidth(), 2.0f);
  EXPECT_EQ(f.yWidth(), PixelFilter::kMaxWidth);
}

}  // namespace
}  // namespace fr
