// Adaptive sampling: the error that was wanted is the error that there is, and what is told of it is true;
// the same picture from any threads and buckets, and whole sums.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/hiders/hider_pair.h"
#include "tests/stability/scenes.h"
#include "tests/stability/traced_model.h"

namespace fr::test {
namespace {

/// Colours alone, cut as estimates are.
double rmse(const Channels& a, const Channels& b) {
  double squares = 0;
  for (size_t c = 0; c < 3; ++c)
    for (size_t i = 0; i < a.values[c].size(); ++i)
      squares +=
          std::pow(std::clamp(double(a.at(c, i)), 0.0, 1.0) - std::clamp(double(b.at(c, i)), 0.0, 1.0), 2);
  return std::sqrt(squares / double(3 * a.values[0].size()));
}

struct Subject {
  const char* name;
  std::string rib;
};
std::ostream& operator<<(std::ostream& out, const Subject& s) { return out << s.name; }

const std::string kOptions = "Format 48 36 1\nPixelFilter \"box\" 1 1\nShadingRate 1\n";
const std::string kCamera = "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n";
const std::string kStripes = [] {
  std::string s = "LightSource \"distantlight\" 1 Surface \"constant\"\n";
  for (int i = 0; i < 24; ++i)
    s += "AttributeBegin Rotate " + std::to_string(i * 7.3) + " 0 0 1 Translate " +
         std::to_string(-1.5 + i * 0.13) + " 0 " + std::to_string(0.01 * i) +
         " Polygon \"P\" [-.02 -2 0 .02 -2 0 .02 2 0 -.02 2 0] AttributeEnd\n";
  return s;
}();

class Adaptive : public ::testing::TestWithParam<Subject> {};

TEST_P(Adaptive, WantedErrorsAreReachedAndToldHonestly) {
  for (const char* filter : {"\"box\" 1 1", "\"gaussian\" 2 2"}) {
    if (filter[1] == 'b' && GetParam().name[0] != 'S' && effort(0, 1) == 0)
      continue;  // takes most samples: the long run does it
    const std::string rib = GetParam().rib;
    const size_t at = rib.find("\"box\" 1 1");
    ASSERT_NE(at, std::string::npos);
    const std::string filtered = rib.substr(0, at) + filter + rib.substr(at + 9);
    RenderOptions reyes;
    tracer::TraceRenderOptions rays;
    // The yardstick: 1024 samples for every pixel.
    reyes.adaptive = rays.adaptive = AdaptiveSampling{0, 1024, 1024};
    const Channels truth = renderByReyes(filtered, everythingsShaders(), reyes);
    const Channels truthOfRays = renderByRays(filtered, everythingsShaders(), rays);
    for (const double target : {0.03, 0.01}) {
      const auto check = [&](const char* who, double told, double is, double samples) {
        std::printf("%-10s %-14s wanted %.4f: %-5s told %.5f, is %.5f, %.1f samples\n", GetParam().name,
                    filter, target, who, told, is, samples);
        EXPECT_LE(is, 1.3 * target) << who;
        // Fewer than 8 samples there are not, which is good enough for some.
        if (samples > 10) {
          EXPECT_GE(is, 0.5 * target) << who << " does more than it was asked for";
        }
        EXPECT_LE(is, 1.4 * told) << who;
        EXPECT_GE(is, 0.5 * told) << who;
      };
      reyes.adaptive = rays.adaptive = AdaptiveSampling::toError(target);
      FrameStatistics a;
      const Channels byReyes = renderByReyes(filtered, everythingsShaders(), reyes, nullptr, &a);
      check("REYES", a.errors.rmse(), rmse(byReyes, truth), double(a.samples) / double(a.pixels));
      tracer::TraceRenderStatistics b;
      const Channels byRays = renderByRays(filtered, everythingsShaders(), rays, &b);
      check("rays", b.errors.rmse(), rmse(byRays, truthOfRays), double(b.samples) / double(b.pixels));
    }
  }
}

TEST_P(Adaptive, SameBitsForAnyThreadsAndBuckets) {
  RenderOptions o;
  o.adaptive = AdaptiveSampling::toError(0.02);
  const Channels toError = renderByReyes(GetParam().rib, everythingsShaders(), o);
  o.threads = 1, o.bucketSize = 24;
  EXPECT_EQ(renderByReyes(GetParam().rib, everythingsShaders(), o).values, toError.values) << "to an error";
  o = {};
  o.adaptive = AdaptiveSampling{1e-4f, 4, 64};
  FrameStatistics s;
  const Channels one = renderByReyes(GetParam().rib, everythingsShaders(), o, nullptr, &s);
  EXPECT_EQ(s.fewestSamples, 4u);
  EXPECT_EQ(s.mostSamples, 64u);
  for (const auto& [threads, bucket] : {std::pair(1, 7), std::pair(3, 33), std::pair(2, 96)}) {
    o.threads = threads, o.bucketSize = bucket;
    EXPECT_EQ(renderByReyes(GetParam().rib, everythingsShaders(), o).values, one.values)
        << threads << " " << bucket;
  }
}

/// Nothing to be found: as many samples in one round as in many.
TEST_P(Adaptive, RoundsAddUpToTheWhole) {
  RenderOptions o;
  o.adaptive = AdaptiveSampling{0, 16, 16};
  const Channels whole = renderByReyes(GetParam().rib, everythingsShaders(), o);
  o.adaptive = AdaptiveSampling{-1, 16, 16};
  EXPECT_EQ(renderByReyes(GetParam().rib, everythingsShaders(), o).values, whole.values);
  // Rounds of 4, 4 and 8 are the same samples in another order: sums differ in their last bits.
  o.adaptive = AdaptiveSampling{-1, 4, 16};
  EXPECT_LT(rmse(renderByReyes(GetParam().rib, everythingsShaders(), o), whole), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, Adaptive,
    ::testing::Values(
        Subject{"Stripes", kOptions + kCamera + "WorldBegin\n" + kStripes + "WorldEnd\n"},
        Subject{"Defocused",
                kOptions + "DepthOfField 2 0.5 4\n" + kCamera + "WorldBegin\n" + kStripes + "WorldEnd\n"},
        Subject{"Moving",
                kOptions + "Shutter 0 1\n" + kCamera +
                    "WorldBegin\nMotionBegin [0 1] Translate -.3 0 0 Translate .3 .1 0 MotionEnd\n" +
                    kStripes + "Opacity [.5 .6 .7] Color [1 .5 .2] Sphere 1 -1 1 360 WorldEnd\n"}),
    [](const auto& p) { return std::string(p.param.name); });

TEST(AdaptiveRequests, PixelVarianceOfTheRib) {
  const std::string rib = kOptions +
                          "PixelVariance 0.001\nOption \"render\" \"integer minsamples\" [2] \"integer "
                          "maxsamples\" [32]\n" +
                          kCamera + "WorldBegin\n" + kStripes + "WorldEnd\n";
  FrameStatistics s;
  renderByReyes(rib, {}, {}, nullptr, &s);
  EXPECT_EQ(s.fewestSamples, 2u);
  EXPECT_EQ(s.mostSamples, 32u);
}

}  // namespace
}  // namespace fr::test
