#include "reyes/renderer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>

#include "base/random.h"
#include "reyes/test_scene.h"

namespace fr::reyes {
namespace {

constexpr int kAlpha = 3, kDepth = 4;

TEST(Renderer, EmptySceneIsBlackAndFar) {
  TestScene s(20, 10);
  const auto image = s.render();
  for (int c = 0; c < 4; ++c)
    for (float v : image.channels[size_t(c)]) EXPECT_EQ(v, 0.0f);
  for (float v : image.channels[kDepth]) EXPECT_GE(v, 1e30f);
  EXPECT_EQ(image.statistics.gridsShaded, 0u);
}

TEST(Renderer, RectangleCoversItsPixelsExactly) {
  TestScene s(40, 30);
  const uint32_t red = s.addSurface({.color = [](const Vec3&) { return Color(1, 0.5f, 0.25f); }});
  s.addRasterRect(red, 5, 7, 25, 19, 3, 10, 6);
  const auto image = s.render();
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x) {
      const bool in = x >= 5 && x < 25 && y >= 7 && y < 19;
      EXPECT_EQ(image.at(0, x, y), in ? 1.0f : 0.0f) << x << " " << y;
      EXPECT_EQ(image.at(1, x, y), in ? 0.5f : 0.0f);
      EXPECT_EQ(image.at(kAlpha, x, y), in ? 1.0f : 0.0f);
      EXPECT_FLOAT_EQ(image.at(kDepth, x, y), in ? 3.0f : kRiInfinity);
    }
}

/// A half plane through the raster at an angle: coverage of the pixels against the exact area, within what
/// stratified samples allow.
TEST(Renderer, HalfPlaneCoverage) {
  TestScene s(32, 32);
  s.pixelSamples[0] = s.pixelSamples[1] = 8;
  const uint32_t white = s.addSurface({});
  // Below the line y = 6.3 + 0.41 x.
  s.addQuad(white, {-40, -(6.3f - 0.41f * 40), 5}, {80, -(6.3f + 0.41f * 80), 5}, {-40, -100, 5},
            {80, -100, 5}, 16, 16);
  const auto image = s.render();
  double worst = 0;
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x) {
      double area = 0;
      for (int i = 0; i < 1000; ++i) {
        const double line = 6.3 + 0.41 * (x + (i + 0.5) / 1000);
        area += std::clamp(y + 1 - line, 0.0, 1.0) / 1000;
      }
      worst = std::max(worst, std::abs(area - double(image.at(kAlpha, x, y))));
    }
  // 64 stratified samples: the line crosses about 8 strata of 1/64 each.
  EXPECT_LT(worst, 5.0 / 64);
  EXPECT_GT(worst, 0);
}

TEST(Renderer, DiskAreaConverges) {
  TestScene s(64, 64);
  const uint32_t white = s.addSurface({});
  const float radius = 21.7f;
  std::vector<TestGrid> wedges;
  for (int k = 0; k < 32; ++k) {
    TestGrid w{16, 4, {}, {}};
    for (int j = 0; j <= 4; ++j)
      for (int i = 0; i <= 16; ++i) {
        const double a = 2 * std::numbers::pi * (k + i / 16.0) / 32, r = double(radius) * j / 4;
        w.positions.push_back({32.1f + float(r * std::cos(a)), -31.7f - float(r * std::sin(a)), 9});
      }
    wedges.push_back(w);
  }
  s.addPatch(white, wedges);
  const auto image = s.render();
  const double n = 512;
  const double area = 0.5 * n * std::sin(2 * std::numbers::pi / n) * double(radius) * double(radius);
  // 16 samples a pixel on a boundary of 136 pixels: standard deviation about 136^0.5 * 0.06.
  EXPECT_NEAR(image.mean(kAlpha) * 64 * 64, area, 2.0);
}

/// A mesh of abutting grids with ragged interior vertices, semi-transparent: a sample hit twice would be too
/// opaque, one not hit too clear. With a constant filter weight the alpha must be exactly that of one layer
/// everywhere inside.
TEST(Renderer, AbuttingGridsAreHitExactlyOnce) {
  TestScene s(64, 64);
  const uint32_t glass = s.addSurface({.opaque = false, .opacity = {0.5f, 0.5f, 0.5f}});
  const int n = 48;
  const auto vertex = [&](int i, int j) {
    const uint64_t h = hashStep(uint64_t(i) << 32 | uint32_t(j), 5);
    const bool border = i == 0 || j == 0 || i == n || j == n;
    const float dx = border ? 0 : 0.4f * (toUnitFloat64(h) - 0.5f),
                dy = border ? 0 : 0.4f * (toUnitFloat64(mix64(h)) - 0.5f);
    return Vec3((float(i) + dx) * 70.0f / n - 3, -((float(j) + dy) * 70.0f / n - 3), 4 + 0.1f * dx);
  };
  std::vector<TestGrid> grids;
  for (int b = 0; b < n; b += 16)
    for (int a = 0; a < n; a += 16) {
      TestGrid g{16, 16, {}, {}};
      for (int j = 0; j <= 16; ++j)
        for (int i = 0; i <= 16; ++i) g.positions.push_back(vertex(a + i, b + j));
      grids.push_back(g);
    }
  s.addPatch(glass, grids);
  const auto image = s.render();
  for (float v : image.channels[kAlpha]) ASSERT_EQ(v, 0.5f);
}

TEST(Renderer, MeshletsAreHitExactlyOnce) {
  TestScene s(32, 32);
  const uint32_t glass = s.addSurface({.opaque = false, .opacity = {0.25f, 0.5f, 0.75f}});
  TestGrid m;
  const int n = 12;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const uint64_t h = hashStep(uint64_t(i), uint64_t(j));
      m.positions.push_back({float(i) * 36 / n - 2 + (i % n ? toUnitFloat64(h) : 0),
                             -(float(j) * 36 / n - 2 + (j % n ? toUnitFloat64(mix64(h)) : 0)), 5});
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      const std::array<int, 6> two =
          (i + j) % 2 ? std::array<int, 6>{a, a + 1, a + n + 1, a + 1, a + n + 2, a + n + 1}
                      : std::array<int, 6>{a, a + n + 2, a + n + 1, a, a + 1, a + n + 2};
      for (int v : two) m.indices.push_back(uint8_t(v));
    }
  s.addPatch(glass, {m});
  const auto image = s.render();
  for (float v : image.channels[kAlpha]) ASSERT_FLOAT_EQ(v, 0.5f);
  for (float v : image.channels[2]) ASSERT_EQ(v, 0.75f);
}

TEST(Renderer, TransparencyCompositesFrontToBack) {
  TestScene s(16, 16);
  const uint32_t back = s.addSurface({.color = [](const Vec3&) { return Color(0, 0, 1); }});
  const uint32_t near =
      s.addSurface({.opaque = false, .opacity = {0.25f, 0.5f, 0.75f}, .color = [](const Vec3&) {
                      return Color(1, 1, 1);
                    }});
  const uint32_t middle = s.addSurface(
      {.opaque = false, .opacity = {0.5f, 0.5f, 0.5f}, .color = [](const Vec3&) { return Color(0, 1, 0); }});
  s.addRasterRect(middle, -2, -2, 20, 20, 4, 4, 4);
  s.addRasterRect(back, -2, -2, 8, 20, 6, 4, 4);
  s.addRasterRect(near, -2, -2, 20, 20, 2, 4, 4);
  const auto image = s.render();
  // near over middle over back.
  EXPECT_FLOAT_EQ(image.at(0, 3, 3), 0.25f);
  EXPECT_FLOAT_EQ(image.at(1, 3, 3), 0.5f + 0.5f * 0.5f);
  EXPECT_FLOAT_EQ(image.at(2, 3, 3), 0.75f + 0.25f * 0.5f);
  EXPECT_FLOAT_EQ(image.at(kAlpha, 3, 3), 1.0f);
  EXPECT_FLOAT_EQ(image.at(2, 12, 3), 0.75f);
  EXPECT_FLOAT_EQ(image.at(kAlpha, 12, 3), (0.625f + 0.75f + 0.875f) / 3);
  EXPECT_FLOAT_EQ(image.at(kDepth, 3, 3), 2);
}

TEST(Renderer, MatteHidesAndIsClear) {
  TestScene s(16, 8);
  const uint32_t white = s.addSurface({});
  const uint32_t matte = s.addSurface({.matte = true});
  s.addRasterRect(white, 0, 0, 16, 8, 5);
  s.addRasterRect(matte, 0, 0, 8, 8, 3);
  const auto image = s.render();
  EXPECT_EQ(image.at(kAlpha, 2, 2), 0.0f);
  EXPECT_EQ(image.at(0, 2, 2), 0.0f);
  EXPECT_EQ(image.at(kAlpha, 12, 2), 1.0f);
}

TEST(Renderer, OneSidedSurfacesShowTheirFront) {
  for (bool reverse : {false, true}) {
    TestScene s(16, 8);
    const uint32_t one = s.addSurface({.reverse = reverse, .sides = 1});
    s.addRasterRect(one, 0, 0, 8, 8, 5);                             // N = +x cross -y = -z: towards the eye
    s.addQuad(one, {8, -8, 5}, {16, -8, 5}, {8, 0, 5}, {16, 0, 5});  // N = +z
    const auto image = s.render();
    EXPECT_EQ(image.at(kAlpha, 3, 3), reverse ? 0.0f : 1.0f);
    EXPECT_EQ(image.at(kAlpha, 12, 3), reverse ? 1.0f : 0.0f);
  }
}

TEST(Renderer, SmoothShadingIsLinear) {
  TestScene s(32, 8);
  s.pixelSamples[0] = s.pixelSamples[1] = 8;
  const uint32_t ramp =
      s.addSurface({.smooth = true, .color = [](const Vec3& p) { return Color(p.x / 32, 0, 0); }});
  s.addRasterRect(ramp, 0, 0, 32, 8, 5, 2, 2);
  const auto image = s.render();
  for (int x = 0; x < 32; ++x) EXPECT_NEAR(image.at(0, x, 4), (float(x) + 0.5f) / 32, 0.0015f);
}

TEST(Renderer, FlatShadingIsTheColourAtTheCentre) {
  TestScene s(32, 8);
  const uint32_t ramp = s.addSurface({.color = [](const Vec3& p) { return Color(p.x / 32, 0, 0); }});
  s.addRasterRect(ramp, 0, 0, 32, 8, 5, 8, 2);
  const auto image = s.render();
  for (int x = 0; x < 32; ++x) EXPECT_FLOAT_EQ(image.at(0, x, 4), (float(x / 4) * 4 + 2) / 32);
}

TEST(Renderer, PerspectivePlaneThroughTheEyesPlane) {
  // A floor y = -1 from behind the eye to far away: its horizon is the middle row, and depth is 1 / slope.
  TestScene s(64, 64);
  s.setPerspective(90);
  s.pixelSamples[0] = s.pixelSamples[1] = 2;
  const uint32_t white = s.addSurface({});
  s.addQuad(white, {-500, -1, -200}, {500, -1, -200}, {-500, -1, 900}, {500, -1, 900}, 3, 5);
  const auto image = s.render();
  for (int x = 0; x < 64; x += 7) {
    EXPECT_EQ(image.at(kAlpha, x, 30), 0.0f);
    for (int y = 36; y < 64; ++y) {
      EXPECT_EQ(image.at(kAlpha, x, y), 1.0f) << x << " " << y;
      // Screen y from the middle: (y - 32) / 32 = 1 / z.
      const float nearest = 32.0f / float(y + 1 - 32), farthest = 32.0f / float(y - 32);
      EXPECT_GE(image.at(kDepth, x, y), nearest * 0.999f);
      EXPECT_LE(image.at(kDepth, x, y), farthest * 1.001f);
    }
  }
}

TEST(Renderer, ClippingPlanesCut) {
  TestScene s(64, 16);
  s.setPerspective(90);
  s.camera.clipping[0] = 2, s.camera.clipping[1] = 6;
  const uint32_t white = s.addSurface({});
  for (float z : {1.0f, 7.0f}) s.addQuad(white, {-20, -20, z}, {20, -20, z}, {-20, 20, z}, {20, 20, z}, 2, 2);
  EXPECT_EQ(s.render().mean(kAlpha), 0.0);
}

TEST(Renderer, HiddenGridsAreNeitherResolvedNorShaded) {
  TestScene s(64, 64);
  const uint32_t white = s.addSurface({});
  s.addRasterRect(white, -5, -5, 70, 70, 2, 16, 16);
  for (int i = 0; i < 50; ++i) s.addRasterRect(white, 0, 0, 64, 64, 10 + float(i), 4, 4);
  RenderOptions o;
  o.bucketSize = 64, o.threads = 1;
  const auto image = s.render(o);
  EXPECT_EQ(s.resolved, 1);
  EXPECT_EQ(s.shaded, 1);
  EXPECT_EQ(image.statistics.nodesCulledHidden, 50u);
}

TEST(Renderer, GridsAreShadedOnceHoweverManyBucketsSeeThem) {
  TestScene s(100, 80);
  const uint32_t white = s.addSurface({});
  s.addRasterRect(white, 0, 0, 100, 80, 2, 16, 16);
  for (int threads : {1, 3}) {
    s.shaded = 0;
    RenderOptions o;
    o.bucketSize = 8, o.threads = threads;
    const auto image = s.render(o);
    EXPECT_EQ(s.shaded, 1);
    EXPECT_EQ(image.statistics.buckets, 130u);
    EXPECT_EQ(image.mean(kAlpha), 1.0);
  }
}

TEST(Renderer, NotANumberGeometryIsLeftOut) {
  TestScene s(16, 16);
  const uint32_t white = s.addSurface({});
  TestGrid g{4, 4, {}, {}};
  for (int j = 0; j <= 4; ++j)
    for (int i = 0; i <= 4; ++i) g.positions.push_back({float(i) * 4, -float(j) * 4, 5});
  g.positions[12] = {NAN, INFINITY, 0};
  s.addPatch(white, {g});
  const auto image = s.render();
  EXPECT_EQ(image.at(kAlpha, 1, 1), 1.0f);
  EXPECT_EQ(image.at(kAlpha, 7, 7), 0.0f);
}

TEST(Renderer, NotANumberColoursAreBlackWithOneMessage) {
  TestScene s(8, 8);
  int messages = 0;
  setReportSink([&](const Error&) { ++messages; });
  const uint32_t bad = s.addSurface({.color = [](const Vec3&) { return Color(NAN, INFINITY, 1); }});
  s.addRasterRect(bad, 0, 0, 8, 8, 5, 4, 4);
  const auto image = s.render();
  setReportSink({});
  EXPECT_EQ(messages, 1);
  EXPECT_EQ(image.at(0, 4, 4), 0.0f);
  EXPECT_EQ(image.at(2, 4, 4), 1.0f);
}

/// A scene with everything: overlapping, transparent, coplanar, crossing the near plane.
void fillWithClutter(TestScene& s) {
  s.setPerspective(60);
  s.filter = "gaussian", s.filterWidth[0] = 3, s.filterWidth[1] = 2.5f;
  s.pixelSamples[0] = 3, s.pixelSamples[1] = 2;
  std::vector<uint32_t> surfaces;
  surfaces.reserve(6);
  for (int i = 0; i < 6; ++i)
    surfaces.push_back(s.addSurface({.opaque = i % 2 == 0,
                                     .smooth = i % 3 == 0,
                                     .opacity = i % 2 == 0 ? Color(1, 1, 1) : Color(0.3f, 0.6f, 0.4f),
                                     .color = [i](const Vec3& p) {
                                       return Color(std::sin(p.x + float(i)), std::cos(p.y),
                                                    std::sin(p.z * 3));
                                     }}));
  const auto random = [](int i, int k) { return toUnitFloat64(hashStep(uint64_t(i), uint64_t(k))) - 0.5f; };
  for (int i = 0; i < 60; ++i) {
    const Vec3 at(6 * random(i, 0), 6 * random(i, 1), 5 + 8 * random(i, 2));
    const Vec3 u(3 * random(i, 3), 3 * random(i, 4), 3 * random(i, 5)),
        v(3 * random(i, 6), 3 * random(i, 7), 3 * random(i, 8));
    const int copies = i % 10 == 0 ? 2 : 1;  // twice the same: ties everywhere
    for (int c = 0; c < copies; ++c)
      s.addQuad(surfaces[size_t(i + c * 2) % surfaces.size()], at, at + u, at + v, at + u + v, 1 + i % 16,
                1 + i * 7 % 16);
  }
}

TEST(Renderer, SameBitsForAnyThreadsAndBucketSize) {
  TestScene s(97, 61);
  fillWithClutter(s);
  RenderOptions o;
  o.threads = 1, o.bucketSize = 32;
  const auto reference = s.render(o);
  EXPECT_GT(reference.mean(kAlpha), 0.2);
  EXPECT_GT(reference.statistics.fragments, 1000u);
  for (int threads : {1, 2, 5})
    for (int size : {8, 13, 32, 128}) {
      o.threads = threads, o.bucketSize = size;
      EXPECT_EQ(s.render(o).channels, reference.channels) << threads << " threads, buckets of " << size;
    }
}

TEST(Renderer, CropTilesAbut) {
  TestScene whole(60, 40);
  fillWithClutter(whole);
  const auto reference = whole.render();
  for (auto [x0, x1, y0, y1] :
       {std::array{0, 22, 0, 39}, std::array{23, 59, 0, 17}, std::array{23, 59, 18, 39}}) {
    TestScene part(60, 40);
    fillWithClutter(part);
    part.camera.cropPixels[0] = x0, part.camera.cropPixels[1] = x1;
    part.camera.cropPixels[2] = y0, part.camera.cropPixels[3] = y1;
    const auto image = part.render();
    for (int c = 0; c < 5; ++c)
      for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x)
          ASSERT_EQ(image.at(c, x - x0, y - y0), reference.at(c, x, y)) << x << " " << y;
  }
}

TEST(Renderer, OutputVariablesComeFromTheNearestSurface) {
  TestScene s(16, 8);
  s.displayName = testing::TempDir() + "fr_reyes_outputs.exr", s.displayMode = "rgba,color Cs";
  const uint32_t red = s.addSurface({.color = [](const Vec3&) { return Color(1, 0, 0); }});
  const uint32_t glass = s.addSurface(
      {.opaque = false, .opacity = {0.5f, 0.5f, 0.5f}, .color = [](const Vec3&) { return Color(0, 1, 0); }});
  s.addRasterRect(red, 0, 0, 16, 8, 5);
  s.addRasterRect(glass, 0, 0, 8, 8, 3);
  const auto image = s.render();
  ASSERT_EQ(image.channels.size(), 8u);
  EXPECT_EQ(image.at(5, 12, 4), 1.0f);
  EXPECT_EQ(image.at(5, 4, 4), 0.0f);
  EXPECT_EQ(image.at(6, 4, 4), 0.5f);
  EXPECT_EQ(image.at(0, 4, 4), 0.5f);
  EXPECT_EQ(std::remove(s.displayName.c_str()), 0);
}

// ---- rays ----

/// Answers a block only when asked to wait; hit distances follow from seeds. Fails after `healthy` blocks.
class TestOracle : public RayOracleService {
 public:
  explicit TestOracle(int healthy = 1 << 30) : healthy_(healthy) {}
  Result<std::unique_ptr<RayOracle>> connect() override {
    ++connections;
    return std::unique_ptr<RayOracle>(new Line(*this));
  }
  std::atomic<int> connections{0}, blocks{0}, mostInFlight{0};

 private:
  class Line : public RayOracle {
   public:
    explicit Line(TestOracle& o) : oracle_(o) {}
    RayQuery* acquire() override {
      if (blocks_.size() - free_.size() >= 3) return nullptr;
      if (free_.empty()) {
        blocks_.push_back(std::make_unique<RayQuery>());
        return blocks_.back().get();
      }
      RayQuery* q = free_.back();
      free_.pop_back();
      return q;
    }
    Result<void> submit(RayQuery* q) override {
      if (oracle_.blocks++ >= oracle_.healthy_) return makeError(RiError::kSystem, "test oracle died");
      waiting_.push_back(q);
      oracle_.mostInFlight = std::max(oracle_.mostInFlight.load(), int(waiting_.size()));
      return {};
    }
    bool answered(const RayQuery* q) const override {
      return std::find(waiting_.begin(), waiting_.end(), q) == waiting_.end();
    }
    Result<void> wait() override {
      if (oracle_.blocks > oracle_.healthy_) return makeError(RiError::kSystem, "test oracle died");
      EXPECT_FALSE(waiting_.empty());
      RayQuery* q = waiting_.back();
      waiting_.pop_back();
      for (uint32_t i = 0; i < q->count; ++i) q->hitDistance[i] = toUnitFloat64(mix64(q->seed[i]));
      return {};
    }
    void release(RayQuery* q) override { free_.push_back(q); }

   private:
    TestOracle& oracle_;
    std::vector<std::unique_ptr<RayQuery>> blocks_;
    std::vector<RayQuery*> free_, waiting_;
  };
  int healthy_;
};

void fillWithRayAskers(TestScene& s) {
  const uint32_t one = s.addSurface({.rayRounds = 1}), two = s.addSurface({.rayRounds = 2});
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i)
      s.addRasterRect((i + j) % 2 ? one : two, float(i) * 10, float(j) * 10, float(i) * 10 + 11,
                      float(j) * 10 + 11, 5 + 0.1f * float(i), 8, 8);
}

TEST(Renderer, SeveralGridsFlyWhileRaysAreTraced) {
  TestScene s(60, 60);
  fillWithRayAskers(s);
  RenderOptions o;
  o.threads = 1;
  TestOracle oracle;
  const auto reference = s.render(o, &oracle);
  EXPECT_GE(oracle.mostInFlight, 2);
  EXPECT_EQ(oracle.connections, 1);
  EXPECT_EQ(reference.statistics.rayBatches, 18u * 1 + 18u * 2);
  EXPECT_EQ(reference.statistics.raysAsked, 54u * 81);
  EXPECT_GT(reference.mean(1), 1.2);
  for (int threads : {2, 5}) {
    o.threads = threads, o.bucketSize = 16;
    TestOracle again;
    EXPECT_EQ(s.render(o, &again).channels, reference.channels);
  }
}

TEST(Renderer, FailingOracleIsOneErrorAndTheFrameIsFinished) {
  for (int threads : {1, 3}) {
    TestScene s(60, 60);
    fillWithRayAskers(s);
    std::vector<Error> errors;
    setReportSink([&](const Error& e) { errors.push_back(e); });
    RenderOptions o;
    o.threads = threads;
    TestOracle oracle(5);
    const auto image = s.render(o, &oracle);
    setReportSink({});
    ASSERT_EQ(errors.size(), 1u);
    EXPECT_EQ(errors[0].severity, Severity::kError);
    EXPECT_TRUE(image.statistics.oracleFailed);
    EXPECT_EQ(image.mean(kAlpha), 1.0);
  }
}

TEST(Renderer, WithoutAnOracleRaysMiss) {
  TestScene s(60, 60);
  fillWithRayAskers(s);
  setReportSink([](const Error&) {});
  const auto image = s.render();
  EXPECT_EQ(reportCount(Severity::kWarning), 1);
  setReportSink({});
  EXPECT_EQ(image.mean(1), 1.0);
}

}  // namespace
}  // namespace fr::reyes
