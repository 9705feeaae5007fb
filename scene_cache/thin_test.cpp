// Points and Curves.
#include "scene_cache/thin.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <cstring>

#include "scene_cache/dice_scene.h"

namespace fr::cache {
namespace {

Vec3 vertex(const GridView& v, size_t i) {
  return Vec3(v.positions[i * 3], v.positions[i * 3 + 1], v.positions[i * 3 + 2]);
}
Vec3 triangleCross(const GridView& v, size_t t) {
  const Vec3 a = vertex(v, v.indices[t * 3]), b = vertex(v, v.indices[t * 3 + 1]),
             c = vertex(v, v.indices[t * 3 + 2]);
  return glm::cross(b - a, c - a);
}

TEST(Points, DisksFaceTheEyeWithTheirArea) {
  // From a third of a pixel to half the picture.
  DiceScene s(diceWorld(diceCamera(4),
                        "Points \"P\" [0 0 0 0.5 0.5 0 -0.5 0.3 0.2 0.2 -0.6 -0.1 0.7 -0.5 0] \"width\" "
                        "[0.003 0.02 0.1 0.5 2]\n"));
  ASSERT_TRUE(s.cache);
  EXPECT_TRUE(s.reports.empty());
  std::map<uint32_t, double> area;
  const Vec3 eye = Vec3(DVec3(0, 0, -4) - s.cache->skeleton().header().cacheOrigin);
  s.forEachGrid([&](NodeId id, const GridRecord& g) {
    ASSERT_TRUE(g.flags & kGridSprites);
    const GridView v = s.cache->view(g);
    EXPECT_EQ(v.vertexCount(), g.nu / g.rowStride);
    const auto* source = sourceRecord<PointsSource>(s.cache->skeleton(), s.cache->objectOf(id));
    ASSERT_TRUE(source);
    const auto clusters = sourceArray<PointCluster>(s.cache->skeleton(), source->clusters);
    const auto order = sourceArray<uint32_t>(s.cache->skeleton(), source->order);
    const PointCluster& c = clusters[s.cache->rootOf(id).face];
    for (uint32_t t = 0; t < g.nv; ++t) {
      const Vec3 n = triangleCross(v, t);
      area[order[c.first + t / (c.sides - 2)]] += 0.5 * double(glm::length(n));
      const Vec3 toEye = eye - vertex(v, v.indices[t * 3]);
      EXPECT_GT(std::abs(glm::dot(n, toEye)) / (glm::length(n) * glm::length(toEye)), 0.9f);
    }
  });
  const double widths[] = {0.003, 0.02, 0.1, 0.5, 2};
  ASSERT_EQ(area.size(), 5u);
  for (uint32_t i = 0; i < 5; ++i) {
    const double disk = 3.14159265 * widths[i] * widths[i] / 4;
    EXPECT_NEAR(area[i] / disk, 1, 2e-3) << i;
  }
}

TEST(Points, ScaleVariablesAndNormals) {
  DiceScene s(diceWorld(diceCamera(4),
                        "Scale 2 2 2 Points \"P\" [0 0 0 .5 0 0] \"constantwidth\" [0.1] \"varying float "
                        "a\" [3 4] \"uniform float b\" [7] \"uniform float c\" [8 9]\n"));
  ASSERT_TRUE(s.cache);
  int seen = 0;
  s.forEachGrid([&](NodeId id, const GridRecord& g) {
    const size_t n = s.cache->view(g).vertexCount();
    std::vector<uint32_t> cell(n);
    std::vector<float> u(n), v(n), a(n), b(n), c(n), P[3], N[3];
    for (auto& x : P) x.resize(n);
    for (auto& x : N) x.resize(n);
    s.cache->vertexParameters(g, cell.data(), u.data(), v.data());
    const auto get = [&](const char* name, std::vector<float>& to) {
      float* const out[1] = {to.data()};
      const ParamRecord* p = s.cache->skeleton().find(s.cache->objectOf(id).primvars, name);
      ASSERT_TRUE(p && s.cache->evaluatePrimvar(id, *p, n, cell.data(), u.data(), v.data(), out));
    };
    get("a", a), get("b", b), get("c", c);
    SurfaceOut out;
    for (size_t k = 0; k < 3; ++k) out.P[k] = P[k].data(), out.N[k] = N[k].data();
    s.cache->evaluateSurface(id, n, cell.data(), u.data(), v.data(), out);
    for (size_t i = 0; i < n; ++i, ++seen) {
      const double x = double(P[0][i]) + s.cache->skeleton().header().cacheOrigin.x;
      EXPECT_NEAR(x, a[i] == 3 ? 0 : 1, 1e-6);
      EXPECT_EQ(b[i], 7);
      EXPECT_EQ(c[i], a[i] + 5);
      EXPECT_LT(N[2][i], -0.9f);  // towards the eye
    }
    EXPECT_NEAR(g.bound.max.y - g.bound.min.y, 0.2f, 0.01f);
  });
  EXPECT_EQ(seen, 2);
}

TEST(Points, BadOnesAreReportedAndLeftOut) {
  DiceScene s(diceWorld(diceCamera(4),
                        "Points \"P\" [0 0 0 1e39 0 0 1 0 0] \"constantwidth\" [0.1]\n"
                        "Points \"P\" [1e39 0 0]\nPoints \"P\" [0 0 0] \"constantwidth\" [0]\n"));
  ASSERT_TRUE(s.cache);
  EXPECT_GE(s.reports.size(), 2u);  // and what the reader says of such numbers
  EXPECT_EQ(s.cache->skeleton().objects().size(), 1u);
  s.forEachGrid([&](NodeId, const GridRecord& g) {
    EXPECT_EQ(s.cache->view(g).vertexCount(), 2u);
    EXPECT_TRUE(isFinite(g.bound.min) && isFinite(g.bound.max));
  });
}

TEST(Points, FaceAnOrthographicCameraWhereverItLooks) {
  // It looks along the world's x axis.
  DiceScene s(diceWorld("Format 100 100 1\nProjection \"orthographic\"\nRotate 90 0 1 0\nTranslate 5 0 0\n",
                        "Points \"P\" [0 0 0] \"constantwidth\" [0.5]\n"));
  size_t seen = 0;
  s.forEachGrid([&](NodeId, const GridRecord& g) {
    ++seen;
    EXPECT_NEAR(g.bound.max.x - g.bound.min.x, 0, 1e-3);
    EXPECT_NEAR(g.bound.max.y - g.bound.min.y, 0.5, 0.02);
    EXPECT_NEAR(g.bound.max.z - g.bound.min.z, 0.5, 0.02);
  });
  EXPECT_EQ(seen, 1u);
}

/// Rows of a scene's only curve, in order: the two ends of each.
struct Rows {
  std::vector<std::pair<Vec3, Vec3>> rows;
};
Rows rowsOf(DiceScene& s) {
  Rows r;
  std::map<uint32_t, std::pair<Vec3, Vec3>> byRow;
  s.forEachGrid([&](NodeId id, const GridRecord& g) {
    const Skeleton& k = s.cache->skeleton();
    const auto* source = sourceRecord<CurvesSource>(k, s.cache->objectOf(id));
    ASSERT_TRUE(source);
    const auto clusters = sourceArray<CurveCluster>(k, source->clusters);
    const auto pieces = sourceArray<CurvePiece>(k, source->pieces);
    const CurveCluster& c = clusters[s.cache->rootOf(id).face];
    const GridView v = s.cache->view(g);
    for (const CurvePiece& p : pieces.subspan(c.firstPiece, c.pieceCount)) {
      for (uint32_t i = 0; i <= p.rows; ++i) {
        const size_t at = p.firstVertex + size_t(i) * (p.columns + 1u);
        auto [it, fresh] = byRow.try_emplace(p.firstRow + i, vertex(v, at), vertex(v, at + p.columns));
        if (p.columns != p.allColumns) {
          if (p.firstColumn == 0) it->second.first = vertex(v, at);
          if (p.firstColumn + p.columns == p.allColumns) it->second.second = vertex(v, at + p.columns);
        } else if (!fresh) {
          // Pieces share rows bit by bit.
          EXPECT_EQ(it->second.first, vertex(v, at));
          EXPECT_EQ(it->second.second, vertex(v, at + p.columns));
        }
      }
    }
  });
  for (const auto& [row, ends] : byRow) r.rows.push_back(ends);
  return r;
}

// Every second row away, chords err four times as much, and the row between them lies on the curve: a quarter
// of that is the distance of the ribbon's own chords.
TEST(Curves, FlatnessBoundsTheDistanceOfChords) {
  const auto deviation = [](double flatness) {
    DiceScene s(
        diceWorld("Format 240 240 1\nProjection \"orthographic\"\nScreenWindow -1.2 1.2 -1.2 1.2\n"
                  "Translate 0 0 5\n",
                  (flatness > 0 ? fmt::format("GeometricApproximation \"flatness\" {}\n", flatness) : "") +
                      "Curves \"cubic\" [4] \"nonperiodic\" \"P\" [1 0 0 1 0.5 0 0.5 1 0 0 1 0] "
                      "\"constantwidth\" 0.004\n"));
    const Rows r = rowsOf(s);
    const auto middle = [&](size_t k) { return 0.5 * (DVec3(r.rows[k].first) + DVec3(r.rows[k].second)); };
    double pixels = 0;
    for (size_t i = 1; i + 1 < r.rows.size(); ++i)
      pixels = std::max(pixels, 100 * glm::length(middle(i) - 0.5 * (middle(i - 1) + middle(i + 1))) / 4);
    return pixels;
  };
  EXPECT_GT(deviation(0), 0.04);
  // Floats of cache space leave 1e-5 pixels.
  for (const double flatness : {0.04, 0.01}) {
    EXPECT_LE(deviation(flatness), flatness + 1e-4);
    EXPECT_GE(deviation(flatness), flatness / 4);
  }
}

TEST(Curves, RibbonsHaveTheirWidthAndFollowTheCurve) {
  for (const double width : {0.001, 0.02, 0.7}) {
    DiceScene s(diceWorld(diceCamera(4),
                          fmt::format("Curves \"cubic\" [4] \"nonperiodic\" \"P\" [-1 0 0 -0.5 1 0 0.5 -1 "
                                      "0.3 1 0 0] \"constantwidth\" [{}]\n",
                                      width)));
    ASSERT_TRUE(s.cache);
    EXPECT_TRUE(s.reports.empty());
    const Rows r = rowsOf(s);
    ASSERT_GT(r.rows.size(), 4u);
    const DVec3 origin = s.cache->skeleton().header().cacheOrigin;
    for (size_t i = 0; i < r.rows.size(); ++i) {
      const auto& [a, b] = r.rows[i];
      EXPECT_NEAR(double(glm::length(b - a)) / width, 1, 1e-3);
      const double t = double(i) / double(r.rows.size() - 1), q = 1 - t;
      const DVec3 p = DVec3(-1, 0, 0) * q * q * q + DVec3(-0.5, 1, 0) * 3.0 * q * q * t +
                      DVec3(0.5, -1, 0.3) * 3.0 * q * t * t + DVec3(1, 0, 0) * t * t * t;
      const DVec3 middle = (DVec3(a) + DVec3(b)) * 0.5 + origin;
      EXPECT_LT(glm::length(p - middle), 1e-5) << i;
      // Facing the eye: the ribbon lies across the line of sight.
      const DVec3 sight = glm::normalize(middle - DVec3(0, 0, -4)),
                  side = glm::normalize(DVec3(b) - DVec3(a));
      EXPECT_LT(std::abs(glm::dot(sight, side)), 1e-3);
    }
  }
}

TEST(Curves, PeriodicOnesClose) {
  for (const char* curve :
       {"Basis \"b-spline\" 1 \"b-spline\" 1 Curves \"cubic\" [5]",
        "Basis \"catmull-rom\" 1 \"catmull-rom\" 1 Curves \"cubic\" [5]",
        "Basis \"bezier\" 3 \"bezier\" 3 Curves \"cubic\" [6]", "Curves \"linear\" [5]"}) {
    std::string p;
    for (int i = 0; i < (std::strstr(curve, "[6]") ? 6 : 5); ++i)
      p += fmt::format("{:.5f} {:.5f} 0.1 ", std::cos(i * 1.2), std::sin(i * 1.1));
    DiceScene s(diceWorld(diceCamera(4),
                          fmt::format("{} \"periodic\" \"P\" [{}] \"constantwidth\" [0.03]\n", curve, p)));
    ASSERT_TRUE(s.cache);
    const Rows r = rowsOf(s);
    ASSERT_GT(r.rows.size(), 4u) << curve;
    EXPECT_EQ(r.rows.front(), r.rows.back()) << curve;
  }
}

TEST(Curves, RibbonsWithNormalsStandOnThem) {
  DiceScene s(diceWorld(diceCamera(4),
                        "Curves \"linear\" [3] \"nonperiodic\" \"P\" [-1 0 0 0 0 0 1 0 0] \"constantwidth\" "
                        "[0.2] \"varying normal N\" [0 1 0 0 1 0 0 0 -1]\n"));
  ASSERT_TRUE(s.cache);
  const Rows r = rowsOf(s);
  const Vec3 first = glm::normalize(r.rows.front().second - r.rows.front().first);
  const Vec3 last = glm::normalize(r.rows.back().second - r.rows.back().first);
  EXPECT_NEAR(std::abs(first.z), 1, 1e-5);  // seen from its edge
  EXPECT_NEAR(std::abs(last.y), 1, 1e-5);
}

TEST(Curves, ParametersAndVariables) {
  DiceScene s(diceWorld(diceCamera(4),
                        "Curves \"linear\" [3 2] \"nonperiodic\" \"P\" [-1 0 0 0 0 0 1 0 0 -1 1 0 1 1 0] "
                        "\"constantwidth\" [0.1] \"uniform float a\" [5 6] \"varying float b\" [0 1 2 3 4] "
                        "\"vertex float c\" [-1 0 1 -1 1]\n"));
  ASSERT_TRUE(s.cache);
  int seen = 0;
  const DVec3 origin = s.cache->skeleton().header().cacheOrigin;
  s.forEachGrid([&](NodeId id, const GridRecord& g) {
    const GridView view = s.cache->view(g);
    const size_t n = view.vertexCount();
    std::vector<uint32_t> cell(n);
    std::vector<float> u(n), v(n), a(n), b(n), c(n), U(n), V(n), S(n), T(n);
    std::vector<float> P[3], dv[3], N[3];
    SurfaceOut out;
    for (size_t k = 0; k < 3; ++k) {
      P[k].resize(n), dv[k].resize(n), N[k].resize(n);
      out.P[k] = P[k].data(), out.dPdv[k] = dv[k].data(), out.N[k] = N[k].data();
    }
    s.cache->vertexParameters(g, cell.data(), u.data(), v.data());
    s.cache->evaluateParameters(id, n, cell.data(), u.data(), v.data(), U.data(), V.data(), S.data(),
                                T.data());
    s.cache->evaluateSurface(id, n, cell.data(), u.data(), v.data(), out);
    for (auto& [name, to] : {std::pair{"a", &a}, {"b", &b}, {"c", &c}}) {
      float* const o[1] = {to->data()};
      const ParamRecord* p = s.cache->skeleton().find(s.cache->objectOf(id).primvars, name);
      ASSERT_TRUE(p && s.cache->evaluatePrimvar(id, *p, n, cell.data(), u.data(), v.data(), o));
    }
    for (size_t i = 0; i < n; ++i, ++seen) {
      const double x = double(view.positions[i * 3]) + origin.x,
                   y = double(view.positions[i * 3 + 1]) + origin.y;
      const bool second = y > 0.5;
      EXPECT_NEAR(V[i], (x + 1) / 2, 1e-5);
      EXPECT_NEAR(std::abs(double(U[i]) - 0.5), std::abs(y - std::round(y)) / 0.1,
                  0.03);  // a ribbon off the axis is turned
      EXPECT_NEAR(P[0][i], view.positions[i * 3], 1e-5);
      EXPECT_NEAR(P[1][i], view.positions[i * 3 + 1], 1e-5);
      EXPECT_EQ(a[i], second ? 6 : 5);
      EXPECT_NEAR(b[i], second ? 3 + (x + 1) / 2 : x + 1, 1e-5);
      EXPECT_NEAR(c[i], x, 1e-5);
      EXPECT_NEAR(dv[0][i], 2, 1e-4);  // the whole length for v from 0 to 1
      EXPECT_LT(N[2][i], -0.8f);
    }
  });
  EXPECT_GT(seen, 8);
}

RC_GTEST_PROP(Curves, NothingBreaksThem, ()) {
  const int n = *rc::gen::inRange(4, 9);
  std::string p, w;
  for (int i = 0; i < n; ++i) {
    for (int c = 0; c < 3; ++c)
      p += fmt::format("{} ", *rc::gen::element(0.0, 1.0, -1.0, 1e-30, 1e20, -4.0, 0.5, 1e39, 1e-3));
  }
  for (int i = 0; i < n - 2; ++i)
    w += fmt::format("{} ", *rc::gen::element(0.0, 0.1, -0.1, 1e10, 1e39, 1e-20));
  DiceScene s(
      diceWorld(diceCamera(4, 1, 32), fmt::format("Basis \"b-spline\" 1 \"b-spline\" 1 Curves \"cubic\" [{}] "
                                                  "\"nonperiodic\" \"P\" [{}] \"width\" [{}]\n",
                                                  n, p, w)));
  RC_ASSERT(s.cache);
  int grids = 0;
  s.forEachGrid([&](NodeId, const GridRecord& g) {
    // The first grids are as good as all: a curve through the eye has many.
    if (++grids > 50) return;
    const GridView v = s.cache->view(g);
    for (size_t i = 0; i < size_t(g.nv) * 3; ++i) RC_ASSERT(v.indices[i] < g.nu);
  });
}

}  // namespace
}  // namespace fr::cache
