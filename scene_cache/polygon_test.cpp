#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "base/random.h"
#include "scene_cache/edge_count.h"
#include "scene_cache/meshlet_builder.h"
#include "scene_cache/triangulate.h"

namespace fr::cache {
namespace {

double areaOf(const std::vector<DVec3>& p, const std::vector<uint32_t>& t) {
  double a = 0;
  for (size_t i = 0; i + 2 < t.size(); i += 3)
    a += glm::length(glm::cross(p[t[i + 1]] - p[t[i]], p[t[i + 2]] - p[t[i]])) / 2;
  return a;
}
double signedAreaOf(const std::vector<DVec3>& p, const std::vector<uint32_t>& t, const DVec3& n) {
  double a = 0;
  for (size_t i = 0; i + 2 < t.size(); i += 3)
    a += glm::dot(glm::cross(p[t[i + 1]] - p[t[i]], p[t[i + 2]] - p[t[i]]), n) / 2;
  return a;
}

TEST(Triangulate, ConcaveLetter) {
  const std::vector<DVec3> p = {{0, 0, 1}, {3, 0, 1}, {3, 1, 1}, {1, 1, 1},
                                {1, 2, 1}, {3, 2, 1}, {3, 3, 1}, {0, 3, 1}};
  const uint32_t sizes[] = {8};
  const auto t = triangulate(p, sizes);
  EXPECT_EQ(t.size(), 18u);
  EXPECT_NEAR(areaOf(p, t), 7, 1e-12);
  EXPECT_NEAR(signedAreaOf(p, t, {0, 0, 1}), 7, 1e-12);  // all the same way round
}
TEST(Triangulate, HolesInEitherDirection) {
  for (const bool reversed : {false, true}) {
    std::vector<DVec3> p = {{0, 0, 0}, {10, 0, 0}, {10, 10, 0}, {0, 10, 0}};
    std::vector<DVec3> a = {{1, 1, 0}, {3, 1, 0}, {3, 3, 0}, {1, 3, 0}},
                       b = {{6, 5, 0}, {8, 5, 0}, {7, 8, 0}};
    if (reversed) std::reverse(a.begin(), a.end()), std::reverse(b.begin(), b.end());
    p.insert(p.end(), a.begin(), a.end());
    p.insert(p.end(), b.begin(), b.end());
    const uint32_t sizes[] = {4, 4, 3};
    const auto t = triangulate(p, sizes);
    EXPECT_NEAR(areaOf(p, t), 100 - 4 - 3, 1e-9);
    EXPECT_NEAR(std::abs(signedAreaOf(p, t, {0, 0, 1})), 93, 1e-9);
  }
}
TEST(Triangulate, RandomStarsKeepTheirArea) {
  for (uint32_t seed = 0; seed < 200; ++seed) {
    const size_t n = 3 + mix32(seed) % 60;
    std::vector<DVec3> p;
    for (size_t i = 0; i < n; ++i) {
      const double r = 0.2 + toUnitFloat(mix32(seed * 977 + uint32_t(i))),
                   a = 2 * M_PI * double(i) / double(n);
      p.emplace_back(r * std::cos(a), 0.3 * r * std::cos(a) + 2, r * std::sin(a));
    }
    const uint32_t sizes[] = {uint32_t(n)};
    const double whole = glm::length(newellNormal(p)) / 2;
    const auto t = triangulate(p, sizes);
    EXPECT_EQ(t.size(), (n - 2) * 3);
    EXPECT_NEAR(areaOf(p, t), whole, 1e-9 * double(n)) << seed;
  }
}
TEST(Triangulate, DegenerateInputEnds) {
  for (uint32_t seed = 0; seed < 50; ++seed) {
    std::vector<DVec3> p;  // crossing itself at random, with repeated points
    for (uint32_t i = 0; i < 40; ++i)
      p.emplace_back(mix32(seed * 100 + i) % 5, mix32(seed * 77 + i * 3) % 5, 0);
    const uint32_t sizes[] = {20, 10, 10};
    const auto t = triangulate(p, sizes);
    for (const uint32_t i : t) EXPECT_LT(i, p.size());
  }
  const std::vector<DVec3> line = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}};
  const uint32_t sizes[] = {4};
  EXPECT_EQ(triangulate(line, sizes).size(), 6u);
}

TEST(Meshlets, HoldEveryTriangleOnceAndTheirLimits) {
  std::vector<Vec3> points;
  std::vector<MeshTriangle> triangles;
  const uint32_t n = 100;
  for (uint32_t j = 0; j <= n; ++j) {
    for (uint32_t i = 0; i <= n; ++i) points.emplace_back(float(i), float(j), 0.0f);
  }
  for (uint32_t j = 0; j < n; ++j) {
    for (uint32_t i = 0; i < n; ++i) {
      const uint32_t a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      triangles.push_back({{a, b, d}, {a, b, d}, j * n + i});
      triangles.push_back({{a, d, c}, {a, d, c}, j * n + i});
    }
  }
  const Meshlets m = buildMeshlets(triangles, points, false, true);
  double area = 0;
  size_t count = 0;
  for (const MeshletRecord& r : m.records) {
    EXPECT_LE(r.vertexCount, uint32_t(kMaxMeshletVertices));
    EXPECT_LE(r.triangleCount, uint32_t(kMaxMeshletTriangles));
    for (uint32_t t = 0; t < r.triangleCount; ++t, ++count) {
      Vec3 p[3];
      for (uint32_t c = 0; c < 3; ++c) {
        const uint8_t v = m.triangles[(r.firstTriangle + t) * 3 + c];
        ASSERT_LT(v, r.vertexCount);
        p[c] = points[m.vertices[r.firstVertex + v]];
      }
      area += double(glm::cross(p[1] - p[0], p[2] - p[0]).z) / 2;
    }
  }
  EXPECT_EQ(count, triangles.size());
  EXPECT_DOUBLE_EQ(area, double(n) * n);
  EXPECT_LE(m.records.size(), triangles.size() / 200);      // well filled
  EXPECT_LE(m.vertices.size(), triangles.size() * 8 / 10);  // well shared
}

// ---- through RIB

std::string icosphere(int frequency, double bulge) {
  // A cube's faces as triangle pairs, pushed onto a sphere; closed and shared vertices.
  std::string p, sizes, verts;
  std::map<std::tuple<int, int, int>, int> ids;
  const int n = frequency;
  const auto vertex = [&](int x, int y, int z) {
    const auto [it, fresh] = ids.try_emplace({x, y, z}, int(ids.size()));
    if (fresh) {
      DVec3 q(2.0 * x / n - 1, 2.0 * y / n - 1, 2.0 * z / n - 1);
      q = q * (1 - bulge) + glm::normalize(q) * bulge;
      p += fmt::format("{:.7f} {:.7f} {:.7f} ", q.x, q.y, q.z);
    }
    return it->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side <= n; side += n) {
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i) {
          const auto v = [&](int a, int b) {
            int c[3];
            c[axis] = side, c[(axis + 1) % 3] = a, c[(axis + 2) % 3] = b;
            return vertex(c[0], c[1], c[2]);
          };
          int q[4] = {v(i, j), v(i + 1, j), v(i + 1, j + 1), v(i, j + 1)};
          if (side == 0) std::swap(q[1], q[3]);
          sizes += "3 3 ";
          verts += fmt::format("{} {} {} {} {} {} ", q[0], q[1], q[2], q[0], q[2], q[3]);
        }
      }
    }
  }
  return "PointsPolygons [" + sizes + "] [" + verts + "] \"P\" [" + p + "]\n";
}

TEST(Polygons, DenseMeshesBecomeMeshlets) {
  DiceScene scene(diceWorld(diceCamera(20, 1, 128), icosphere(40, 1)));
  ASSERT_EQ(scene.cache->skeleton().objects().size(), 1u);
  EXPECT_EQ(scene.cache->skeleton().objects()[0].type, PrimitiveType::kMeshlets);
  size_t triangles = 0;
  scene.forEachGrid([&](NodeId, const GridRecord& g) { triangles += g.nv; });
  EXPECT_EQ(triangles, 6u * 40 * 40 * 2);
}
TEST(Polygons, LargeFacesBecomePatches) {
  DiceScene scene(diceWorld(diceCamera(4, 1, 128), icosphere(2, 0)));
  EXPECT_EQ(scene.cache->skeleton().objects()[0].type, PrimitiveType::kBilinearPatches);
}

TEST(Watertight, PolygonMeshes) {
  // Near faces are patches, far ones meshlets: both in one closed mesh.
  expectWatertight("mesh", icosphere(6, 1), {1.05, 1.3, 2.5, 6, 20});
  expectWatertight("mesh", icosphere(40, 0.8), {1.3, 2.0, 3.0});
  DiceScene mixed(diceWorld(diceCamera(1.6, 1, 40), icosphere(40, 0.8)));
  EXPECT_EQ(mixed.cache->skeleton().objects().size(), 2u);
}
TEST(Watertight, GeneralPolygons) {
  // A box with a square tunnel: two faces with holes.
  expectWatertight("tunnel",
                   "PointsGeneralPolygons [2 2 1 1 1 1 1 1 1 1] [4 4 4 4 4 4 4 4 4 4 4 4]"
                   "[0 1 2 3  8 11 10 9   7 6 5 4  12 13 14 15   0 4 5 1  1 5 6 2  2 6 7 3  3 7 4 0"
                   " 8 9 13 12  9 10 14 13  10 11 15 14  11 8 12 15]"
                   "\"P\" [-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1  -1 -1 1 1 -1 1 1 1 1 -1 1 1"
                   " -.5 -.5 -1 .5 -.5 -1 .5 .5 -1 -.5 .5 -1  -.5 -.5 1 .5 -.5 1 .5 .5 1 -.5 .5 1]\n",
                   {2, 4, 20});
}

TEST(Polygons, NormalFollowsTheVerticesAndOrientation) {
  // Clockwise seen from the camera, in the left-handed default: faces the camera.
  const std::string square = "Polygon \"P\" [-1 -1 0 -1 1 0 1 1 0 1 -1 0]\n";
  for (const bool reverse : {false, true}) {
    DiceScene scene(diceWorld(diceCamera(4), (reverse ? "ReverseOrientation\n" : "") + square));
    const float u = 0.5f, v = 0.5f;
    float n[3];
    SurfaceOut out;
    for (int c = 0; c < 3; ++c) out.N[c] = n + c;
    scene.cache->evaluateSurface(0, 1, nullptr, &u, &v, out);
    EXPECT_FLOAT_EQ(n[2], reverse ? 1.0f : -1.0f);
  }
}

TEST(Polygons, VariablesByClass) {
  const std::string mesh =
      "PointsPolygons [4 4] [0 1 4 3  1 2 5 4] \"P\" [0 0 0 1 0 0 2 0 0 0 1 0 1 1 0 2 1 0] "
      "\"uniform float a\" [5 7] \"varying float b\" [0 1 2 10 11 12] \"facevarying float c\" [0 1 2 3 4 5 6 "
      "7] "
      "\"constant color d\" [1 2 3]\n";
  DiceScene scene(diceWorld(diceCamera(4), mesh));
  ASSERT_EQ(scene.cache->skeleton().rootPatches().size(), 2u);
  const auto get = [&](NodeId node, const char* name, float u, float v) {
    const auto& s = scene.cache->skeleton();
    const ParamRecord* p = s.find(s.objects()[0].primvars, name);
    float r[3] = {-1, -1, -1};
    float* out[3] = {r, r + 1, r + 2};
    EXPECT_TRUE(p && scene.cache->evaluatePrimvar(node, *p, 1, nullptr, &u, &v, out)) << name;
    return r[0];
  };
  EXPECT_EQ(get(0, "a", 0.3f, 0.3f), 5);
  EXPECT_EQ(get(1, "a", 0.3f, 0.3f), 7);
  EXPECT_EQ(get(0, "b", 0.5f, 0.5f), 5.5f);
  EXPECT_EQ(get(1, "b", 1, 0), 2);
  EXPECT_EQ(get(1, "b", 0, 1), 11);
  EXPECT_EQ(get(0, "c", 0, 0), 0);
  EXPECT_EQ(get(0, "c", 1, 0), 1);
  EXPECT_EQ(get(0, "c", 1, 1), 2);
  EXPECT_EQ(get(1, "c", 0, 1), 7);
  EXPECT_EQ(get(1, "d", 0, 1), 1);
}

TEST(Polygons, BadPositionsAreReportedAndTheRestStays) {
  DiceScene scene(
      diceWorld(diceCamera(4), "PointsPolygons [3 3] [0 1 2 1 2 3] \"P\" [0 0 0 1 0 0 0 1 0 1e39 1 0]\n"));
  EXPECT_EQ(scene.cache->skeleton().rootPatches().size(), 1u);
  size_t said = 0;
  for (const Error& e : scene.reports) said += e.code == RiError::kRange;
  EXPECT_GE(said, 1u);
}

}  // namespace
}  // namespace fr::cache
