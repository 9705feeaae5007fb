// Displays, frames and passes of both programs from the outside.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

constexpr const char* kOutputs =
    "surface outputs(output varying color shade = 0; output varying float mask = 0;\n"
    "                output varying float pair[2] = {0, 0}; output float flat = 0.25;) {\n"
    "  shade = color(0.25, 0.5, 0.75); mask = 1; pair[0] = u; pair[1] = 0.5;\n"
    "  Oi = Os; Ci = Cs; }\n";
const std::string kHead =
    "Format 64 48 1\nPixelSamples 2 2\nPixelFilter \"box\" 1 1\nProjection \"perspective\" \"fov\" [40]\n"
    "Translate 0 0 5\n";
const std::string kSphere = "WorldBegin Surface \"outputs\" Sphere 1 -1 1 360 WorldEnd\n";

/// Both renderers: `GetParam()` is the program.
class Displays : public testing::TestWithParam<const char*> {
 protected:
  Outcome render(const std::string& rib, std::vector<std::string> options = {}) {
    w_.write("outputs.sl", kOutputs);
    w_.write("scene.rib", rib);
    options.push_back("scene.rib");
    return run(GetParam(), options, w_.path());
  }
  Picture picture(const std::string& name) { return readExr(w_.path() / name); }
  Workspace w_;
};
INSTANTIATE_TEST_SUITE_P(Programs, Displays, testing::Values("frankenrender", "rendrib"));

TEST_P(Displays, VariablesOfShadersInFilesOfTheirOwnAndTogether) {
  const Outcome o = render(
      kHead +
      "DisplayChannel \"varying color shade\"\nDisplayChannel \"varying float mask\" \"string filter\" "
      "[\"max\"]\n"
      "Display \"all.exr\" \"openexr\" \"rgba,shade,pair,flat,z,N,P,u,Ng\"\n"
      "Display \"+shade.exr\" \"openexr\" \"shade\"\nDisplay \"+mask.exr\" \"openexr\" \"mask\"\n"
      "Display \"+smooth.exr\" \"openexr\" \"varying float mask\"\nDisplay \"+n.exr\" \"openexr\" \"N\"\n" +
      kSphere);
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  const Picture all = picture("all.exr");
  std::vector<std::string> names;
  for (const auto& [name, values] : all.channels) names.push_back(name);
  EXPECT_EQ(names,
            (std::vector<std::string>{"A",    "B",      "G",      "N.B",     "N.G",     "N.R",     "Ng.B",
                                      "Ng.G", "Ng.R",   "P.B",    "P.G",     "P.R",     "R",       "Z",
                                      "flat", "pair.0", "pair.1", "shade.B", "shade.G", "shade.R", "u"}));
  EXPECT_NEAR(all.at("shade.G", 32, 24), 0.5, 1e-3);
  EXPECT_NEAR(all.at("flat", 32, 24), 0.25, 1e-3);
  EXPECT_NEAR(all.at("pair.1", 32, 24), 0.5, 1e-3);
  EXPECT_NEAR(all.at("pair.0", 40, 20), all.at("u", 40, 20), 1e-3);
  EXPECT_NEAR(all.at("P.B", 32, 24), 4, 0.01);   // camera space
  EXPECT_NEAR(all.at("N.B", 32, 24), -1, 0.01);  // towards the eye
  EXPECT_NEAR(all.at("Z", 32, 24), 4, 0.01);
  EXPECT_EQ(picture("shade.exr").channels.size(), 3u);
  EXPECT_EQ(picture("n.exr").channels.size(), 3u);
  // At the outline the largest sample is 1, the filtered one what the sphere covers.
  const Picture mask = picture("mask.exr"), smooth = picture("smooth.exr");
  int between = 0;
  for (size_t i = 0; i < mask.channels.at("Y").size(); ++i) {
    const float m = mask.channels.at("Y")[i], s = smooth.channels.at("Y")[i];
    EXPECT_TRUE(m == 0 || m == 1);
    EXPECT_EQ(m > 0, s > 0);
    between += s > 0 && s < 1;
  }
  EXPECT_GT(between, 10);
}

TEST_P(Displays, EachHasItsQuantisationDitherAndExposure) {
  const Outcome o =
      render(kHead +
             "Exposure 2 1\nQuantize \"rgba\" 0 0 0 0\nQuantize \"shade\" 100 0 255 0\n"
             "Display \"float.exr\" \"openexr\" \"rgb\"\n"
             "Display \"+half.exr\" \"openexr\" \"rgb\" \"exposure\" [0.5 1]\n"
             "Display \"+eight.tif\" \"tiff\" \"rgba\" \"quantize\" [0 200 10 255] \"dither\" [0] "
             "\"compression\" [\"none\"]\n"
             "Display \"+sixteen.tif\" \"tiff\" \"rgba\" \"quantize\" [0 65535 0 65535] \"dither\" [0] "
             "\"compression\" [\"none\"]\n"
             "Display \"+shade.tif\" \"tiff\" \"color shade\"\n"
             "WorldBegin Color [0.25 0.25 0.25] Surface \"outputs\" Sphere 1 -1 1 360 WorldEnd\n");
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_NEAR(picture("float.exr").at("R", 32, 24), 0.5, 1e-3);
  EXPECT_NEAR(picture("half.exr").at("R", 32, 24), 0.125, 1e-3);
  // The sizes tell the depths; the values are for imaging_test.
  const auto bytes = [&](const char* name) { return std::filesystem::file_size(w_.path() / name); };
  EXPECT_GT(bytes("sixteen.tif"), 64u * 48 * 4 * 2);
  EXPECT_LT(bytes("eight.tif"), 64u * 48 * 4 * 2);
  EXPECT_GT(bytes("shade.tif"), 0u);
}

TEST_P(Displays, DepthFilters) {
  const auto frame = [](int n, const std::string& filter) {
    return "FrameBegin " + std::to_string(n) + "\nDisplay \"" + filter + ".exr\" \"openexr\" \"z\"\n" +
           "Hider \"hidden\" \"string depthfilter\" [\"" + filter +
           "\"] \"int jitter\" [0]\n"
           "WorldBegin Surface \"constant\" Sphere 1 -1 1 360 Translate 0 0 3\n"
           "Polygon \"P\" [-9 -9 0 9 -9 0 9 0 0 -9 0 0] WorldEnd FrameEnd\n";
  };
  const Outcome o =
      render(kHead + frame(1, "min") + frame(2, "max") + frame(3, "average") + frame(4, "midpoint"));
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  const Picture least = picture("min.exr"), most = picture("max.exr"), mean = picture("average.exr"),
                middle = picture("midpoint.exr");
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      EXPECT_LE(least.at("Z", x, y), mean.at("Z", x, y));
      EXPECT_LE(mean.at("Z", x, y), most.at("Z", x, y));
    }
  EXPECT_NEAR(least.at("Z", 32, 20), 4, 0.03);
  EXPECT_NEAR(middle.at("Z", 32, 20), 5, 0.03);  // between 4 and 6
  EXPECT_GT(middle.at("Z", 2, 40), 1e30);        // the polygon alone: there is no second surface
  EXPECT_NEAR(most.at("Z", 2, 40), 8, 1e-3);
  EXPECT_GT(most.at("Z", 2, 2), 1e30);
}

TEST_P(Displays, FourCropsAreTheWhole) {
  const std::string world =
      "Display \"out.exr\" \"openexr\" \"rgbaz\"\nWorldBegin LightSource \"distantlight\" 1 Surface "
      "\"matte\"\n"
      "Sphere 1 -1 1 360 Translate 0.7 0.3 1 Torus 0.9 0.3 0 360 360 WorldEnd\n";
  const auto rendered = [&](const std::string& window) {
    const Outcome o = render(kHead + "PixelFilter \"gaussian\" 2.5 3.5\n" + window + world);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return picture("out.exr");
  };
  const Picture whole = rendered("");
  // RISpec 3.2: pixels from ceil(64 * 0.37) = 24 and ceil(48 * 0.61) = 30.
  const Picture part[4] = {rendered("CropWindow 0 0.37 0 0.61\n"), rendered("CropWindow 0.37 1 0 0.61\n"),
                           rendered("CropWindow 0 0.37 0.61 1\n"), rendered("CropWindow 0.37 1 0.61 1\n")};
  ASSERT_EQ(part[0].width, 24);
  ASSERT_EQ(part[0].height, 30);
  ASSERT_EQ(part[1].width, 40);
  ASSERT_EQ(part[2].height, 18);
  for (const auto& [name, values] : whole.channels)
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 64; ++x) {
        const Picture& p = part[(x >= 24) + 2 * (y >= 30)];
        ASSERT_EQ(whole.at(name, x, y), p.at(name, x >= 24 ? x - 24 : x, y >= 30 ? y - 30 : y)) << name;
      }
}

TEST_P(Displays, FramesWorldsAndAChosenRange) {
  std::string rib = kHead;
  for (int f = 1; f <= 4; ++f)
    rib += "FrameBegin " + std::to_string(f) + "\nDisplay \"f" + std::to_string(f) +
           ".exr\" \"openexr\" \"rgba\"\n" + kSphere + "FrameEnd\n";
  const bool reyes = std::string(GetParam()) == "frankenrender";
  const Outcome o = render(rib, {reyes ? "--frames" : "-frames", "2", "3"});
  EXPECT_EQ(o.exitCode, 0) << o.err;
  for (int f = 1; f <= 4; ++f)
    EXPECT_EQ(std::filesystem::exists(w_.path() / ("f" + std::to_string(f) + ".exr")), f == 2 || f == 3) << f;
  // Several worlds without frames; the second Display replaces the first.
  const Outcome worlds =
      render(kHead + "Display \"a.exr\" \"openexr\" \"rgba\"\n" + kSphere +
             "Display \"b.exr\" \"openexr\" \"a\"\nDisplay \"+c.exr\" \"openexr\" \"z\"\n" + kSphere);
  EXPECT_EQ(worlds.exitCode, 0) << worlds.err;
  EXPECT_EQ(picture("a.exr").channels.size(), 4u);
  EXPECT_EQ(picture("b.exr").channels.size(), 1u);
  EXPECT_EQ(picture("c.exr").channels.size(), 1u);
}

TEST_P(Displays, AWindowBecomesAFileAndSaysSo) {
  const Outcome o = render(kHead + "Display \"view\" \"framebuffer\" \"rgb\"\n" + kSphere);
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_NE(o.err.find("view.tif"), std::string::npos) << o.err;
  EXPECT_TRUE(std::filesystem::exists(w_.path() / "view.tif"));
  const Outcome missing = render(kHead + "Display \"x.exr\" \"openexr\" \"nothing\"\n" + kSphere);
  EXPECT_EQ(missing.exitCode, 0);
  EXPECT_NE(missing.err.find("nothing"), std::string::npos);
}

TEST(Catrib, RewritesChecksAndSaysWhatIsWrong) {
  Workspace w;
  w.write("a.rib",
          "##RenderMan RIB\nversion 3.04\nWorldBegin\nSphere 1 -1 1 360 # ball\nReadArchive "
          "\"b.rib\"\nWorldEnd\n");
  w.write("b.rib", "Sides 1\n");
  const Outcome pretty = run("catrib", {"a.rib"}, w.path());
  EXPECT_EQ(pretty.exitCode, 0) << pretty.err;
  EXPECT_EQ(
      pretty.out,
      "##RenderMan RIB\nversion 3.04\nWorldBegin\n  Sphere 1 -1 1 360\n  # ball\n  ReadArchive \"b.rib\"\n"
      "WorldEnd\n");
  EXPECT_EQ(run("catrib", {"-b", "-z", "-o", "c.rib.gz", "a.rib"}, w.path()).exitCode, 0);
  EXPECT_EQ(run("catrib", {"c.rib.gz"}, w.path()).out, pretty.out);
  const Outcome expanded = run("catrib", {"--expand", "--compact", "a.rib"}, w.path());
  EXPECT_NE(expanded.out.find("Sides 1"), std::string::npos) << expanded.out;
  EXPECT_EQ(run("catrib", {"--check", "a.rib"}, w.path()).exitCode, 0);
  w.write("bad.rib", "WorldBegin\nSphere 1 2\nAttributeEnd\nWorldEnd\n");
  const Outcome bad = run("catrib", {"--check", "bad.rib"}, w.path());
  EXPECT_EQ(bad.exitCode, 1);
  EXPECT_NE(bad.err.find("bad.rib:3:"), std::string::npos) << bad.err;
  EXPECT_NE(bad.err.find("2 errors, 0 warnings"), std::string::npos) << bad.err;
  EXPECT_EQ(run("catrib", {"missing.rib"}, w.path()).exitCode, 1);
  EXPECT_EQ(run("catrib", {"--nonsense"}, w.path()).exitCode, 2);
}

}  // namespace
}  // namespace fr::test
