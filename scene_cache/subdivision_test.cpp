#include <gtest/gtest.h>

#include <cmath>

#include "scene_cache/edge_count.h"

namespace fr::cache {
namespace {

const std::string kCubePoints = "\"P\" [-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1 -1 -1 1 1 -1 1 1 1 1 -1 1 1]";
const std::string kCubeFaces = "[4 4 4 4 4 4] [0 3 2 1 4 5 6 7 0 1 5 4 1 2 6 5 2 3 7 6 3 0 4 7]";
const std::string kCube =
    "SubdivisionMesh \"catmull-clark\" " + kCubeFaces + " [] [] [] [] " + kCubePoints + "\n";
// A house: quads, triangles and a pentagon pair (not all quads).
const std::string kHouse =
    "SubdivisionMesh \"catmull-clark\" [5 5 4 4 4 4 4] [0 4 3 2 1  5 6 7 8 9  0 1 6 5  1 2 7 6  2 3 8 7  3 4 "
    "9 8  4 0 5 9]"
    " [\"crease\"] [3 1] [1 6 7] [2.5] \"P\" [-1 -1 -1 1 -1 -1 1 0.5 -1 0 1.2 -1 -1 0.5 -1"
    " -1 -1 1 1 -1 1 1 0.5 1 0 1.2 1 -1 0.5 1]\n";
const std::string kTetra =
    "SubdivisionMesh \"loop\" [3 3 3 3] [0 1 2 0 3 1 1 3 2 2 3 0] [] [] [] [] \"P\" [1 1 1 -1 -1 1 -1 1 -1 1 "
    "-1 -1]\n";

Vec3 pointOf(DiceScene& s, NodeId node, float u, float v) {
  Vec3 p;
  SurfaceOut out;
  for (int c = 0; c < 3; ++c) out.P[c] = &p[c];
  s.cache->evaluateSurface(node, 1, nullptr, &u, &v, out);
  return p + Vec3(s.cache->skeleton().header().cacheOrigin);
}

TEST(Subdivision, CubeHasTheKnownLimit) {
  DiceScene scene(diceWorld(diceCamera(6), kCube));
  ASSERT_TRUE(scene.cache);
  ASSERT_EQ(scene.cache->skeleton().rootPatches().size(), 6u);
  // Limit of a vertex of valence n: (n^2 v + 4 sum e + sum f) / (n (n + 5)), e edge neighbours, f opposite
  // corners of the faces (Halstead, Kass, DeRose 1993). Corner (1,1,1): 9 + 4 (1 + 1 - 1) + (1 - 1 - 1) over
  // 24 = 12 / 24.
  for (NodeId face = 0; face < 6; ++face) {
    for (const float u : {0.0f, 1.0f}) {
      for (const float v : {0.0f, 1.0f}) {
        const Vec3 p = pointOf(scene, face, u, v);
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(std::abs(p[c]), 0.5, 1e-5);
      }
    }
    // The middle of a face lies on its axis, and all six are alike.
    const Vec3 m = pointOf(scene, face, 0.5f, 0.5f);
    EXPECT_NEAR(std::abs(m.x) + std::abs(m.y) + std::abs(m.z), glm::length(m), 1e-5);
    EXPECT_NEAR(glm::length(m), glm::length(pointOf(scene, 0, 0.5f, 0.5f)), 1e-6);
  }
}

TEST(Subdivision, NormalsPointOutwards) {
  for (const std::string& mesh : {kCube, kHouse, kTetra}) {
    // Faces run counterclockwise seen from outside in these meshes: in the left-handed default that is inside
    // out.
    DiceScene scene(diceWorld(diceCamera(6), "ReverseOrientation\n" + mesh));
    for (NodeId face = 0; face < scene.cache->skeleton().rootPatches().size(); ++face) {
      const float u = 0.3f, v = 0.4f;
      Vec3 n;
      SurfaceOut out;
      for (int c = 0; c < 3; ++c) out.N[c] = &n[c];
      scene.cache->evaluateSurface(face, 1, nullptr, &u, &v, out);
      const float outwards = glm::dot(n, pointOf(scene, face, u, v));
      if (mesh == kCube) {
        EXPECT_LT(outwards, 0);
      }
      EXPECT_GT(std::abs(outwards), 0.1f);
    }
  }
}

TEST(Subdivision, CreasesStayOnTheControlPolygon) {
  const std::string sharp =
      "SubdivisionMesh \"bilinear\" " + kCubeFaces + " [] [] [] [] " + kCubePoints + "\n";
  DiceScene scene(diceWorld(diceCamera(6), sharp));
  const Vec3 p = pointOf(scene, 1, 1, 1);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(std::abs(p[c]), 1, 1e-6);
}

TEST(Subdivision, BordersNeedInterpolateBoundary) {
  const std::string open =
      "SubdivisionMesh \"catmull-clark\" [4] [0 1 2 3] {} \"P\" [0 0 0 1 0 0 1 1 0 0 1 0]\n";
  const auto with = [&](const std::string& tags) {
    std::string rib = open;
    rib.replace(rib.find("{}"), 2, tags);
    return rib;
  };
  DiceScene none(diceWorld(diceCamera(6), with("[] [] [] []")));
  EXPECT_EQ(none.cache->skeleton().rootPatches().size(), 0u);
  DiceScene edges(diceWorld(diceCamera(6), with("[\"interpolateboundary\"] [0 0] [] []")));
  ASSERT_EQ(edges.cache->skeleton().rootPatches().size(), 1u);
  EXPECT_NEAR(glm::length(pointOf(edges, 0, 1, 1) - Vec3(1, 1, 0)), 0, 1e-5);
}

TEST(Subdivision, HolesHaveNoPatch) {
  DiceScene scene(diceWorld(diceCamera(6), "SubdivisionMesh \"catmull-clark\" " + kCubeFaces +
                                               " [\"hole\"] [2 0] [1 4] [] " + kCubePoints + "\n"));
  EXPECT_EQ(scene.cache->skeleton().rootPatches().size(), 4u);
}

TEST(Subdivision, PiecesOfAFaceMeetWhereTheyShould) {
  DiceScene scene(diceWorld(diceCamera(6), kHouse));
  // The first face has five pieces: (1,1) is its centre for all of them.
  const Vec3 centre = pointOf(scene, 0, 1, 1);
  for (NodeId k = 1; k < 5; ++k) EXPECT_NEAR(glm::length(pointOf(scene, k, 1, 1) - centre), 0, 1e-5);
  for (NodeId k = 0; k < 5; ++k) {
    EXPECT_NEAR(glm::length(pointOf(scene, k, 1, 0) - pointOf(scene, (k + 1) % 5, 0, 1)), 0, 1e-5);
  }
}

TEST(Subdivision, VertexVariablesFollowTheSurface) {
  std::string cube = kCube;
  cube.insert(cube.size() - 1,
              " \"vertex point Q\" [-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1 -1 -1 1 1 -1 1 1 1 1 -1 1 1]");
  DiceScene scene(diceWorld(diceCamera(6), cube));
  const Skeleton& s = scene.cache->skeleton();
  const ParamRecord* q = s.find(s.objects()[0].primvars, "Q");
  ASSERT_TRUE(q);
  const float u = 0.3f, v = 0.8f;
  Vec3 value;
  float* out[3] = {&value.x, &value.y, &value.z};
  ASSERT_TRUE(scene.cache->evaluatePrimvar(2, *q, 1, nullptr, &u, &v, out));
  const Vec3 inCamera = pointOf(scene, 2, u, v);
  EXPECT_NEAR(glm::length(value - inCamera), 0, 1e-5);
}

TEST(Watertight, SubdivisionMeshes) {
  expectWatertight("cube", "Rotate 30 1 2 3 " + kCube, {0.7, 1.0, 3, 20});
  expectWatertight("house", "Rotate 60 1 2 3 " + kHouse, {0.9, 1.3, 3, 20});
  expectWatertight("loop", "Rotate 30 1 2 3 " + kTetra, {0.5, 0.9, 3, 20});
}

}  // namespace
}  // namespace fr::cache
