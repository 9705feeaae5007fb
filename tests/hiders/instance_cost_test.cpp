// What instances cost: vertices and Embree's trees are stored once, however many places show them.
#include <gtest/gtest.h>

#include "scene_cache/dice_scene.h"
#include "tracer/ray_scene.h"

namespace fr::test {
namespace {

struct Cost {
  cache::CacheStatistics cache;
  tracer::RaySceneStatistics rays;
};

/// `copies` of one object in a row, seen orthographically so that each wants the same rate: as instances, or
/// written out.
Cost costOf(int copies, bool instances) {
  const std::string object = "Sphere 1 -1 1 360\nTranslate 0 0 2 Torus 0.8 0.3 0 360 360\n";
  std::string world = instances ? "ObjectBegin 1\n" + object + "ObjectEnd\n" : "";
  for (int i = 0; i < copies; ++i) {
    world += fmt::format("AttributeBegin Translate {} 0 0 Rotate {} 0 1 0\n{}\nAttributeEnd\n",
                         3 * (i % 8) - 12, 7 * i, instances ? "ObjectInstance 1" : object);
  }
  cache::DiceScene scene(
      cache::diceWorld("Format 800 800 1\nProjection \"orthographic\"\nScreenWindow -14 14 -14 14\n"
                       "ShadingRate 1\nTranslate 0 0 30\n",
                       world));
  EXPECT_TRUE(scene.reports.empty());
  scene.forEachGrid([](cache::NodeId, const cache::GridRecord&) {});
  const auto rays = tracer::RayScene::build(*scene.cache, [](cache::ObjectId) { return true; }, {});
  EXPECT_TRUE(rays.ok());
  return {scene.cache->statistics(), rays.ok() ? (*rays)->statistics() : tracer::RaySceneStatistics{}};
}

TEST(InstanceCost, VerticesAndTreesAreThoseOfOne) {
  // The first instance is diced where it stands, for it may stay the only one; the second makes the
  // prototypes.
  const Cost one = costOf(1, true), two = costOf(2, true), many = costOf(66, true),
             written = costOf(66, false);
  EXPECT_EQ(one.cache.gridsShared, 0u);
  EXPECT_GT(two.cache.gridsShared, 0u);
  EXPECT_EQ(many.cache.gridsShared, 65 * two.cache.gridsShared);
  EXPECT_EQ(many.cache.gridsDiced, two.cache.gridsDiced);
  EXPECT_EQ(many.cache.micropolygonsDiced, two.cache.micropolygonsDiced);
  EXPECT_GT(written.cache.micropolygonsDiced, 60 * one.cache.micropolygonsDiced);

  EXPECT_EQ(many.rays.prototypes, 1u);
  EXPECT_EQ(many.rays.instances, 65u);
  EXPECT_EQ(many.rays.quads, two.rays.quads);
  EXPECT_EQ(many.rays.triangles, two.rays.triangles);
  EXPECT_GT(written.rays.quads, 60 * one.rays.quads);

  // Each instance more costs its nodes and grid records alone: 300 bytes a grid of up to 289 vertices of 12
  // bytes, and a matrix in Embree. An eighth leaves room for chunks and Embree's own blocks.
  const auto more = [](uint64_t a, uint64_t b) { return double(a) - double(b); };
  EXPECT_LT(more(many.cache.arenaBytes, two.cache.arenaBytes),
            more(written.cache.arenaBytes, one.cache.arenaBytes) / 8);
  EXPECT_LT(more(many.rays.embreeBytes, two.rays.embreeBytes),
            more(written.rays.embreeBytes, one.rays.embreeBytes) / 8);
}

}  // namespace
}  // namespace fr::test
