// Closed models let no ray out, whatever stride the tracer sees them at.
#include <gtest/gtest.h>

#include <cstdlib>

#include "base/random.h"
#include "scene_cache/dice_scene.h"
#include "tracer/ray_scene.h"

namespace fr::test {
namespace {

using namespace cache;

struct Model {
  std::string name, rib;
  DVec3 inside;         // camera space
  double distance = 4;  // of the camera from the model's origin
  double shadingRate = 4;
};
std::ostream& operator<<(std::ostream& out, const Model& m) { return out << m.name; }

/// A cube of quadrilaterals, as subdivision mesh.
constexpr const char* kCubeMesh = "[4 4 4 4 4 4] [0 1 3 2  4 6 7 5  0 4 5 1  2 3 7 6  0 2 6 4  1 5 7 3]";
constexpr const char* kCubePoints = "\"P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1]";

std::vector<Model> models() {
  return {
      {"Sphere", "Rotate 40 1 1 0 Sphere 1 -1 1 360", DVec3(0.1, 0.05, 0), 1.3, 2},
      {"StretchedSphere", "Rotate 20 0 1 1 Scale 0.2 0.4 3 Sphere 1 -1 1 360", DVec3(0), 3.3, 1},
      {"Torus", "Rotate 70 1 0 0 Torus 1 0.35 0 360 360", DVec3(1, 0, 0), 1.6, 2},
      {"Cone", "Rotate 100 1 0 0 Cone 1.5 0.7 360 Disk 0 0.7 360", DVec3(0, -0.5, 0), 2.2, 1},
      {"CatmullClark",
       fmt::format("Rotate 30 1 1 0 SubdivisionMesh \"catmull-clark\" {} [\"interpolateboundary\"] "
                   "[0 0] [] [] {}",
                   kCubeMesh, kCubePoints),
       DVec3(0.1, 0, 0), 1.7, 2},
      {"Creased",
       fmt::format("Rotate 30 1 1 0 SubdivisionMesh \"catmull-clark\" {} [\"crease\" \"crease\" \"corner\"] "
                   "[5 1 3 1 1 1] [0 1 3 2 0 4 5 7 6] [3.5 2 4] {}",
                   kCubeMesh, kCubePoints),
       DVec3(0.1, 0, 0), 1.9, 1},
      // A tall box: long edges opposite short ones.
      {"Stretched",
       fmt::format("Scale 0.2 0.3 2 SubdivisionMesh \"catmull-clark\" {} [\"interpolateboundary\"] [0 0] [] "
                   "[] {}",
                   kCubeMesh, kCubePoints),
       DVec3(0, 0, 0), 2.6, 0.5},
  };
}

class Watertight : public ::testing::TestWithParam<Model> {
 protected:
  void SetUp() override {
    const Model& m = GetParam();
    scene_ = std::make_unique<DiceScene>(
        diceWorld(diceCamera(m.distance, m.shadingRate, 512) + "\nSides 2", m.rib));
    for (const Error& e : scene_->reports) ADD_FAILURE() << e.str();
    ASSERT_TRUE(scene_->cache);
    // From camera to cache space.
    const DVec3 world = m.inside;
    inside_ = Vec3(world - scene_->cache->skeleton().header().cacheOrigin);
  }
  /// `clusters`: cut into small clusters, all of whose borders are open.
  std::unique_ptr<tracer::RayScene> trace(float multiplier, bool clusters = false) {
    tracer::RaySceneOptions o;
    o.patchMultiplier = multiplier;
    o.flatMicropolygons = clusters ? 0 : 1e12;
    if (clusters) o.clusterMicropolygons = 20000;
    auto made = tracer::RayScene::build(
        *scene_->cache, [](ObjectId) { return true; }, o);
    EXPECT_TRUE(made.ok()) << (made.ok() ? "" : made.error().str());
    return made.ok() ? std::move(*made) : nullptr;
  }
  tracer::Ray ray(const Vec3& direction) const {
    tracer::Ray r;
    r.origin = inside_;
    r.direction = glm::normalize(direction);
    return r;
  }
  static uint64_t rays() { return std::getenv("FR_STRESS") ? 20'000'000 : 300'000; }

  std::unique_ptr<DiceScene> scene_;
  Vec3 inside_{0};
};

TEST_P(Watertight, RandomRaysFromInside) {
  for (const float multiplier : {1.0f, 0.5f, 0.25f, 0.125f}) {
    const auto traced = trace(multiplier);
    ASSERT_TRUE(traced);
    uint64_t leaks = 0;
    for (uint64_t i = 0; i < rays(); ++i) {
      const float z = 2 * toUnitFloat(uint32_t(mix64(3 * i))) - 1,
                  a = 6.2831853f * toUnitFloat(uint32_t(mix64(3 * i + 1)));
      const float r = std::sqrt(std::max(0.0f, 1 - z * z));
      leaks += !traced->closest(ray({r * std::cos(a), r * std::sin(a), z})).any();
    }
    EXPECT_EQ(leaks, 0u) << "multiplier " << multiplier << ", " << traced->statistics().stitchQuads
                         << " quads";
  }
}

/// Clusters in which a ray takes one level, beside others in which it takes another one.
TEST_P(Watertight, RandomRaysWithFootprintsThroughClusters) {
  const auto traced = trace(0.5f, true);
  ASSERT_TRUE(traced);
  uint64_t leaks = 0;
  for (uint64_t i = 0; i < rays(); ++i) {
    const float z = 2 * toUnitFloat(uint32_t(mix64(3 * i))) - 1,
                a = 6.2831853f * toUnitFloat(uint32_t(mix64(3 * i + 1)));
    const float r = std::sqrt(std::max(0.0f, 1 - z * z));
    tracer::Ray ask = ray({r * std::cos(a), r * std::sin(a), z});
    ask.radius = 0.02f * std::pow(toUnitFloat(uint32_t(mix64(3 * i + 2))), 4.0f);
    leaks += !traced->closest(ask).any();
  }
  EXPECT_EQ(leaks, 0u);
  EXPECT_GT(traced->statistics().clustersDiced, 4u);
  EXPECT_GT(traced->statistics().treesBuilt, traced->statistics().clustersDiced) << "one level alone";
}

/// At the lines along which grids meet, as shown at every stride, but not at vertices.
TEST_P(Watertight, RaysAtBordersFromInside) {
  const float* const arena = reinterpret_cast<const float*>(scene_->cache->arena().data());
  for (const auto& [multiplier, clusters] :
       {std::pair(1.0f, false), std::pair(0.5f, false), std::pair(0.25f, false), std::pair(0.5f, true)}) {
    const auto traced = trace(multiplier, clusters);
    ASSERT_TRUE(traced);
    uint64_t leaks = 0, asked = 0;
    scene_->forEachGrid([&](NodeId, const GridRecord& g) {
      const auto at = [&](int i, int j) {
        const float* p = arena + g.positions / 4 + 3 * (size_t(j) * g.rowStride + size_t(i));
        return Vec3(p[0], p[1], p[2]);
      };
      for (const int step : {1, 2, 4}) {
        if (g.nu % step || g.nv % step) continue;
        for (int edge = 0; edge < 4; ++edge) {
          const bool alongU = edge == 0 || edge == 2;
          for (int k = 0; k + step <= (alongU ? g.nu : g.nv); k += step) {
            const int side = edge == 1 ? g.nu : edge == 2 ? g.nv : 0;
            const Vec3 a = alongU ? at(k, side) : at(side, k),
                       b = alongU ? at(k + step, side) : at(side, k + step);
            if (a == b) continue;
            const uint64_t h = mix64(asked++);
            const float t = 0.02f + 0.96f * toUnitFloat(uint32_t(h));
            tracer::Ray ask = ray(a + t * (b - a) - inside_);
            if (clusters) ask.radius = 0.02f * std::pow(toUnitFloat(uint32_t(h >> 32)), 4.0f);
            leaks += !traced->closest(ask).any();
          }
        }
      }
    });
    EXPECT_GT(asked, 1000u);
    EXPECT_EQ(leaks, 0u) << "of " << asked << ", multiplier " << multiplier
                         << (clusters ? ", in clusters" : "");
  }
}

INSTANTIATE_TEST_SUITE_P(Models, Watertight, ::testing::ValuesIn(models()),
                         [](const auto& p) { return p.param.name; });

}  // namespace
}  // namespace fr::test
