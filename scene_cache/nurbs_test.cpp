#include "scene_cache/nurbs.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <cmath>
#include <set>

#include "ri/renderer.h"
#include "scene_cache/edge_count.h"
#include "scene_cache/surface.h"
#include "scene_cache/trim.h"

namespace fr::cache {
namespace {

/// Cox and de Boor's recursion, as it stands in every textbook.
double basis(const std::vector<float>& t, size_t i, int order, double x) {
  if (order == 1) return double(t[i]) <= x && x < double(t[i + 1]) ? 1 : 0;
  const size_t k = size_t(order) - 1;
  double r = 0;
  if (t[i + k] > t[i])
    r += (x - double(t[i])) / (double(t[i + k]) - double(t[i])) * basis(t, i, order - 1, x);
  if (t[i + k + 1] > t[i + 1])
    r += (double(t[i + k + 1]) - x) / (double(t[i + k + 1]) - double(t[i + 1])) *
         basis(t, i + 1, order - 1, x);
  return r;
}

RC_GTEST_PROP(Nurbs, PiecesAreTheSpline, ()) {
  const int order = *rc::gen::inRange(2, 9);
  const int count = order + *rc::gen::inRange(0, 6);
  std::vector<float> knots{0};
  // Steps of 0 make multiple knots.
  while (knots.size() < size_t(count + order))
    knots.push_back(knots.back() + float(*rc::gen::inRange(0, 4)) * 0.5f);
  const float low = knots[size_t(order) - 1], high = knots[size_t(count)];
  if (!(high > low)) return;
  const float min = low + (high - low) * float(*rc::gen::inRange(0, 3)) / 8, max = high;
  std::vector<double> values;
  for (int i = 0; i < count; ++i) values.push_back(*rc::gen::inRange(-100, 100) * 0.1);
  const auto spans = nurbsSpans(knots, order, min, max);
  RC_ASSERT(!spans.empty());
  const auto pieces = bezierPieces(knots, order, spans, values.data(), 1, 1);
  const size_t out = size_t(std::max(order, 4));
  RC_ASSERT(pieces.size() == spans.size() * out);
  for (size_t s = 0; s < spans.size(); ++s) {
    for (const double t : {0.0, 0.125, 0.5, 0.9}) {
      const double x = spans[s].low + (spans[s].high - spans[s].low) * t;
      double expected = 0, got = 0;
      for (int i = 0; i < count; ++i) expected += basis(knots, size_t(i), order, x) * values[size_t(i)];
      bezierPiecePoint(pieces.data() + s * out, int(out), 1, t, &got);
      RC_ASSERT(std::abs(expected - got) < 1e-9);
    }
    const auto multiplicity = std::count(knots.begin(), knots.end(), float(spans[s].low));
    if (s > 0 && multiplicity < order) RC_ASSERT(pieces[s * out] == pieces[s * out - 1]);
  }
  RC_ASSERT(spans.back().unitHigh == 1.0f);
}

/// A unit sphere of rational biquadratics (Piegl and Tiller, "The NURBS Book", 7.5), z up.
std::string nurbsSphere() {
  const double q = std::sqrt(0.5);
  const double ring[9][3] = {{1, 0, 1},   {1, 1, q},  {0, 1, 1},  {-1, 1, q}, {-1, 0, 1},
                             {-1, -1, q}, {0, -1, 1}, {1, -1, q}, {1, 0, 1}};
  const double arc[5][3] = {{0, -1, 1}, {1, -1, q}, {1, 0, 1}, {1, 1, q}, {0, 1, 1}};
  std::string p;
  for (const auto& a : arc) {
    for (const auto& r : ring) {
      const double w = a[2] * r[2];
      p += fmt::format("{:.9g} {:.9g} {:.9g} {:.9g} ", a[0] * r[0] * w, a[0] * r[1] * w, a[1] * w, w);
    }
  }
  return "NuPatch 9 3 [0 0 0 .25 .25 .5 .5 .75 .75 1 1 1] 0 1 5 3 [0 0 0 .5 .5 1 1 1] 0 1 \"Pw\" [" + p +
         "]\n";
}

TEST(Nurbs, RationalSphereIsRoundAndClosed) {
  DiceScene s(diceWorld(diceCamera(4), "Rotate 40 1 1 0\n" + nurbsSphere()));
  ASSERT_TRUE(s.cache);
  EXPECT_EQ(s.cache->skeleton().rootPatches().size(), 8u);
  const Vec3 origin(s.cache->skeleton().header().cacheOrigin);
  s.forEachGrid([&](NodeId, const GridRecord& g) {
    const GridView v = s.cache->view(g);
    const size_t n = v.vertexCount();
    std::vector<uint32_t> cell(n);
    std::vector<float> u(n), w(n), N[3];
    for (auto& c : N) c.resize(n);
    s.cache->vertexParameters(g, cell.data(), u.data(), w.data());
    SurfaceOut out;
    for (size_t c = 0; c < 3; ++c) out.Ng[c] = N[c].data();
    s.cache->evaluateSurface(g.node, n, cell.data(), u.data(), w.data(), out);
    for (size_t i = 0; i < n; ++i) {
      const size_t at = i / (g.nu + 1u) * g.rowStride + i % (g.nu + 1u);
      const Vec3 p = Vec3(v.positions[at * 3], v.positions[at * 3 + 1], v.positions[at * 3 + 2]) + origin;
      EXPECT_NEAR(glm::length(p), 1, 2e-6);
      EXPECT_NEAR(std::abs(glm::dot(p, Vec3(N[0][i], N[1][i], N[2][i]))), 1, 5e-3);
    }
    EXPECT_LT(g.deviation[0], 0.01f);
  });
  expectWatertight("sphere", "Rotate 40 1 1 0\n" + nurbsSphere(), {3, 1.5, 40});
}

/// A bumpy net: n x n, around z = 0.
std::string net(int nu, int nv) {
  std::string p;
  for (int j = 0; j < nv; ++j) {
    for (int i = 0; i < nu; ++i)
      p += fmt::format("{:.6f} {:.6f} {:.6f} ", 2.0 * i / (nu - 1) - 1, 2.0 * j / (nv - 1) - 1,
                       std::sin(i * 2.1 + j * 1.3));
  }
  return "\"P\" [" + p + "]";
}

TEST(Nurbs, SpansOfEveryOrderMeetWithoutGaps) {
  for (const int order : {2, 3, 4, 5, 7}) {
    // Ascending knots of uneven steps.
    std::string ascending;
    double at = 0;
    double min = 0, max = 0;
    for (int i = 0; i < 9 + order; ++i) {
      if (i == order - 1) min = at;
      if (i == 9) max = at;
      ascending += fmt::format("{} ", at);
      at += 1 + i % 3;
    }
    const std::string body = fmt::format("NuPatch 9 {0} [{1}] {2} {3} 9 {0} [{1}] {2} {3} {4}\n", order,
                                         ascending, min, max, net(9, 9));
    for (const double d : {2.0, 8.0}) {
      DiceScene s(diceWorld(diceCamera(d, 1, 64), "Rotate 30 1 0 0\n" + body));
      ASSERT_TRUE(s.cache) << order;
      const size_t spans = size_t(9 - order + 1);
      EXPECT_EQ(s.cache->skeleton().rootPatches().size(), spans * spans);
      // Only the outer border is open: a sheet of V - E + F = 1.
      const EdgeCount c = countEdges(s);
      std::set<std::array<float, 3>> places;
      s.forEachGrid([&](NodeId, const GridRecord& g) {
        const GridView v = s.cache->view(g);
        for (int j = 0; j <= g.nv; ++j) {
          for (int i = 0; i <= g.nu; ++i) {
            const float* p = v.positions + (size_t(j) * g.rowStride + size_t(i)) * 3;
            places.insert({p[0] + 0.0f, p[1] + 0.0f, p[2] + 0.0f});
          }
        }
      });
      EXPECT_EQ(int64_t(places.size()) - int64_t(c.edges) + int64_t(c.faces), 1) << order << " at " << d;
    }
  }
}

float valueAt(DiceScene& s, NodeId node, const char* name, float u, float v, size_t component = 0) {
  const ObjectRecord& o = s.cache->objectOf(node);
  const ParamRecord* p = s.cache->skeleton().find(o.primvars, name);
  EXPECT_NE(p, nullptr);
  float values[4] = {};
  float* const out[4] = {values, values + 1, values + 2, values + 3};
  uint32_t cell = 0;
  EXPECT_TRUE(s.cache->evaluatePrimvar(node, *p, 1, &cell, &u, &v, out));
  return values[component];
}

TEST(Nurbs, VariablesOfEveryClass) {
  // Knots with an empty interval: segments 0 [0,1], 1 (empty), 2 [1,3].
  DiceScene s(diceWorld(
      diceCamera(4),
      "NuPatch 6 4 [0 0 0 0 1 1 3 3 3 3] 0 3 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 2 0 0 3 0 0 4 0 0 "
      "5 0 0 0 1 0 1 1 0 2 1 0 3 1 0 4 1 0 5 1 0] \"uniform float a\" [5 6 7] \"varying float b\" "
      "[0 1 2 3 10 11 12 13] \"vertex float c\" [0 1 2 3 4 5 0 1 2 3 4 5]\n"));
  ASSERT_TRUE(s.cache);
  ASSERT_EQ(s.cache->skeleton().rootPatches().size(), 2u);
  EXPECT_EQ(valueAt(s, 0, "a", 0.5f, 0.5f), 5);
  EXPECT_EQ(valueAt(s, 1, "a", 0.5f, 0.5f), 7);
  EXPECT_FLOAT_EQ(valueAt(s, 0, "b", 0.5f, 0), 0.5f);
  EXPECT_FLOAT_EQ(valueAt(s, 1, "b", 0.25f, 1), 12.25f);
  for (const NodeId node : {0u, 1u}) {
    for (const float u : {0.0f, 0.3f, 1.0f}) {
      // Positions and vertex variables go the same way: c is x.
      Vec3 p;
      SurfaceOut out;
      for (int c = 0; c < 3; ++c) out.P[c] = &p[c];
      const float v = 0.5f;
      s.cache->evaluateSurface(node, 1, nullptr, &u, &v, out);
      const double x = double(p.x) + s.cache->skeleton().header().cacheOrigin.x;
      EXPECT_NEAR(double(valueAt(s, node, "c", u, v)), x, 1e-5);
      float shaderU, shaderV, st[2];
      s.cache->evaluateParameters(node, 1, nullptr, &u, &v, &shaderU, &shaderV, st, st + 1);
      EXPECT_NEAR(shaderU, node == 0 ? u / 3 : (1 + 2 * u) / 3, 1e-6);
      EXPECT_EQ(st[0], shaderU);
      EXPECT_EQ(st[1], 0.5f);
    }
  }
}

TEST(Nurbs, BadDataIsReported) {
  const std::string flat = "\"P\" [0 0 0 1 0 0 0 1 0 1 1 0]";
  const std::pair<std::string, const char*> bad[] = {
      {"NuPatch 2 1 [0 1 2] 0 1 2 2 [0 0 1 1] 0 1 " + flat, "order 1"},
      {"NuPatch 2 2 [1 1 1 1] 1 1 2 2 [0 0 1 1] 0 1 " + flat, "not below"},
      {"NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 0 nan 0 1 1 0]", ""},
      {"NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 0 0 0 1e39 0 1 1 0]", "not finite"},
      {"NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"Pw\" [0 0 0 1 1 0 0 0 0 1 0 1 1 1 0 1]", "weight 0"},
      {"NuPatch 2 2 [0 0 1] 0 1 2 2 [0 0 1 1] 0 1 " + flat, "knot"},
      {"NuPatch 2 2 [0 0 1 1] -1 1 2 2 [0 0 1 1] 0 1 " + flat, "range"},
  };
  for (const auto& [body, message] : bad) {
    DiceScene s(diceWorld(diceCamera(4), body + "\n"));
    ASSERT_TRUE(s.cache) << body;
    EXPECT_EQ(s.cache->skeleton().rootPatches().size(), 0u) << body;
    ASSERT_FALSE(s.reports.empty()) << body;
    EXPECT_NE(s.reports[0].str().find(message), std::string::npos) << s.reports[0].str();
  }
}

/// A circle in the middle of the unit square: nine rational quadratic points.
std::string circle(double r) {
  const double q = std::sqrt(0.5);
  const double ring[9][3] = {{1, 0, 1},   {1, 1, q},  {0, 1, 1},  {-1, 1, q}, {-1, 0, 1},
                             {-1, -1, q}, {0, -1, 1}, {1, -1, q}, {1, 0, 1}};
  std::string u, v, w;
  for (const auto& p : ring) {
    u += fmt::format("{:.9g} ", (0.5 + r * p[0]) * p[2]),
        v += fmt::format("{:.9g} ", (0.5 + r * p[1]) * p[2]);
    w += fmt::format("{:.9g} ", p[2]);
  }
  return "TrimCurve [1] [3] [0 0 0 .25 .25 .5 .5 .75 .75 1 1 1] [0] [1] [9] [" + u + "] [" + v + "] [" + w +
         "]\n";
}
const std::string kSquare =
    "NuPatch 2 2 [0 0 1 1] 0 1 2 2 [0 0 1 1] 0 1 \"P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]\n";

TEST(Trim, CircleRemovesItsArea) {
  for (const bool outside : {false, true}) {
    DiceScene s(diceWorld(diceCamera(4), (outside ? "Attribute \"trimcurve\" \"sense\" \"outside\"\n" : "") +
                                             circle(0.4) + kSquare));
    ASSERT_TRUE(s.cache);
    EXPECT_TRUE(s.reports.empty());
    const PatchTrim trim = s.cache->trimOf(0);
    ASSERT_TRUE(trim.any());
    constexpr int kSide = 1000;
    int removed = 0;
    for (int j = 0; j < kSide; ++j) {
      for (int i = 0; i < kSide; ++i) {
        const float u = (float(i) + 0.5f) / kSide, v = (float(j) + 0.5f) / kSide;
        const bool cut = trim.removed(u, v);
        removed += cut;
        const double r = std::hypot(double(u) - 0.5, double(v) - 0.5);
        if (std::abs(r - 0.4) > 2e-5) {
          EXPECT_EQ(cut, (r < 0.4) != outside);
        }
      }
    }
    const double area = outside ? 1 - 0.16 * 3.14159265 : 0.16 * 3.14159265;
    EXPECT_NEAR(removed * 1e-6, area, 2e-4);
    // Grids are cut where the circle goes, whole or absent elsewhere.
    int cut = 0, absent = 0, whole = 0;
    s.forEachGrid([&](NodeId id, const GridRecord& g) {
      const PatchNode& n = s.cache->node(id);
      const double u = (n.iu + 0.5) * std::ldexp(1.0, -n.du), v = (n.iv + 0.5) * std::ldexp(1.0, -n.dv);
      ++(g.flags & kGridTrimmed ? cut : g.flags & kGridAbsent ? absent : whole);
      if (!(g.flags & kGridTrimmed)) {
        EXPECT_EQ((g.flags & kGridAbsent) != 0, trim.removed(float(u), float(v)));
      }
    });
    EXPECT_GT(cut, 0);
    EXPECT_GT(absent, 0);
    EXPECT_GT(whole, 0);
  }
}

RC_GTEST_PROP(Trim, RectanglesSayWhatTheirPointsSay, ()) {
  ri::TrimCurve t;
  const int loops = *rc::gen::inRange(1, 4);
  const auto coordinate = [] { return float(*rc::gen::inRange(0, 1000)) * 1e-3f; };
  for (int k = 0; k < loops; ++k) {
    const int n = *rc::gen::inRange(4, 8), order = *rc::gen::inRange(2, 5);
    t.ncurves.push_back(1), t.order.push_back(order), t.n.push_back(n);
    for (int i = 0; i < n + order; ++i) t.knot.push_back(float(i));
    t.min.push_back(float(order - 1)), t.max.push_back(float(n));
    for (int i = 0; i < n; ++i) t.u.push_back(coordinate()), t.v.push_back(coordinate()), t.w.push_back(1);
  }
  const TrimLoops loopsFlat = flattenTrimCurves(t, 1);
  const TrimTest test(loopsFlat.edges, loopsFlat.bands, loopsFlat.low, loopsFlat.high,
                      *rc::gen::arbitrary<bool>());
  const double u0 = double(coordinate()), v0 = double(coordinate());
  const double size = 0.001 * *rc::gen::inRange(1, 200);
  const auto all = test.removed(u0, u0 + size, v0, v0 + size);
  if (!all) return;
  for (int i = 0; i < 10; ++i) {
    for (int j = 0; j < 10; ++j)
      RC_ASSERT(test.removed(u0 + size * (i + 0.5) / 10, v0 + size * (j + 0.5) / 10) == *all);
  }
}

TEST(Trim, BadLoopsAreReportedAndLeftOut) {
  // Ascending knots fail; an open loop is closed; a weight of 0 makes a loop useless.
  for (const auto& [trim, message] : std::initializer_list<std::pair<const char*, const char*>>{
           {"TrimCurve [1] [2] [0 0 2 1 3] [0] [1] [3] [0 1 1] [0 0 1] [1 1 1]\n", "decrease"},
           {"TrimCurve [1] [2] [0 0 1 2 2] [0] [2] [3] [0 .5 .5] [0 0 .5] [1 1 1]\n", "open"},
           {"TrimCurve [1] [2] [0 0 1 2 2] [0] [2] [3] [0 1 1] [0 0 1] [1 0 1]\n", "weight"},
           {"TrimCurve [1] [2] [0 0 1 2 2] [5] [6] [3] [0 1 1] [0 0 1] [1 1 1]\n", "empty"}}) {
    DiceScene s(diceWorld(diceCamera(4), trim + kSquare));
    ASSERT_TRUE(s.cache) << trim;
    EXPECT_EQ(s.cache->skeleton().rootPatches().size(), 1u);
    ASSERT_EQ(s.reports.size(), 1u) << trim;
    EXPECT_NE(s.reports[0].str().find(message), std::string::npos) << s.reports[0].str();
  }
}

}  // namespace
}  // namespace fr::cache
