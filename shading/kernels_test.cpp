// Every elementwise kernel against double precision, uniform against varying operands, every instruction set
// against the others bit for bit.
#include "shading/kernels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <random>

#include "base/isa.h"
#include "base/random.h"
#include "base/sobol.h"

namespace fr {
namespace {

/// A register file of aligned columns for tests.
class Columns {
 public:
  explicit Columns(uint32_t lanes) : lanes_(lanes) {}
  Operand varying(uint32_t components) {
    float* p = allocate(lanes_ * components);
    return {p, lanes_, ~0u};
  }
  Operand uniform(uint32_t components) {
    float* p = allocate(kLanePad * components);
    return {p, kLanePad, kLanePad - 1};
  }
  static void setUniform(const Operand& o, uint32_t c, float v) {
    for (uint32_t i = 0; i < kLanePad; ++i) o.comp(c)[i] = v;
  }

 private:
  float* allocate(size_t n) {
    blocks_.emplace_back(static_cast<float*>(std::aligned_alloc(64, n * sizeof(float))), &std::free);
    std::memset(blocks_.back().get(), 0, n * sizeof(float));
    return blocks_.back().get();
  }
  uint32_t lanes_;
  std::vector<std::unique_ptr<float, decltype(&std::free)>> blocks_;
};

std::vector<int> availableSets() {
  std::vector<int> r;
  for (int i = 0; i <= int(currentIsa()); ++i) r.push_back(i);
  return r;
}
void run(int isa, Op op, const std::vector<Operand>& args, uint32_t lanes, const int32_t* mask = nullptr) {
  KernelCall c;
  c.arg = args.data(), c.argCount = uint32_t(args.size()), c.lanes = lanes, c.mask = mask;
  ASSERT_NE(kernelsOf(isa).op[size_t(op)], nullptr) << opInfo(op).name;
  kernelsOf(isa).op[size_t(op)](c);
}

struct Unary {
  Op op;
  double (*f)(double);
  double lo, hi, tolerance;  // relative above 1, absolute below
};
double roundAway(double x) { return std::round(x); }
double signOf(double x) { return x > 0 ? 1 : x < 0 ? -1 : 0; }
double radiansOf(double x) { return x * M_PI / 180; }
double degreesOf(double x) { return x * 180 / M_PI; }
double negate(double x) { return -x; }
double isZero(double x) { return x == 0; }
double guardedSqrt(double x) { return x < 0 ? 0 : std::sqrt(x); }
double guardedInverse(double x) { return x <= 0 ? 0 : 1 / std::sqrt(x); }
const Unary kUnary[] = {
    {Op::sin, std::sin, -100, 100, 3e-7},
    {Op::cos, std::cos, -100, 100, 3e-7},
    {Op::sin, std::sin, -1e6, 1e6, 3e-7},
    {Op::tan, std::tan, -1.5, 1.5, 2e-6},
    {Op::asin, std::asin, -1, 1, 4e-7},
    {Op::acos, std::acos, -1, 1, 6e-7},
    {Op::atan, std::atan, -50, 50, 3e-7},
    {Op::exp, std::exp, -20, 80, 1e-6},
    {Op::log, std::log, 1e-6, 1e6, 3e-7},
    {Op::sqrt, guardedSqrt, -1, 1e4, 1e-7},
    {Op::inversesqrt, guardedInverse, -1, 1e4, 3e-7},
    {Op::erf, std::erf, -4, 4, 5e-7},
    {Op::erfc, std::erfc, -4, 4, 5e-7},
    {Op::floor, std::floor, -9, 9, 0},
    {Op::ceil, std::ceil, -9, 9, 0},
    {Op::round, roundAway, -9, 9, 0},
    {Op::sign, signOf, -1, 1, 0},
    {Op::abs, std::fabs, -9, 9, 0},
    {Op::radians, radiansOf, -720, 720, 3e-7},
    {Op::degrees, degreesOf, -9, 9, 3e-7},
    {Op::neg_f, negate, -9, 9, 0},
    {Op::not_f, isZero, -1, 1, 0},
};
void expectClose(double got, double want, double tolerance, const char* what, double x, double y = 0) {
  EXPECT_LE(std::fabs(got - want), tolerance * std::max(1.0, std::fabs(want)))
      << what << "(" << x << ", " << y << ") = " << got << ", want " << want;
}

TEST(Kernels, UnaryFunctionsAgreeWithDouble) {
  for (const Unary& u : kUnary) {
    Columns c(1024);
    const Operand in = c.varying(1);
    for (uint32_t i = 0; i < 1024; ++i) in.data[i] = float(u.lo + (u.hi - u.lo) * i / 1023.0);
    std::vector<Operand> results;
    for (int isa : availableSets()) {
      results.push_back(c.varying(1));
      run(isa, u.op, {results.back(), in}, 1024);
    }
    for (uint32_t i = 0; i < 1024; ++i)
      expectClose(results[0].data[i], u.f(double(in.data[i])), u.tolerance, opInfo(u.op).name, in.data[i]);
    for (const Operand& r : results)
      EXPECT_EQ(0, std::memcmp(r.data, results[0].data, 4096))
          << opInfo(u.op).name << " differs between sets";
  }
}

struct Binary {
  Op op;
  double (*f)(double, double);
  double lo, hi, tolerance;
};
const Binary kBinary[] = {
    {Op::add_f, [](double a, double b) { return a + b; }, -5, 5, 1e-7},
    {Op::sub_f, [](double a, double b) { return a - b; }, -5, 5, 1e-7},
    {Op::mul_f, [](double a, double b) { return a * b; }, -5, 5, 1e-7},
    {Op::div_f, [](double a, double b) { return b == 0 ? 0 : a / b; }, -5, 5, 1e-7},
    {Op::mod, [](double a, double b) { return b == 0 ? 0 : a - b * std::floor(a / b); }, 0.5, 5, 2e-6},
    {Op::min_f, [](double a, double b) { return std::min(a, b); }, -5, 5, 0},
    {Op::max_f, [](double a, double b) { return std::max(a, b); }, -5, 5, 0},
    {Op::atan2, [](double a, double b) { return std::atan2(a, b); }, -5, 5, 5e-7},
    {Op::pow, [](double a, double b) { return std::pow(a, b); }, 0.01, 9, 2e-6},
    {Op::step, [](double a, double b) { return b < a ? 0.0 : 1.0; }, -5, 5, 0},
    {Op::lt_f, [](double a, double b) { return a < b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::le_f, [](double a, double b) { return a <= b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::gt_f, [](double a, double b) { return a > b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::ge_f, [](double a, double b) { return a >= b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::eq_f, [](double a, double b) { return a == b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::ne_f, [](double a, double b) { return a != b ? 1.0 : 0.0; }, -5, 5, 0},
    {Op::and_f, [](double a, double b) { return a != 0 && b != 0 ? 1.0 : 0.0; }, 0, 1, 0},
    {Op::or_f, [](double a, double b) { return a != 0 || b != 0 ? 1.0 : 0.0; }, 0, 1, 0},
    {Op::log2arg, [](double a, double b) { return std::log(a) / std::log(b); }, 1.5, 90, 1e-6},
};

TEST(Kernels, BinaryFunctionsAgreeWithDoubleForEveryMixtureOfUniformAndVarying) {
  std::mt19937 random(7);
  for (const Binary& b : kBinary) {
    for (int mixture = 0; mixture < 4; ++mixture) {
      Columns c(64);
      const Operand x = mixture & 1 ? c.uniform(1) : c.varying(1);
      const Operand y = mixture & 2 ? c.uniform(1) : c.varying(1);
      std::uniform_real_distribution<double> d(b.lo, b.hi);
      const float ux = float(d(random)), uy = float(d(random));
      for (uint32_t i = 0; i < 64; ++i) {
        x.data[i & x.indexMask] = mixture & 1 ? ux : i % 9 == 0 && b.lo <= 0 ? 0.0f : float(d(random));
        y.data[i & y.indexMask] = mixture & 2 ? uy : i % 7 == 0 && b.lo <= 0 ? 0.0f : float(d(random));
      }
      for (int isa : availableSets()) {
        const Operand out = mixture == 3 ? c.uniform(1) : c.varying(1);
        run(isa, b.op, {out, x, y}, mixture == 3 ? kLanePad : 64);
        for (uint32_t i = 0; i < 64; ++i)
          expectClose(out.at(i), b.f(x.at(i), y.at(i)), b.tolerance, opInfo(b.op).name, x.at(i), y.at(i));
      }
    }
  }
}

TEST(Kernels, DomainErrorsAreFiniteAndDefined) {
  const auto eval = [](Op op, float a, float b = 0) {
    Columns c(16);
    const Operand x = c.uniform(1), y = c.uniform(1), out = c.uniform(1);
    Columns::setUniform(x, 0, a), Columns::setUniform(y, 0, b);
    run(int(currentIsa()), op, {out, x, y}, 16);
    return out.at(3);
  };
  EXPECT_EQ(eval(Op::sqrt, -4), 0);
  EXPECT_EQ(eval(Op::inversesqrt, 0), 0);
  EXPECT_EQ(eval(Op::log, 0), -1e38f);
  EXPECT_EQ(eval(Op::log, -2), -1e38f);
  EXPECT_EQ(eval(Op::pow, -2, 0.5f), 0);
  EXPECT_NEAR(eval(Op::pow, -2, 3), -8, 1e-5);
  EXPECT_NEAR(eval(Op::pow, -2, 4), 16, 1e-5);
  EXPECT_EQ(eval(Op::pow, 0, 0), 1);
  EXPECT_EQ(eval(Op::pow, 0, 2), 0);
  EXPECT_EQ(eval(Op::pow, 0, -2), 0);
  EXPECT_EQ(eval(Op::pow, 1, 1e9f), 1);
  EXPECT_TRUE(std::isfinite(eval(Op::pow, 1e30f, 30)));
  EXPECT_EQ(eval(Op::pow, 1e-30f, 30), 0);
  EXPECT_EQ(eval(Op::div_f, 3, 0), 0);
  EXPECT_TRUE(std::isfinite(eval(Op::div_f, 1e30f, 1e-30f)));
  EXPECT_TRUE(std::isfinite(eval(Op::exp, 1e30f)));
  EXPECT_NEAR(eval(Op::exp, 88.5f) / 2.72e38, 1.0, 0.01);
  EXPECT_EQ(eval(Op::exp, -1e30f), 0);
  EXPECT_EQ(eval(Op::asin, 2), float(M_PI / 2));
  EXPECT_EQ(eval(Op::mod, 3, 0), 0);
  EXPECT_NEAR(eval(Op::mod, -1, 3), 2, 1e-6);
  EXPECT_TRUE(std::isfinite(eval(Op::sin, 1e30f)));
  EXPECT_EQ(eval(Op::atan2, 0, 0), 0);
}

TEST(Kernels, MaskedAssignmentLeavesInactivePointsAlone) {
  for (int isa : availableSets())
    for (uint32_t lanes : {16u, 32u, 48u}) {
      Columns c(lanes);
      const Operand out = c.varying(3), in = c.uniform(3), mask = c.varying(1);
      for (uint32_t k = 0; k < 3; ++k) Columns::setUniform(in, k, float(k + 1));
      auto* m = reinterpret_cast<int32_t*>(mask.data);
      for (uint32_t i = 0; i < lanes; ++i) m[i] = i % 3 == 1 ? -1 : 0;
      run(isa, Op::assign_t, {out, in}, lanes, m);
      for (uint32_t i = 0; i < lanes; ++i)
        for (uint32_t k = 0; k < 3; ++k) EXPECT_EQ(out.at(i, k), i % 3 == 1 ? float(k + 1) : 0.0f);
    }
}

void fillRandom(const Operand& o, uint32_t components, uint32_t lanes, unsigned seed, float lo = -2,
                float hi = 2) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> d(lo, hi);
  for (uint32_t c = 0; c < components; ++c)
    for (uint32_t i = 0; i < lanes; ++i) o.comp(c)[i] = d(random);
}

TEST(Kernels, VectorIdentities) {
  constexpr uint32_t n = 256;
  for (int isa : availableSets()) {
    Columns c(n);
    const Operand a = c.varying(3), b = c.varying(3), f = c.varying(1), g = c.varying(1), r = c.varying(3);
    fillRandom(a, 3, n, 1), fillRandom(b, 3, n, 2);
    run(isa, Op::cross, {r, a, b}, n);
    run(isa, Op::dot, {f, r, a}, n);
    for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(f.at(i), 0, 1e-5);
    run(isa, Op::normalize, {r, a}, n);
    run(isa, Op::length, {f, r}, n);
    for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(f.at(i), 1, 1e-6);
    // A reflection keeps the length and turns the component along N.
    run(isa, Op::reflect, {b, a, r}, n);
    run(isa, Op::length, {f, a}, n), run(isa, Op::length, {g, b}, n);
    for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(f.at(i), g.at(i), 1e-5);
  }
  // Zero and huge vectors.
  Columns c(16);
  const Operand v = c.uniform(3), r = c.uniform(3), f = c.uniform(1);
  run(0, Op::normalize, {r, v}, 16);
  EXPECT_EQ(r.at(0, 0), 0);
  for (uint32_t k = 0; k < 3; ++k) Columns::setUniform(v, k, 1e30f);
  run(0, Op::length, {f, v}, 16);
  EXPECT_NEAR(f.at(0) / 1.7320508e30f, 1, 1e-5);
  run(0, Op::normalize, {r, v}, 16);
  EXPECT_NEAR(r.at(0, 1), 0.57735027, 1e-6);
}

TEST(Kernels, SeedsAndPairsAreThoseOfTheScalarFunctions) {
  constexpr uint32_t n = 64;
  std::vector<uint64_t> base(n), out(n);
  std::vector<uint32_t> counter(n), high(n);
  std::vector<float> x(n), y(n);
  for (uint32_t i = 0; i < n; ++i) base[i] = hashStep(3, i), counter[i] = i % 5;
  for (const int isa : availableSets())
    for (int way = 0; way < 3; ++way) {
      SeedHash h;
      h.base = way == 0 ? nullptr : base.data(), h.one = 99, h.site = 1234567890123ull, h.lanes = n;
      h.next = 7, h.hasNext = way == 1, h.counter = way == 2 ? counter.data() : nullptr;
      h.out = out.data(), h.high = high.data();
      kernelsOf(isa).hashSeeds(h);
      const SobolPairs pairs{uint32_t(5 * way + 1), n, high.data(), x.data(), y.data()};
      kernelsOf(isa).sobolPairs(pairs);
      for (uint32_t i = 0; i < n; ++i) {
        uint64_t want = hashStep(way == 0 ? 99 : base[i], h.site);
        if (way > 0) want = hashStep(want, way == 1 ? 7 : counter[i]);
        ASSERT_EQ(out[i], want) << isa << " " << way;
        ASSERT_EQ(high[i], uint32_t(want >> 32));
        const Vec2 pair = sobolOwen2(pairs.index, high[i]);
        ASSERT_EQ(x[i], pair.x);
        ASSERT_EQ(y[i], pair.y);
      }
    }
}

TEST(Kernels, DifferencesOfRowsOfAnyLength) {
  constexpr uint32_t n = 128;
  std::mt19937 random(9);
  std::uniform_real_distribution<float> value(-1, 1);
  for (const uint32_t row : {1u, 2u, 3u, 7u, 8u, 9u, 16u, 31u}) {
    Columns registers(n);
    const Operand x = registers.varying(3), out = registers.varying(3), cross = registers.varying(3);
    std::vector<uint16_t> lo[2], hi[2];
    std::vector<float> scale, cell;
    std::vector<int32_t> mask;
    for (uint32_t i = 0; i < n; ++i) {
      const uint32_t at[2] = {i % row, i / row}, step[2] = {1, row};
      for (int d = 0; d < 2; ++d) {
        lo[d].push_back(uint16_t(at[d] > 0 ? i - step[d] : i));
        hi[d].push_back(uint16_t((d == 0 ? at[0] + 1 < row && i + 1 < n : i + row < n) ? i + step[d] : i));
      }
      for (uint32_t c = 0; c < 3; ++c) x.comp(c)[i] = value(random);
      scale.push_back(value(random)), cell.push_back(value(random));
      mask.push_back(random() % 4 ? -1 : 0);
    }
    for (const bool masked : {false, true})
      for (const int isa : availableSets()) {
        Difference d[2];
        for (int k = 0; k < 2; ++k) {
          d[k].x = x.data, d[k].component = n, d[k].components = 3, d[k].lanes = n;
          d[k].lo = lo[k].data(), d[k].hi = hi[k].data(), d[k].scale = scale.data();
          d[k].cell = k == 0 ? cell.data() : nullptr;
          d[k].mask = masked ? mask.data() : nullptr;
        }
        const auto want = [&](int k, uint32_t i, uint32_t c) {
          uint32_t a = lo[k][i], b = hi[k][i];
          float s = scale[i] * (k == 0 ? cell[i] : 1.0f);
          if (masked) {
            const bool one = !mask[a] || !mask[b];
            if (one && a != i && b != i) s *= 2;
            if (!mask[a]) a = i;
            if (!mask[b]) b = i;
          }
          return (x.at(b, c) - x.at(a, c)) * s;
        };
        for (int k = 0; k < 2; ++k) {
          d[k].out = out.data, d[k].outComponent = n;
          kernelsOf(isa).difference(d[k]);
          for (uint32_t i = 0; i < n; ++i)
            for (uint32_t c = 0; c < 3; ++c)
              ASSERT_EQ(out.at(i, c), want(k, i, c)) << isa << ' ' << row << ' ' << i << ' ' << c;
        }
        d[0].out = cross.data, d[0].outComponent = n;
        kernelsOf(isa).crossOfDifferences(d[0], d[1], -1.0f);
        for (uint32_t i = 0; i < n; ++i)
          for (uint32_t c = 0; c < 3; ++c) {
            const uint32_t y = (c + 1) % 3, z = (c + 2) % 3;
            ASSERT_EQ(cross.at(i, c), -(want(0, i, y) * want(1, i, z) - want(0, i, z) * want(1, i, y)));
          }
      }
  }
}

TEST(Kernels, RaysHaveTheSameBitsOnEverySet) {
  constexpr uint32_t n = 64, row = 8;
  Columns registers(n);
  const Operand P = registers.varying(3), to = registers.varying(3), unit = registers.varying(3);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> value(-1, 1);
  std::vector<uint16_t> lo[2], hi[2];
  std::vector<float> ones(n, 1.0f);
  std::vector<uint32_t> seed(n);
  for (uint32_t i = 0; i < n; ++i) {
    const uint32_t at[2] = {i % row, i / row}, step[2] = {1, row};
    for (int d = 0; d < 2; ++d) {
      lo[d].push_back(uint16_t(at[d] > 0 ? i - step[d] : i));
      hi[d].push_back(uint16_t(at[d] + 1 < row ? i + step[d] : i));
    }
    const float place[3] = {float(at[0]), float(at[1]), value(random)};
    float size = 0;
    for (uint32_t c = 0; c < 3; ++c)
      P.comp(c)[i] = place[c], to.comp(c)[i] = value(random), size += to.at(i, c) * to.at(i, c);
    for (uint32_t c = 0; c < 3; ++c) unit.comp(c)[i] = to.at(i, c) / std::sqrt(size);
    seed[i] = uint32_t(random());
  }
  to.comp(1)[62] = std::numeric_limits<float>::infinity();
  const Operand cone = registers.uniform(1), samples = registers.uniform(1);
  Columns::setUniform(cone, 0, 0.7f), Columns::setUniform(samples, 0, 4);
  std::vector<int32_t> mask(n, -1);
  mask[20] = 0;
  for (int way = 0; way < 8; ++way) {
    std::vector<float> first;
    for (const int isa : availableSets()) {
      std::vector<float> out(16 * n);
      std::vector<int32_t> on(n);
      const auto column = [&](int k) { return out.data() + k * n; };
      Footprints f;
      f.lanes = n, f.P = P;
      RayMaking r;
      for (int d = 0; d < 2; ++d) {
        f.lo[d] = r.lo[d] = lo[d].data(), f.hi[d] = r.hi[d] = hi[d].data();
        f.scale[d] = f.cell[d] = r.scale[d] = r.cell[d] = ones.data();
      }
      f.radius = column(0), f.spread = column(1), f.inward = column(2);
      kernelsOf(isa).footprints(f);
      r.lanes = n, r.from = r.P = P, r.direction = to, r.unit = unit;
      r.radius = f.radius, r.spread = f.spread, r.inward = f.inward, r.inwardComponent = n;
      r.segment = r.toPoint = way & 1;
      if (way & 2) r.cone = cone, r.samples = samples, r.seed = seed.data(), r.cosine = way & 4, r.sample = 3;
      if (way & 4) r.neighbourMask = mask.data();
      for (int c = 0; c < 3; ++c) r.origin[c] = column(5 + c), r.to[c] = column(8 + c);
      r.rayRadius = column(11), r.raySpread = column(12), r.pair[0] = column(13), r.pair[1] = column(14);
      r.onSurface = on.data();
      // Several samples at once are those of one after the other.
      std::vector<float> together(15 * n);
      RayMaking three = r;
      for (int c = 0; c < 3; ++c) three.to[c] = together.data() + c * n;
      for (int c = 0; c < 2; ++c) three.pair[c] = together.data() + (3 + c) * n;
      three.many = 3, three.next = 5 * n;
      kernelsOf(isa).makeRays(three);
      for (uint32_t k = 0; k < 3; ++k) {
        r.sample = three.sample + k;
        kernelsOf(isa).makeRays(r);
        for (uint32_t c = 0; c < 5; ++c)
          ASSERT_EQ(std::memcmp(together.data() + (k * 5 + c) * n, c < 3 ? r.to[c] : r.pair[c - 3],
                                n * sizeof(float)),
                    0);
      }
      for (uint32_t i = 0; i < n; ++i) {
        column(15)[i] = float(on[i]);
        EXPECT_NE(on[i] != 0, i == 62) << "starts at its point";
        // Into the grid from its borders, nowhere else.
        const uint32_t x = i % row, y = i / row;
        const float sideways = column(2)[i], upwards = column(2)[n + i];
        EXPECT_EQ(sideways, x == 0 ? 0x1p-10f : x == row - 1 ? -0x1p-10f : 0.0f);
        EXPECT_EQ(upwards, y == 0 ? 0x1p-10f : y == row - 1 ? -0x1p-10f : 0.0f);
        EXPECT_GE(column(0)[i], 0.5f);
        if ((way & 1) || i == 62) continue;
        const double length = std::hypot(double(column(8)[i]), double(column(9)[i]), double(column(10)[i]));
        const double cosine = double(column(8)[i]) * double(unit.at(i, 0)) +
                              double(column(9)[i]) * double(unit.at(i, 1)) +
                              double(column(10)[i]) * double(unit.at(i, 2));
        EXPECT_NEAR(length, 1, 1e-5);
        EXPECT_GE(cosine, way & 2 ? std::cos(0.7) - 1e-4 : 0.9999);
      }
      if (first.empty()) first = out;
      EXPECT_EQ(std::memcmp(first.data(), out.data(), out.size() * sizeof(float)), 0) << isa << " " << way;
    }
  }
}

TEST(Kernels, FresnelAndRefraction) {
  Columns c(16);
  const Operand in = c.varying(3), n = c.uniform(3), eta = c.uniform(1);
  const Operand kr = c.varying(1), kt = c.varying(1), r = c.varying(3), t = c.varying(3);
  Columns::setUniform(n, 2, 1);
  Columns::setUniform(eta, 0, 1.5f);  // from glass into air
  for (uint32_t i = 0; i < 16; ++i) {
    const double angle = i * M_PI / 2 / 16;
    in.comp(0)[i] = float(std::sin(angle)), in.comp(2)[i] = float(-std::cos(angle));
  }
  run(int(currentIsa()), Op::fresnel, {kr, kt, r, t, in, n, eta}, 16);
  for (uint32_t i = 0; i < 16; ++i) {
    const double angle = i * M_PI / 2 / 16, s = 1.5 * std::sin(angle);
    if (s > 1) {
      EXPECT_EQ(kr.at(i), 1);
      EXPECT_EQ(t.at(i, 2), 0);
    } else {
      EXPECT_NEAR(t.at(i, 0), s, 1e-5);  // Snell
      const double ci = std::cos(angle), ct = std::sqrt(1 - s * s);
      const double rs = (1.5 * ci - ct) / (1.5 * ci + ct), rp = (1.5 * ct - ci) / (1.5 * ct + ci);
      EXPECT_NEAR(kr.at(i), (rs * rs + rp * rp) / 2, 2e-5) << i;
    }
  }
}

TEST(Kernels, MatrixInverseAndTransforms) {
  constexpr uint32_t n = 64;
  for (int isa : availableSets()) {
    Columns c(n);
    const Operand m = c.varying(16), i1 = c.varying(16), p = c.varying(3), q = c.varying(3),
                  back = c.varying(3);
    fillRandom(m, 16, n, 3), fillRandom(p, 3, n, 4);
    for (uint32_t i = 0; i < n; ++i) {
      for (uint32_t k : {3u, 7u, 11u}) m.comp(k)[i] = 0;
      m.comp(15)[i] = 1;
      for (uint32_t k : {0u, 5u, 10u}) m.comp(k)[i] += 5;  // well conditioned
    }
    run(isa, Op::inverse_m, {i1, m}, n);
    run(isa, Op::transform_pm, {q, m, p}, n), run(isa, Op::transform_pm, {back, i1, q}, n);
    for (uint32_t i = 0; i < n; ++i)
      for (uint32_t k = 0; k < 3; ++k) EXPECT_NEAR(back.at(i, k), p.at(i, k), 2e-5);
    // A normal stays perpendicular to a transformed tangent.
    const Operand tangent = c.varying(3), normal = c.varying(3), d = c.varying(1);
    fillRandom(tangent, 3, n, 5);
    run(isa, Op::cross, {normal, tangent, p}, n);
    run(isa, Op::transform_nm, {q, m, normal}, n), run(isa, Op::transform_vm, {back, m, tangent}, n);
    run(isa, Op::dot, {d, q, back}, n);
    for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(d.at(i), 0, 1e-4);
  }
}

TEST(Kernels, ColorSpacesRoundTrip) {
  constexpr uint32_t n = 64;
  Columns c(n);
  const Operand a = c.varying(3), b = c.varying(3), back = c.varying(3);
  fillRandom(a, 3, n, 6, 0.05f, 0.95f);
  for (uint32_t space = 1; space < 6; ++space) {
    KernelCall call;
    const Operand to[] = {b, a}, from[] = {back, b};
    call.argCount = 2, call.lanes = n, call.arg = to, call.mode = space;
    kernels().helper[size_t(Helper::ctransform)](call);
    call.arg = from, call.mode = space * 8;
    kernels().helper[size_t(Helper::ctransform)](call);
    for (uint32_t i = 0; i < n; ++i)
      for (uint32_t k = 0; k < 3; ++k) EXPECT_NEAR(back.at(i, k), a.at(i, k), 3e-5) << "space " << space;
  }
}

struct NoiseCase {
  Op op;
  std::vector<uint32_t> components;  // of the arguments
  uint32_t out;
};
const NoiseCase kNoise[] = {
    {Op::noise_f_f, {1}, 1},     {Op::noise_f_ff, {1, 1}, 1}, {Op::noise_f_t, {3}, 1},
    {Op::noise_f_tf, {3, 1}, 1}, {Op::noise_t_f, {1}, 3},     {Op::noise_t_ff, {1, 1}, 3},
    {Op::noise_t_t, {3}, 3},     {Op::noise_t_tf, {3, 1}, 3},
};
TEST(Kernels, NoiseHasTheRightMeanRangeAndLattice) {
  constexpr uint32_t n = 1024;
  for (const NoiseCase& k : kNoise) {
    Columns c(n);
    std::vector<Operand> args = {c.varying(k.out)};
    for (uint32_t comps : k.components) args.push_back(c.varying(comps));
    double sum = 0, clamped = 0, total = 0, lo = 1, hi = 0;
    for (unsigned round = 0; round < 40; ++round) {
      for (size_t a = 1; a < args.size(); ++a)
        fillRandom(args[a], k.components[a - 1], n, round * 10 + unsigned(a), -500, 500);
      run(int(currentIsa()), k.op, args, n);
      for (uint32_t o = 0; o < k.out; ++o)
        for (uint32_t i = 0; i < n; ++i) {
          const float x = args[0].at(i, o);
          ASSERT_TRUE(x >= 0 && x <= 1);
          sum += x, total += 1, clamped += x == 0 || x == 1, lo = std::min<double>(lo, x),
                                                             hi = std::max<double>(hi, x);
        }
    }
    EXPECT_NEAR(sum / total, 0.5, 0.01) << opInfo(k.op).name;
    EXPECT_LT(clamped / total, 0.013) << opInfo(k.op).name;
    EXPECT_LT(lo, 0.1) << opInfo(k.op).name;
    EXPECT_GT(hi, 0.9) << opInfo(k.op).name;
    // 0.5 at whole numbers, on every instruction set the same bits.
    for (size_t a = 1; a < args.size(); ++a)
      for (uint32_t o = 0; o < k.components[a - 1]; ++o)
        for (uint32_t i = 0; i < n; ++i) args[a].comp(o)[i] = float(int(i * 7 + o) % 31 - 15);
    run(0, k.op, args, n);
    for (uint32_t i = 0; i < n; ++i) EXPECT_FLOAT_EQ(args[0].at(i), 0.5f);
    fillRandom(args[1], k.components[0], n, 99, -9, 9);
    std::vector<float> first;
    for (int isa : availableSets()) {
      run(isa, k.op, args, n);
      std::vector<float> now(args[0].data, args[0].data + n * k.out);
      if (first.empty()) first = now;
      EXPECT_EQ(0, std::memcmp(first.data(), now.data(), now.size() * 4)) << opInfo(k.op).name;
    }
  }
}

TEST(Kernels, NoiseIsContinuousAndPeriodic) {
  constexpr uint32_t n = 256;
  Columns c(n);
  const Operand p = c.varying(3), q = c.varying(3), a = c.varying(1), b = c.varying(1), period = c.uniform(3);
  fillRandom(p, 3, n, 11, -20, 20);
  for (uint32_t k = 0; k < 3; ++k)
    for (uint32_t i = 0; i < n; ++i) q.comp(k)[i] = p.at(i, k) + 1e-4f;
  run(int(currentIsa()), Op::noise_f_t, {a, p}, n), run(int(currentIsa()), Op::noise_f_t, {b, q}, n);
  for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(a.at(i), b.at(i), 2e-3);
  for (uint32_t k = 0; k < 3; ++k) Columns::setUniform(period, k, float(k + 3));
  for (uint32_t k = 0; k < 3; ++k)
    for (uint32_t i = 0; i < n; ++i) q.comp(k)[i] = p.at(i, k) + float(k + 3) * float(int(i % 5) - 2);
  run(int(currentIsa()), Op::pnoise_f_t, {a, p, period}, n);
  run(int(currentIsa()), Op::pnoise_f_t, {b, q, period}, n);
  for (uint32_t i = 0; i < n; ++i) EXPECT_NEAR(a.at(i), b.at(i), 2e-4);
}

TEST(Kernels, CellNoiseIsConstantInCellsAndUniform) {
  constexpr uint32_t n = 1024;
  Columns c(n);
  const Operand p = c.varying(3), q = c.varying(3), a = c.varying(3), b = c.varying(3);
  fillRandom(p, 3, n, 12, -300, 300);
  for (uint32_t k = 0; k < 3; ++k)
    for (uint32_t i = 0; i < n; ++i) q.comp(k)[i] = std::floor(p.at(i, k)) + 0.999f * float(i % 2);
  run(int(currentIsa()), Op::cellnoise_t_t, {a, p}, n), run(int(currentIsa()), Op::cellnoise_t_t, {b, q}, n);
  double sum = 0, squares = 0;
  for (uint32_t k = 0; k < 3; ++k)
    for (uint32_t i = 0; i < n; ++i) {
      EXPECT_EQ(a.at(i, k), b.at(i, k));
      sum += a.at(i, k), squares += a.at(i, k) * a.at(i, k);
    }
  EXPECT_NEAR(sum / (3 * n), 0.5, 0.02);
  EXPECT_NEAR(squares / (3 * n), 1.0 / 3, 0.02);
}

}  // namespace
}  // namespace fr
