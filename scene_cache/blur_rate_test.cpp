// GeometricApproximation "motionfactor" and "focusfactor": what is blurred is diced coarser, and only that.
#include <gtest/gtest.h>

#include <string>

#include "scene_cache/dice_metric.h"
#include "scene_cache/dice_scene.h"

namespace fr::cache {
namespace {

size_t micropolygons(const std::string& options, const std::string& body) {
  DiceScene scene(diceWorld("Format 400 400 1\nShutter 0 1\n" + options +
                                "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n",
                            body));
  size_t n = 0;
  scene.forEachGrid([&](NodeId, const GridRecord& g) { n += size_t(g.nu) * g.nv; });
  return n;
}
size_t moving(const std::string& way, double factor) {
  return micropolygons("", fmt::format("GeometricApproximation \"motionfactor\" {}\nMotionBegin [0 1] "
                                       "Translate 0 0 0 {} MotionEnd Sphere 0.5 -0.5 0.5 360\n",
                                       factor, way));
}
size_t defocused(double z, double factor, double fstop = 2) {
  return micropolygons(fmt::format("DepthOfField {} 1 5\n", fstop),
                       fmt::format("GeometricApproximation \"focusfactor\" {}\nTranslate 0 0 {}\nSphere "
                                   "0.5 -0.5 0.5 360\n",
                                   factor, z));
}

TEST(BlurRate, MotionMakesGridsCoarser) {
  const size_t sharp = moving("Translate 1 0.3 0", 0);
  // 1.04 units are 143 pixels: micropolygons of up to 36 pixels, in powers of two a side.
  EXPECT_LT(moving("Translate 1 0.3 0", 1), sharp / 15);
  EXPECT_GT(moving("Translate 1 0.3 0", 1), sharp / 70);
  EXPECT_LT(moving("Translate 1 0.3 0", 0.25), sharp / 3);
  EXPECT_GT(moving("Translate 1 0.3 0", 0.25), moving("Translate 1 0.3 0", 1));
  // Three pixels hide nothing.
  EXPECT_EQ(moving("Translate 0.02 0 0", 1), moving("Translate 0.02 0 0", 0));
}

TEST(BlurRate, WhatMovesOnlyInPartsStaysFine) {
  for (const char* way : {"Rotate 80 0 0 1", "Translate 0 0 -2", "Rotate 60 1 1 0"})
    EXPECT_EQ(moving(way, 1), moving(way, 0)) << way;
}

TEST(BlurRate, TheLensMakesGridsCoarserOutOfFocusAlone) {
  EXPECT_EQ(defocused(0, 1, 8), defocused(0, 0, 8));
  EXPECT_LT(defocused(-2.5, 1), defocused(-2.5, 0) / 15);
  EXPECT_LT(defocused(6, 1), defocused(6, 0) / 3);
}

TEST(BlurRate, BoundsOfMotionAreBounds) {
  glm::dvec2 open[8], close[8];
  for (int i = 0; i < 8; ++i) open[i] = {i & 1, i >> 1}, close[i] = open[i] + glm::dvec2(64, 0);
  EXPECT_FLOAT_EQ(motionSide(open, close, 1), 4);
  EXPECT_FLOAT_EQ(motionSide(open, close, 0), 1);
  EXPECT_FLOAT_EQ(motionSide(open, close, 1e9f), 16);
  close[3] = open[3] - glm::dvec2(1, 0);  // a corner goes the other way: something between stands still
  EXPECT_FLOAT_EQ(motionSide(open, close, 1), 1);
  close[3] = {std::nan(""), 0};
  EXPECT_FLOAT_EQ(motionSide(open, close, 1), 1);
  EXPECT_FLOAT_EQ(motionSide(open, open, 1), 1);
}

}  // namespace
}  // namespace fr::cache
