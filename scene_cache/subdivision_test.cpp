#include <gtest/gtest.h>

#include <cmath>

#include "scene_cache/edge_count.h"
#include "scene_cache/subdivision.h"

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

/// n x n quadrilaterals over [0, n], at heights of no pattern.
std::string bumpySheet(int n, const std::string& tags) {
  std::string sizes, faces, points;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i)
      points += fmt::format("{} {} {:.4f} ", i, j, 0.7 * std::sin(3.1 * i * i + 5.7 * j + i * j));
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      sizes += "4 ";
      // Faces begin at different corners.
      const int corner[4] = {a, a + 1, a + n + 2, a + n + 1};
      for (int k = 0; k < 4; ++k) faces += fmt::format("{} ", corner[(k + i + 2 * j) % 4]);
    }
  return fmt::format("SubdivisionMesh \"catmull-clark\" [{}] [{}] {} \"P\" [{}]\n", sizes, faces, tags,
                     points);
}

TEST(Subdivision, RegularFacesAreBicubicPatches) {
  const std::string boundary = "[\"interpolateboundary\"] [0 0] [] []";
  // A crease between two vertices inside: the faces around both are no longer regular.
  const std::string crease = "[\"interpolateboundary\" \"crease\"] [0 0 2 1] [24 25] [2]";
  for (const auto& [tags, regular] : {std::pair(boundary, 16u), std::pair(crease, 10u)}) {
    DiceScene scene(diceWorld(diceCamera(12), bumpySheet(6, tags)));
    ASSERT_TRUE(scene.cache);
    const Skeleton& s = scene.cache->skeleton();
    SubdivisionStore store(s);
    const SubdivisionSurface* surface = store.surface(0, 0);
    ASSERT_NE(surface, nullptr);
    uint32_t found = 0;
    for (NodeId face = 0; face < s.rootPatches().size(); ++face) {
      double points[48];
      DMat4 placement;
      if (surface->bezier(face, points, &placement)) ++found;
      for (const auto& [u, v] :
           {std::pair(0.0f, 0.0f), {1.0f, 0.0f}, {0.3f, 0.8f}, {0.5f, 0.5f}, {1.0f, 1.0f}}) {
        Vec3 p, du, dv, wantedU, wantedV;
        SurfaceOut out;
        for (int c = 0; c < 3; ++c) out.P[c] = &p[c], out.dPdu[c] = &du[c], out.dPdv[c] = &dv[c];
        scene.cache->evaluateSurface(face, 1, nullptr, &u, &v, out);
        const Vec3 wanted = surface->derivatives(face, u, v, wantedU, wantedV);
        EXPECT_LT(glm::length(p - wanted), 2e-5f) << face;
        EXPECT_LT(glm::length(du - wantedU) + glm::length(dv - wantedV), 2e-4f) << face;
      }
    }
    EXPECT_EQ(found, regular);
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

/// The 3 x 3 vertices of two by two unit quads around the origin, with tags and variables.
std::string fourQuads(const std::string& tags, const std::string& variables) {
  return "HierarchicalSubdivisionMesh \"catmull-clark\" [4 4 4 4] [0 1 4 3  1 2 5 4  3 4 7 6  4 5 8 7] " +
         tags + " \"P\" [-1 -1 0 0 -1 0 1 -1 0  -1 0 0 0 0 0 1 0 0  -1 1 0 0 1 0 1 1 0] " + variables + "\n";
}
/// Tags with one integer each, and "interpolateboundary".
std::string integerTags(const std::vector<std::pair<std::string, int>>& tags) {
  std::string names = "[\"interpolateboundary\"", counts = " [1 0 0", values = " [1";
  for (const auto& [name, value] : tags) {
    names += " \"" + name + "\"", counts += " 1 0 0", values += " " + std::to_string(value);
  }
  return names + "]" + counts + "]" + values + "] [] []";
}
/// The face-varying values of the four quads, for which the lower two are one chart and the upper two
/// another: with a seam, the upper ones are 10 more.
std::string faceVaryingOfFourQuads(const std::string& type, bool seam) {
  const float at[9] = {0, 1, 0, 2, 5, 1, 0, 3, 0};
  const int vertices[16] = {0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7};
  std::string r = "\"" + type + " float b\" [";
  for (int i = 0; i < 16; ++i) r += std::to_string(at[vertices[i]] + (seam && i >= 8 ? 10.0f : 0.0f)) + " ";
  return r + "]";
}
float valueOf(DiceScene& s, const char* name, NodeId node, float u, float v) {
  const Skeleton& k = s.cache->skeleton();
  const ParamRecord* p = k.find(k.objects()[0].primvars, name);
  float value = NAN;
  float* out[1] = {&value};
  if (!p || !s.cache->evaluatePrimvar(node, *p, 1, nullptr, &u, &v, out)) return NAN;
  return value;
}

TEST(Subdivision, FaceVaryingDataIsLinearUnlessATagSaysOtherwise) {
  DiceScene linear(
      diceWorld(diceCamera(6), fourQuads(integerTags({}), faceVaryingOfFourQuads("facevarying", false))));
  ASSERT_TRUE(linear.cache);
  EXPECT_NEAR(valueOf(linear, "b", 0, 1, 1), 5, 1e-6);
  EXPECT_NEAR(valueOf(linear, "b", 0, 0.5f, 0.5f), 2, 1e-6);

  // One chart: what a vertex variable of the same values does. In the middle, of valence 4:
  // (16 v + 4 (sum of neighbours) + (sum of opposite corners)) / 36 = (80 + 4 (1 + 2 + 1 + 3) + 0) / 36.
  const std::string vertex = " \"vertex float a\" [0 1 0 2 5 1 0 3 0]";
  for (const int rule : {1, 2, 3}) {
    DiceScene smooth(
        diceWorld(diceCamera(6), fourQuads(integerTags({{"facevaryinginterpolateboundary", rule}}),
                                           faceVaryingOfFourQuads("facevarying", false) + vertex)));
    EXPECT_NEAR(valueOf(smooth, "b", 0, 1, 1), 108 / 36.0, 1e-5) << rule;
    // Rule 1 is that of this surface's border, so both agree everywhere.
    if (rule == 1) {
      for (const float u : {0.0f, 0.3f, 1.0f}) {
        for (NodeId face = 0; face < 4; ++face)
          EXPECT_NEAR(valueOf(smooth, "b", face, u, 0.6f), valueOf(smooth, "a", face, u, 0.6f), 1e-5);
      }
    }
  }
}

TEST(Subdivision, FaceVertexDataIsSmoothWithoutATag) {
  DiceScene s(
      diceWorld(diceCamera(6), fourQuads(integerTags({}), faceVaryingOfFourQuads("facevertex", false))));
  EXPECT_NEAR(valueOf(s, "b", 0, 1, 1), 3, 1e-5);
  // On a surface that does not subdivide it is what facevarying is.
  DiceScene polygons(diceWorld(diceCamera(6),
                               "PointsPolygons [4] [0 1 2 3] \"P\" [0 0 0 1 0 0 1 1 0 0 1 0] "
                               "\"facevertex float b\" [1 2 3 4]\n"));
  EXPECT_NEAR(valueOf(polygons, "b", 0, 1, 0), 2, 1e-6);
}

TEST(Subdivision, SeamsOfFaceVaryingData) {
  const auto scene = [](int rule) {
    return diceWorld(diceCamera(6), fourQuads(integerTags({{"facevaryinginterpolateboundary", rule}}),
                                              faceVaryingOfFourQuads("facevarying", true)));
  };
  // "Always sharp": linear along the seam, so its vertex has its own value on either side.
  DiceScene sharp(scene(3));
  EXPECT_NEAR(valueOf(sharp, "b", 0, 1, 1), 5, 1e-5);
  EXPECT_NEAR(valueOf(sharp, "b", 2, 1, 0), 15, 1e-5);
  EXPECT_NEAR(valueOf(sharp, "b", 0, 0.5f, 1), 3.5, 1e-5);
  // "Edges": the seam is a crease of each chart, a cubic B-spline: (2 + 4 * 5 + 1) / 6.
  for (const int rule : {1, 2}) {
    DiceScene edges(scene(rule));
    EXPECT_NEAR(valueOf(edges, "b", 0, 1, 1), 23 / 6.0, 1e-5) << rule;
    EXPECT_NEAR(valueOf(edges, "b", 2, 1, 0), 10 + 23 / 6.0, 1e-5) << rule;
  }
}

TEST(Subdivision, PropagateCornersSharpensTheEndOfASeam) {
  // A seam from the middle of the lower border to the middle of the mesh, where it ends.
  const std::string values = "\"facevarying float b\" [0 1 5 2  3 0 1 5  2 5 3 0  5 1 0 3]";
  const auto scene = [&](int propagate) {
    return diceWorld(diceCamera(6), fourQuads(integerTags({{"facevaryinginterpolateboundary", 1},
                                                           {"facevaryingpropagatecorners", propagate}}),
                                              values));
  };
  DiceScene on(scene(1)), off(scene(0));
  EXPECT_NEAR(valueOf(on, "b", 0, 1, 1), 5, 1e-5);
  // Without, both sides of the seam are one crease through it: (1 + 4 * 5 + 3) / 6.
  EXPECT_NEAR(valueOf(off, "b", 0, 1, 1), 4, 1e-5);
}

TEST(Subdivision, CreaseMethod) {
  // A ring of edges around the cube's top. Chaikin's rule averages sharpness along it: without differences it
  // changes nothing, with them it does.
  const auto scene = [](const std::string& sharpness, const std::string& method) {
    return diceWorld(diceCamera(6), "HierarchicalSubdivisionMesh \"catmull-clark\" " + kCubeFaces +
                                        " [\"crease\" \"creasemethod\"] [5 4 0  0 0 1] [4 5 6 7 4] [" +
                                        sharpness + "] [\"" + method + "\"] " + kCubePoints + "\n");
  };
  const auto distance = [&](const std::string& sharpness) {
    DiceScene normal(scene(sharpness, "normal")), chaikin(scene(sharpness, "chaikin"));
    EXPECT_TRUE(normal.reports.empty() && chaikin.reports.empty());
    float most = 0;
    for (const float u : {0.1f, 0.5f, 0.9f})
      most = std::max(most, glm::length(pointOf(normal, 1, u, 0) - pointOf(chaikin, 1, u, 0)));
    return most;
  };
  EXPECT_LT(distance("2 2 2 2"), 1e-6);
  EXPECT_GT(distance("3 1 3 1"), 1e-3);
  DiceScene wrong(scene("1 1 1 1", "round"));
  ASSERT_EQ(wrong.reports.size(), 1u);
  EXPECT_NE(wrong.reports[0].str().find("round"), std::string::npos);
}

TEST(Subdivision, SmoothTriangles) {
  const std::string octahedron =
      "[3 3 3 3 3 3 3 3] [0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5] [\"smoothtriangles\"] [1 0] [{}] "
      "[] "
      "\"P\" [1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 0 0 -1]\n";
  const auto scene = [](std::string mesh, int on) {
    mesh.replace(mesh.find("{}"), 2, std::to_string(on));
    return diceWorld(diceCamera(6), "SubdivisionMesh \"catmull-clark\" " + mesh);
  };
  DiceScene off(scene(octahedron, 0)), on(scene(octahedron, 1)), two(scene(octahedron, 2));
  const auto middleOfEdge = [](DiceScene& s) { return glm::length(pointOf(s, 0, 1, 0)); };
  EXPECT_GT(std::abs(middleOfEdge(on) - middleOfEdge(off)), 1e-3);
  EXPECT_EQ(middleOfEdge(on), middleOfEdge(two));
  // Quads have no triangles: nothing changes.
  const std::string cube = kCubeFaces + " [\"smoothtriangles\"] [1 0] [{}] [] " + kCubePoints + "\n";
  DiceScene a(scene(cube, 0)), b(scene(cube, 1));
  EXPECT_EQ(pointOf(a, 0, 0.5f, 0.3f), pointOf(b, 0, 0.5f, 0.3f));
}

TEST(Subdivision, HierarchicalEditsAreNamedOnceAndTheMeshIsDrawn) {
  DiceScene s(
      diceWorld(diceCamera(6), "HierarchicalSubdivisionMesh \"catmull-clark\" " + kCubeFaces +
                                   " [\"vertexedit\" \"vertexedit\" \"faceedit\" \"interpolateboundary\"]"
                                   " [3 3 3 3 3 3 2 0 1 0 0 0] [2 0 1 2 1 1 1 0] [0 0 1 0 0 1] [\"add\" "
                                   "\"value\" \"P\" \"add\" \"value\" \"P\" \"hole\"] " +
                                   kCubePoints + "\n"));
  ASSERT_TRUE(s.cache);
  EXPECT_EQ(s.cache->skeleton().rootPatches().size(), 6u);
  ASSERT_EQ(s.reports.size(), 2u);
  EXPECT_NE(s.reports[0].str().find("vertexedit"), std::string::npos);
  EXPECT_NE(s.reports[1].str().find("faceedit"), std::string::npos);
}

TEST(Subdivision, InterpolateBoundaryWithAndWithoutItsNumber) {
  // 0: no border, no face; 1 and nothing: corners stay; 2: corners are rounded off.
  const auto scene = [](const std::string& tags) {
    return diceWorld(diceCamera(6), "SubdivisionMesh \"catmull-clark\" [4] [0 1 2 3] " + tags +
                                        " [] \"P\" [0 0 0 1 0 0 1 1 0 0 1 0]\n");
  };
  DiceScene none(scene("[\"interpolateboundary\"] [1 0] [0]")),
      one(scene("[\"interpolateboundary\"] [1 0] [1]")), bare(scene("[\"interpolateboundary\"] [0 0] []")),
      two(scene("[\"interpolateboundary\"] [1 0] [2]"));
  EXPECT_EQ(none.cache->skeleton().rootPatches().size(), 0u);
  EXPECT_NEAR(glm::length(pointOf(one, 0, 1, 1) - Vec3(1, 1, 0)), 0, 1e-5);
  EXPECT_NEAR(glm::length(pointOf(bare, 0, 1, 1) - Vec3(1, 1, 0)), 0, 1e-5);
  // A closed cubic B-spline of the four corners: (4 + 1 + 0) / 6.
  EXPECT_NEAR(glm::length(pointOf(two, 0, 1, 1) - Vec3(5 / 6.0f, 5 / 6.0f, 0)), 0, 1e-5);
}

TEST(Watertight, RegularAndOtherFacesOfASubdivisionMesh) {
  // A torus with a crease: faces along it are not regular, their neighbours are.
  constexpr int kRows = 7, kColumns = 9;
  std::string sizes, faces, points;
  for (int j = 0; j < kRows; ++j)
    for (int i = 0; i < kColumns; ++i) {
      const double a = 2 * M_PI * i / kColumns, b = 2 * M_PI * j / kRows,
                   r = 0.45 + 0.1 * std::sin(3 * i + j);
      points += fmt::format("{:.5f} {:.5f} {:.5f} ", (1 + r * std::cos(b)) * std::cos(a),
                            (1 + r * std::cos(b)) * std::sin(a), r * std::sin(b));
      const int i1 = (i + 1) % kColumns, j1 = (j + 1) % kRows;
      sizes += "4 ";
      faces += fmt::format("{} {} {} {} ", j * kColumns + i, j * kColumns + i1, j1 * kColumns + i1,
                           j1 * kColumns + i);
    }
  expectWatertight(
      "torus",
      fmt::format("Rotate 40 1 2 3\nSubdivisionMesh \"catmull-clark\" [{}] [{}] [\"crease\"] [3 1] [0 1 "
                  "2] [1.5] \"P\" [{}]\n",
                  sizes, faces, points),
      {1.1, 1.6, 3, 20});
}

TEST(Watertight, SubdivisionMeshes) {
  expectWatertight("cube", "Rotate 30 1 2 3 " + kCube, {0.7, 1.0, 3, 20});
  expectWatertight("house", "Rotate 60 1 2 3 " + kHouse, {0.9, 1.3, 3, 20});
  expectWatertight("loop", "Rotate 30 1 2 3 " + kTetra, {0.5, 0.9, 3, 20});
}

}  // namespace
}  // namespace fr::cache
