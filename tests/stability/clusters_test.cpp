// Scenes in clusters: the same answers while trees are freed under the rays, and nothing diced that no ray
// meets.
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "base/random.h"
#include "scene_cache/dice_scene.h"
#include "tracer/ray_scene.h"

namespace fr::test {
namespace {

using namespace cache;

std::string manySpheres() {
  std::string s;
  for (int i = 0; i < 27; ++i)
    s += fmt::format("AttributeBegin Translate {} {} {} Sphere 0.4 -0.4 0.4 360 AttributeEnd\n", i % 3 - 1,
                     i / 3 % 3 - 1, i / 9 - 1);
  return s;
}

tracer::Ray randomRay(uint64_t i) {
  const auto unit = [&](uint64_t k) { return toUnitFloat(uint32_t(mix64(8 * i + k))); };
  tracer::Ray r;
  r.origin = Vec3(4 * unit(0) - 2, 4 * unit(1) - 2, 4 * unit(2) - 2);
  r.direction = glm::normalize(Vec3(unit(3) - 0.5f, unit(4) - 0.5f, unit(5) - 0.5f) + Vec3(1e-3f));
  r.radius = 0.01f * unit(6) * unit(6), r.spread = 0.05f * unit(7) * unit(7);
  r.mask = tracer::kReflectionRay;
  return r;
}

class InClusters : public ::testing::Test {
 protected:
  void SetUp() override {
    scene_ = std::make_unique<DiceScene>(diceWorld(diceCamera(6, 4, 512) + "\nSides 2", manySpheres()));
    for (const Error& e : scene_->reports) ADD_FAILURE() << e.str();
    ASSERT_TRUE(scene_->cache);
    offset_ = Vec3(scene_->cache->skeleton().header().cacheOrigin);
  }
  std::unique_ptr<tracer::RayScene> trace(bool clusters) {
    tracer::RaySceneOptions o;
    o.flatMicropolygons = clusters ? 0 : 1e12, o.clusterMicropolygons = 4000, o.leastTreeBytes = 0;
    auto made = tracer::RayScene::build(
        *scene_->cache, [](ObjectId) { return true; }, o);
    EXPECT_TRUE(made.ok());
    return made.ok() ? std::move(*made) : nullptr;
  }
  struct Answer {
    float distance, u, v;
    NodeId node;
    bool operator==(const Answer&) const = default;
  };
  Answer ask(const tracer::RayScene& s, uint64_t i, bool footprint = true) const {
    tracer::Ray r = randomRay(i);
    r.origin -= offset_;
    if (!footprint) r.radius = r.spread = 0;
    const tracer::Hit h = s.closest(r);
    return {h.distance, h.u, h.v, h.any() ? s.entry(h.entry).node : kNone};
  }
  std::unique_ptr<DiceScene> scene_;
  Vec3 offset_{0};
};

/// Nearly: where a surface is cut its borders are finer, and there u and v are reckoned in another way.
TEST_F(InClusters, WithoutFootprintsAnswersAreThoseOfOneTree) {
  const auto flat = trace(false), clustered = trace(true);
  ASSERT_TRUE(flat && clustered);
  EXPECT_EQ(clustered->entryCount(), 0u) << "nothing is diced before a ray comes";
  int hits = 0, same = 0;
  for (uint64_t i = 0; i < 20000; ++i) {
    const Answer a = ask(*flat, i, false), b = ask(*clustered, i, false);
    if (a.node == kNone && b.node == kNone) continue;
    ++hits;
    same += a.node == b.node && std::abs(a.distance - b.distance) < 2e-3f && std::abs(a.u - b.u) < 2e-2f &&
            std::abs(a.v - b.v) < 2e-2f;
  }
  EXPECT_GT(hits, 5000);
  EXPECT_GE(same, hits - hits / 100);
  EXPECT_GT(clustered->statistics().clusters, 10u);
}

TEST_F(InClusters, AnswersStayWhileTreesAreFreed) {
  const auto calm = trace(true), stormy = trace(true);
  ASSERT_TRUE(calm && stormy);
  constexpr uint64_t kRays = 6000;
  std::vector<Answer> expected;
  for (uint64_t i = 0; i < kRays; ++i) expected.push_back(ask(*calm, i));
  std::atomic<bool> ended{false};
  std::thread storm([&] {
    while (!ended) {
      stormy->giveBack(uint64_t(1) << 20);
      std::this_thread::yield();
    }
  });
  std::atomic<uint64_t> wrong{0};
  std::vector<std::thread> askers;
  for (uint64_t t = 0; t < 3; ++t)
    askers.emplace_back([&, t] {
      for (uint64_t i = t; i < kRays; i += 2) wrong += !(ask(*stormy, i) == expected[i]);
    });
  for (std::thread& t : askers) t.join();
  ended = true;
  storm.join();
  EXPECT_EQ(wrong, 0u);
  EXPECT_GT(stormy->statistics().treesFreed, 20u);
}

TEST_F(InClusters, DepartingRaysKnowTheirSurface) {
  const auto clustered = trace(true);
  const auto flat = trace(false);
  ASSERT_TRUE(flat && clustered);
  for (uint64_t i = 0; i < 3000; ++i) {
    const Answer a = ask(*flat, i, false);
    if (a.node == kNone) continue;
    tracer::Ray r = randomRay(i);
    const auto f = flat->departure(a.node, r.direction, -r.direction);
    const auto c = clustered->departure(a.node, r.direction, -r.direction);
    EXPECT_EQ(f.surfaceGroup, c.surfaceGroup);
    EXPECT_EQ(f.deviation, c.deviation);
    EXPECT_EQ(f.cellSize, c.cellSize);
  }
}

/// Option "trace" "levels": trees of several levels, one level, or no clusters at all.
TEST(LevelsOfTheScene, AreChosenByAnOption) {
  const auto traced = [](const std::string& option) {
    DiceScene scene(diceWorld(diceCamera(6, 4, 512) + "\nSides 2\n" + option, manySpheres()));
    EXPECT_TRUE(scene.reports.empty());
    tracer::RaySceneOptions o;
    o.clusterMicropolygons = 4000;
    auto made = tracer::RayScene::build(
        *scene.cache, [](ObjectId) { return true; }, o);
    EXPECT_TRUE(made.ok());
    for (uint64_t i = 0; i < 4000; ++i) {
      tracer::Ray r = randomRay(i);
      r.origin -= Vec3(scene.cache->skeleton().header().cacheOrigin);
      (*made)->closest(r);
    }
    return (*made)->statistics();
  };
  EXPECT_EQ(traced("").clusters, 0u) << "small scenes are one tree";
  EXPECT_EQ(traced("Option \"trace\" \"levels\" [\"off\"]").clusters, 0u);
  const auto on = traced("Option \"trace\" \"string levels\" [\"on\"]");
  EXPECT_GT(on.clusters, 10u);
  EXPECT_GT(on.treesBuilt, on.clustersDiced) << "of several levels";
}

/// What no ray comes near is never diced, wherever it stands.
TEST(OutsideThePicture, WaitsInClusters) {
  DiceScene scene(diceWorld(diceCamera(6, 4, 128) + "\nSides 2",
                            "Sphere 1 -1 1 360\n"
                            "AttributeBegin Translate 0 0 -200 Sphere 1 -1 1 360 AttributeEnd\n"
                            "AttributeBegin Translate 900 0 0 Sphere 1 -1 1 360 AttributeEnd\n"));
  ASSERT_TRUE(scene.cache);
  auto made = tracer::RayScene::build(*scene.cache, [](ObjectId) { return true; }, {});
  ASSERT_TRUE(made.ok());
  const auto& roots = scene.cache->skeleton().rootPatches();
  const auto isDiced = [&](ObjectId o) {
    for (NodeId i = 0; i < roots.size(); ++i)
      if (roots[i].object == o && scene.cache->peek(i).state == NodeState::kEmpty) return false;
    return true;
  };
  EXPECT_TRUE(isDiced(0));
  EXPECT_FALSE(isDiced(1));
  EXPECT_FALSE(isDiced(2));
  EXPECT_EQ((*made)->statistics().clusters, 2u);
  tracer::Ray r;
  r.origin = Vec3(0.2f, 0.1f, -190) - Vec3(scene.cache->skeleton().header().cacheOrigin);
  r.direction = Vec3(0, 0, -1);
  EXPECT_TRUE((*made)->closest(r).any());
  EXPECT_TRUE(isDiced(1));
  EXPECT_FALSE(isDiced(2));
  EXPECT_EQ((*made)->statistics().clustersDiced, 1u);
}

}  // namespace
}  // namespace fr::test
