// rendrib as a renderer, from the outside: its options, its files, and its pictures against REYES.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

const std::string kCamera = "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n";
const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 48 36 1\nPixelFilter \"box\" 1 1\n" + kCamera;
const std::string kSphere = "WorldBegin\nSurface \"constant\"\nSphere 1 -1 1 360\nWorldEnd\n";

/// The user's own .rendribrc must not matter.
const std::map<std::string, std::string> kNoHome = {{"HOME", "/nonexistent"}};

Outcome rendrib(const Workspace& w, const std::vector<std::string>& arguments) {
  return run("rendrib", arguments, w.path(), {}, kNoHome);
}
bool exists(const Workspace& w, const std::string& file) { return std::filesystem::exists(w.path() / file); }

std::string bytesOf(const std::filesystem::path& file) {
  std::stringstream s;
  s << std::ifstream(file, std::ios::binary).rdbuf();
  return s.str();
}

TEST(Rendrib, RendersSilentlyAndWritesTheDisplays) {
  Workspace w;
  w.write("scene.rib",
          "Display \"a.exr\" \"openexr\" \"rgba\"\nDisplay \"+z.exr\" \"openexr\" \"z\"\n"
          "Display \"+b.tif\" \"tiff\" \"rgb\"\nDisplay \"+n.exr\" \"openexr\" \"normal N\"\n"
          "Format 48 36 1\nPixelFilter \"box\" 1 1\n" +
              kCamera + kSphere);
  const Outcome o = rendrib(w, {"scene.rib"});
  EXPECT_EQ(o.exitCode, 0);
  EXPECT_EQ(o.err + o.out, "");
  EXPECT_EQ(readExr(w.path() / "a.exr").at("A", 24, 18), 1.f);
  EXPECT_NEAR(readExr(w.path() / "z.exr").at("Z", 24, 18), 4.f, 0.01f);
  const Picture n = readExr(w.path() / "n.exr");
  EXPECT_EQ(n.channels.size(), 3u);
  EXPECT_GT(std::filesystem::file_size(w.path() / "b.tif"), 200u);
}

TEST(Rendrib, StandardInputIsReadWithoutAFile) {
  Workspace w;
  w.write("scene.rib", kHead + kSphere);
  EXPECT_EQ(run("rendrib", {}, w.path(), {}, kNoHome, w.path() / "scene.rib").exitCode, 0);
  EXPECT_TRUE(exists(w, "out.exr"));
  std::filesystem::remove(w.path() / "out.exr");
  w.write("head.rib", kHead);
  w.write("world.rib", kSphere);
  EXPECT_EQ(run("rendrib", {"head.rib", "-"}, w.path(), {}, kNoHome, w.path() / "world.rib").exitCode, 0);
  EXPECT_TRUE(exists(w, "out.exr"));
}

TEST(Rendrib, ResolutionAndSamplesHoldWhereTheRibSaysNothing) {
  Workspace w;
  const std::string display = "Display \"out.exr\" \"openexr\" \"rgba\"\n";
  w.write("open.rib", display + kCamera + kSphere);
  w.write("fixed.rib", display + "Format 48 36 1\nPixelSamples 1 1\n" + kCamera + kSphere);
  const std::vector<std::string> options{"-res", "20", "10", "-samples", "3", "3", "-stats"};
  const auto with = [&](const std::string& file) {
    std::vector<std::string> a = options;
    a.push_back(file);
    const Outcome o = rendrib(w, a);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return o.out;
  };
  EXPECT_NE(with("open.rib").find("9.00 samples"), std::string::npos);
  EXPECT_EQ(readExr(w.path() / "out.exr").width, 20);
  EXPECT_NE(with("fixed.rib").find("1.00 samples"), std::string::npos);
  EXPECT_EQ(readExr(w.path() / "out.exr").width, 48);
}

TEST(Rendrib, FramesAndSeveralWorlds) {
  Workspace w;
  std::string rib = "Format 16 12 1\n" + kCamera;
  for (int f = 1; f <= 4; ++f)
    rib += "FrameBegin " + std::to_string(f) + "\nDisplay \"f" + std::to_string(f) +
           ".exr\" \"openexr\" \"rgba\"\n" + kSphere + "FrameEnd\n";
  w.write("scene.rib", rib);
  EXPECT_EQ(rendrib(w, {"-frames", "2", "3", "scene.rib"}).exitCode, 0);
  EXPECT_FALSE(exists(w, "f1.exr"));
  EXPECT_TRUE(exists(w, "f2.exr"));
  EXPECT_TRUE(exists(w, "f3.exr"));
  EXPECT_FALSE(exists(w, "f4.exr"));
  EXPECT_EQ(rendrib(w, {"scene.rib"}).exitCode, 0);
  EXPECT_TRUE(exists(w, "f1.exr") && exists(w, "f4.exr"));
}

TEST(Rendrib, CropIsThatPartOfTheWholePicture) {
  Workspace w;
  w.write("scene.rib", kHead + kSphere);
  ASSERT_EQ(rendrib(w, {"scene.rib", "-of", "whole.exr"}).exitCode, 0);
  ASSERT_EQ(rendrib(w, {"-crop", "0.25", "0.75", "0.5", "1", "-of", "part.exr", "scene.rib"}).exitCode, 0);
  EXPECT_FALSE(exists(w, "out.exr")) << "-of stands for the Displays";
  const Picture whole = readExr(w.path() / "whole.exr"), part = readExr(w.path() / "part.exr");
  ASSERT_EQ(part.width, 24);
  ASSERT_EQ(part.height, 18);
  for (int y = 0; y < part.height; ++y)
    for (int x = 0; x < part.width; ++x)
      for (const char* c : {"R", "A"}) ASSERT_EQ(part.at(c, x, y), whole.at(c, x + 12, y + 18));
}

TEST(Rendrib, SafeKeepsWhatIsThere) {
  Workspace w;
  w.write("scene.rib",
          "Display \"a.exr\" \"openexr\" \"rgba\"\nDisplay \"+b.exr\" \"openexr\" \"rgba\"\n"
          "Format 16 12 1\n" +
              kCamera + kSphere);
  w.write("a.exr", "precious");
  const Outcome o = rendrib(w, {"-safe", "scene.rib"});
  EXPECT_EQ(o.exitCode, 0);
  EXPECT_NE(o.err.find("a.exr exists and is kept"), std::string::npos) << o.err;
  EXPECT_EQ(bytesOf(w.path() / "a.exr"), "precious");
  EXPECT_TRUE(exists(w, "b.exr"));
  w.write("b.exr", "precious too");
  EXPECT_EQ(rendrib(w, {"-safe", "-silent", "scene.rib"}).err, "");
  EXPECT_EQ(bytesOf(w.path() / "b.exr"), "precious too");
  EXPECT_EQ(rendrib(w, {"scene.rib"}).exitCode, 0);
  EXPECT_EQ(readExr(w.path() / "a.exr").width, 16);
}

TEST(Rendrib, AWindowIsAFile) {
  Workspace w;
  w.write("scene.rib", kHead + kSphere);
  for (const std::vector<std::string>& a :
       {std::vector<std::string>{"-d", "scene.rib"}, {"-d", "8", "-pos", "10", "-20", "scene.rib"}}) {
    const Outcome o = rendrib(w, a);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_NE(o.err.find("no window"), std::string::npos) << o.err;
    EXPECT_TRUE(exists(w, "out.exr"));
    std::filesystem::remove(w.path() / "out.exr");
  }
}

TEST(Rendrib, RcFilesAreReadFirst) {
  Workspace w;
  std::filesystem::create_directory(w.path() / "home");
  w.write("home/.rendribrc", "Format 20 10 1\nPixelFilter \"box\" 1 1\n");
  w.write(".rendribrc", "Format 30 10 1\n");
  w.write("scene.rib", "Display \"out.exr\" \"openexr\" \"rgba\"\n" + kCamera + kSphere);
  const std::map<std::string, std::string> home = {{"HOME", (w.path() / "home").string()}};
  const auto width = [&](const std::vector<std::string>& a) {
    const Outcome o = run("rendrib", a, w.path(), {}, home);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return readExr(w.path() / "out.exr").width;
  };
  EXPECT_EQ(width({"scene.rib"}), 30) << "that of the folder after that of the home";
  EXPECT_EQ(width({"-norc", "-res", "40", "10", "scene.rib"}), 40);
  std::filesystem::remove(w.path() / ".rendribrc");
  EXPECT_EQ(width({"scene.rib"}), 20);
}

TEST(Rendrib, AdaptiveSamplingAndProgressAndBeep) {
  Workspace w;
  w.write("scene.rib", kHead + kSphere);
  const Outcome o =
      rendrib(w, {"-var", "0.001", "4", "64", "-stats", "-Progress", "-beep", "-threads", "1", "scene.rib"});
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_NE(o.out.find("4 to 64"), std::string::npos) << o.out;
  EXPECT_NE(o.out.find("R90000 0%\n"), std::string::npos) << o.out;
  EXPECT_NE(o.out.find("R90000 100%\n"), std::string::npos) << o.out;
  EXPECT_EQ(o.err, "\a");
}

TEST(Rendrib, OneDashOrTwo) {
  Workspace w;
  w.write("scene.rib", "Display \"out.exr\" \"openexr\" \"rgba\"\n" + kCamera + kSphere);
  EXPECT_EQ(rendrib(w, {"--res", "20", "10", "--silent", "--threads", "1", "scene.rib"}).exitCode, 0);
  EXPECT_EQ(readExr(w.path() / "out.exr").width, 20);
  for (const char* a : {"-help", "--help", "-version", "--version", "-arch"}) {
    const Outcome o = rendrib(w, {a});
    EXPECT_EQ(o.exitCode, 0) << a;
    EXPECT_NE(o.out, "") << a;
    EXPECT_EQ(o.err, "") << a;
  }
  const std::string help = rendrib(w, {"-help"}).out;
  for (const char* option :
       {"-res x y", "-samples x y", "-var v min max", "-frames f1 f2", "-crop x1 x2 y1 y2", "-safe",
        "-d [interleave]", "-Progress", "-rayserver", ".rendribrc"})
    EXPECT_NE(help.find(option), std::string::npos) << option;
}

TEST(Rendrib, WrongUsageSaysWhatIsWrong) {
  Workspace w;
  w.write("scene.rib", kHead + kSphere);
  const std::pair<std::vector<std::string>, const char*> cases[] = {
      {{"-nosuchoption", "scene.rib"}, "unknown option -nosuchoption"},
      {{"scene.rib", "-res", "10"}, "-res wants x y"},
      {{"-res", "ten", "10", "scene.rib"}, "\"ten\" should be a whole number"},
      {{"-res", "10", "0", "scene.rib"}, "should be a whole number from 1"},
      {{"-crop", "0.5", "0.2", "0", "1", "scene.rib"}, "x1 < x2"},
      {{"-crop", "nan", "0.2", "0", "1", "scene.rib"}, "should be a number from 0 to 1"},
      {{"-var", "0.1", "8", "4", "scene.rib"}, "min <= max"},
      {{"-threads", "-3", "scene.rib"}, "-threads"},
  };
  for (const auto& [arguments, message] : cases) {
    const Outcome o = rendrib(w, arguments);
    EXPECT_EQ(o.exitCode, 2) << message;
    EXPECT_NE(o.err.find(message), std::string::npos) << o.err;
  }
  EXPECT_EQ(rendrib(w, {"nosuch.rib"}).exitCode, 1);
  EXPECT_FALSE(exists(w, "out.exr"));
}

TEST(Rendrib, ACameraWithoutInverseIsAnError) {
  Workspace w;
  w.write("scene.rib", "Display \"out.exr\" \"openexr\" \"rgba\"\nScale 1 1 0\n" + kSphere);
  const Outcome o = rendrib(w, {"scene.rib"});
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err, "");
  EXPECT_FALSE(exists(w, "out.exr"));
}

TEST(Rendrib, ATruncatedSceneNeverCrashesOrHangs) {
  Workspace w;
  const std::string text = kHead + kSphere +
                           "WorldBegin\nOpacity [0.5 0.5 0.5] Surface \"mirror\" Torus 1 0.2 0 360 "
                           "360\nWorldEnd\n";
  for (size_t n = 0; n < text.size(); n += 31) {
    w.write("cut.rib", "Format 12 9 1\n" + text.substr(0, n));
    ASSERT_EQ(rendrib(w, {"cut.rib"}).signal, 0) << "cut at " << n;
  }
}

const std::string kLitScene =
    "Attribute \"light\" \"string shadows\" [\"on\"]\n"
    "LightSource \"pointlight\" 1 \"intensity\" [20] \"from\" [2 3 -3]\n"
    "AttributeBegin Surface \"mirror\" Translate -0.8 0 0 Sphere 0.7 -0.7 0.7 360 AttributeEnd\n"
    "AttributeBegin Color [1 0.3 0.2] Surface \"plastic\" Translate 0.9 -0.1 -0.3 Rotate 90 1 0 0\n"
    "Torus 0.5 0.2 0 360 360 AttributeEnd\n"
    "Surface \"matte\" Polygon \"P\" [-4 -0.8 -3 -4 -0.8 6 4 -0.8 6 4 -0.8 -3]\n";

TEST(Rendrib, APrebuiltCacheGivesTheSamePicture) {
  Workspace w;
  w.write("scene.rib", kHead + "WorldBegin\n" + kLitScene + "WorldEnd\n");
  ASSERT_EQ(rendrib(w, {"scene.rib"}).exitCode, 0);
  const Picture direct = readExr(w.path() / "out.exr");
  std::filesystem::remove(w.path() / "out.exr");
  ASSERT_EQ(run("scenecache", {"build", "scene.rib", "-o", "scene.fsc"}, w.path()).exitCode, 0);
  w.write(".rendribrc", "Format 30 10 1\n");  // nothing to a finished scene
  const Outcome o = rendrib(w, {"scene.fsc"});
  EXPECT_EQ(o.exitCode, 0);
  EXPECT_EQ(o.err, "");
  EXPECT_EQ(worst(direct, readExr(w.path() / "out.exr")), 0.0);
  EXPECT_NE(rendrib(w, {"-res", "9", "9", "scene.fsc"}).err.find("-res"), std::string::npos);
  EXPECT_EQ(rendrib(w, {"scene.fsc", "scene.rib"}).exitCode, 2);
}

// REYES shades cells as large as pixels and interpolates, rays shade every sample: the checks of the teapots'
// floor make that 0.0405 at this size.
class RendribExamples : public testing::TestWithParam<std::pair<const char*, double>> {};
INSTANTIATE_TEST_SUITE_P(Examples, RendribExamples,
                         testing::Values(std::pair("teapots", 0.05), std::pair("dragon", 0.004)));

TEST_P(RendribExamples, LookAsReyesDrawsThem) {
  Workspace w;
  const auto& [name, colorTolerance] = GetParam();
  const std::string source = std::string(FR_SOURCE_DIR) + "/examples/" + name + "/";
  // The example without its Format, PixelSamples and Displays, which the command line then gives.
  std::ifstream in(source + name + ".rib");
  std::string rib, line;
  while (std::getline(in, line))
    if (line.rfind("Format", 0) != 0 && line.rfind("PixelSamples", 0) != 0 && line.rfind("Display", 0) != 0 &&
        line.rfind("Imager", 0) != 0)
      rib += line + "\n";
  const std::string paths = "Option \"searchpath\" \"string archive\" [\"" + source +
                            "\"] \"string shader\" [\"" + source + ":@\"]\n";
  w.write("scene.rib", paths + rib);
  const std::vector<std::string> tail{"-res", "160", "90", "-samples", "2", "2", "scene.rib"};
  const std::string rgbaz = "Display \"out.exr\" \"openexr\" \"rgbaz\" \"string exrpixeltype\" [\"float\"]\n";
  w.write("scene.rib", rgbaz + "PixelFilter \"box\" 1 1\n" + paths + rib);
  const auto picture = [&](const char* program, std::vector<std::string> arguments) {
    const Outcome o = run(program, arguments, w.path(), {}, kNoHome);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return readExr(w.path() / "out.exr");
  };
  const Picture rays = picture("rendrib", tail);
  const Picture reyes = picture("frankenrender", {"--res", "160", "90", "--samples", "2", "2", "scene.rib"});
  ASSERT_EQ(rays.width, 160);
  size_t outline = 0, alpha = 0, depth = 0;
  double squares = 0;
  for (int y = 0; y < 90; ++y)
    for (int x = 0; x < 160; ++x) {
      const float z = reyes.at("Z", x, y);
      for (const auto& [nx, ny] : {std::pair(x + 1, y), std::pair(x, y + 1)})
        if (nx < 160 && ny < 90) outline += std::abs(reyes.at("Z", nx, ny) - z) > 0.02f * z;
      alpha += std::abs(rays.at("A", x, y) - reyes.at("A", x, y)) > 1e-3f;
      depth += std::abs(rays.at("Z", x, y) - z) > 2e-3f * z;
      for (const char* c : {"R", "G", "B"})
        squares += std::pow(double(rays.at(c, x, y)) - double(reyes.at(c, x, y)), 2);
    }
  // Four samples a pixel; each may differ along 0.002 of the outline (tests/hiders/hiders_test.cpp).
  const double expected = 4 * 0.002 * double(outline), allowed = expected + 4 * std::sqrt(expected) + 2;
  EXPECT_LT(double(alpha), allowed) << "outline " << outline;
  EXPECT_LT(double(depth), allowed) << "outline " << outline;
  // REYES colours whole micropolygons, and traces reflections at half the tessellation. The difference halves
  // when the micropolygons are half as wide (0.0145 at ShadingRate 1, 0.0074 at 0.25 for the teapots).
  EXPECT_LT(std::sqrt(squares / (3 * 160 * 90)), colorTolerance);
}

}  // namespace
}  // namespace fr::test
