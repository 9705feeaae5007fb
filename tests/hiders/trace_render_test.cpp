// The renderer by rays against closed forms, and the same picture however the work is divided.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

constexpr int kSize = 96;
/// Pixels across which one unit at distance 1 reaches (fov 40).
const double kFocal = kSize / 2.0 / std::tan(20 * std::numbers::pi / 180);

std::string scene(const std::string& world, const std::string& options = "",
                  const std::string& camera = "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n") {
  return fmt::format("Format {} {} 1\nPixelSamples 4 4\nPixelFilter \"box\" 1 1\n", kSize, kSize) + options +
         camera + "WorldBegin\n" + world + "WorldEnd\n";
}

double sum(const Channels& c, size_t channel) {
  double s = 0;
  for (float v : c.values[channel]) s += double(v);
  return s;
}
size_t pixel(int x, int y) { return size_t(y) * kSize + size_t(x); }

TEST(TraceRender, NothingIsTransparentBlackAndFarAway) {
  const Channels c = renderByRays(scene(""));
  for (size_t i = 0; i < size_t(kSize * kSize); ++i) {
    for (size_t k = 0; k < 4; ++k) ASSERT_EQ(c.at(k, i), 0.0f);
    ASSERT_EQ(c.at(4, i), kRiInfinity);
  }
}

TEST(TraceRender, SphereCoversItsSilhouetteAndHasItsDepth) {
  const Channels c = renderByRays(scene("Surface \"constant\" Color [1 0.5 0.25] Sphere 1 -1 1 360\n"));
  const double radius = kFocal * std::tan(std::asin(1.0 / 5));
  const double area = std::numbers::pi * radius * radius;
  // Chords of micropolygons of a pixel cut off less than 1/100 pixel; the rest is noise: 16 stratified
  // samples leave a standard deviation of about 0.1 in each of some 170 pixels along the outline, 1.3 in all.
  const double tolerance = 4 * 1.3 + 0.01 * 2 * std::numbers::pi * radius;
  EXPECT_NEAR(sum(c, 3), area, tolerance);
  EXPECT_NEAR(sum(c, 0), area, tolerance);
  EXPECT_NEAR(sum(c, 2), 0.25 * area, 0.25 * tolerance);
  for (int y = kSize / 2 - 12; y < kSize / 2 + 12; ++y)
    for (int x = kSize / 2 - 12; x < kSize / 2 + 12; ++x) {
      // Depth of the sphere on the ray through the pixel, smallest over the pixel: between those of its
      // corners nearest to and farthest from the middle.
      const auto depth = [](double px, double py) {
        const double dx = (px - kSize / 2.0) / kFocal, dy = (py - kSize / 2.0) / kFocal;
        const double a = dx * dx + dy * dy + 1;
        return (5 - std::sqrt(25 - a * 24)) / a;
      };
      const int nx = x < kSize / 2 ? x + 1 : x, ny = y < kSize / 2 ? y + 1 : y;
      const double sagitta = 0.0005;  // of a micropolygon
      const float z = c.at(4, pixel(x, y));
      ASSERT_GE(z, depth(nx, ny) - sagitta);
      ASSERT_LE(z, depth(x < kSize / 2 ? x : x + 1, y < kSize / 2 ? y : y + 1) + sagitta);
    }
}

TEST(TraceRender, LambertSphereUnderADistantLightIsItsCosine) {
  const Channels c = renderByRays(
      scene("LightSource \"distantlight\" 1 \"from\" [0 0 -1] \"to\" [0 0 0]\n"
            "Surface \"matte\" \"Ka\" [0] \"Kd\" [1]\nSphere 1 -1 1 360\n",
            "ScreenWindow -1.25 1.25 -1.25 1.25\n", "Projection \"orthographic\"\nTranslate 0 0 5\n"));
  for (int y = 24; y < 72; ++y)
    for (int x = 24; x < 72; ++x) {
      const double px = (x + 0.5) / kSize * 2.5 - 1.25, py = (y + 0.5) / kSize * 2.5 - 1.25;
      // The mean over the pixel against the value at its centre; and sampling noise of a gentle slope.
      ASSERT_NEAR(c.at(0, pixel(x, y)), std::sqrt(1 - px * px - py * py), 0.01) << x << "," << y;
    }
}

const std::string kSquare = "Polygon \"P\" [-3 -3 0 -3 3 0 3 3 0 3 -3 0]\n";

TEST(TraceRender, LayersAreCompositedFrontToBack) {
  const Channels c =
      renderByRays(scene("Surface \"constant\"\n"
                         "AttributeBegin Color [0 1 0] Translate 0 0 1 " +
                         kSquare +
                         "AttributeEnd\n"
                         "AttributeBegin Color [1 0 0] Opacity [0.25 0.5 0.75] " +
                         kSquare +
                         "AttributeEnd\n"
                         "AttributeBegin Color [0 0 1] Opacity [0.5 0.5 0.5] Translate 0 0 -1 " +
                         kSquare + "AttributeEnd\n"));
  const size_t i = pixel(kSize / 2, kSize / 2);
  EXPECT_NEAR(c.at(2, i), 0.5f, 1e-5f);
  EXPECT_NEAR(c.at(0, i), 0.5f * 0.25f, 1e-5f);
  EXPECT_NEAR(c.at(1, i), 0.5f * 0.5f, 1e-5f);
  EXPECT_NEAR(c.at(3, i), 1.0f, 1e-5f);
  EXPECT_NEAR(c.at(4, i), 4.0f, 1e-4f);
}

TEST(TraceRender, ManyLayersFollowThePowerLaw) {
  std::string world = "Surface \"constant\" Opacity [0.1 0.1 0.1]\n";
  for (int i = 0; i < 20; ++i) world += "Translate 0 0 0.05\n" + kSquare;
  const Channels c = renderByRays(scene(world));
  EXPECT_NEAR(c.at(3, pixel(40, 40)), 1 - std::pow(0.9, 20), 1e-4);
}

TEST(TraceRender, ShadowsHaveTheAreaOfTheirProjection) {
  // A wall that fills the view, 6 from the camera, lit along the view; before it a disk that cameras do not
  // see.
  const Channels c = renderByRays(
      scene("Attribute \"light\" \"string shadows\" [\"on\"]\n"
            "LightSource \"distantlight\" 1 \"from\" [0 0 -1] \"to\" [0 0 0]\n"
            "Surface \"matte\" \"Ka\" [0] \"Kd\" [1]\nTranslate 0 0 1\n" +
            kSquare + "Attribute \"render\" \"integer visibility\" [4]\nTranslate 0 0 -1\nDisk 0 0.5 360\n"));
  const double radius = 0.5 * kFocal / 6, area = std::numbers::pi * radius * radius;
  EXPECT_EQ(c.at(0, pixel(kSize / 2, kSize / 2)), 0.0f);
  EXPECT_NEAR(c.at(0, pixel(4, 4)), 1.0f, 1e-5f);
  const double noise = 4 * 0.1 * std::sqrt(2 * std::numbers::pi * radius), chords = 0.01 * area;
  EXPECT_NEAR(double(kSize * kSize) - sum(c, 0), area, noise + chords);
}

TEST(TraceRender, AMirrorShowsWhatIsBehindTheCamera) {
  const Channels c = renderByRays(
      scene("AttributeBegin Surface \"raymirror\" " + kSquare +
                "AttributeEnd\n"
                "Surface \"constant\" Color [0.2 0.4 0.8] Translate 0 0 -15\nDisk 0 2 360\n",
            ""),
      {{"raymirror",
        "surface raymirror() { Oi = Os; Ci = trace(P, reflect(normalize(I), normalize(N))); }\n"}});
  // Seen 5 + 15 away.
  const double radius = 2 * kFocal / 20, area = std::numbers::pi * radius * radius;
  const double tolerance = 4 * 0.1 * std::sqrt(2 * std::numbers::pi * radius) + 0.005 * area;
  EXPECT_NEAR(sum(c, 0), 0.2 * area, 0.2 * tolerance);
  EXPECT_NEAR(sum(c, 2), 0.8 * area, 0.8 * tolerance);
  EXPECT_EQ(c.at(3, pixel(2, 2)), 1.0f);
}

const std::string kBusy =
    "LightSource \"distantlight\" 1 \"from\" [1 1 -2] \"to\" [0 0 0]\nSurface \"plastic\"\n"
    "AttributeBegin Opacity [0.4 0.6 0.8] Translate -0.5 0 -1 Sphere 0.6 -0.6 0.6 360 AttributeEnd\n"
    "AttributeBegin Surface \"raymirror\" Rotate 50 1 1 0 Torus 0.9 0.4 0 360 360 AttributeEnd\n" +
    kSquare;
const std::map<std::string, std::string> kRandomMirror = {
    {"raymirror",
     "surface raymirror() { Oi = Os; Ci = 0.2 + trace(P, reflect(normalize(I), normalize(N)) + 0.05 * "
     "(vector random() - vector(0.5, 0.5, 0.5))); }\n"}};

TEST(TraceRender, SameBitsForAnyThreadsAndTileSize) {
  const std::string rib = scene(kBusy, "PixelFilter \"gaussian\" 3 3\n");
  const Channels reference = renderByRays(rib, kRandomMirror);
  for (const auto& [threads, tile] : {std::pair(1, 7), std::pair(5, 16), std::pair(2, 96)}) {
    tracer::TraceRenderOptions o;
    o.threads = threads, o.tileSize = tile;
    EXPECT_EQ(renderByRays(rib, kRandomMirror, o).values, reference.values) << threads << " " << tile;
  }
}

TEST(TraceRender, CropsAbut) {
  const std::string filter = "PixelFilter \"catmull-rom\" 4 4\n";
  const Channels whole = renderByRays(scene(kBusy, filter), kRandomMirror);
  const Channels left = renderByRays(scene(kBusy, filter + "CropWindow 0 0.43 0 1\n"), kRandomMirror);
  const Channels right = renderByRays(scene(kBusy, filter + "CropWindow 0.43 1 0 1\n"), kRandomMirror);
  size_t fromLeft = 0;
  for (size_t i = 0; i < whole.values[0].size(); ++i) {
    const bool isLeft = !std::isnan(left.at(0, i));
    ASSERT_NE(isLeft, !std::isnan(right.at(0, i))) << "in both crops or in none: " << i;
    fromLeft += isLeft;
    for (size_t c = 0; c < 5; ++c) ASSERT_EQ((isLeft ? left : right).at(c, i), whole.at(c, i));
  }
  EXPECT_GT(fromLeft, 0u);
}

TEST(TraceRender, AdaptiveSamplingSpendsSamplesWhereThePictureChanges) {
  const std::string rib = scene("Surface \"constant\" Sphere 1 -1 1 360\n");
  tracer::TraceRenderOptions o;
  o.adaptive = AdaptiveSampling{0.0002f, 4, 256};
  tracer::TraceRenderStatistics s;
  const Channels c = renderByRays(rib, {}, o, &s);
  EXPECT_EQ(s.fewestSamples, 4u);
  EXPECT_GT(s.mostSamples, 64u);
  EXPECT_LT(double(s.samples), 20.0 * kSize * kSize) << "most pixels need no more than four";
  // What was asked for: a standard deviation of 0.014 in each of some 170 pixels of the outline.
  const double radius = kFocal * std::tan(std::asin(1.0 / 5)), area = std::numbers::pi * radius * radius;
  EXPECT_NEAR(sum(c, 3), area, 4 * 0.0142 * std::sqrt(170.0) + 0.01 * 2 * std::numbers::pi * radius);
  // With no variance asked for, every pixel gets all samples: the plain picture.
  o.adaptive = AdaptiveSampling{0.0f, 16, 16};
  EXPECT_EQ(renderByRays(rib, {}, o).values, renderByRays(rib).values);
}

TEST(TraceRender, PixelVarianceOfTheRibIsAdaptiveSampling) {
  tracer::TraceRenderStatistics s;
  renderByRays(scene("Surface \"constant\" Sphere 1 -1 1 360\n",
                     "PixelVariance 0.001\nOption \"render\" \"integer minsamples\" [2] \"integer "
                     "maxsamples\" [32]\n"),
               {}, {}, &s);
  EXPECT_EQ(s.fewestSamples, 2u);
  EXPECT_EQ(s.mostSamples, 32u);
}

TEST(TraceRender, OutputVariablesAreThoseOfTheNearestSurface) {
  const Channels c = renderByRays(
      scene("Surface \"tagged\" \"float tag\" [7] Opacity [0.5 0.5 0.5] " + kSquare +
                "Translate 0 0 1 Surface \"tagged\" \"float tag\" [3] Opacity [1 1 1] " + kSquare,
            "Display \"x.exr\" \"openexr\" \"rgba\"\nDisplay \"+y.exr\" \"openexr\" \"float mark\"\n"),
      {{"tagged",
        "surface tagged(float tag = 1; output varying float mark = 0) { mark = tag; Oi = Os; Ci = "
        "Os; }\n"}});
  ASSERT_EQ(c.values.size(), 6u);
  EXPECT_EQ(c.at(5, pixel(50, 50)), 7.0f);
}

}  // namespace
}  // namespace fr::test
