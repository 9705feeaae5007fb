// RAYSERVER_JITTER_TIMES in our own renderer: rays look about in the whole shutter, unless it is 0.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

// The camera looks along z at a floor whose shader asks whether the way up is free. A strip that the camera
// does not see moves across from x = 0 to 1 while the shutter is open: |x - t| <= 1/4.
constexpr const char* kScene = R"(Display "out.exr" "openexr" "rgb"
Format 128 64 1
ScreenWindow -1 1 -0.5 0.5
PixelSamples 1 1
PixelFilter "box" 1 1
Projection "orthographic"
Shutter 0 1
WorldBegin
ShadingRate 1
Surface "sky"
Polygon "P" [-2 -1 5  -2 1 5  2 1 5  2 -1 5]
AttributeBegin
  Attribute "visibility" "int camera" [0] "int transmission" [1]
  Surface "constant"
  MotionBegin [0 1]
    Translate 0 0 0
    Translate 1 0 0
  MotionEnd
  Polygon "P" [-0.25 -2 3  -0.25 2 3  0.25 2 3  0.25 -2 3]
AttributeEnd
WorldEnd
)";

class RayTimes : public testing::Test {
 protected:
  RayTimes() {
    w_.write("scene.rib", kScene);
    w_.write("sky.sl", "surface sky() { Oi = 1; Ci = visibility(P, P - vector (0, 0, 4)); }");
  }
  Picture render(const std::string& transport, const std::map<std::string, std::string>& environment) {
    std::filesystem::remove(w_.path() / "out.exr");
    const Outcome o = run("frankenrender", {transport, "scene.rib"}, w_.path(), {}, environment);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.err, "");
    return readExr(w_.path() / "out.exr");
  }
  /// Mean over the columns of x in [from, to].
  static double mean(const Picture& p, double from, double to) {
    double sum = 0;
    int n = 0;
    for (int x = 0; x < p.width; ++x) {
      const double at = (x + 0.5) / p.width * 2 - 1;
      if (at < from || at > to) continue;
      for (int y = 0; y < p.height; ++y) sum += double(p.at("R", x, y)), ++n;
    }
    return n ? sum / n : -1;
  }
  Workspace w_;
};

TEST_F(RayTimes, AreSpreadOverTheShutterUnlessTheUserSaysNo) {
  const Picture spread = render("--shm", {});
  ASSERT_EQ(spread.width, 128);
  // Covered half of the time. About 1200 points that are 0 or 1: a standard error of 0.015.
  EXPECT_NEAR(mean(spread, 0.35, 0.65), 0.5, 0.06);
  EXPECT_EQ(mean(spread, -0.9, -0.3), 1);
  for (const std::string transport : {"--inproc", "--pipe"})
    EXPECT_TRUE(render(transport, {{"RAYSERVER_JITTER_TIMES", "1"}}) == spread) << transport;

  const Picture open = render("--shm", {{"RAYSERVER_JITTER_TIMES", "0"}});
  EXPECT_EQ(mean(open, -0.2, 0.2), 0) << "where the strip is when the shutter opens";
  EXPECT_EQ(mean(open, 0.3, 0.9), 1) << "and nowhere else";
  EXPECT_EQ(mean(open, -0.9, -0.3), 1);
  for (const std::string transport : {"--inproc", "--pipe"})
    EXPECT_TRUE(render(transport, {{"RAYSERVER_JITTER_TIMES", "0"}}) == open) << transport;
}

}  // namespace
}  // namespace fr::test
