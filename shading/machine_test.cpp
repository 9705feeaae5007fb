// Statements, masks, built-in functions and suspension, through compiled RSL.
#include <gtest/gtest.h>

#include <cmath>

#include "shading/machine_fixture.h"

namespace fr {
namespace {

class MachineTest : public ::testing::Test {
 protected:
  /// Runs `body` (which sets float r from u, v) and compares with `want(u, v)` at every point, for many batch
  /// sizes, at every optimisation level, by kernels and by machine code.
  void expect(const std::string& body, const std::function<double(double, double)>& want,
              double tolerance = 1e-5, const std::string& before = "") {
    for (int way = 0; way < 4; ++way) {
      const int optimize = way < 2 ? 0 : 2;
      f.native = way % 2 == 1;
      auto s = f.shader(before + "surface t() { float r = 0;\n" + body + "\nCi = color(r, r, r); }", {}, {},
                        optimize);
      ASSERT_TRUE(s) << f.error;
      const uint32_t sizes[][2] = {{0, 0},  {1, 1},  {14, 0}, {15, 0}, {16, 0},
                                   {30, 0}, {32, 0}, {7, 4},  {16, 16}};
      for (const auto& size : sizes) {
        f.resize(size[0], size[1]);
        f.run(*s);
        const Operand u = f.batch.globals[size_t(GlobalId::k_u)], v = f.batch.globals[size_t(GlobalId::k_v)];
        for (uint32_t i = 0; i < f.count; ++i) {
          const double w = want(u.at(i), v.at(i));
          ASSERT_NEAR(f.Ci(i), w, tolerance * std::max(1.0, std::fabs(w)))
              << body << " at u " << u.at(i) << " v " << v.at(i) << " of " << f.count << " optimize "
              << optimize;
        }
      }
    }
  }
  MachineFixture f;
};

TEST_F(MachineTest, Conditionals) {
  expect("if (u > 0.5) r = 1; else r = 2;", [](double u, double) { return u > 0.5 ? 1 : 2; });
  expect("if (u > 0.5) r = 1;", [](double u, double) { return u > 0.5 ? 1 : 0; });
  expect("if (u > 0.3) { if (v > 0.6) r = 1; else r = 2; r += 10; } else { if (v > 0.2) r = 3; }",
         [](double u, double v) { return u > 0.3f   ? (v > 0.6f ? 11 : 12)
                                         : v > 0.2f ? 3
                                                    : 0; });
  expect("if (1 > 2) r = 1; else r = 5;", [](double, double) { return 5; });
  expect("float k = 3; if (k == 3) { if (u > 0.5) r = 7; } else r = 1;",
         [](double u, double) { return u > 0.5 ? 7 : 0; });
  // The condition's variable changes inside.
  expect("float c = u > 0.5 ? 1 : 0; if (c) { c = 0; r = 1; } else { c = 1; r = 2; }",
         [](double u, double) { return u > 0.5 ? 1 : 2; });
}

TEST_F(MachineTest, StatementsUnderMasks) {
  // Each statement where only points with u > .5 are active; the others keep what they had.
  const auto half = [&](const std::string& statement, const std::function<double(double, double)>& want,
                        const std::string& before = "") {
    SCOPED_TRACE(statement);
    expect(
        "r = -1; if (u > .5) { " + statement + " }",
        [&](double u, double v) { return u > .5 ? want(u, v) : -1; }, 1e-5, before);
    // The same as the other branch, and within a loop that the others have left.
    expect(
        "r = -1; if (u <= .5) ; else { " + statement + " }",
        [&](double u, double v) { return u > .5 ? want(u, v) : -1; }, 1e-5, before);
    expect(
        "r = -1; float turn; for (turn = 0; turn < 1; turn += 1) { if (u <= .5) break; " + statement + " }",
        [&](double u, double v) { return u > .5 ? want(u, v) : -1; }, 1e-5, before);
  };
  half("r = v;", [](double, double v) { return v; });
  half("r += v; r *= 2;", [](double, double v) { return 2 * (v - 1); });
  half("float k[3] = {1, 2, 3}; k[floor(2.9 * v)] = 7; r = k[0] + k[1] + k[2];",
       [](double, double v) { return 6 - (1 + std::floor(2.9f * float(v))) + 7; });
  half("color c = color (1, 2, 3); setcomp(c, 1, v); r = comp(c, 0) + comp(c, 1) + comp(c, 2);",
       [](double, double v) { return 4 + v; });
  half("matrix m = 1; setcomp(m, 2, 1, v); r = comp(m, 2, 1) + comp(m, 1, 1);",
       [](double, double v) { return 1 + v; });
  half("if (v > .5) r = 1; else r = 2;", [](double, double v) { return v > .5 ? 1 : 2; });
  half("float i; r = 0; for (i = 0; i < 4; i += 1) { if (i == 1) continue; if (i > 2) break; r += i + 1; }",
       [](double, double) { return 4; });
  half("float i = 0; r = 0; while (i < v * 4) { i += 1; r += 1; }",
       [](double, double v) { return std::ceil(v * 4); });
  half(
      "r = f(v);", [](double, double v) { return v > .5 ? 10 : 20 + v; },
      "float f(float x) { if (x > .5) return 10; return 20 + x; }\n");
  half(
      "g(v, r);", [](double, double v) { return v > .5 ? 3 : 4; },
      "void g(float x; output float y) { if (x > .5) { y = 3; return; } y = 4; }\n");
  half("string s = \"abc\"; r = s == \"abc\" ? v : 9;", [](double, double v) { return v; });
  half("float d = 5; if (rayinfo(\"depth\", d) != 0) r = d;", [](double, double) { return 0; });
  half("r = 0; gather (\"samplepattern\", P, N, 0, 2) r += 100; else r += 1;",
       [](double, double) { return 2; });
  half("r = trace(P, N) > 1e30 ? v : 9;", [](double, double v) { return v; });
  // Under the lights of this test there are none: the body never runs.
  half("r = v; illuminance (P) { r = 9; }", [](double, double v) { return v; });
}

TEST_F(MachineTest, LightLoopsUnderMasks) {
  // A light straight above each point, behind those with v > .5 of the cone's middle; half of the points do
  // not ask.
  for (const bool native : {false, true}) {
    f.native = native;
    const auto light = f.shader("light l() { solar (vector (0, 0, 1), 0) Cl = 2; }");
    const auto s = f.shader(
        "surface t() { float r = -1; if (u > .5) { r = 0; illuminance (P, normal (0, 0, v > .5 ? 1 : -1), PI "
        "/ 2) {"
        " if (v < .25) continue; r += comp(Cl, 0) + zcomp(L); } } Ci = r; }");
    ASSERT_TRUE(light && s) << f.error;
    for (const uint32_t n : {0u, 6u, 7u, 8u, 15u, 16u}) {
      f.resize(n, n);
      f.run(*s, {light.get()});
      const Operand u = f.batch.globals[size_t(GlobalId::k_u)], v = f.batch.globals[size_t(GlobalId::k_v)];
      for (uint32_t i = 0; i < f.count; ++i) {
        // L leads to the light: (0, 0, -1).
        const double lit = v.at(i) > .5f || v.at(i) < .25f ? 0 : 1;
        EXPECT_EQ(f.Ci(i), u.at(i) > .5f ? lit : -1) << i << " of " << f.count << (native ? " native" : "");
      }
    }
  }
}

TEST_F(MachineTest, LightsMayTurnL) {
  // From a point, but along an axis: parallel rays. An ambient light has no direction to turn.
  for (const bool native : {false, true}) {
    f.native = native;
    const auto light = f.shader(
        "light l() { illuminate (point (0, 0, -5)) { Cl = length(L); if (Ps . Ps >= 0) L = vector (0, 0, 3); "
        "} }");
    const auto ambient = f.shader("light a() { L = 0; Cl = .5; }");
    const auto s = f.shader(
        "surface t() { illuminance (P) { Ci += color (xcomp(L), ycomp(L), zcomp(L)); Oi = Cl; } Ci += "
        "ambient(); }");
    ASSERT_TRUE(light && ambient && s) << f.error;
    f.run(*s, {light.get(), ambient.get()});
    for (uint32_t i = 0; i < f.count; ++i) {
      EXPECT_EQ(f.Ci(i, 0), 0.5f);
      EXPECT_EQ(f.Ci(i, 1), 0.5f);
      EXPECT_EQ(f.Ci(i, 2), -2.5f);
    }
  }
}

TEST_F(MachineTest, SurfacesMayChangeTheirCopyOfTheLight) {
  for (const bool native : {false, true}) {
    f.native = native;
    const auto light = f.shader("light l() { solar (vector (0, 0, -1), 0) { Cl = color (1, 2, 3); } }");
    const auto s = f.shader(
        "void halve(output color c) { c *= .5; }"
        "surface t() { illuminance (P) { extern color Cl; if (u >= .5) Cl *= 2; halve(Cl); L = vector (0, 7, "
        "0); "
        "Cl[2] = length(L); Ci += Cl; } illuminance (P) Ci += 10 * Cl; Ci += 100 * diffuse(normal (0, 0, "
        "1)); "
        "}");
    ASSERT_TRUE(light && s) << f.error;
    f.run(*s, {light.get(), light.get()});
    for (uint32_t i = 0; i < f.count; ++i) {
      const float k = f.batch.globals[size_t(GlobalId::k_u)].at(i, 0) >= 0.5f ? 1.0f : 0.5f;
      EXPECT_NEAR(f.Ci(i, 0), 2 * (k + 110), 1e-3);
      EXPECT_NEAR(f.Ci(i, 1), 2 * (2 * k + 220), 1e-3);
      EXPECT_NEAR(f.Ci(i, 2), 2 * (7 + 330), 1e-3);
    }
  }
}

TEST_F(MachineTest, Loops) {
  expect("float i; for (i = 0; i < 5; i += 1) r += i;", [](double, double) { return 10; });
  expect("float i = 0; while (i < u * 8) { r += 1; i += 1; }",
         [](double u, double) { return std::ceil(u * 8); });
  expect("float i; for (i = 0; i < 8; i += 1) { if (i > u * 4) break; r += 1; }",
         [](double u, double) { return std::floor(u * 4) + 1; });
  expect("float i; for (i = 0; i < 8; i += 1) { if (mod(i, 2) < u) continue; r += i; }",
         [](double u, double) {
           double r = 0;
           for (int i = 0; i < 8; ++i)
             if (!(i % 2 < u)) r += i;
           return r;
         });
  expect(
      "float i, j; for (i = 0; i < 5; i += 1) { for (j = 0; j < 5; j += 1) { if (j > v * 5) break 2; if (i > "
      "u * 5) continue 2;"
      " r += 1; } r += 100; }",
      [](double u, double v) {
        double r = 0;
        for (int i = 0; i < 5; ++i) {
          bool next = false, out = false;
          for (int j = 0; j < 5; ++j) {
            if (float(j) > float(v) * 5.0f) {
              out = true;
              break;
            }
            if (float(i) > float(u) * 5.0f) {
              next = true;
              break;
            }
            r += 1;
          }
          if (out) break;
          if (next) continue;
          r += 100;
        }
        return r;
      });
}

TEST_F(MachineTest, FunctionsWithEarlyReturns) {
  expect(
      "r = f(u, v) + f(v, u);",
      [](double u, double v) {
        const auto g = [](double a, double b) { return a > 0.5 ? (b > 0.5 ? 1 : 2) : b; };
        return g(u, v) + g(v, u);
      },
      1e-5, "float f(float a; float b) { if (a > 0.5) { if (b > 0.5) return 1; return 2; } return b; }\n");
  expect(
      "r = g(u);", [](double u, double) { return std::floor(float(u) * 10.0f); }, 1e-5,
      "float g(float a) { float i; for (i = 0; i < 20; i += 1) { if (i + 1 > a * 10) return i; } return -1; "
      "}\n");
}

TEST_F(MachineTest, ArraysAndVaryingIndices) {
  expect("float a[4] = {1, 2, 4, 8}; r = a[u * 3.99];",
         [](double u, double) { return std::exp2(std::floor(u * 3.99)); });
  expect("float a[3]; float i; for (i = 0; i < 3; i += 1) a[i] = i * u; r = a[0] + a[1] + a[2];",
         [](double u, double) { return 3 * u; });
  expect("float a[2] = {0, 0}; a[u > 0.5 ? 1 : 0] = 5; r = a[1];",
         [](double u, double) { return u > 0.5 ? 5 : 0; });
}

TEST_F(MachineTest, SplinesInterpolate) {
  expect("r = spline(u, 0, 0, 1, 2, 3, 3);", [](double u, double) {
    const double k[] = {0, 0, 1, 2, 3, 3}, x = std::min(u * 3, 2.9999999);
    const int s = int(x);
    const double t = x - s, *p = k + s;
    return 0.5 * (2 * p[1] + (p[2] - p[0]) * t + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * t * t +
                  (3 * p[1] - p[0] - 3 * p[2] + p[3]) * t * t * t);
  });
  expect("r = spline(\"bezier\", u, 1, 1, 4, 4);",
         [](double u, double) { return 1 + 3 * u * u * (3 - 2 * u); });
  expect("r = spline(\"linear\", u, 9, 1, 3, 9);", [](double u, double) { return 1 + 2 * u; });
  expect("r = spline(\"bspline\", u, 2, 2, 2, 2, 2);", [](double, double) { return 2; });
}

TEST_F(MachineTest, VectorsAndTransforms) {
  f.host.spaces["shifted"] = DMat4(1.0);
  f.host.spaces["shifted"][3] = DVec4(10, 0, 0, 1);  // shifted -> current adds 10 in x
  f.host.spaces["scaled"] = DMat4(1.0);
  f.host.spaces["scaled"][0][0] = 2;
  expect("r = xcomp(transform(\"shifted\", P));", [](double u, double) { return u - 10; });
  expect("point q = point \"shifted\" (1, 2, 3); r = xcomp(q);", [](double, double) { return 11; });
  expect("vector q = vtransform(\"shifted\", vector (u, 0, 0)); r = xcomp(q);",
         [](double u, double) { return u; });
  expect("normal q = ntransform(\"scaled\", normal (u, 0, 0)); r = xcomp(q);",
         [](double u, double) { return 2 * u; });
  expect("matrix m = translate(1, vector (u, 0, 0)); r = xcomp(transform(m, point (1, 1, 1)));",
         [](double u, double) { return 1 + u; });
  expect("r = depth(P + vector (0, 0, u));", [](double u, double) { return u / 10; });
  expect("r = comp(ctransform(\"hsv\", \"rgb\", color (u, 0, v)), 1);", [](double, double v) { return v; });
  expect("r = xcomp(rotate(point (1, 0, 0), u, point (0, 0, 0), point (0, 0, 1)));",
         [](double u, double) { return std::cos(u); });
}

TEST_F(MachineTest, DerivativesOnAGrid) {
  DerivativeStencil d;
  auto s = f.shader("surface t() { float a = u * u + 3 * v; Ci = color(Du(a), Dv(a), area(P)); }");
  ASSERT_TRUE(s) << f.error;
  constexpr uint32_t nu = 8, nv = 4;
  f.resize(nu, nv);
  gridStencil(d, nu, nv, f.lanes, 1.0f / nu, 1.0f / nv);
  f.batch.stencil = &d;
  f.run(*s);
  for (uint32_t y = 0; y <= nv; ++y)
    for (uint32_t x = 0; x <= nu; ++x) {
      const uint32_t i = y * (nu + 1) + x;
      const double u = double(x) / nu, h = 1.0 / nu;
      const double want = x == 0 ? h : x == nu ? 2 - h : 2 * u;  // one-sided at the borders
      EXPECT_NEAR(f.Ci(i, 0), want, 1e-5);
      EXPECT_NEAR(f.Ci(i, 1), 3, 1e-5);
      EXPECT_NEAR(f.Ci(i, 2), 1.0 / nu / nv, 1e-6);
    }
  auto n = f.shader("surface t() { P += vector(0, 0, 2 * u); N = calculatenormal(P); Ci = color(N); }");
  ASSERT_TRUE(n) << f.error;
  f.batch.orientation = -1;
  f.run(*n);
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(f.Ci(i, 0) / f.Ci(i, 2), -2, 1e-5);
}

// At the pole of a sphere, where v is 0, nothing changes along u.
TEST_F(MachineTest, TheNormalOfAPoleIsThatOfItsNeighbour) {
  constexpr uint32_t nu = 4, nv = 4;
  f.resize(nu, nv);
  auto s = f.shader(
      "surface t() { point q = point(v * cos(6 * u), v * sin(6 * u), 0); Ci = "
      "color(normalize(calculatenormal(q))); }");
  ASSERT_TRUE(s) << f.error;
  DerivativeStencil d;
  gridStencil(d, nu, nv, f.lanes, 1.0f / nu, 1.0f / nv);
  f.batch.stencil = &d;
  f.run(*s);
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(std::fabs(f.Ci(i, 2)), 1, 1e-5) << i;
}

TEST_F(MachineTest, ParametersDefaultsAndOverrides) {
  f.shaderToCurrent[3] = DVec4(5, 0, 0, 1);
  const std::string source =
      "surface t(float a = 2; point p = point \"shader\" (1, 0, 0); float b = sqrt(16); color c = color "
      "\"hsv\" (0, 0, .5);"
      "string s = concat(\"x\", \"y\"); float k[3] = {1, 2, 3};)"
      "{ Ci = color(a + b, xcomp(p), k[2] + (s == \"xy\" ? 10 : 0)) + 0 * c; }";
  auto plain = f.shader(source);
  ASSERT_TRUE(plain) << f.error;
  f.run(*plain);
  EXPECT_NEAR(f.Ci(3, 0), 6, 1e-6);
  EXPECT_NEAR(f.Ci(3, 1), 6, 1e-6);
  EXPECT_NEAR(f.Ci(3, 2), 13, 1e-6);
  EXPECT_NEAR(plain->parameter("c")->floats[0], 0.5, 1e-6);
  ShaderValue seven;
  seven.floats = {7};
  auto set = f.shader(source, {{"a", seven}});
  f.run(*set);
  EXPECT_NEAR(f.Ci(0, 0), 11, 1e-6);
  // A uniform parameter that a primitive variable overrides.
  auto varying = f.shader(source, {}, {"a"});
  std::vector<float> memory(f.lanes + 16);
  float* values = memory.data() + (64 - (reinterpret_cast<uintptr_t>(memory.data()) & 63)) / 4 % 16;
  for (uint32_t i = 0; i < f.lanes; ++i) values[i] = float(i);
  const Batch::Override o[] = {{varying->program().findParameter("a"), Operand{values, f.lanes, ~0u}}};
  f.batch.overrides = o;
  f.run(*varying);
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(f.Ci(i, 0), float(i) + 4, 1e-5);
}

TEST_F(MachineTest, ValuesThatDoNotFitAParameterAreMadeToOrLeftOut) {
  const std::string source =
      "surface t(color c = .5; float k = 2; float a[2] = {5, 6};) { Ci = color(xcomp(vector(c)) + "
      "ycomp(vector(c)), "
      "k, a[1]); }";
  const auto with = [&](const char* name, std::vector<float> floats, float r, float g, float b) {
    ShaderValue v;
    v.floats = std::move(floats);
    auto s = f.shader(source, {{name, v}});
    ASSERT_TRUE(s) << f.error;
    f.run(*s);
    EXPECT_NEAR(f.Ci(0, 0), r, 1e-6) << name;
    EXPECT_NEAR(f.Ci(0, 1), g, 1e-6) << name;
    EXPECT_NEAR(f.Ci(0, 2), b, 1e-6) << name;
  };
  with("c", {.25f}, .5f, 2, 6);           // one number is a grey
  with("c", {.25f, .5f, 1}, .75f, 2, 6);  // three floats
  with("c", {.25f, .5f}, 1, 2, 6);
  with("k", {3, 4}, 1, 3, 6);
  with("a", {3, 4, 5}, 1, 2, 4);
  with("a", {3}, 1, 2, 6);
}

TEST_F(MachineTest, OperandsAreWhatTheyAreWhenTheyAreRead) {
  auto s = f.shader(
      "float down(float x) { extern float last; last = x - 1; return x; }"
      "surface t(output varying float trail = 0) { float last = 20 + u * 0;"
      " float up(float x) { trail += x; return trail; }"
      " trail = 2 + u * 0; Oi = 1;"
      " Ci = color(trail + up(5), up(1) - trail, last + down(4) + last); }");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  for (uint32_t i = 0; i < f.count; ++i) {
    EXPECT_EQ(f.Ci(i, 0), 9) << "2 + 7";
    EXPECT_EQ(f.Ci(i, 1), 0) << "8 - 8";
    EXPECT_EQ(f.Ci(i, 2), 27) << "20 + 4 + 3";
  }
}

TEST_F(MachineTest, RandomNumbersBelongToPointsNotToBatches) {
  auto s = f.shader(
      "surface t() { float i, r = 0; for (i = 0; i < 4; i += 1) { if (i <= u * 4) r += random(); }"
      " Ci = color(r, random(), random()); }");
  ASSERT_TRUE(s) << f.error;
  f.resize(31, 0);
  f.run(*s);
  std::vector<float> all;
  double sum = 0;
  for (uint32_t i = 0; i < f.count; ++i) all.push_back(f.Ci(i, 1)), sum += f.Ci(i, 1);
  EXPECT_NEAR(sum / 32, 0.5, 0.2);
  EXPECT_NE(f.Ci(3, 1), f.Ci(3, 2));
  // The same points in another arrangement.
  f.resize(31, 3);
  f.run(*s);
  for (uint32_t i = 0; i < 32; ++i) EXPECT_EQ(f.Ci(i, 1), all[i]);
}

const char* kPointLight =
    "light pointlight(float intensity = 1; color lightcolor = 1; point from = point \"shader\" (0,0,0);"
    " string __category = \"\"; output float __tag = 3)"
    "{ illuminate (from) { Cl = intensity * lightcolor / (L . L); __tag = 4; } }";
const char* kPlastic =
    "surface plastic(float Ka = 1, Kd = .5, Ks = .5, roughness = .1; color specularcolor = 1)"
    "{ normal Nf = faceforward(normalize(N), I); Oi = Os;"
    "  Ci = Os * (Cs * (Ka * ambient() + Kd * diffuse(Nf)) + specularcolor * Ks * specular(Nf, "
    "-normalize(I), roughness)); }";

double plastic(const Vec3& P, const Vec3& light, double Kd, double Ks) {
  const Vec3 N(0, 0, -1), toLight = light - P, V = -glm::normalize(P), L = glm::normalize(toLight);
  const double Cl = 1 / glm::dot(toLight, toLight);
  const double nl = glm::dot(N, L);
  if (nl <= 0) return 0;
  return Cl * (Kd * nl + Ks * std::pow(std::max(0.0f, glm::dot(N, glm::normalize(L + V))), 10.0));
}

TEST_F(MachineTest, PlasticUnderAPointLightAndAmbient) {
  f.shaderToCurrent[3] = DVec4(0.3, 0.4, -2, 1);
  auto light = f.shader(kPointLight);
  auto ambient = f.shader("light ambientlight(float intensity = .25) { Cl = intensity; }");
  f.shaderToCurrent = DMat4(1.0);
  auto s = f.shader(kPlastic);
  ASSERT_TRUE(light && ambient && s) << f.error;
  f.run(*s, {light.get(), ambient.get()});
  const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
  for (uint32_t i = 0; i < f.count; ++i) {
    const Vec3 p(P.at(i, 0), P.at(i, 1), P.at(i, 2));
    EXPECT_NEAR(f.Ci(i), 0.25 + plastic(p, Vec3(0.3f, 0.4f, -2), 0.5, 0.5), 2e-5);
  }
  // Three loops over lights (diffuse and specular share one evaluation of the point light).
  EXPECT_EQ(f.machine.statistics().lightPoints, 2u * f.count);
}

TEST_F(MachineTest, ShadowRaysMultiplyTheLight) {
  f.shaderToCurrent[3] = DVec4(0.3, 0.4, -2, 1);
  auto plain = f.shader(kPointLight);
  auto s = f.shader(kPlastic);
  ASSERT_TRUE(plain && s) << f.error;
  ShaderInstance light = *plain;
  light.shadows = true;
  uint32_t rays = 0;
  f.oracle = [&](PendingRays& r) {
    EXPECT_EQ(r.kind, RayKind::kVisibility);
    for (uint32_t k = 0; k < r.count; ++k) {
      // Shadow where x > 0.5; the ray ends at the light.
      EXPECT_NEAR(r.origin[0][k] + r.direction[0][k], 0.3, 1e-5);
      EXPECT_NEAR(r.origin[2][k] + r.direction[2][k], -2, 1e-5);
      const float seen = r.origin[0][k] > 0.5f ? 0.0f : 1.0f;
      for (auto& c : r.color) c[k] = seen;
    }
    rays += r.count;
  };
  f.run(*s, {&light});
  EXPECT_EQ(f.suspensions, 1);  // specular() finds the shadow known
  EXPECT_EQ(rays, f.count);
  const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
  for (uint32_t i = 0; i < f.count; ++i) {
    const Vec3 p(P.at(i, 0), P.at(i, 1), P.at(i, 2));
    EXPECT_NEAR(f.Ci(i), p.x > 0.5f ? 0 : plastic(p, Vec3(0.3f, 0.4f, -2), 0.5, 0.5), 2e-5);
  }
}

TEST_F(MachineTest, CategoriesConesAndMessages) {
  auto a = f.shader(
      "light a(string __category = \"key, left\"; float mark = 1) { solar (vector (0, 0, 1), 0) Cl = 1; }");
  auto b = f.shader(
      "light b(float mark = 10) { illuminate (point (0.5, 0.5, 0), vector (0, 0, 1), 0.3) Cl = 2; }");
  ASSERT_TRUE(a && b) << f.error;
  const auto sum = [&](const std::string& loop) {
    auto s = f.shader("surface t() { color r = 0; float m = 0, marks = 0; " + loop +
                      " { if (lightsource(\"mark\", m) == 1) marks += m; r += Cl; }"
                      " Ci = color(comp(r, 0), marks, 0); }");
    EXPECT_TRUE(s) << f.error;
    if (s) f.run(*s, {a.get(), b.get()});
  };
  const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
  const auto inCone = [&](uint32_t i) {
    const Vec3 d(P.at(i, 0) - 0.5f, P.at(i, 1) - 0.5f, 1);
    return std::acos(d.z / glm::length(d)) < 0.3;
  };
  sum("illuminance (P)");
  for (uint32_t i = 0; i < f.count; ++i) {
    EXPECT_NEAR(f.Ci(i), 1 + (inCone(i) ? 2 : 0), 1e-6);
    EXPECT_NEAR(f.Ci(i, 1), 1 + (inCone(i) ? 10 : 0), 1e-6);
  }
  sum("illuminance (\"left\", P)");
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(f.Ci(i), 1, 1e-6);
  sum("illuminance (\"-key\", P)");
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(f.Ci(i), inCone(i) ? 2 : 0, 1e-6);
  sum("illuminance (P, vector (0, 0, 1), PI/2)");  // lights are behind
  for (uint32_t i = 0; i < f.count; ++i) EXPECT_NEAR(f.Ci(i), 0, 1e-6);
}

/// Answers that depend on the ray alone: what a scene would do.
void analyticOracle(PendingRays& r) {
  for (uint32_t k = 0; k < r.count; ++k) {
    const float x = r.origin[0][k], y = r.origin[1][k];
    r.hitDistance[k] = x + 1;
    r.missDepth[k] = 2;
    for (int c = 0; c < 3; ++c) {
      r.color[c][k] = x + 2 * y;
      r.hitP[c][k] = r.origin[c][k] + r.direction[c][k] * (x + 1);
      r.hitN[c][k] = -r.direction[c][k];
      r.missP[c][k] = 7, r.missR[c][k] = r.direction[c][k];
    }
  }
}

TEST_F(MachineTest, EveryRayOperationSuspendsAndResumesAnywhere) {
  f.oracle = analyticOracle;
  const auto color = [](double u, double v) { return double(float(u)) + 2 * v; };
  const std::string use = "vector D = vector (0, 0, 1); ";
  expect(use + "r = comp(trace(P, D), 0);", color);
  EXPECT_EQ(f.suspensions, 1);
  expect(use + "float d = trace(P, D); r = d;", [](double u, double) { return u + 1; });
  expect(use + "r = comp(visibility(P, P + D), 1);", color);
  expect(use + "r = comp(transmission(P, P + D), 1);", color);
  expect(
      use + "point Ph = 0; vector Nh = 0; r = rayhittest(P, D, Ph, Nh) + zcomp(Ph) * 10 + zcomp(Nh) * 100;",
      [](double u, double) { return u + 1 + (1 + u + 1) * 10 - 100; });
  expect(use +
             "color c = 0; float d = 0; point p = 0, q = 0; vector n = 0, w = 0;"
             "r = fulltrace(P, D, c, d, p, n, q, w) + d * 10 + comp(c, 0) * 100 + xcomp(q) * 1000 + zcomp(w) "
             "* 10000;",
         [&](double u, double v) { return 2 + (u + 1) * 10 + color(u, v) * 100 + 7000 + 10000; });
  // In conditionals, loops and user functions; only active points ask.
  expect(use + "if (u > 0.5) r = comp(trace(P, D), 0); else r = -1;",
         [&](double u, double v) { return u > 0.5 ? color(u, v) : -1; });
  expect(use + "float i; for (i = 0; i < 3; i += 1) { if (i > u * 3) break; r += comp(trace(P, D), 0); }",
         [&](double u, double v) { return color(u, v) * std::min(3.0, std::floor(u * 3) + 1); });
  expect(
      use + "if (v < 0.7) { r = f(P, D, u); }",
      [&](double u, double v) { return v < 0.7f ? (u > 0.2f ? color(u, v) : 0.5) : 0; }, 1e-5,
      "float f(point A; vector B; float x) { if (x > 0.2) { color c = trace(A, B); return comp(c, 0); } "
      "return 0.5; }\n");
  // Nobody active: nobody asks.
  expect(use + "if (u > 2) r = comp(trace(P, D), 0);", [](double, double) { return 0; });
  EXPECT_EQ(f.suspensions, 0);
}

TEST_F(MachineTest, RaysInLightsSuspendTheSurface) {
  f.oracle = analyticOracle;
  auto light = f.shader(
      "light t(point from = point (0, 0, -3)) { illuminate (from) { if (xcomp(Ps) > 0.3)"
      " Cl = visibility(Ps, from); else Cl = 5; } }");
  auto s = f.shader(
      "color lit(point Q) { color r = 0; illuminance (Q) { r += Cl; if (u > 0.5) r += trace(P, L); } return "
      "r; }\n"
      "surface t() { Ci = 1; if (v > 0.1) Ci = lit(P); }");
  ASSERT_TRUE(light && s) << f.error;
  f.run(*s, {light.get()});
  EXPECT_EQ(f.suspensions, 2);
  const Operand P = f.batch.globals[size_t(GlobalId::k_P)];
  for (uint32_t i = 0; i < f.count; ++i) {
    const double x = P.at(i, 0), y = P.at(i, 1), c = x + 2 * y;
    const double want = y > 0.1f ? (x > 0.3f ? c : 5) + (x > 0.5 ? c : 0) : 1;
    EXPECT_NEAR(f.Ci(i), want, 1e-5) << x << " " << y;
  }
}

TEST_F(MachineTest, OcclusionAndGather) {
  // Everything above z = 1 in the direction +x hits.
  f.oracle = [](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) {
      const bool hit = r.direction[0][k] > 0;
      r.hitDistance[k] = hit ? 2.0f : 1e30f;
      for (auto& c : r.color) c[k] = hit ? 0.5f : 0.0f;
    }
  };
  auto s = f.shader(
      "surface t() { float hits = 0, misses = 0; color c = 0; float len = 0;"
      " gather (\"illuminance\", P, N, PI/2, 64, \"surface:Ci\", c, \"ray:length\", len)"
      " { hits += 1; if (u > 0.5) continue; hits += 0; } else { misses += 1; }"
      " Ci = color(hits + misses, hits, occlusion(P, N, 64)); }");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  for (uint32_t i = 0; i < f.count; ++i) {
    EXPECT_EQ(f.Ci(i, 0), 64);
    EXPECT_NEAR(f.Ci(i, 1), 32, 5);
    EXPECT_NEAR(f.Ci(i, 2), 0.5, 0.08);
  }
}

TEST_F(MachineTest, StateAndMessages) {
  f.batch.level = 2;
  auto displacement =
      f.shader("displacement d(float height = .75; string how = \"deep\") { P += height * N; }");
  auto s = f.shader(
      "surface t(output float mark = 0) { float rate = 0, h = 0, fmt[3] = {0, 0, 0}; string name = \"\", how "
      "= \"\";"
      " attribute(\"ShadingRate\", rate); option(\"Format\", fmt); rendererinfo(\"renderer\", name);"
      " float found = displacement(\"height\", h) + displacement(\"how\", how) + displacement(\"absent\", h);"
      " mark = found; Ci = color(rate, h + raylevel() * 10, fmt[0]);"
      " if (name == \"frankenrender\" && how == \"deep\" && shadername() == \"t\") mark += 10;"
      " printf(\"%f %s\\n\", rate, name); }");
  ASSERT_TRUE(displacement && s) << f.error;
  Machine::Partners partners;
  partners.displacement = displacement.get();
  partners.surface = s.get();
  f.run(*s, {}, partners);
  EXPECT_NEAR(f.Ci(0, 0), 0.25, 1e-6);
  EXPECT_NEAR(f.Ci(0, 1), 20.75, 1e-5);
  EXPECT_NEAR(f.Ci(0, 2), 640, 1e-3);
  EXPECT_NEAR(f.machine.result("mark").at(0), 12, 1e-6);
  EXPECT_EQ(f.host.printed, "0.25 frankenrender\n");
}

TEST_F(MachineTest, EndlessLoopsEnd) {
  setReportSink([](const Error&) {});
  auto s = f.shader("surface t() { float i = 0; while (i < 1) { Ci = 1; } }");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  setReportSink({});
}

TEST(Strings, WidthAndPrecisionOfFormats) {
  MachineFixture m;
  auto s = m.shader(
      "surface a() { printf(\"%s|%04d|%.2f|%-4d|%5s|%g|%f|%99999d|%d\\n\", concat(\"t.\", format(\"%03d\", "
      "7)), 42, 1.005, 3,"
      " \"ab\", 0.5, 0.25, 1, -2.7); }");
  ASSERT_TRUE(s) << m.error;
  m.run(*s);
  EXPECT_EQ(m.host.printed.substr(0, 42), "t.007|0042|1.00|3   |   ab|0.5|0.25|      ") << m.host.printed;
}

TEST(Statements, RightSideOfAndAndOrOnlyWhereItDecides) {
  MachineFixture m;
  auto s = m.shader(
      "float touch(output float n; float r) { n += 1; return r; }\n"
      "surface a() { float n = 0, k = 0; if (u > 0.5 && touch(n, v) > 0.5) k += 1; if (u > 0.5 || touch(n, "
      "v) > 0.5) k += 2;"
      " float z = (v > 0.5 && (n += 10) > 0); Ci = color(n, k, z); }");
  ASSERT_TRUE(s) << m.error;
  m.run(*s);
  for (uint32_t i = 0; i < m.count; ++i) {
    const float u = m.batch.globals[size_t(GlobalId::k_u)].at(i),
                v = m.batch.globals[size_t(GlobalId::k_v)].at(i);
    EXPECT_EQ(m.Ci(i, 0), 1 + (v > 0.5f ? 10 : 0)) << i;  // each point evaluates one of the two
    EXPECT_EQ(m.Ci(i, 1), (u > 0.5f && v > 0.5f ? 1 : 0) + (u > 0.5f || v > 0.5f ? 2 : 0)) << i;
    EXPECT_EQ(m.Ci(i, 2), v > 0.5f ? 1 : 0) << i;
  }
}

TEST(Arrays, InitialisersFromValuesThatAreNotConstant) {
  MachineFixture m;
  auto s = m.shader(
      "surface a(string names[3] = {\"a\", \"b\", \"c\"}; float k = 2; float w[2] = {k, k * 3}; color c[2] = "
      "color(k, 1, 0);)"
      " { float x[2] = {u, v}; float y[3] = u; Ci = color(x[0] + x[1], y[2], w[1]) + c[1] + (names[2] == "
      "\"c\" ? 1 : 0); }");
  ASSERT_TRUE(s) << m.error;
  m.run(*s);
  for (uint32_t i = 0; i < m.count; ++i) {
    const float u = m.batch.globals[size_t(GlobalId::k_u)].at(i),
                v = m.batch.globals[size_t(GlobalId::k_v)].at(i);
    EXPECT_EQ(m.Ci(i, 0), (u + v) + 2 + 1);
    EXPECT_EQ(m.Ci(i, 1), u + 1 + 1);
    EXPECT_EQ(m.Ci(i, 2), 7);
  }
}

}  // namespace
}  // namespace fr
