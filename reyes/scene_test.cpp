// The hider over the real scene cache: geometry diced on demand by several threads, colours from a stand-in
// for the shader machine.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "reyes/renderer.h"
#include "scene_cache/dice_scene.h"

namespace fr {

// ---- stand-in: Cs Os of the attribute state, red varied by the position
// -------------------------------------------

struct ShadingSystem::Impl {
  cache::SceneCache& cache;
};
// NOLINTNEXTLINE(performance-unnecessary-value-param): the signature of the class this stands in for
ShadingSystem::ShadingSystem(cache::SceneCache& cache, Options) : impl_(new Impl{cache}) {}
ShadingSystem::~ShadingSystem() = default;
bool ShadingSystem::canAskRays() const { return false; }
bool ShadingSystem::isOpaque(cache::AttributeId a) const {
  const Color o = impl_->cache.skeleton().attributes()[a].opacity;
  return o.x >= 1 && o.y >= 1 && o.z >= 1;
}
int ShadingSystem::outputComponents(std::string_view) const { return 0; }
bool ShadingSystem::runImager(size_t, const float*, const float*, float* const[3], float* const[3], float*) {
  return false;
}
struct ShadeTask::Impl {
  cache::SceneCache& cache;
  std::vector<float> values[6];
};
ShadeTask::ShadeTask(ShadingSystem& s) : impl_(new Impl{s.impl_->cache, {}}) {}
ShadeTask::~ShadeTask() = default;
void ShadeTask::begin(const ShadePoints& points) {
  const cache::AttributeRecord& a = impl_->cache.attributesOf(points.grid->node);
  const cache::GridView view = impl_->cache.view(*points.grid);
  for (size_t c = 0; c < 3; ++c) {
    impl_->values[c].assign(points.count, a.color[int(c)] * a.opacity[int(c)]);
    impl_->values[3 + c].assign(points.count, a.opacity[int(c)]);
  }
  const bool grid = points.topology == ShadePoints::Topology::kGrid;
  const size_t columns = grid ? points.grid->nu + 1u : points.count;
  for (size_t i = 0; i < points.count; ++i) {
    const size_t vertex = grid ? points.vertexOf(i) : i;
    const float* p = view.positions + (vertex / columns * points.grid->rowStride + vertex % columns) * 3;
    impl_->values[0][i] *= 0.5f + 0.5f * std::sin(5 * p[0] + 3 * p[1] + 4 * p[2]);
  }
}
ShadeTask::Status ShadeTask::run() { return Status::kDone; }
void ShadeTask::writeRays(RayQuery&) const {}
void ShadeTask::readAnswers(const RayQuery&) {}
void ShadeTask::missAll() {}
const float* ShadeTask::color(int c) const { return impl_->values[c].data(); }
const float* ShadeTask::opacity(int c) const { return impl_->values[3 + c].data(); }
const float* ShadeTask::output(std::string_view, int) const { return nullptr; }

namespace {

constexpr int kSize = 128;

struct Image {
  std::vector<std::vector<float>> channels;
  FrameStatistics statistics;
  float at(int c, int x, int y) const { return channels[size_t(c)][size_t(y * kSize + x)]; }
  double sum(int c) const {
    double s = 0;
    for (float v : channels[size_t(c)]) s += double(v);
    return s;
  }
};

/// A fresh cache each time, so that its nodes are split in the order of this rendering.
Image render(const std::string& body, const RenderOptions& asked = {}, double distance = 5) {
  cache::DiceScene scene(cache::diceWorld(
      "PixelSamples 4 4\nPixelFilter \"box\" 1 1\n" + cache::diceCamera(distance, 1, kSize), body));
  EXPECT_TRUE(scene.reports.empty()) << scene.reports[0].str();
  Image image;
  if (!scene.cache) return image;
  ShadingSystem shading(*scene.cache, {});
  RenderOptions options = asked;
  options.writeDisplays = false;
  options.pixels = [&](const FilmTile& t) {
    image.channels.resize(t.channels.size(), std::vector<float>(size_t(kSize * kSize), -1.0f));
    size_t i = 0;
    for (int y = t.rect.y0; y < t.rect.y1; ++y)
      for (int x = t.rect.x0; x < t.rect.x1; ++x, ++i)
        for (size_t c = 0; c < t.channels.size(); ++c)
          image.channels[c][size_t(y * kSize + x)] = t.channels[c][i];
  };
  auto r = renderFrame(*scene.cache, shading, nullptr, options);
  EXPECT_TRUE(r) << r.error().str();
  if (r) image.statistics = *r;
  return image;
}

/// Pixels across which one unit at distance 1 reaches (fov 40).
double focal() { return kSize / 2 / std::tan(20 * std::numbers::pi / 180); }

TEST(RendererScene, SphereCoversItsSilhouette) {
  const Image image = render("Sphere 1 -1 1 360");
  const double radius = focal() * std::tan(std::asin(1.0 / 5));
  const double area = std::numbers::pi * radius * radius;
  // Micropolygons of a pixel cut the outline by less than 1/100 pixel; the rest is sampling noise of some 220
  // border pixels.
  EXPECT_NEAR(image.sum(3), area, 0.003 * area);
  EXPECT_NEAR(image.at(4, 64, 64), 4, 0.01);
  EXPECT_EQ(image.at(3, 5, 5), 0.0f);
}

TEST(RendererScene, OneSidedSphereShowsItsOutsideUnlessReversed) {
  const Image outside = render("Sides 1 Sphere 1 -1 1 360");
  EXPECT_NEAR(outside.at(4, 64, 64), 4, 0.01);
  const Image inside = render("Sides 1 ReverseOrientation Sphere 1 -1 1 360");
  EXPECT_NEAR(inside.at(4, 64, 64), 6, 0.01);
  const Image mirrored = render("Sides 1 Scale -1 1 1 Sphere 1 -1 1 360");
  EXPECT_NEAR(mirrored.at(4, 64, 64), 4, 0.01);
}

/// Front and back of a half-transparent sphere: exactly two layers wherever the outline is not near. A crack
/// or a double hit between any two micropolygons, grids or patches shows.
TEST(RendererScene, TransparentSphereHasTwoLayersEverywhere) {
  const Image image = render("Opacity .5 .5 .5 Sphere 1 -1 1 360");
  const double radius = focal() * std::tan(std::asin(1.0 / 5));
  int inside = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x)
      if (std::hypot(x + 0.5 - kSize / 2, y + 0.5 - kSize / 2) < radius - 2) {
        ++inside;
        EXPECT_EQ(image.at(3, x, y), 0.75f) << x << " " << y;
      }
  EXPECT_GT(inside, 2000);
}

TEST(RendererScene, SameBitsForAnyThreadsThoughPatchesSplitInAnotherOrder) {
  const std::string body =
      "Rotate -90 1 0 0 Rotate 30 0 0 1 Scale .45 .45 .45 Geometry \"teapot\"\n"
      "Identity Translate 0 0 1 Opacity .4 .5 .6 Color 1 .5 .2 Torus 1.2 .4 0 360 360 Opacity 1 1 1 Sphere "
      ".6 -.6 .6 360";
  RenderOptions o;
  o.threads = 1;
  const Image reference = render(body, o);
  EXPECT_GT(reference.sum(3), 1000);
  for (int threads : {2, 5}) {
    o.threads = threads, o.bucketSize = threads == 5 ? 16 : 0;
    EXPECT_EQ(render(body, o).channels, reference.channels) << threads;
  }
}

TEST(RendererScene, FloorUnderTheEyeReachesTheHorizon) {
  const Image image = render("Patch \"bilinear\" \"P\" [-900 -1 -30 900 -1 -30 -900 -1 900 900 -1 900]");
  for (int x = 3; x < kSize; x += 20) {
    EXPECT_EQ(image.at(3, x, 62), 0.0f);
    for (int y = 67; y < kSize; ++y) EXPECT_EQ(image.at(3, x, y), 1.0f) << x << " " << y;
  }
}

}  // namespace
}  // namespace fr
