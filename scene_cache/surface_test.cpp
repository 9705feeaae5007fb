#include <gtest/gtest.h>

#include <cmath>

#include "scene_cache/edge_count.h"
#include "scene_cache/patch_basis.h"
#include "scene_cache/quadric.h"
#include "scene_cache/surface.h"

namespace fr::cache {
namespace {

struct Implicit {
  Quadric q;
  std::function<double(const DVec3&)> f;  // 0 on the surface
  std::function<DVec3(const DVec3&)> gradient;
};

TEST(Quadrics, PointsAndNormalsSatisfyTheEquation) {
  const std::vector<Implicit> all = {
      {{PrimitiveType::kSphere, {2, -1, 1.5, 300}},
       [](const DVec3& p) { return glm::dot(p, p) - 4; },
       [](const DVec3& p) { return p; }},
      {{PrimitiveType::kCone, {3, 1.5, 200}},
       [](const DVec3& p) { return std::hypot(p.x, p.y) - 1.5 * (1 - p.z / 3); },
       [](const DVec3& p) { return DVec3(p.x / std::hypot(p.x, p.y), p.y / std::hypot(p.x, p.y), 0.5); }},
      {{PrimitiveType::kCylinder, {0.7, -1, 2, 360}},
       [](const DVec3& p) { return std::hypot(p.x, p.y) - 0.7; },
       [](const DVec3& p) { return DVec3(p.x, p.y, 0); }},
      {{PrimitiveType::kParaboloid, {2, 0.5, 3, 270}},
       [](const DVec3& p) { return p.x * p.x + p.y * p.y - 4 * p.z / 3; },
       [](const DVec3& p) { return DVec3(2 * p.x, 2 * p.y, -4.0 / 3); }},
      {{PrimitiveType::kDisk, {1.25, 2, 90}},
       [](const DVec3& p) { return p.z - 1.25; },
       [](const DVec3&) { return DVec3(0, 0, 1); }},
      {{PrimitiveType::kTorus, {2, 0.5, 0, 360, 360}},
       [](const DVec3& p) { return std::pow(std::hypot(p.x, p.y) - 2, 2) + p.z * p.z - 0.25; },
       [](const DVec3& p) {
         const double r = std::hypot(p.x, p.y), k = (r - 2) / r;
         return DVec3(p.x * k, p.y * k, p.z);
       }},
      {{PrimitiveType::kHyperboloid, {1, 0, 0, 0, 1, 1, 360}},
       [](const DVec3& p) { return p.x * p.x + p.y * p.y - (2 * p.z * p.z - 2 * p.z + 1); },
       [](const DVec3& p) { return DVec3(2 * p.x, 2 * p.y, -(4 * p.z - 2)); }},
  };
  for (const Implicit& i : all) {
    Surface s;
    s.setQuadric(i.q, DMat4(1));
    for (float u = 0; u <= 1; u += 0.125f) {
      for (float v = 0; v <= 1; v += 0.125f) {
        const Vec3 p = s.point(u, v);
        EXPECT_NEAR(i.f(DVec3(p)), 0, 2e-6) << int(i.q.type) << " " << u << " " << v;
        Vec3 n;
        float* const out[3] = {&n.x, &n.y, &n.z};
        s.normals(1, &u, &v, out);
        EXPECT_NEAR(glm::length(n), 1, 1e-5);
        if (i.q.type == PrimitiveType::kCone && v > 0.9f) continue;  // the tip has no gradient
        EXPECT_NEAR(std::abs(glm::dot(DVec3(n), glm::normalize(i.gradient(DVec3(p))))), 1, 3e-3)
            << int(i.q.type) << " " << u << " " << v;
        const Box3d box = quadricBound(i.q);
        for (int c = 0; c < 3; ++c) {
          EXPECT_GE(p[c], box.min[c] - 1e-6);
          EXPECT_LE(p[c], box.max[c] + 1e-6);
        }
      }
    }
  }
}

TEST(Quadrics, SeamsAndPolesCloseBitByBit) {
  Surface s;
  s.setQuadric({PrimitiveType::kSphere, {1, -1, 1, 360}}, DMat4(1.7));
  for (float v = 0; v <= 1; v += 0.0625f) EXPECT_EQ(s.point(0, v), s.point(1, v));
  EXPECT_EQ(s.point(0.25f, 1), s.point(0.7f, 1));
  EXPECT_EQ(s.point(0, 0.5f).z, 0.0f);
}

TEST(Quadrics, DerivativesAreThoseOfThePoints) {
  for (const Quadric& q : {Quadric{PrimitiveType::kSphere, {2, -1, 1.5, 300}},
                           Quadric{PrimitiveType::kTorus, {2, 0.5, 20, 200, 360}},
                           Quadric{PrimitiveType::kHyperboloid, {1, 0, 0, 0.5, 1, 1, 360}},
                           Quadric{PrimitiveType::kParaboloid, {2, 0.5, 3, 270}}}) {
    Surface s;
    s.setQuadric(q, DMat4(1));
    const float u = 0.37f, v = 0.61f, h = 1.0f / 256;
    Vec3 du, dv;
    float* const a[3] = {&du.x, &du.y, &du.z};
    float* const b[3] = {&dv.x, &dv.y, &dv.z};
    s.evaluate(1, &u, &v, nullptr, a, b);
    EXPECT_NEAR(glm::length(du - (s.point(u + h, v) - s.point(u - h, v)) / (2 * h)), 0,
                0.02 * glm::length(du));
    EXPECT_NEAR(glm::length(dv - (s.point(u, v + h) - s.point(u, v - h)) / (2 * h)), 0,
                0.02 * glm::length(dv));
  }
}

const float kBezier[16] = {-1, 3, -3, 1, 3, -6, 3, 0, -3, 3, 0, 0, 1, 0, 0, 0};
const float kBSpline[16] = {-1 / 6.f, 3 / 6.f, -3 / 6.f, 1 / 6.f, 3 / 6.f, -1,      3 / 6.f, 0,
                            -3 / 6.f, 0,       3 / 6.f,  0,       1 / 6.f, 4 / 6.f, 1 / 6.f, 0};
const float kCatmullRom[16] = {-0.5f, 1.5f, -1.5f, 0.5f, 1, -2.5f, 2, -0.5f, -0.5f, 0, 0.5f, 0, 0, 1, 0, 0};
const float kHermite[16] = {2, 1, -2, 1, -3, -2, 3, -1, 0, 1, 0, 0, 1, 0, 0, 0};
const float kPower[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

TEST(Quadrics, MoreThanAFullTurnIsOne) {
  const auto micropolygons = [](const std::string& quadric, size_t reports) {
    DiceScene s(diceWorld(diceCamera(5), quadric));
    EXPECT_EQ(s.reports.size(), reports) << quadric;
    s.forEachGrid([](NodeId, const GridRecord&) {});
    return s.cache->statistics().micropolygonsDiced;
  };
  EXPECT_EQ(micropolygons("Sphere 1 -1 1 1e9", 1), micropolygons("Sphere 1 -1 1 360", 0));
  EXPECT_EQ(micropolygons("Cylinder 1 -1 1 -1e9", 1), micropolygons("Cylinder 1 -1 1 -360", 0));
  EXPECT_EQ(micropolygons("Torus 1 .3 0 1e9 360", 1), micropolygons("Torus 1 .3 0 360 360", 0));
  EXPECT_EQ(micropolygons("Torus 1 .3 -180 180 360", 0), micropolygons("Torus 1 .3 180 -180 360", 0));
}

TEST(PatchBasis, EveryBasisGivesItsCurve) {
  const double g[4] = {0.3, -1.25, 2.5, 0.75};
  for (const float* basis : {kBezier, kBSpline, kCatmullRom, kHermite, kPower}) {
    const BezierConversion c = bezierConversion(basis);
    double b[4];
    for (int i = 0; i < 4; ++i) {
      b[i] = 0;
      for (int j = 0; j < 4; ++j) b[i] += c.m[i][j] * g[j] / c.denominator;
    }
    for (double t = 0; t <= 1; t += 0.1) {
      double direct = 0;
      const double power[4] = {t * t * t, t * t, t, 1};
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) direct += power[i] * double(basis[i * 4 + j]) * g[j];
      }
      const double s = 1 - t;
      const double bezier = s * s * s * b[0] + 3 * s * s * t * b[1] + 3 * s * t * t * b[2] + t * t * t * b[3];
      EXPECT_NEAR(direct, bezier, 1e-6);
    }
    double back[4];
    ASSERT_TRUE(geometryFromBezier(c, b, back));
    for (int i = 0; i < 4; ++i) EXPECT_NEAR(back[i], g[i], 1e-12);
  }
}

Vec3 patchPoint(DiceScene& s, NodeId node, float u, float v) {
  Vec3 p;
  SurfaceOut out;
  for (int c = 0; c < 3; ++c) out.P[c] = &p[c];
  s.cache->evaluateSurface(node, 1, nullptr, &u, &v, out);
  return p + Vec3(s.cache->skeleton().header().cacheOrigin);
}

TEST(PatchMesh, CountsAndWraps) {
  const auto points = [](int n) {
    std::string p;
    for (int i = 0; i < n; ++i) p += fmt::format("{} {} {} ", i % 7, i / 7, (i * 5) % 3);
    return "\"P\" [" + p + "]\n";
  };
  const auto patches = [&](const std::string& basis, const std::string& mesh, int n) {
    DiceScene s(diceWorld(diceCamera(30), basis + "\nPatchMesh " + mesh + " " + points(n)));
    return s.cache ? s.cache->skeleton().rootPatches().size() : 0;
  };
  EXPECT_EQ(patches("", "\"bilinear\" 7 \"nonperiodic\" 3 \"nonperiodic\"", 21), 12u);
  EXPECT_EQ(patches("", "\"bilinear\" 7 \"periodic\" 3 \"nonperiodic\"", 21), 14u);
  EXPECT_EQ(patches("Basis \"bezier\" 3 \"bezier\" 3", "\"bicubic\" 7 \"nonperiodic\" 4 \"nonperiodic\"", 28),
            2u);
  EXPECT_EQ(patches("Basis \"bezier\" 3 \"bezier\" 3", "\"bicubic\" 6 \"periodic\" 4 \"nonperiodic\"", 24),
            2u);
  EXPECT_EQ(
      patches("Basis \"b-spline\" 1 \"b-spline\" 1", "\"bicubic\" 7 \"periodic\" 5 \"nonperiodic\"", 35),
      14u);
  EXPECT_EQ(
      patches("Basis \"b-spline\" 1 \"b-spline\" 1", "\"bicubic\" 7 \"nonperiodic\" 5 \"periodic\"", 35),
      20u);
}

TEST(PatchMesh, HeightFieldsLieOverTheUnitSquare) {
  for (const std::string& basis :
       {std::string("Basis \"bezier\" 3 \"bezier\" 3"), std::string("Basis \"b-spline\" 1 \"b-spline\" 1")}) {
    const int n = basis.find("bezier") != std::string::npos ? 7 : 5;
    std::string z;
    for (int i = 0; i < n * n; ++i) z += fmt::format("{} ", (i * 7) % 5);
    DiceScene s(diceWorld(diceCamera(30),
                          basis + fmt::format("\nPatchMesh \"bicubic\" {} \"nonperiodic\" {} \"nonperiodic\" "
                                              "\"Pz\" [{}]\n",
                                              n, n, z)));
    ASSERT_TRUE(s.cache);
    ASSERT_EQ(s.cache->skeleton().rootPatches().size(), 4u);
    const float u = 0.25f, v = 0.75f;
    float su, sv, ss, st;
    s.cache->evaluateParameters(3, 1, nullptr, &u, &v, &su, &sv, &ss, &st);
    EXPECT_FLOAT_EQ(su, (1 + u) / 2);
    EXPECT_FLOAT_EQ(sv, (1 + v) / 2);
    EXPECT_FLOAT_EQ(ss, su);
    const Vec3 p = patchPoint(s, 3, u, v);
    EXPECT_NEAR(p.x, su, 2e-6);
    EXPECT_NEAR(p.y, sv, 2e-6);
  }
}

TEST(Patch, RationalQuarterCircleIsRound) {
  // A quarter cylinder: quadratic arc of weights 1, sqrt(1/2), 1, raised to a cubic.
  const double w = std::sqrt(0.5);
  const double arc[4][3] = {{1, 0, 1},
                            {(1 + 2 * w) / 3, 2 * w / 3, (1 + 2 * w) / 3},
                            {2 * w / 3, (2 * w + 1) / 3, (2 * w + 1) / 3},
                            {0, 1, 1}};
  std::string p;
  for (int j = 0; j < 4; ++j) {
    for (const auto& a : arc) p += fmt::format("{} {} {} {} ", a[0], a[1], j * a[2], a[2]);
  }
  DiceScene s(
      diceWorld(diceCamera(30), "Basis \"bezier\" 3 \"bezier\" 3\nPatch \"bicubic\" \"Pw\" [" + p + "]\n"));
  for (float u = 0; u <= 1; u += 0.1f) {
    const Vec3 q = patchPoint(s, 0, u, 0.4f);
    EXPECT_NEAR(std::hypot(q.x, q.y), 1, 1e-5);
    EXPECT_NEAR(q.z, 1.2, 1e-5);
  }
}

TEST(Patch, TextureCoordinates) {
  DiceScene s(diceWorld(diceCamera(30),
                        "TextureCoordinates 0 0 2 0 0 3 2 3\nSphere 1 -1 1 360\n"
                        "Sphere 1 -1 1 360 \"varying float[2] st\" [5 5 6 5 5 7 6 7]\n"));
  const float u = 0.25f, v = 0.5f;
  float su, sv, ss, st;
  s.cache->evaluateParameters(0, 1, nullptr, &u, &v, &su, &sv, &ss, &st);
  EXPECT_FLOAT_EQ(ss, 0.5f);
  EXPECT_FLOAT_EQ(st, 1.5f);
  s.cache->evaluateParameters(1, 1, nullptr, &u, &v, &su, &sv, &ss, &st);
  EXPECT_FLOAT_EQ(ss, 5.25f);
  EXPECT_FLOAT_EQ(st, 6.0f);
}

TEST(Primitive, MissingOrWrongPositionsAreErrors) {
  DiceScene s(diceWorld(diceCamera(30),
                        "Patch \"bilinear\" \"P\" [0 0 0 1 1 1]\nSphere 1 -1 1 360\nPatch \"bicubic\"\n"));
  EXPECT_EQ(s.cache->skeleton().objects().size(), 1u);
  size_t errors = 0;
  for (const Error& e : s.reports)
    errors += e.code == RiError::kConsistency || e.code == RiError::kMissingData;
  EXPECT_EQ(errors, 2u);
}

}  // namespace
}  // namespace fr::cache
