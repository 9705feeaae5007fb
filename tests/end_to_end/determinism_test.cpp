// The same picture, bit for bit, however it is made: threads, transports, memory, order, a cache made before;
// and with --deterministic on whatever instructions.
#include <gtest/gtest.h>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

/// Something of everything that could depend on who came first: rays from displaced and from blurred
/// surfaces, random directions, shadows through transparency, several grids to a bucket and several buckets
/// to a grid.
std::string scene(const std::string& options = {}) {
  std::string s =
      "Display \"out.exr\" \"openexr\" \"rgbaz\" \"string exrpixeltype\" [\"float\"]\nFormat 96 72 1\n"
      "PixelSamples 3 3\nShutter 0 1\nDepthOfField 8 0.4 6\n" +
      options +
      "Projection \"perspective\" \"fov\" [45]\nTranslate 0 0 6\nWorldBegin\n"
      "Attribute \"light\" \"string shadows\" [\"on\"]\n"
      "LightSource \"distantlight\" 1 \"from\" [1 2 -2] \"to\" [0 0 0]\n"
      "AttributeBegin Attribute \"light\" \"int nsamples\" [4] AreaLightSource \"arealight\" 2 \"intensity\" "
      "[2]\n"
      "Surface \"constant\" Translate -2 3 -1 Rotate 90 1 0 0 Polygon \"P\" [-1 -1 0 -1 1 0 1 1 0 1 -1 0] "
      "AttributeEnd\nIlluminate 2 1\nShadingRate 2\nSurface \"seen\"\n"
      "AttributeBegin Color [0.7 0.8 0.9] Translate 0 -1.6 0 Rotate 90 1 0 0 Polygon \"P\" [-9 -9 0 -9 9 0 9 "
      "9 0 9 -9 0] "
      "AttributeEnd\n";
  for (int i = 0; i < 6; ++i) {
    const std::string x = std::to_string(1.5 * (i % 3) - 1.5), y = std::to_string(1.4 * (i / 3) - 0.8);
    s += "AttributeBegin\nColor [" + std::to_string(0.3 + 0.1 * i) + " 0.6 " + std::to_string(0.9 - 0.1 * i) +
         "]\n";
    if (i == 1) s += "Opacity [0.4 0.5 0.6]\n";
    if (i == 2)
      s += "MotionBegin [0 1] Translate " + x + " " + y + " 0 Translate " + x + " 1.1 0 MotionEnd\n";
    else
      s += "Translate " + x + " " + y + " 0\n";
    if (i == 3) s += "Displacement \"lumps\" Attribute \"displacementbound\" \"float sphere\" [0.1]\n";
    s += i == 4 ? "Rotate 50 1 1 0 Torus 0.4 0.2 0 360 360\n" : "Sphere 0.6 -0.6 0.6 360\n";
    s += "AttributeEnd\n";
  }
  return s + "WorldEnd\n";
}
constexpr const char* kSeen =
    "surface seen() { normal Nf = faceforward(normalize(N), I); Oi = Os;\n"
    "  Ci = Os * Cs * (0.2 * (1 - occlusion(P, Nf, 4)) + 0.5 * diffuse(Nf) + 0.1 * noise(8 * P)\n"
    "    + 0.3 * trace(P, reflect(normalize(I), Nf)) + 0.1 * color(random(), random(), 0)); }\n";
constexpr const char* kLumps =
    "displacement lumps() { P += 0.1 * noise(6 * transform(\"object\", P)) * normalize(N); N = "
    "calculatenormal(P); }\n";

class Determinism : public ::testing::Test {
 protected:
  void SetUp() override {
    w_.write("seen.sl", kSeen);
    w_.write("lumps.sl", kLumps);
    w_.write("scene.rib", scene());
  }
  Picture render(const std::string& program, std::vector<std::string> arguments,
                 const std::map<std::string, std::string>& environment = {},
                 const std::string& file = "scene.rib") {
    std::filesystem::remove(w_.path() / "out.exr");
    arguments.push_back(file);
    const Outcome o = run(program, arguments, w_.path(), {}, environment);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return readExr(w_.path() / "out.exr");
  }
  Workspace w_;
};

TEST_F(Determinism, ThreadsTransportsMemoryOrderAndCachesChangeNothing) {
  const Picture picture = render("frankenrender", {"--quiet", "--threads", "2"});
  ASSERT_EQ(picture.width, 96);
  const std::vector<std::vector<std::string>> ways = {
      {"--threads", "1"},           {"--threads", "5"}, {"--inproc"}, {"--inproc", "--threads", "3"},
      {"--pipe", "--threads", "2"}, {"--memory", "90M"}};
  for (std::vector<std::string> way : ways) {
    const std::string name = way.front() + " " + way.back();
    way.emplace_back("--quiet");
    EXPECT_EQ(render("frankenrender", way), picture) << name;
  }
  // Other buckets: the order of everything is another.
  w_.write("buckets.rib", scene("Option \"limits\" \"integer[2] bucketsize\" [11 11]\n"));
  EXPECT_EQ(render("frankenrender", {"--quiet"}, {}, "buckets.rib"), picture);
  ASSERT_EQ(run("scenecache", {"build", "-q", "scene.rib", "-o", "scene.fsc"}, w_.path()).exitCode, 0);
  EXPECT_EQ(render("frankenrender", {"--quiet"}, {}, "scene.fsc"), picture) << "from a cache";
}

TEST_F(Determinism, OfTheRendererByRays) {
  const Picture picture = render("rendrib", {"-silent", "-threads", "2"});
  ASSERT_EQ(picture.width, 96);
  const std::vector<std::vector<std::string>> ways = {
      {"-threads", "1"}, {"-threads", "5"}, {"-memory", "90M"}};
  for (std::vector<std::string> way : ways) {
    const std::string name = way.front() + " " + way.back();
    way.emplace_back("-silent");
    EXPECT_EQ(render("rendrib", way), picture) << name;
  }
  w_.write("buckets.rib", scene("Option \"limits\" \"integer[2] bucketsize\" [11 11]\n"));
  EXPECT_EQ(render("rendrib", {"-silent"}, {}, "buckets.rib"), picture);
  ASSERT_EQ(run("scenecache", {"build", "-q", "scene.rib", "-o", "scene.fsc"}, w_.path()).exitCode, 0);
  EXPECT_EQ(render("rendrib", {"-silent"}, {}, "scene.fsc"), picture) << "from a cache";
}

TEST_F(Determinism, AnyInstructionsWhenAskedFor) {
  const Picture picture = render("frankenrender", {"--quiet", "--deterministic"});
  ASSERT_EQ(picture.width, 96);
  const Picture byRays = render("rendrib", {"-silent", "-deterministic"});
  for (const char* set : {"sse4", "avx2", "avx512"}) {
    const std::map<std::string, std::string> environment = {{"FRANKENRENDER_ISA", set}};
    EXPECT_EQ(render("frankenrender", {"--quiet", "--deterministic"}, environment), picture) << set;
    EXPECT_EQ(render("rendrib", {"-silent", "-deterministic"}, environment), byRays) << set;
  }
  for (const char* way : {"--inproc", "--pipe"})
    EXPECT_EQ(render("frankenrender", {"--quiet", "--deterministic", way}), picture) << way;
}

}  // namespace
}  // namespace fr::test
