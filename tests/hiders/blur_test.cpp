// Motion blur and depth of field of both renderers: against each other sample by sample, and against closed
// forms.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

const std::string kPerspective = "Projection \"perspective\" \"fov\" [40]\n";
const std::string kLit =
    "LightSource \"distantlight\" 1 \"from\" [1 1 -2] \"to\" [0 0 0]\nSurface \"matte\"\n";

struct Scene {
  const char* name;
  std::string camera, world;
};
std::ostream& operator<<(std::ostream& out, const Scene& s) { return out << s.name; }

const std::string kTorus = "Rotate 50 1 1 0 Torus 0.7 0.3 0 360 360\n";
const std::string kDrilledBall =
    "SolidBegin \"difference\"\nSolidBegin \"primitive\" Sphere 1 -1 1 360 SolidEnd\n"
    "SolidBegin \"primitive\" Cylinder 0.4 -2 2 360 Disk 2 0.4 360 Disk -2 0.4 360 SolidEnd\nSolidEnd\n";
const std::string kLens = "DepthOfField 2 0.5 5\n";
const std::vector<Scene> kScenes = {
    {"MovingSphere", kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 1] Translate -0.8 -0.2 0 Translate 0.8 0.3 0.5 MotionEnd Sphere 0.6 -0.6 0.6 360\n"},
    {"TowardsTheEye", kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 1] Translate 0 0 3 Translate 0.3 0 -3.2 MotionEnd " + kTorus},
    {"Spinning", kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 1] Rotate 0 0 0 1 Rotate 70 0 0 1 MotionEnd "
     "Polygon \"P\" [-1.4 -0.2 0 1.4 -0.2 0 1.4 0.2 0 -1.4 0.2 0]\n"},
    {"Deforming", kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 0.3 1]\n"
     "Patch \"bilinear\" \"P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]\n"
     "Patch \"bilinear\" \"P\" [-1 -1 0 1 -1 0 -1 1 0 1 0 -1]\n"
     "Patch \"bilinear\" \"P\" [-1.4 -1 0 1 -1 1 -1 1 0 0.2 0.5 0]\n"
     "MotionEnd\n"},
    {"MovingCamera", kPerspective + "MotionBegin [0 1] Translate -0.3 0 5 Translate 0.3 0.2 4.2 MotionEnd\n",
     kTorus + "Polygon \"P\" [-9 -1 -9 -9 -1 9 9 -1 9 9 -1 -9]\n"},
    {"TurningCameraAndMovingObject",
     kPerspective + "MotionBegin [0 1] Rotate -5 0 1 0 Rotate 8 0 1 0 MotionEnd Translate 0 0 5\n",
     "MotionBegin [0 1] Translate 0 -0.5 0 Translate 0 0.5 0 MotionEnd " + kTorus},
    {"Defocused", kLens + kPerspective + "Translate 0 0 5\n",
     "AttributeBegin Translate -0.6 0 -2 Sphere 0.3 -0.3 0.3 360 AttributeEnd\n"
     "AttributeBegin Translate 0.8 0 0 Sphere 0.5 -0.5 0.5 360 AttributeEnd\n"
     "Translate 0 0 6 Sphere 1.5 -1.5 1.5 360\n"},
    {"DefocusedFloorUnderTheEye", kLens + kPerspective + "Translate 0 0 5\n",
     "Polygon \"P\" [-9 -1 -9 -9 -1 19 9 -1 19 9 -1 -9]\n" + kTorus},
    {"DefocusedOrthographic",
     kLens + "Projection \"orthographic\"\nScreenWindow -1.5 1.5 -1.5 1.5\nTranslate 0 0 5\n",
     "Translate -0.5 0 -2 Sphere 0.3 -0.3 0.3 360 Translate 1 0 5 Sphere 0.5 -0.5 0.5 360\n"},
    {"Both", kLens + kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 1] Translate -0.6 0 -2 Translate 0.6 0.4 1 MotionEnd " + kTorus},
    {"TransparentAndOneSided", kLens + kPerspective + "Translate 0 0 5\n",
     "Sides 1 Opacity [0.5 0.5 0.5]\n"
     "MotionBegin [0 1] Translate -0.6 0 -1 Translate 0.6 0.4 1 MotionEnd " +
         kTorus},
    {"MovingSolid", kPerspective + "Translate 0 0 5\n",
     "MotionBegin [0 1] Translate -0.5 0 0 Translate 0.5 0.3 0 MotionEnd Rotate 40 1 1 0\n" + kDrilledBall},
    {"SolidWithAMovingPart", kPerspective + "Translate 0 0 5\n",
     "Rotate 30 1 1 0\nSolidBegin \"difference\"\nSolidBegin \"primitive\" Sphere 1 -1 1 360 SolidEnd\n"
     "SolidBegin \"primitive\" MotionBegin [0 1] Translate -0.9 0 -0.9 Translate 0.9 0.2 -0.9 MotionEnd "
     "Sphere 0.6 -0.6 0.6 360 SolidEnd\nSolidEnd\n"},
    {"DefocusedSolid", kLens + kPerspective + "Translate 0 0 5\n",
     "AttributeBegin Translate -0.7 0 -1.5 Scale .5 .5 .5 Rotate 40 1 1 0\n" + kDrilledBall +
         "AttributeEnd Translate 0.8 0 2 Rotate -40 1 1 0\n" + kDrilledBall},
    {"MovingTransparentSolidBothBlurred", kLens + kPerspective + "Translate 0 0 5\n",
     "Opacity [0.6 0.6 0.6]\nMotionBegin [0 1] Translate -0.5 0 -1 Translate 0.5 0.3 1 MotionEnd Rotate 40 1 "
     "1 0\n" +
         kDrilledBall},
    {"SolidSeenByAMovingCamera",
     kPerspective + "MotionBegin [0 1] Translate -0.3 0 5 Translate 0.3 0.2 4.2 MotionEnd\n",
     "Rotate 40 1 1 0\n" + kDrilledBall},
    {"InstancesOfSolids", kLens + kPerspective + "Translate 0 0 5\n",
     "ObjectBegin 1\n" + kDrilledBall +
         "ObjectEnd\n"
         "AttributeBegin MotionBegin [0 1] Translate -1 0 0 Translate -0.5 0.2 0 MotionEnd Scale .6 .6 .6 "
         "Rotate 30 1 1 0 "
         "ObjectInstance 1 AttributeEnd\n"
         "AttributeBegin Translate 0.8 0.4 1 Scale .6 .7 .6 Rotate -30 1 1 0 ObjectInstance 1 "
         "AttributeEnd\n"},
    {"DefocusedInstances", kLens + kPerspective + "Translate 0 0 5\n",
     "ObjectBegin 1\n" + kTorus +
         "ObjectEnd\nAttributeBegin Translate -0.8 0 -1 Scale .5 .5 .5 ObjectInstance 1 "
         "AttributeEnd\nAttributeBegin Translate 0.7 0 0.5 Scale .7 .6 .7 ObjectInstance 1 AttributeEnd\n"
         "Translate 0 0.5 3 ObjectInstance 1\n"},
};

class Blur : public testing::TestWithParam<Scene> {};
INSTANTIATE_TEST_SUITE_P(Scenes, Blur, testing::ValuesIn(kScenes),
                         [](const auto& i) { return std::string(i.param.name); });

// One sample a pixel, as in hiders_test.cpp: samples may only differ within 1/1448 pixel of an outline as
// they see it. Neighbouring samples have other times and lens positions, so every pixel of a blurred part
// counts as outline; and a sample near an edge within the surface may take its depth from the other side.
TEST_P(Blur, HidersAgree) {
  const Scene& s = GetParam();
  const HiderPair pair =
      renderBoth("Format 200 200 1\nPixelSamples 1 1\nPixelFilter \"box\" 1 1\nShutter 0 1\n" + s.camera +
                 "WorldBegin\n" + kLit + s.world + "WorldEnd\n");
  const Difference d = compare(pair, 2e-3);
  const double expected = 0.002 * double(d.outline), allowed = expected + 4 * std::sqrt(expected) + 2;
  EXPECT_GT(d.covered, d.pixels / 20);
  EXPECT_LT(double(d.alpha), allowed) << "coverage differs in so many samples; outline: " << d.outline;
  EXPECT_LT(double(d.depth), allowed) << "depth differs in so many samples; outline: " << d.outline;
  // REYES shades at shutter open, once a micropolygon.
  EXPECT_LT(d.colorRms, 0.05);
}

constexpr int kSize = 64;
/// Pixels across which one unit at distance 1 reaches (fov 90).
constexpr double kFocal = kSize / 2.0;

HiderPair render(const std::string& options, const std::string& world, const std::string& samples = "8 8") {
  return renderBoth(fmt::format("Format {} {} 1\nPixelSamples {}\nPixelFilter \"box\" 1 1\nShutter 0 1\n",
                                kSize, kSize, samples) +
                    options + "Projection \"perspective\" \"fov\" [90]\nWorldBegin\nSurface \"constant\"\n" +
                    world + "WorldEnd\n");
}

// The left edge of a white wall moves across 20 pixels while the shutter is open: coverage is a ramp.
TEST(MotionBlur, AnEdgeIsARamp) {
  const HiderPair pair =
      render("", fmt::format("MotionBegin [0 1] Translate {} 0 0 Translate {} 0 0 MotionEnd\n"
                             "Polygon \"P\" [0 -9 1 20 -9 1 20 9 1 0 9 1]\n",
                             -10 / kFocal, 10 / kFocal));
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    double squares = 0;
    for (int x = 0; x < kSize; ++x) {
      // The share of (time, place in the pixel) in which the edge is to the left.
      const double from = kSize / 2.0 - 10, exact = std::clamp((x + 0.5 - from) / 20, 0.0, 1.0);
      double mean = 0;
      for (int y = 0; y < kSize; ++y) {
        const double v = double(c->at(0, size_t(y) * kSize + size_t(x)));
        mean += v / kSize;
        squares += (v - exact) * (v - exact);
      }
      // In the two pixels where the ramp starts and ends the corner is rounded off by 1/8 of a step of 1/20.
      EXPECT_NEAR(mean, exact, 0.012) << "column " << x;
    }
    // 64 random samples would leave 0.05 in the ramp; stratified in time and place, they leave a third of
    // that.
    EXPECT_LT(std::sqrt(squares / (20.0 * kSize)), 0.02);
  }
}

// Two motions of the same length, the first in a fifth of the time: the fast part is five times as thin.
TEST(MotionBlur, UnevenKeysHaveTheirOwnSpeeds) {
  const auto bar = [](double x) {
    return fmt::format("Polygon \"P\" [{0} -9 1 {1} -9 1 {1} 9 1 {0} 9 1]\n", (x - 2) / kFocal,
                       (x + 2) / kFocal);
  };
  const HiderPair pair = render("", "MotionBegin [0 0.2 1]\n" + bar(-20) + bar(0) + bar(20) + "MotionEnd\n");
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    double fast = 0, slow = 0;
    for (int y = 0; y < kSize; ++y)
      for (int x = 3; x < 8; ++x) {
        fast += double(c->at(3, size_t(y) * kSize + size_t(kSize / 2 - 4 - x))) / (5 * kSize);
        slow += double(c->at(3, size_t(y) * kSize + size_t(kSize / 2 + 3 + x))) / (5 * kSize);
      }
    // A bar of 4 pixels that crosses 20 in 0.2 (0.8) of the time.
    EXPECT_NEAR(fast, 4 * 0.2 / 20, 0.004);
    EXPECT_NEAR(slow, 4 * 0.8 / 20, 0.01);
  }
}

TEST(MotionBlur, AShutterOfNoLengthIsSharp) {
  const std::string moving =
      "MotionBegin [0 1] Translate -0.5 0 0 Translate 0.5 0 0 MotionEnd Translate 0 0 3 Sphere 1 -1 1 360\n";
  const HiderPair pair = render("Shutter 0 0\n", moving);
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    // Seen at time 0: centred at x = -0.5, so symmetric about that column.
    const double middle = kSize / 2.0 - 0.5 / 3 * kFocal;
    double moment = 0, sum = 0;
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x)
        moment += double(c->at(3, size_t(y) * kSize + size_t(x))) * (x + 0.5),
            sum += double(c->at(3, size_t(y) * kSize + size_t(x)));
    // Off the axis an ellipse, whose middle lies a little farther out than the centre's image.
    EXPECT_NEAR(moment / sum, middle, 0.8);
  }
}

// A small bright square out of focus becomes the lens' image: a disk of RISpec's circle of confusion, with
// the light spread evenly over it.
TEST(DepthOfField, ACircleOfConfusion) {
  constexpr double kFstop = 2, kFocalLength = 0.8, kFocus = 6, kDepth = 2, kHalf = 0.06;
  const HiderPair pair = render(
      fmt::format("DepthOfField {} {} {}\n", kFstop, kFocalLength, kFocus),
      fmt::format("Polygon \"P\" [-{0} -{0} {1} {0} -{0} {1} {0} {0} {1} -{0} {0} {1}]\n", kHalf, kDepth),
      "16 16");
  const double confusion =
      kFocal * kFocalLength / kFstop * std::abs(1 / kDepth - 1 / kFocus);  // diameter, pixels
  const double light = std::pow(kFocal * 2 * kHalf / kDepth, 2);
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    double sum = 0, squares = 0;
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x) {
        const double v = double(c->at(3, size_t(y) * kSize + size_t(x)));
        const double dx = x + 0.5 - kSize / 2.0, dy = y + 0.5 - kSize / 2.0;
        sum += v, squares += v * (dx * dx + dy * dy);
      }
    EXPECT_NEAR(sum, light, 0.05 * light);
    // Second moment of a uniform disk of radius r: r^2 / 2. The square's own is added.
    const double own = 2 * light / 12;
    EXPECT_NEAR(squares / sum, std::pow(confusion / 2, 2) / 2 + own, 0.05 * std::pow(confusion / 2, 2));
  }
}

TEST(DepthOfField, WhatIsInFocusIsSharp) {
  const std::string wall = "Polygon \"P\" [0 -9 4 20 -9 4 20 9 4 0 9 4]\n";
  const HiderPair pair = render("DepthOfField 1.4 1 4\n", wall);
  for (const Channels* c : {&pair.reyes, &pair.rays})
    for (int y = 0; y < kSize; ++y)
      for (int x = 0; x < kSize; ++x)
        ASSERT_EQ(c->at(3, size_t(y) * kSize + size_t(x)), x < kSize / 2 ? 0.0f : 1.0f) << x << ' ' << y;
}

// Without jitter the samples of a pixel have their times in equal steps: a bar that moves is a row of copies.
TEST(MotionBlur, WithoutJitterTimesAreRegular) {
  const HiderPair pair = render("Hider \"hidden\" \"jitter\" [0]\n",
                                fmt::format("MotionBegin [0 1] Translate {} 0 0 Translate {} 0 0 MotionEnd\n"
                                            "Polygon \"P\" [0 -9 1 20 -9 1 20 9 1 0 9 1]\n",
                                            -8 / kFocal, 8 / kFocal),
                                "4 4");
  for (const Channels* c : {&pair.reyes, &pair.rays})
    for (int x = 0; x < kSize; ++x)
      for (int y = 1; y < kSize; ++y)
        ASSERT_EQ(c->at(0, size_t(y) * kSize + size_t(x)), c->at(0, size_t(x))) << "all rows are alike";
}

}  // namespace
}  // namespace fr::test
