// What ray calls say about their rays, and what becomes of the answers; area lights over analytic geometry;
// brackets on triples; strings. Without a scene.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "shading/machine_fixture.h"

namespace fr {
namespace {

std::shared_ptr<const ShaderInstance> surface(MachineFixture& f, const std::string& body) {
  auto s = f.shader("surface t() { " + body + " }");
  EXPECT_TRUE(s) << f.error;
  return s;
}

TEST(RayCalls, TermsTravelWithTheRays) {
  MachineFixture f;
  RayTerms seen{};
  f.oracle = [&](PendingRays& r) { seen = r.terms; };
  const auto s =
      surface(f,
              "Ci = trace(P, N, \"bias\", 0.25, \"maxdist\", 7, \"label\", \"mine\", \"subset\", \"a,b\","
              " \"excludesubset\", \"c\", \"hitsides\", \"front\", \"hitmode\", \"primitive\");");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.suspensions, 1);
  EXPECT_EQ(seen.rayClass, RayClass::kSpecular);
  EXPECT_EQ(seen.flags, RayTerms::kHasBias | RayTerms::kFrontOnly);
  EXPECT_EQ(seen.bias, 0.25f);
  EXPECT_EQ(seen.maxDistance, 7.0f);
  EXPECT_EQ(seen.hitMode, HitMode::kPrimitive);
  EXPECT_STREQ(seen.label, "mine");
  EXPECT_STREQ(seen.subset, "a,b");
  EXPECT_STREQ(seen.excludeSubset, "c");
  EXPECT_EQ(seen.diffuseDepth, 0u);
  const auto plain = surface(f, "Ci = trace(P, N);");
  ASSERT_TRUE(plain);
  f.run(*plain);
  const RayTerms nothing{};
  EXPECT_EQ(std::memcmp(&seen, &nothing, sizeof seen), 0);
}

TEST(RayCalls, RaysOfTheBorderStartInsideTheSurface) {
  MachineFixture f;  // cells of 1/7 by 1/4
  DerivativeStencil stencil;
  gridStencil(stencil, 7, 4, f.batch.lanes, 1 / 7.0f, 1 / 4.0f);
  f.batch.stencil = &stencil;
  int asked = 0;
  f.oracle = [&](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k, ++asked) {
      const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
      EXPECT_GT(r.origin[0][k], 0) << k;
      EXPECT_LT(r.origin[0][k], 1) << k;
      EXPECT_GT(r.origin[1][k], 0) << k;
      EXPECT_LT(r.origin[1][k], 1) << k;
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(r.origin[c][k], P.at(r.lane[k], uint32_t(c)), 3e-4) << k;
      if (r.kind != RayKind::kVisibility) continue;
      EXPECT_NEAR(r.origin[0][k] + r.direction[0][k], 3, 1e-6);
      EXPECT_NEAR(r.origin[1][k] + r.direction[1][k], 4, 1e-6);
    }
  };
  const auto s = surface(f, "Ci = trace(P, N) + transmission(P, point (3, 4, 9)) + occlusion(P, N, 2);");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(asked, int(4 * f.count));
}

TEST(RayCalls, OthresholdSaysWhereRaysEnd) {
  MachineFixture f;
  RayTerms seen{};
  f.oracle = [&](PendingRays& r) { seen = r.terms; };
  const auto s = surface(f, "Ci = trace(P, N, \"othreshold\", color(0.25, 0.5, 1));");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(seen.flags, RayTerms::kHasOpaque);
  EXPECT_EQ(seen.opaque[0], 0.25f);
  EXPECT_EQ(seen.opaque[2], 1.0f);
  const auto scalar =
      surface(f, "color c = 0; gather(\"\", P, N, 0, 1, \"othreshold\", .5, \"surface:Ci\", c) {}");
  ASSERT_TRUE(scalar);
  f.run(*scalar);
  EXPECT_EQ(seen.opaque[1], 0.5f);
}

/// Everything stands at distance 2.
void atTwo(PendingRays& r) {
  for (uint32_t k = 0; k < r.count; ++k) {
    const bool seen = r.terms.maxDistance == 0 || r.terms.maxDistance > 2;
    r.hitDistance[k] = seen ? 2.0f : kNoHit;
    for (int c = 0; c < 3; ++c) r.color[c][k] = seen ? 1.0f : 0.0f;
  }
}

TEST(RayCalls, TermsMayDifferFromPointToPoint) {
  MachineFixture f;  // u in steps of 1/7
  f.oracle = atTwo;
  const auto each = [&](const std::string& body, const std::function<double(double)>& want, double tolerance,
                        int suspensions) {
    const auto s = surface(f, body);
    ASSERT_TRUE(s) << f.error;
    f.run(*s);
    EXPECT_EQ(f.suspensions, suspensions) << body;
    for (uint32_t i = 0; i < f.count; ++i)
      EXPECT_NEAR(f.Ci(i), want(double(f.batch.globals[size_t(GlobalId::k_u)].at(i))), tolerance)
          << body << " at " << i;
  };
  const auto near = [](double u) { return u * 4 > 2 ? 1 : 0; };
  // One block for each distance.
  each("Ci = trace(P, N, \"maxdist\", u * 4);", near, 0, 8);
  each("float d = trace(P, N, \"maxdist\", u * 4); Ci = d < 1e10 ? 1 : 0;", near, 0, 8);
  each(
      "Ci = trace(P, N, \"maxdist\", u > 0.5 ? 5 : 1);", [](double u) { return u > 0.5 ? 1 : 0; }, 0, 2);
  each(
      "Ci = trace(P, N, \"maxdist\", 5);", [](double) { return 1; }, 0, 1);
  each("Ci = occlusion(P, N, 3, \"maxdist\", u * 4);", near, 1e-6, 8);
  each(
      "Ci = occlusion(P, N, 4, \"falloff\", u);", [](double u) { return std::exp(-2 * u); }, 1e-6, 1);
  // As many samples as each point wants, its own cone.
  f.oracle = [](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k)
      for (int c = 0; c < 3; ++c) r.color[c][k] = -r.direction[2][k];
  };
  each(
      "Ci = trace(P, N, \"samples\", 64, \"samplecone\", u);",
      [](double u) { return 0.5 * (1 + std::cos(u)); }, 2e-3, 3);
  each(
      "Ci = trace(P, N, \"samples\", 1 + u * 7, \"samplecone\", 0.01);", [](double) { return 1; }, 1e-4, 1);
  uint32_t rays = 0;
  f.oracle = [&](PendingRays& r) { rays += r.count; };
  each(
      "Ci = trace(P, N, \"samples\", 1 + u * 7, \"samplecone\", 0.01);", [](double) { return 0; }, 0, 1);
  EXPECT_EQ(rays, 5u * (1 + 2 + 3 + 4 + 5 + 6 + 7 + 8));
}

TEST(RayCalls, GatherMayDifferFromPointToPoint) {
  MachineFixture f;
  f.oracle = atTwo;
  const auto s = surface(
      f,
      "float hits = 0, misses = 0, wide = 0; vector d = 0;\n"
      "gather(\"illuminance\", P, N, u * 1.5, 1 + 7 * u, \"maxdist\", v > 0.5 ? 3 : 1, \"ray:direction\", d)"
      " { hits += 1; wide = max(wide, acos(d . N)); } else { misses += 1; wide = max(wide, acos(d . N)); }"
      " Ci = color(hits, misses, wide);");
  ASSERT_TRUE(s);
  f.run(*s);
  for (uint32_t i = 0; i < f.count; ++i) {
    const float u = f.batch.globals[size_t(GlobalId::k_u)].at(i),
                v = f.batch.globals[size_t(GlobalId::k_v)].at(i);
    const float samples = std::floor(1 + 7 * u);
    EXPECT_EQ(f.Ci(i, 0), v > 0.5f ? samples : 0) << i;
    EXPECT_EQ(f.Ci(i, 1), v > 0.5f ? 0 : samples) << i;
    EXPECT_LE(f.Ci(i, 2), u * 1.5f + 1e-3f) << i;
    if (u > 0.9f) {
      EXPECT_GT(f.Ci(i, 2), 0.5f) << i;
    }
  }
}

TEST(Loops, OperandsKeepTheValuesThatTheyHadAtFirst) {
  MachineFixture f;
  // The body turns the direction about: all samples still go where the first one went.
  const auto s = surface(f,
                         "vector d = vector(0, 0, 1), r = 0; point Q = P; float n = 3; Ci = 0;\n"
                         "gather(\"samplepattern\", Q, d, 0, n, \"ray:direction\", r) {} else {"
                         " Ci += color(r); d = vector(1, 0, 0); Q = 0; n = 100; }");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.Ci(0, 0), 0);
  EXPECT_EQ(f.Ci(0, 2), 3);
  const auto light = f.shader("light a() { solar(vector(0, 0, 1), 0) Cl = 1; }");
  const auto lit = surface(f,
                           "vector axis = vector(0, 0, -1); float angle = 0.5; Ci = 0; point Q = P;\n"
                           "illuminance(Q, axis, angle) { Ci += Cl; axis = -axis; angle = 0; Q += 1; }");
  ASSERT_TRUE(light && lit) << f.error;
  f.run(*lit, {light.get(), light.get(), light.get()});
  EXPECT_EQ(f.Ci(0), 3);
}

TEST(RayCalls, LongNamesAreCutNotOverrun) {
  MachineFixture f;
  RayTerms seen{};
  f.oracle = [&](PendingRays& r) { seen = r.terms; };
  const auto s = surface(f, "Ci = trace(P, N, \"label\", \"" + std::string(500, 'x') + "\");");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(std::strlen(seen.label), sizeof seen.label - 1);
}

TEST(RayCalls, DepthsBoundDiffuseAndSpecularRays) {
  MachineFixture f;
  const auto diffuse = surface(f, "Ci = occlusion(P, N, 2) + indirectdiffuse(P, N, 2);");
  const auto specular = surface(f, "Ci = trace(P, N);");
  ASSERT_TRUE(diffuse && specular);
  uint32_t depth = 0;
  f.oracle = [&](PendingRays& r) { depth = r.terms.diffuseDepth; };
  f.run(*diffuse);
  EXPECT_EQ(f.suspensions, 2);
  EXPECT_EQ(depth, 1u);
  f.batch.level = f.batch.diffuseDepth = 1;
  f.run(*diffuse);
  EXPECT_EQ(f.suspensions, 0);
  EXPECT_EQ(f.Ci(3), 0.0f);
  f.run(*specular);
  EXPECT_EQ(f.suspensions, 1);
  f.batch.maxDiffuseDepth = 2;
  f.run(*diffuse);
  EXPECT_EQ(f.suspensions, 2);
  EXPECT_EQ(depth, 2u);
  f.batch.diffuseDepth = 0, f.batch.level = 3, f.batch.maxSpecularDepth = 3;
  f.run(*specular);
  EXPECT_EQ(f.suspensions, 0);
}

TEST(RayCalls, OcclusionFallsOffWithDistance) {
  MachineFixture f;
  f.oracle = [&](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) r.hitDistance[k] = 2;
  };
  const auto value = [&](const std::string& terms) {
    const auto s = surface(f, "Ci = occlusion(P, N, 4" + terms + ");");
    if (!s) return -1.0f;
    f.run(*s);
    return f.Ci(5);
  };
  EXPECT_EQ(value(""), 1.0f);
  EXPECT_NEAR(value(", \"falloff\", 0.5"), std::exp(-1.0f), 1e-6);
  EXPECT_NEAR(value(", \"falloff\", 3, \"falloffmode\", 1, \"maxdist\", 8"), std::pow(0.75f, 3.0f), 1e-6);
}

TEST(RayCalls, OcclusionAsksNoMoreThanItUses) {
  const auto flags = [](const std::string& body) {
    MachineFixture f;
    uint32_t seen = 0;
    f.oracle = [&](PendingRays& r) {
      seen = r.terms.flags;
      // What is not asked for is not there.
      for (auto* rows : {r.color, r.hitP, r.hitN})
        for (int c = 0; c < 3; ++c) std::fill_n(rows[c], r.count, std::numeric_limits<float>::quiet_NaN());
      std::fill_n(r.hitDistance, r.count, 0.0f);
    };
    const auto s = surface(f, body);
    if (!s) return ~0u;
    f.run(*s);
    EXPECT_EQ(f.Ci(2), 1.0f) << body;
    return seen;
  };
  EXPECT_EQ(flags("Ci = occlusion(P, N, 16);"), uint32_t(RayTerms::kOnlyWhether));
  EXPECT_EQ(flags("vector open = 0; Ci = occlusion(P, N, 16, \"environmentdir\", open);"),
            uint32_t(RayTerms::kOnlyWhether));
  EXPECT_EQ(flags("Ci = occlusion(P, N, 16, \"falloff\", 1);"), uint32_t(RayTerms::kOnlyDistance));
  EXPECT_EQ(flags("float d = trace(P, N); Ci = 1 + d;"), uint32_t(RayTerms::kOnlyDistance));
}

TEST(RayCalls, EnvironmentdirIsTheMeanOfWhatIsClear) {
  MachineFixture f;
  f.oracle = [&](PendingRays& r) {  // a wall hides all that goes to +x
    for (uint32_t k = 0; k < r.count; ++k) r.hitDistance[k] = r.direction[0][k] > 0 ? 1.0f : kNoHit;
  };
  const auto s =
      surface(f,
              "vector clear = 0; Ci = occlusion(P, N, 256, \"environmentdir\", clear); Ci[1] = clear[0];"
              " Ci[2] = length(clear);");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_NEAR(f.Ci(2, 0), 0.5, 0.02);
  EXPECT_LT(f.Ci(2, 1), -0.3f);
  EXPECT_NEAR(f.Ci(2, 2), 1, 1e-5);
}

TEST(RayCalls, SamplesOfAConeAreAveragedAndStayInside) {
  MachineFixture f;
  f.oracle = [&](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) {
      EXPECT_GE(-r.direction[2][k], std::cos(0.3f) - 1e-5f);
      r.hitDistance[k] = 1;
      for (int c = 0; c < 3; ++c) r.color[c][k] = -r.direction[2][k];
    }
  };
  const auto s = surface(f, "Ci = trace(P, N, \"samples\", 64, \"samplecone\", 0.3);");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.suspensions, 3);  // 40 points, as many samples of each as a block holds
  // The mean cosine over a uniform cone is half way between its ends.
  EXPECT_NEAR(f.Ci(1), 0.5f * (1 + std::cos(0.3f)), 1e-3);
}

TEST(RayCalls, GatherAsksForValuesAndGetsThem) {
  MachineFixture f;
  std::string extras;
  f.oracle = [&](PendingRays& r) {
    extras = r.terms.extras;
    for (uint32_t k = 0; k < r.count; ++k) {
      r.hitDistance[k] = 4;
      for (uint32_t c = 0; c < kMaxExtraAnswers; ++c) r.extra[c][k] = float(c) + 1;
    }
  };
  const auto s = surface(
      f,
      "float a = 0, b = 0; color c = 0; Ci = 0;\n"
      "gather(\"illuminance\", P, N, 0, 1, \"primitive:s\", a, \"surface:c\", c, \"attribute:user:b\", b)"
      " { Ci = color(a, comp(c, 2), b); }");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(extras, "1 primitive:s\n3 surface:c\n1 attribute:user:b\n");
  EXPECT_EQ(f.Ci(4, 0), 1);
  EXPECT_EQ(f.Ci(4, 1), 4);
  EXPECT_EQ(f.Ci(4, 2), 5);
}

TEST(RayCalls, SamplePatternTracesNothing) {
  MachineFixture f;
  const auto s = surface(f,
                         "vector d = 0; Ci = 0;\n"
                         "gather(\"samplepattern\", P, N, 1, 8, \"ray:direction\", d) { Ci += 1000; } else { "
                         "Ci += d . N / 8; }");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.suspensions, 0);
  EXPECT_GT(f.Ci(0), 0.54f);
  EXPECT_LT(f.Ci(0), 1.0f);
}

TEST(RayCalls, MapsNamedRaytrace) {
  MachineFixture f;
  f.oracle = [&](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) {
      r.hitDistance[k] = 1;
      for (int c = 0; c < 3; ++c) r.color[c][k] = 0.25f * float(c + 1);
    }
  };
  const auto s =
      surface(f, "string map = \"raytrace\"; Ci = environment(map, N) + float environment(map[2], N);");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.suspensions, 2);
  EXPECT_NEAR(f.Ci(0, 0), 1.0, 1e-6);
  EXPECT_NEAR(f.Ci(0, 1), 1.25, 1e-6);
}

// --- area lights ---

/// A square with sides of 2 a at z = 1 - h over x = y = 0, seen from z = 1.
class Square final : public Emitter {
 public:
  explicit Square(float half, float height) : half_(half), height_(height) {}
  bool ready() const override { return true; }
  void sample(const EmitterQuery& q) const override {
    for (uint32_t i = 0; i < q.lanes; ++i) {
      if (!q.mask[i]) continue;
      const Vec3 P((2 * q.xi[i].x - 1) * half_, (2 * q.xi[i].y - 1) * half_, 1 - height_), N(0, 0, 1);
      const Vec3 to = Vec3(q.Ps.at(i, 0), q.Ps.at(i, 1), q.Ps.at(i, 2)) - P;
      for (uint32_t c = 0; c < 3; ++c) q.P.comp(c)[i] = P[int(c)], q.N.comp(c)[i] = N[int(c)];
      q.factor[i] = std::max(0.0f, glm::dot(glm::normalize(to), N));
    }
  }

 private:
  float half_, height_;
};
/// Form factor of a parallel rectangle a by b at distance 1 over one of its corners.
double corner(double a, double b) {
  const double x = std::sqrt(1 + a * a), y = std::sqrt(1 + b * b);
  return (a / x * std::atan(b / x) + b / y * std::atan(a / y)) / (2 * std::numbers::pi);
}
double irradiance(double x, double y, double half, double height) {
  const auto signedCorner = [](double a, double b) {
    return std::copysign(1.0, a) * std::copysign(1.0, b) * corner(std::fabs(a), std::fabs(b));
  };
  const double x0 = (-half - x) / height, x1 = (half - x) / height, y0 = (-half - y) / height,
               y1 = (half - y) / height;
  const double form =
      signedCorner(x1, y1) - signedCorner(x0, y1) - signedCorner(x1, y0) + signedCorner(x0, y0);
  // intensity 1 = radiance times area
  return std::numbers::pi * form / (4 * half * half);
}

class AreaLightCalls : public ::testing::Test {
 protected:
  /// Root mean square error of diffuse() over the grid.
  double error(uint32_t samples) {
    const auto light = f.shader("light a() { illuminate(P, N, PI/2) Cl = 1 / (L . L); }");
    EXPECT_TRUE(light) << f.error;
    ShaderInstance area = *light;
    area.emitter = std::make_shared<Square>(0.5f, 0.8f);
    area.samples = samples;
    area.id = 5;
    const auto s = surface(f, "Ci = diffuse(N);");
    f.run(*s, {&area});
    double sum = 0;
    for (uint32_t i = 0; i < f.count; ++i) {
      const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
      const double e = double(f.Ci(i)) - irradiance(double(P.at(i, 0)), double(P.at(i, 1)), 0.5, 0.8);
      sum += e * e;
    }
    return std::sqrt(sum / f.count);
  }
  MachineFixture f;
};

TEST_F(AreaLightCalls, SquareOverAPlane) { EXPECT_LT(error(256), 2e-3); }

TEST_F(AreaLightCalls, ConvergesFasterThanIndependentSamples) {
  const double e4 = error(4), e16 = error(16), e64 = error(64);
  EXPECT_LT(e16, e4 / 2.5);
  EXPECT_LT(e64, e16 / 2.5);
  EXPECT_LT(e64, e4 / 10);
}

TEST_F(AreaLightCalls, DiffuseHitsTakeOneSample) {
  const double e1 = error(1);
  f.batch.level = f.batch.diffuseDepth = 1;
  EXPECT_EQ(error(64), e1);
}

TEST(LightCache, RefreshRunsTheLightAgain) {
  MachineFixture f;
  f.native = false;  // machine code has no light cache: the same light twice is one value
  const auto light = f.shader("light a(float bright = 1) { illuminate(point(0, 0, 0)) Cl = bright; }");
  ASSERT_TRUE(light) << f.error;
  const auto points = [&](const std::string& terms) {
    const auto s = surface(
        f, "color c = 0; illuminance(P) { c += Cl; } illuminance(P" + terms + ") { c += Cl; } Ci = c;");
    if (!s) return 0.0;
    f.machine.statistics() = {};
    f.run(*s, {light.get()});
    return double(f.machine.statistics().lightPoints) / f.count;
  };
  EXPECT_EQ(points(""), 1);
  EXPECT_EQ(points(", \"lightcache\", \"reuse\""), 1);
  EXPECT_EQ(points(", \"lightcache\", \"refresh\""), 2);
  EXPECT_EQ(f.Ci(0), 2);
  EXPECT_EQ(points(", \"send:bright\", 5"), 2);
  EXPECT_EQ(f.Ci(0), 6);
  const auto told = surface(f, "float b = 0; illuminance(P, \"light:bright\", b) { Ci = b; }");
  ASSERT_TRUE(told);
  f.run(*told, {light.get()});
  EXPECT_EQ(f.Ci(0), 1);
}

TEST(LightCache, PartsOfALightAreLeftOut) {
  MachineFixture f;
  const auto light = f.shader(
      "light a(float __nondiffuse = 0.25; float __nonspecular = 1) { solar(vector(0, 0, 1), 0) Cl = 1; }");
  const auto s = surface(f, "Ci = color(comp(diffuse(N), 0), comp(specular(N, -normalize(I), 0.1), 0), 0);");
  ASSERT_TRUE(light && s) << f.error;
  f.run(*s, {light.get()});
  EXPECT_NEAR(f.Ci(0, 0), 0.75, 1e-6);
  EXPECT_EQ(f.Ci(0, 1), 0);
}

// --- brackets and strings ---

TEST(Components, ReadAndWrittenByIndex) {
  MachineFixture f;
  const auto s =
      surface(f,
              "point q = point(1, 2, 3); color c = (4, 5, 6); vector a[2]; a[1] = vector(7, 8, 9);\n"
              "q[1] = 10; q[2] += 1; float k = 0; c[k] *= 2;\n"
              "Ci = color(q[1] + q[2], c[0], a[1][2] + (q + vector(0, 0, 1))[0]);\n"
              "Ci[2] = Ci[2] + (vector noise(P)[1] - ycomp(vector noise(P)));");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.Ci(0, 0), 14);
  EXPECT_EQ(f.Ci(0, 1), 8);
  EXPECT_EQ(f.Ci(0, 2), 10);
  EXPECT_FALSE(f.shader("surface t() { float x = 1; Ci = x[0]; }"));
  EXPECT_FALSE(f.shader("surface t() { Ci[3] = 1; }"));
}

TEST(Strings, LimitsHaveOneMessageEach) {
  MachineFixture f;
  std::vector<std::string> said;
  setReportSink([&](const Error& e) { said.push_back(e.message); });
  const auto s = surface(f,
                         "string a = \"abcdefgh\"; float i; for (i = 0; i < 100; i += 1) a = concat(a, a);"
                         " Ci = strlen(a); Ci[1] = match(\"(a*)*(a*)*(a*)*c$\", concat(a, \"b\"));"
                         " string b = \"((((((((((\"; for (i = 0; i < 9; i += 1) b = concat(b, b);"
                         " Ci[2] = match(b, a);");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  EXPECT_EQ(f.Ci(0, 0), 32767);
  EXPECT_EQ(f.Ci(0, 1), 0);
  EXPECT_EQ(f.Ci(0, 2), 0);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_NE(said[0].find("longer than"), std::string::npos);
  EXPECT_NE(said[1].find("bad pattern"), std::string::npos);
  // Many different texts, none of them long: a batch does not grow without end.
  const auto many = surface(f,
                            "string a = \"\"; float i; for (i = 0; i < 200000; i += 1)"
                            " a = format(\"%900d\", i); Ci = strlen(a);");
  ASSERT_TRUE(many);
  said.clear();
  f.run(*many);
  setReportSink({});
  ASSERT_EQ(said.size(), 1u);
  EXPECT_NE(said[0].find("too many"), std::string::npos);
}

TEST(Strings, LengthAndParts) {
  MachineFixture f;
  const auto s =
      surface(f,
              "string a = \"texture\"; Ci = color(strlen(a), 0, 0);\n"
              "if (substr(a, 0, 3) == \"tex\") Ci[1] += 1; if (substr(a, -4, -1) == \"ture\") Ci[1] += 2;\n"
              "if (substr(a, 90, 5) == \"\") Ci[1] += 4; if (substr(a, 2, 90) == \"xture\") Ci[1] += 8;");
  ASSERT_TRUE(s);
  f.run(*s);
  EXPECT_EQ(f.Ci(0, 0), 7);
  EXPECT_EQ(f.Ci(0, 1), 15);
}

TEST(MachineStatistics, LanesAreCounted) {
  MachineFixture f(7, 3);  // 32 points
  f.native = false;        // machine code has such a short condition computed by all
  const auto s = surface(f, "float x = u; if (u < 0.4) x = sin(x) + v; Ci = x;");
  ASSERT_TRUE(s);
  f.run(*s);
  const auto& n = f.machine.statistics();
  EXPECT_GT(n.lanesActive, 0u);
  EXPECT_LT(n.lanesActive, n.lanesTotal);
  EXPECT_EQ(n.lanesTotal % f.lanes, 0u);
}

}  // namespace
}  // namespace fr
