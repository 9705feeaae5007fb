// What a scene does not need is not done: asserted by the counters of --stats.
#include <gtest/gtest.h>

#include <regex>
#include <sstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 128 96 1\nPixelSamples 2 2\nProjection \"perspective\" "
    "\"fov\" [40]\nTranslate 0 0 5\n";

/// Asks for one shadow ray a point, towards a place above and before everything.
const std::string kShadowed =
    "surface shadowed() { Ci = Cs * visibility(P, point \"world\" (0, 20, -20)); Oi = 1; }\n";

class NotNeeded : public ::testing::Test {
 protected:
  /// The report of one frame.
  std::string stats(const std::string& world, const std::vector<std::string>& more = {}) {
    w_.write("scene.rib", kHead + "WorldBegin\n" + world + "WorldEnd\n");
    return statsOf("scene.rib", more);
  }
  std::string statsOf(const std::string& file, std::vector<std::string> arguments = {}) {
    arguments.insert(arguments.begin(), {"--stats", file});
    const Outcome o = run("frankenrender", arguments, w_.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return o.out;
  }
  /// First number after `pattern` in the report; -1: no such line.
  static double number(const std::string& report, const std::string& pattern) {
    std::smatch m;
    return std::regex_search(report, m, std::regex(pattern + R"(\D*?(\d+(?:\.\d+)?))")) ? std::stod(m[1])
                                                                                        : -1;
  }
  static double gridsDiced(const std::string& r) { return number(r, "grids diced"); }
  Workspace w_;
};

TEST_F(NotNeeded, WhatIsOutsideThePictureIsNotDiced) {
  const std::string seen = "Surface \"constant\"\nSphere 1 -1 1 360\n";
  const double one = gridsDiced(stats(seen));
  ASSERT_GT(one, 0);
  EXPECT_EQ(gridsDiced(stats(
                seen + "Translate 40 0 0\nSphere 1 -1 1 360\nTranslate -40 0 -30\nSphere 1 -1 1 360\n")),
            one);
}

TEST_F(NotNeeded, WhatIsHiddenIsNeitherDicedNorShaded) {
  const std::string wall =
      "Surface \"constant\"\nPatch \"bilinear\" \"P\" [-9 -9 -1  9 -9 -1  -9 9 -1  9 9 -1]\n";
  std::string behind;
  for (int i = 0; i < 20; ++i)
    behind += "AttributeBegin\nTranslate " + std::to_string(i % 5 - 2) + " " + std::to_string(i / 5 - 2) +
              " 3\nSphere 0.8 -0.8 0.8 360\nAttributeEnd\n";
  const std::string alone = stats(wall), both = stats(wall + behind), order = stats(behind + wall);
  EXPECT_EQ(gridsDiced(both), gridsDiced(alone));
  EXPECT_EQ(gridsDiced(order), gridsDiced(alone));
  EXPECT_EQ(number(both, "grids shaded"), number(alone, "grids shaded"));
  EXPECT_GT(number(both, R"(patches culled\s+\d+ outside,)"), 0);
  // A wall that lets light through hides nothing.
  EXPECT_GT(gridsDiced(stats("Opacity .5 .5 .5\n" + wall + "Opacity 1 1 1\n" + behind)), gridsDiced(alone));
}

TEST_F(NotNeeded, ArchivesThatTheCameraCannotSeeAreNotOpened) {
  w_.write("ball.rib", "Sphere 0.5 -0.5 0.5 360\n");
  const std::string archive = "Procedural \"DelayedReadArchive\" [\"ball.rib\"] [-.5 .5 -.5 .5 -.5 .5]\n",
                    // If it were opened there would be a message and another exit status.
      missing =
          "Translate 0 0 -50\nProcedural \"DelayedReadArchive\" [\"missing.rib\"] [-.5 .5 -.5 .5 -.5 .5]\n";
  const std::string r = stats("Surface \"constant\"\n" + archive + missing);
  EXPECT_EQ(number(r, "procedurals"), 1);
  EXPECT_EQ(number(r, R"(expanded,)"), 1);
}

TEST_F(NotNeeded, NoShaderAsksSoThereIsNoTracer) {
  w_.write("shadowed.sl", kShadowed);
  const std::string r = stats("Surface \"plastic\"\nSphere 1 -1 1 360\n");
  EXPECT_NE(r.find("no ray tracer was started"), std::string::npos) << r;
  EXPECT_EQ(r.find("ray scene"), std::string::npos) << r;
  EXPECT_EQ(r.find("ray tracer process"), std::string::npos) << r;
  // Could ask, but nothing of it shows.
  const std::string unseen = stats("Surface \"shadowed\"\nTranslate 0 0 -50\nSphere 1 -1 1 360\n");
  EXPECT_NE(unseen.find("no ray tracer was started"), std::string::npos) << unseen;
}

TEST_F(NotNeeded, OpaqueThingsRunNoShaderForShadowRays) {
  w_.write("shadowed.sl", kShadowed);
  const std::string floor =
      "Surface \"shadowed\"\nPatch \"bilinear\" \"P\" [-3 -1 -3  3 -1 -3  -3 -1 3  3 -1 3]\n";
  const std::string r = stats(floor + "Surface \"plastic\"\nSphere 0.7 -0.7 0.7 360\n");
  EXPECT_GT(number(r, "visibility"), 1000);
  EXPECT_EQ(number(r, "hits shaded"), 0) << r;
  const std::string glass = stats(floor + "Opacity .5 .5 .5\nSurface \"plastic\"\nSphere 0.7 -0.7 0.7 360\n");
  EXPECT_GE(number(glass, "visibility"), 1000);
}

TEST_F(NotNeeded, GridsHoldPositionsAlone) {
  w_.write("painted.sl", "surface painted(varying color paint = 0;) { Ci = paint; Oi = 1; }\n");
  const auto scene = [&](const std::string& primvars, const char* file) {
    w_.write(
        "scene.rib",
        kHead +
            "WorldBegin\nSurface \"painted\"\nPatch \"bilinear\" \"P\" [-1 -1 0  1 -1 0  -1 1 0  1 1 0] " +
            primvars + "\nWorldEnd\n");
    const Outcome o = run("scenecache", {"build", "scene.rib", "-o", file}, w_.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return run("scenecache", {"ls", file, "--json"}, w_.path()).out;
  };
  const auto bytes = [](const std::string& json) { return number(json, "\"bytes\":"); };
  const double plain = bytes(scene("", "a.fsc"));
  EXPECT_GT(plain, 0);
  EXPECT_EQ(
      bytes(scene("\"varying color paint\" [1 0 0  0 1 0  0 0 1  1 1 1] \"varying float unread\" [1 2 3 4]",
                  "b.fsc")),
      plain);
}

TEST_F(NotNeeded, OnlyTheTilesThatShowAreRead) {
  // A texture of 2048 x 2048 pixels, 12 MB as it is stored, seen through a keyhole.
  std::ostringstream ppm;
  constexpr int kSide = 2048;
  ppm << "P6\n" << kSide << ' ' << kSide << "\n255\n";
  for (int j = 0; j < kSide; ++j)
    for (int i = 0; i < kSide; ++i) ppm << char(i * 7 ^ j) << char(j * 13 ^ i) << char(i * j);
  w_.write("big.ppm", ppm.str());
  ASSERT_EQ(run("mkmip", {"big.ppm", "big.tx"}, w_.path()).exitCode, 0);
  w_.write("poster.sl", "surface poster() { Ci = texture(\"big.tx\"); Oi = 1; }\n");
  const std::string r =
      stats("Surface \"poster\"\nPatch \"bilinear\" \"P\" [-15 -15 0  15 -15 0  -15 15 0  15 15 0]\n");
  const double read = number(r, "lookups,");
  EXPECT_GT(read, 0) << r;
  EXPECT_LT(read, 2) << r;  // MiB: the view shows a sixth of the poster in each direction
  EXPECT_EQ(stats("Surface \"poster\"\nTranslate 0 0 -50\nSphere 1 -1 1 360\n").find(" read,"),
            std::string::npos);
}

TEST_F(NotNeeded, WhatARayCannotSeeIsNotInItsScene) {
  w_.write("shadowed.sl", kShadowed);
  const std::string floor =
      "Surface \"shadowed\"\nPatch \"bilinear\" \"P\" [-3 -1 -3  3 -1 -3  -3 -1 3  3 -1 3]\n";
  const std::string ball = "Sphere 0.7 -0.7 0.7 360\n";
  const double alone = number(stats(floor), "ray scene");
  ASSERT_GT(alone, 0);
  EXPECT_GT(number(stats(floor + ball), "ray scene"), alone);
  EXPECT_EQ(number(stats(floor +
                         "Attribute \"visibility\" \"integer trace\" [0] \"string transmission\" "
                         "[\"transparent\"]\n" +
                         ball),
                   "ray scene"),
            alone);
}

TEST_F(NotNeeded, FilesForOneSideExistForThatSideAlone) {
  w_.write("shadowed.sl", kShadowed);
  const std::string floor =
      "Surface \"shadowed\"\nPatch \"bilinear\" \"P\" [-3 -1 -3  3 -1 -3  -3 -1 3  3 -1 3]\n";
  const auto files = [&](const std::string& common, const std::string& bmrt, const std::string& prman) {
    w_.write("common.rib", kHead + "WorldBegin\n" + common);
    w_.write("bmrt.rib", bmrt + "WorldEnd\n");
    w_.write("prman.rib", prman + "WorldEnd\n");
    return statsOf("common.rib", {"-bmrt", "bmrt.rib", "-prman", "prman.rib"});
  };
  const std::string ball = "Surface \"plastic\"\nSphere 0.7 -0.7 0.7 360\n";
  const std::string none = files(floor, "", ""), tracer = files(floor, ball, ""),
                    reyes = files(floor, "", ball);
  EXPECT_GT(number(tracer, "ray scene"), number(none, "ray scene"));
  EXPECT_EQ(number(reyes, "ray scene"), number(none, "ray scene"));
  EXPECT_GT(number(reyes, "grids drawn"), number(none, "grids drawn"));
  EXPECT_EQ(number(tracer, "grids drawn"), number(none, "grids drawn"));
}

}  // namespace
}  // namespace fr::test
