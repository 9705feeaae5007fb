// Built-in functions, one by one: their values against definitions in double precision, uniform against
// varying, the same bits in every batch, kernels and machine code, derivatives.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>

#include "shading/machine_fixture.h"

namespace fr {
namespace {

using Numbers = std::array<double, 3>;
/// What a point has: a, b, c in -2..2 and A, B, C in the same range by component.
struct Given {
  double a, b, c;
  Numbers A, B, C;
};
struct Builtin {
  const char* expression;  // RSL over a, b, c, A, B, C
  std::function<Numbers(const Given&)> expected;
  double tolerance = 3e-6;  // relative to the larger of 1 and the value
  bool smooth = false;      // its derivatives are tested too
};

Numbers all(double x) { return {x, x, x}; }
Numbers by(const Numbers& x, const Numbers& y, double (*f)(double, double)) {
  return {f(x[0], y[0]), f(x[1], y[1]), f(x[2], y[2])};
}
Numbers scaled(const Numbers& x, double k) { return {x[0] * k, x[1] * k, x[2] * k}; }
Numbers sum(const Numbers& x, const Numbers& y) { return {x[0] + y[0], x[1] + y[1], x[2] + y[2]}; }
double dot(const Numbers& x, const Numbers& y) { return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]; }
Numbers cross(const Numbers& x, const Numbers& y) {
  return {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
}
double length(const Numbers& x) { return std::sqrt(dot(x, x)); }
Numbers unit(const Numbers& x) { return scaled(x, 1 / length(x)); }
double clamped(double x, double lo, double hi) { return std::min(std::max(x, lo), hi); }
double smoothstep(double lo, double hi, double x) {
  if (lo >= hi) return x < lo ? 0 : 1;
  const double t = clamped((x - lo) / (hi - lo), 0, 1);
  return t * t * (3 - 2 * t);
}
double modulo(double x, double y) { return x - y * std::floor(x / y); }
double fresnel(double cosine, double eta) {
  const double g2 = 1 / (eta * eta) - 1 + cosine * cosine;
  if (g2 < 0) return 1;
  const double g = std::sqrt(g2), d = (g - cosine) / (g + cosine),
               e = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1);
  return 0.5 * d * d * (1 + e * e);
}
Numbers rotated(const Numbers& q, double angle, const Numbers& axis) {
  const double c = std::cos(angle), s = std::sin(angle);
  return sum(sum(scaled(q, c), scaled(cross(axis, q), s)), scaled(axis, dot(axis, q) * (1 - c)));
}
double catmullRom(double x, const std::vector<double>& k) {
  const size_t segments = k.size() - 3;
  const double at = clamped(x, 0, 1) * double(segments);
  const size_t s = std::min(size_t(at), segments - 1);
  const double t = at - double(s), p0 = k[s], p1 = k[s + 1], p2 = k[s + 2], p3 = k[s + 3];
  return 0.5 * (2 * p1 + (p2 - p0) * t + (2 * p0 - 5 * p1 + 4 * p2 - p3) * t * t +
                (3 * p1 - p0 - 3 * p2 + p3) * t * t * t);
}
double bezier(double x, double p0, double p1, double p2, double p3) {
  const double t = clamped(x, 0, 1), u = 1 - t;
  return u * u * u * p0 + 3 * u * u * t * p1 + 3 * u * t * t * p2 + t * t * t * p3;
}
double bspline(double x, double p0, double p1, double p2, double p3) {
  const double t = clamped(x, 0, 1);
  return ((1 - t) * (1 - t) * (1 - t) * p0 + (3 * t * t * t - 6 * t * t + 4) * p1 +
          (-3 * t * t * t + 3 * t * t + 3 * t + 1) * p2 + t * t * t * p3) /
         6;
}

std::vector<Builtin> builtins() {
  using G = const Given&;
  return {
      {"radians(a * 90)", [](G g) { return all(g.a * M_PI / 2); }, 3e-6, true},
      {"degrees(a)", [](G g) { return all(g.a * 180 / M_PI); }},
      {"sin(3 * a)", [](G g) { return all(std::sin(3 * g.a)); }, 3e-6, true},
      {"cos(a + b)", [](G g) { return all(std::cos(g.a + g.b)); }, 3e-6, true},
      {"tan(a / 2)", [](G g) { return all(std::tan(g.a / 2)); }, 3e-6, true},
      {"asin(a / 2.1)", [](G g) { return all(std::asin(g.a / 2.1)); }},
      {"acos(a)", [](G g) { return all(std::acos(clamped(g.a, -1, 1))); }, 3e-6},
      {"atan(a)", [](G g) { return all(std::atan(g.a)); }, 3e-6, true},
      {"atan(a, b)", [](G g) { return all(std::atan2(g.a, g.b)); }},
      {"pow(abs(a) + .1, b)", [](G g) { return all(std::pow(std::fabs(g.a) + .1, g.b)); }, 1e-5},
      {"pow(a, 3)", [](G g) { return all(g.a * g.a * g.a); }, 1e-5, true},
      {"exp(a * 3)", [](G g) { return all(std::exp(g.a * 3)); }, 3e-6, true},
      {"sqrt(a)", [](G g) { return all(std::sqrt(std::max(0.0, g.a))); }},
      {"inversesqrt(abs(a) + .5)", [](G g) { return all(1 / std::sqrt(std::fabs(g.a) + .5)); }},
      {"log(abs(a) + .01)", [](G g) { return all(std::log(std::fabs(g.a) + .01)); }},
      {"log(abs(a) + .1, 2)", [](G g) { return all(std::log2(std::fabs(g.a) + .1)); }, 1e-5},
      {"erf(a)", [](G g) { return all(std::erf(g.a)); }, 3e-6, true},
      {"erfc(a)", [](G g) { return all(std::erfc(g.a)); }, 3e-6, true},
      {"mod(a, .7)", [](G g) { return all(modulo(g.a, 0.7f)); }, 1e-5},
      {"abs(a)", [](G g) { return all(std::fabs(g.a)); }, 0},
      {"sign(a)", [](G g) { return all(g.a < 0   ? -1
                                       : g.a > 0 ? 1
                                                 : 0); }, 0},
      {"floor(4 * a)", [](G g) { return all(std::floor(4 * g.a)); }, 0},
      {"ceil(4 * a)", [](G g) { return all(std::ceil(4 * g.a)); }, 0},
      {"round(4 * a)", [](G g) { return all(std::round(4 * g.a)); }, 0},
      {"min(a, b, c)",
       [](G g) {
         return all(std::min({g.a, g.b, g.c}));
       },
       0},
      {"max(a, b, c)",
       [](G g) {
         return all(std::max({g.a, g.b, g.c}));
       },
       0},
      {"min(A, B)", [](G g) { return by(g.A, g.B, [](double x, double y) { return std::min(x, y); }); }, 0},
      {"max(A, B, C)",
       [](G g) {
         const auto f = [](double x, double y) { return std::max(x, y); };
         return by(by(g.A, g.B, f), g.C, f);
       },
       0},
      {"clamp(a, -.5, .5)", [](G g) { return all(clamped(g.a, -.5, .5)); }, 0},
      {"clamp(a, .5, -.5)", [](G) { return all(.5); }, 0},
      {"clamp(A, B, B + 1)",
       [](G g) {
         Numbers r;
         for (size_t k = 0; k < 3; ++k) r[k] = clamped(g.A[k], g.B[k], g.B[k] + 1);
         return r;
       }},
      {"mix(a, b, c)", [](G g) { return all(g.a * (1 - g.c) + g.b * g.c); }, 3e-6, true},
      {"mix(A, B, c)", [](G g) { return sum(scaled(g.A, 1 - g.c), scaled(g.B, g.c)); }},
      {"step(a, b)", [](G g) { return all(g.b < g.a ? 0 : 1); }, 0},
      {"smoothstep(-1, 1.5, a)", [](G g) { return all(smoothstep(-1, 1.5, g.a)); }, 3e-6, true},
      {"smoothstep(a, b, c)", [](G g) { return all(smoothstep(g.a, g.b, g.c)); }, 1e-4},
      {"filterstep(a, b, c)",
       [](G g) {
         const double w = std::fabs(g.c - g.b);
         return all(clamped(((g.b + g.c) / 2 - g.a) / w + .5, 0, 1));
       },
       1e-3},
      {"spline(a, .2, .3, .9, .1, .5, .4)",
       [](G g) {
         return all(catmullRom(g.a, {.2, .3, .9, .1, .5, .4}));
       },
       1e-5},
      {"spline(a, A, B, C, A)",
       [](G g) {
         Numbers r;
         for (size_t k = 0; k < 3; ++k) r[k] = catmullRom(g.a, {g.A[k], g.B[k], g.C[k], g.A[k]});
         return r;
       },
       1e-5},
      {"spline(\"bezier\", a, .2, .9, -.4, .6)", [](G g) { return all(bezier(g.a, .2, .9, -.4, .6)); }, 1e-5},
      {"spline(\"bspline\", a, .2, .9, -.4, .6)", [](G g) { return all(bspline(g.a, .2, .9, -.4, .6)); },
       1e-5},
      {"spline(\"linear\", a, 9, .2, .6, 9)", [](G g) { return all(.2 + .4 * clamped(g.a, 0, 1)); }, 1e-5},
      {"xcomp(A) + 10 * ycomp(B) + 100 * zcomp(C)",
       [](G g) { return all(g.A[0] + 10 * g.B[1] + 100 * g.C[2]); }},
      {"comp(color A, 1)", [](G g) { return all(g.A[1]); }, 0},
      {"A . B", [](G g) { return all(dot(g.A, g.B)); }},
      {"A ^ B", [](G g) { return cross(g.A, g.B); }},
      {"length(B)", [](G g) { return all(length(g.B)); }},
      {"distance(A, point C)",
       [](G g) {
         return all(length({g.A[0] - g.C[0], g.A[1] - g.C[1], g.A[2] - g.C[2]}));
       }},
      {"normalize(B)", [](G g) { return unit(g.B); }},
      {"ptlined(A, point B, point C)",
       [](G g) {
         const Numbers d = sum(g.B, scaled(g.A, -1)), q = sum(g.C, scaled(g.A, -1));
         const double t = clamped(dot(q, d) / dot(d, d), 0, 1);
         return all(length(sum(q, scaled(d, -t))));
       },
       1e-5},
      {"rotate(A, a, point (0, 0, 0), point (1, 2, 2))",
       [](G g) {
         return rotated(g.A, g.a, {1 / 3.0, 2 / 3.0, 2 / 3.0});
       },
       1e-5},
      {"faceforward(C, B, C)", [](G g) { return dot(g.B, g.C) > 0 ? scaled(g.C, -1) : g.C; }, 0},
      {"reflect(B, normalize(C))",
       [](G g) {
         const Numbers n = unit(g.C);
         return sum(g.B, scaled(n, -2 * dot(g.B, n)));
       },
       1e-5},
      {"refract(normalize(B), faceforward(normalize(C), B, C), .8)",
       [](G g) {
         const Numbers i = unit(g.B), m = unit(g.C), n = dot(g.B, g.C) > 0 ? scaled(m, -1) : m;
         const double d = dot(i, n), eta = 0.8f, k = 1 - eta * eta * (1 - d * d);
         return k < 0 ? all(0) : sum(scaled(i, eta), scaled(n, -(eta * d + std::sqrt(k))));
       },
       2e-5},
      {"reflectance(normalize(B), faceforward(normalize(C), B, C))",
       [](G g) { return all(fresnel(std::fabs(dot(unit(g.B), unit(g.C))), 2 / 3.0)); }, 2e-5},
      {"ctransform(\"hsv\", \"rgb\", color (mod(a, 1), .5, .8))",
       [](G g) {
         const double h = modulo(g.a, 1) * 6, f = h - std::floor(h), v = 0.8, p = v * .5,
                      q = v * (1 - .5 * f), t = v * (1 - .5 * (1 - f));
         const int k = int(std::floor(h)) % 6;
         const Numbers table[] = {{v, t, p}, {q, v, p}, {p, v, t}, {p, q, v}, {t, p, v}, {v, p, q}};
         return table[k];
       },
       1e-5},
      {"transform(translate(matrix 1, vector (a, b, c)), A)",
       [](G g) {
         return sum(g.A, {g.a, g.b, g.c});
       }},
      {"transform(rotate(matrix 1, a, vector (0, 0, 1)), A)",
       [](G g) {
         return rotated(g.A, g.a, {0, 0, 1});
       },
       1e-5},
      {"vtransform(scale(matrix 1, point (2, 3, 4)), B)",
       [](G g) {
         return Numbers{2 * g.B[0], 3 * g.B[1], 4 * g.B[2]};
       }},
      {"ntransform(scale(matrix 1, point (2, 4, 8)), C)",
       [](G g) {
         return Numbers{g.C[0] / 2, g.C[1] / 4, g.C[2] / 8};
       }},
      {"determinant(scale(matrix 1, point (a, 2, b)))", [](G g) { return all(2 * g.a * g.b); }, 1e-5},
      {"transform(1 / translate(matrix 1, vector (a, b, c)), A)",
       [](G g) {
         return sum(g.A, {-g.a, -g.b, -g.c});
       },
       1e-5},
      {"cellnoise(a) - cellnoise(floor(a))", [](G) { return all(0); }, 0},
      {"noise(floor(a * 8))", [](G) { return all(.5); }},
      {"pnoise(a, 3) - pnoise(a + 3, 3)", [](G) { return all(0); }, 2e-5},
      {"a > b && b > c ? 1 : a != c ? 2 : 3",
       [](G g) { return all(g.a > g.b && g.b > g.c ? 1
                            : g.a != g.c           ? 2
                                                   : 3); }, 0},
  };
}

constexpr const char* kFunctions =
    "float reflectance(vector i; normal n) { float kr, kt; fresnel(i, n, 1 / 1.5, kr, kt); return kr; }\n";

/// Every point's numbers follow from its index alone.
float number(uint32_t point, uint32_t which) {
  return float(hashStep(91 + which, point) >> 40) / 4194304.0f - 2;
}

class Builtins : public testing::Test {
 protected:
  void fill(MachineFixture& m) {
    const auto set = [&](GlobalId id, uint32_t component, uint32_t which) {
      for (uint32_t i = 0; i < m.lanes; ++i)
        m.batch.globals[size_t(id)].comp(component)[i] = number(i, which);
    };
    set(GlobalId::k_u, 0, 0), set(GlobalId::k_v, 0, 1), set(GlobalId::k_s, 0, 2);
    for (uint32_t c = 0; c < 3; ++c)
      set(GlobalId::k_P, c, 3 + c), set(GlobalId::k_I, c, 6 + c), set(GlobalId::k_N, c, 9 + c);
  }
  static Given given(uint32_t i) {
    const auto n = [&](uint32_t k) { return double(number(i, k)); };
    return {n(0), n(1), n(2), {n(3), n(4), n(5)}, {n(6), n(7), n(8)}, {n(9), n(10), n(11)}};
  }
  static std::string varying(const std::string& e) {
    return std::string(kFunctions) +
           "surface t() { float a = u, b = v, c = s; point A = P; vector B = I; normal C = N; Ci = color (" +
           e + "); }";
  }
  static std::string uniform(const std::string& e) {
    return std::string(kFunctions) +
           "surface t(uniform float a = 0, b = 0, c = 0; uniform point A = 0; uniform vector B = 0; uniform "
           "normal C "
           "= 0) { Ci = color (" +
           e + "); }";
  }
};

TEST_F(Builtins, AgreeWithTheirDefinitionsInEveryBatch) {
  // Around the width of vectors and of registers; points keep their values from batch to batch.
  constexpr uint32_t kSizes[] = {1, 7, 8, 9, 15, 16, 17, 255, 256};
  for (const Builtin& f : builtins()) {
    SCOPED_TRACE(f.expression);
    std::vector<std::array<float, 3>> known;
    for (const bool native : {false, true})
      for (const uint32_t size : kSizes) {
        MachineFixture m(size - 1, 0);
        m.native = native;
        fill(m);
        const auto s = m.shader(varying(f.expression));
        ASSERT_TRUE(s) << m.error;
        m.run(*s);
        for (uint32_t i = 0; i < m.count; ++i) {
          const Numbers expected = f.expected(given(i));
          for (uint32_t c = 0; c < 3; ++c) {
            const float got = m.Ci(i, c);
            if (i == known.size()) known.emplace_back();
            if (i + 1 == known.size() && size > known.size() - 1 && !native) known[i][c] = got;
            ASSERT_NEAR(got, expected[c], f.tolerance * std::max(1.0, std::fabs(expected[c])))
                << "point " << i;
            ASSERT_EQ(std::memcmp(&got, &known[i][c], sizeof got), 0)
                << "point " << i << " of " << size << (native ? ", machine code" : "") << ": " << got
                << " and " << known[i][c];
          }
        }
      }
  }
}

TEST_F(Builtins, UniformValuesAreThoseOfOnePoint) {
  for (const Builtin& f : builtins()) {
    SCOPED_TRACE(f.expression);
    for (const bool native : {false, true}) {
      MachineFixture m(16, 0);
      m.native = native;
      fill(m);
      const auto v = m.shader(varying(f.expression));
      ASSERT_TRUE(v) << m.error;
      m.run(*v);
      std::vector<std::array<float, 3>> points;
      for (uint32_t i = 0; i < m.count; ++i) points.push_back({m.Ci(i, 0), m.Ci(i, 1), m.Ci(i, 2)});
      for (uint32_t i = 0; i < m.count; i += 5) {
        std::vector<ParameterSetting> settings;
        const auto set = [&](const char* name, std::initializer_list<uint32_t> which) {
          ShaderValue value;
          value.type = which.size() == 1 ? SlType::kFloat : SlType::kPoint;
          for (const uint32_t k : which) value.floats.push_back(number(i, k));
          settings.push_back({name, value});
        };
        set("a", {0}), set("b", {1}), set("c", {2}), set("A", {3, 4, 5}), set("B", {6, 7, 8}),
            set("C", {9, 10, 11});
        const auto u = m.shader(uniform(f.expression), settings);
        ASSERT_TRUE(u) << m.error;
        m.run(*u);
        for (uint32_t lane = 0; lane < m.count; ++lane)
          for (uint32_t c = 0; c < 3; ++c)
            ASSERT_EQ(m.Ci(lane, c), points[i][c]) << "point " << i << " lane " << lane;
      }
    }
  }
}

TEST_F(Builtins, DerivativesAreDifferencesOfValues) {
  // A grid over a = u and b = v, c = s constant; differences of the definition at the neighbours, exactly as
  // RISpec 16 has them: central inside, one-sided at the borders.
  constexpr uint32_t n = 16;
  for (const Builtin& f : builtins()) {
    if (!f.smooth) continue;
    SCOPED_TRACE(f.expression);
    MachineFixture m(n, n);
    for (uint32_t i = 0; i < m.lanes; ++i) m.batch.globals[size_t(GlobalId::k_s)].data[i] = 0.25f;
    DerivativeStencil d;
    gridStencil(d, n, n, m.lanes, 1.0f / n, 1.0f / n);
    m.batch.stencil = &d;
    const auto s = m.shader(std::string("surface t() { float a = u, b = v, c = s; float f = ") +
                            f.expression + "; Ci = color (Du(f), Dv(f), Deriv(f, u + 2 * v)); }");
    ASSERT_TRUE(s) << m.error;
    m.run(*s);
    const auto value = [&](uint32_t x, uint32_t y) {
      Given g{};
      g.a = double(x) / n, g.b = double(y) / n, g.c = 0.25;
      return f.expected(g)[0];
    };
    for (uint32_t y = 0; y <= n; ++y)
      for (uint32_t x = 0; x <= n; ++x) {
        const uint32_t l = x > 0 ? x - 1 : x, r = std::min(x + 1, n), b = y > 0 ? y - 1 : y,
                       t = std::min(y + 1, n);
        const double du = (value(r, y) - value(l, y)) * n / (r - l),
                     dv = (value(x, t) - value(x, b)) * n / (t - b);
        const uint32_t i = y * (n + 1) + x;
        // Rounding of the values (some 1e-7) times n.
        const double tolerance = 5e-5 * std::max({1.0, std::fabs(du), std::fabs(dv)});
        ASSERT_NEAR(m.Ci(i, 0), du, tolerance) << x << ' ' << y;
        ASSERT_NEAR(m.Ci(i, 1), dv, tolerance) << x << ' ' << y;
        ASSERT_NEAR(m.Ci(i, 2), du + dv / 2, tolerance) << x << ' ' << y;
      }
  }
}

TEST_F(Builtins, DerivativesOfActivePointsAlone) {
  // Neighbours that are not active count as the point itself: du is one-sided where one is missing.
  constexpr uint32_t n = 8;
  for (const bool native : {false, true}) {
    MachineFixture m(n, n);
    m.native = native;
    DerivativeStencil d;
    gridStencil(d, n, n, m.lanes, 1.0f / n, 1.0f / n);
    m.batch.stencil = &d;
    const auto s =
        m.shader("surface t() { float r = -1; if (u < .6) { float x = u * u; r = Du(x); } Ci = r; }");
    ASSERT_TRUE(s) << m.error;
    m.run(*s);
    for (uint32_t y = 0; y <= n; ++y)
      for (uint32_t x = 0; x <= n; ++x) {
        const double h = 1.0 / n, u = x * h;
        const uint32_t last = 4;  // u = 0.5
        const double want = x > last ? -1 : x == 0 ? h : x == last ? 2 * u - h : 2 * u;
        EXPECT_NEAR(m.Ci(y * (n + 1) + x), want, 1e-5) << x << ' ' << y;
      }
  }
}

}  // namespace
}  // namespace fr
