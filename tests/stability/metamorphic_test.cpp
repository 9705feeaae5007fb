// Scenes that say the same in other words make the same picture.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "ri/reader.h"
#include "ri/rib_writer.h"
#include "tests/hiders/hider_pair.h"
#include "tests/stability/scenes.h"

namespace fr::test {
namespace {

using Points = std::vector<DVec3>;

double rmse(const Channels& a, const Channels& b) {
  double squares = 0;
  for (size_t c = 0; c < 4; ++c)
    for (size_t i = 0; i < a.values[c].size(); ++i)
      squares += std::pow(double(a.at(c, i)) - double(b.at(c, i)), 2);
  return std::sqrt(squares / double(4 * a.values[0].size()));
}

/// Both pairs of pictures must be as near as this.
void expectSame(const std::string& a, const std::string& b, double tolerance) {
  const HiderPair x = renderBoth(a, everythingsShaders()), y = renderBoth(b, everythingsShaders());
  RC_ASSERT(rmse(x.reyes, y.reyes) <= tolerance);
  RC_ASSERT(rmse(x.rays, y.rays) <= tolerance);
}

std::string scene(const std::string& world, const std::string& camera = "", const std::string& place = "") {
  return "Format 64 64 1\nPixelSamples 2 2\nShadingRate 0.5\nProjection \"perspective\" \"fov\" "
         "[40]\nTranslate 0 0 5\n" +
         camera + "WorldBegin\n" + place +
         "LightSource \"distantlight\" 1 \"from\" [1 1 -2] \"to\" [0 0 0]\nSides 2 Surface \"matte\"\n" +
         world + "WorldEnd\n";
}

std::string list(const Points& p) {
  std::string s;
  for (const DVec3& v : p) s += fmt::format("{:.9g} {:.9g} {:.9g} ", v.x, v.y, v.z);
  return s;
}

double within(double lo, double hi) {
  return lo + (hi - lo) * *rc::gen::inRange(0, 1 << 20) / double(1 << 20);
}

/// A bicubic patch about as large as the view.
Points anyPatch() {
  Points p;
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 4; ++i)
      p.emplace_back(i - 1.5 + within(-0.4, 0.4), j - 1.5 + within(-0.4, 0.4), within(-1, 1));
  return p;
}
std::string bicubic(const Points& p) {
  return "Basis \"bezier\" 3 \"bezier\" 3 Patch \"bicubic\" \"P\" [" + list(p) + "]\n";
}

/// Outlines have other chords when something is diced otherwise: half a sample in a hundred may see it.
constexpr double kDicedOtherwise = 0.02;

/// Few cases, each four pictures; always the same ones, but in the long run.
void expectProperty(void (*property)()) {
  rc::detail::TestParams params;
  params.seed = std::getenv("FR_STRESS") ? rc::detail::configuration().testParams.seed : 1;
  params.maxSuccess = std::getenv("FR_STRESS") ? 1000 : 8;
  params.disableShrinking = true;
  const auto result = rc::detail::checkTestable(property, rc::detail::TestMetadata{}, params);
  std::ostringstream text;
  rc::detail::printResultMessage(result, text);
  EXPECT_TRUE(result.is<rc::detail::SuccessResult>()) << text.str();
}

#define FR_PROPERTY(name)                                      \
  void name##Property();                                       \
  TEST(Metamorphic, name) { expectProperty(&name##Property); } \
  void name##Property()

FR_PROPERTY(TheWorldAndTheCameraTurnTogether) {
  const std::string axis = fmt::format("{} {} {}\n", within(-1, 1), within(-1, 1), within(0.1, 1));
  const double angle = within(-180, 180);
  const std::string world = bicubic(anyPatch()) + "Translate 0 0 1 Torus 0.8 0.3 0 360 300\n";
  expectSame(scene(world),
             scene(world, fmt::format("Rotate {} ", -angle) + axis, fmt::format("Rotate {} ", angle) + axis),
             1e-3);
}

FR_PROPERTY(UAndVMayBeSwapped) {
  const Points p = anyPatch();
  Points q(16);
  for (size_t i = 0; i < 16; ++i) q[i % 4 * 4 + i / 4] = p[i];
  expectSame(scene(bicubic(p)), scene("ReverseOrientation " + bicubic(q)), kDicedOtherwise);
}

FR_PROPERTY(APatchInTwoHalves) {
  const Points p = anyPatch();
  const double t = within(0.3, 0.7);
  Points low(16), high(16);
  for (size_t row = 0; row < 4; ++row) {
    std::array<DVec3, 4> c;
    for (size_t i = 0; i < 4; ++i) c[i] = p[4 * row + i];
    for (size_t k = 0; k < 4; ++k) {
      low[4 * row + k] = c[0], high[4 * row + 3 - k] = c[3 - k];
      for (size_t i = 0; i + 1 < 4 - k; ++i) c[i] = (1 - t) * c[i] + t * c[i + 1];
    }
  }
  expectSame(scene(bicubic(p)), scene(bicubic(low) + bicubic(high)), kDicedOtherwise);
}

FR_PROPERTY(ABilinearPatchOrThePolygon) {
  const DVec3 o(within(-1, -0.5), within(-1, -0.5), within(-1, 1)),
      u(within(1, 2), within(-0.5, 0.5), within(-1, 1)), v(within(-0.5, 0.5), within(1, 2), within(-1, 1));
  expectSame(scene("Patch \"bilinear\" \"P\" [" + list({o, o + u, o + v, o + u + v}) + "]\n"),
             scene("ReverseOrientation Polygon \"P\" [" + list({o, o + u, o + u + v, o + v}) + "]\n"), 2e-3);
}

FR_PROPERTY(OrientationReversedTwice) {
  const std::string world = "Sides 1 " + bicubic(anyPatch()) + "Rotate 50 1 1 0 Torus 0.8 0.3 0 360 300\n";
  expectSame(scene(world), scene("ReverseOrientation ReverseOrientation " + world), 0);
}

FR_PROPERTY(AnInstanceOrItsGeometry) {
  const std::string object = bicubic(anyPatch()) + "Rotate 50 1 1 0 Torus 0.8 0.3 0 360 300\n";
  const std::string place =
      fmt::format("Translate {} {} {} Rotate {} 1 1 0 Scale {} 0.7 0.8 ", within(-0.5, 0.5),
                  within(-0.5, 0.5), within(-0.5, 0.5), within(-180, 180), within(0.5, 1));
  const std::string second = "Translate 0.3 0.2 1.5 Scale 0.5 0.5 0.5 ";
  expectSame(scene("TransformBegin " + place + object + "TransformEnd TransformBegin " + second + object +
                   "TransformEnd\n"),
             scene("ObjectBegin \"it\" " + object + "ObjectEnd TransformBegin " + place +
                   "ObjectInstance \"it\" TransformEnd TransformBegin " + second +
                   "ObjectInstance \"it\" TransformEnd\n"),
             kDicedOtherwise);
}

TEST(Metamorphic, AsciiOrBinary) {
  const std::string ascii = everything({});
  std::string binary;
  ri::RibWriterOptions options;
  options.binary = true;
  ri::RibWriter writer([&](std::string_view text) { binary += text; }, options);
  ri::Reader reader(writer);
  ASSERT_TRUE(reader.readBuffer(ascii, "ascii.rib").ok());
  writer.flush();
  ASSERT_LT(binary.size(), ascii.size());
  const HiderPair a = renderBoth(ascii, everythingsShaders()), b = renderBoth(binary, everythingsShaders());
  EXPECT_EQ(a.reyes.values, b.reyes.values);
  EXPECT_EQ(a.rays.values, b.rays.values);
}

/// Also: threads and buckets change nothing.
TEST(Metamorphic, AnyThreadsAndBuckets) {
  const std::string rib = everything({});
  const HiderPair one = renderBoth(rib, everythingsShaders());
  for (const auto& [threads, bucket] : {std::pair(1, 8), std::pair(3, 17), std::pair(2, 160)}) {
    RenderOptions reyes;
    reyes.threads = threads, reyes.bucketSize = bucket;
    EXPECT_EQ(renderByReyes(rib, everythingsShaders(), reyes).values, one.reyes.values)
        << threads << " " << bucket;
    tracer::TraceRenderOptions rays;
    rays.threads = threads, rays.tileSize = bucket;
    EXPECT_EQ(renderByRays(rib, everythingsShaders(), rays).values, one.rays.values)
        << threads << " " << bucket;
  }
}

}  // namespace
}  // namespace fr::test
