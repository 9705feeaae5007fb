// The kernels of shading against long double: how far off they are, in units of the last place of a float,
// over all of a function's domain; and what they make of the numbers at its ends.
//
// Why long double: its functions (glibc, x87 format) are right to about one unit in 64 bits, huge arguments
// included, so the error of the yardstick is 2^-39 units of a float.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "base/isa.h"
#include "shading/kernels.h"
#include "tests/stability/traced_model.h"

namespace fr::test {
namespace {

using Real = long double;
constexpr float kInf = std::numeric_limits<float>::infinity();

/// Distance in units of the last place of the float nearest to `exact`; below the smallest normal number they
/// are as large as there.
double ulps(float got, Real exact) {
  if (std::isnan(got)) return 1e30;
  if (std::fabs(exact) > Real(std::numeric_limits<float>::max()))
    return std::fabs(got) >= std::numeric_limits<float>::max() && (got > 0) == (exact > 0) ? 0 : 1e30;
  int e = 0;
  std::frexp(exact, &e);
  const Real unit = std::ldexp(Real(1), std::max(e, -125) - 24);
  return double(std::fabs(Real(got) - exact) / unit);
}

struct Function {
  const char* name;
  Op op;
  Real (*exact)(Real);
  float lo, hi;
  double bound;      // units of the last place
  double close = 0;  // no error is as small as this, however many units it is: near zeros of large arguments
};

const Function kFunctions[] = {
    {"sin", Op::sin, [](Real x) { return std::sin(x); }, -100, 100, 2},
    {"sin, to 8000", Op::sin, [](Real x) { return std::sin(x); }, 100, 8000, 2, 0x1p-35},
    {"sin, huge", Op::sin, [](Real x) { return std::sin(x); }, 8000, 3.4e38f, 2},
    {"cos", Op::cos, [](Real x) { return std::cos(x); }, -100, 100, 2},
    {"cos, to 8000", Op::cos, [](Real x) { return std::cos(x); }, 100, 8000, 2, 0x1p-35},
    {"cos, huge", Op::cos, [](Real x) { return std::cos(x); }, 8000, 3.4e38f, 2},
    {"tan", Op::tan, [](Real x) { return std::tan(x); }, -100, 100, 4},
    {"tan, huge", Op::tan, [](Real x) { return std::tan(x); }, 8000, 3.4e38f, 4},
    {"asin", Op::asin, [](Real x) { return std::asin(x); }, -1, 1, 4},
    {"acos", Op::acos, [](Real x) { return std::acos(x); }, -1, 1, 4},
    {"atan", Op::atan, [](Real x) { return std::atan(x); }, -3.4e38f, 3.4e38f, 4},
    {"exp", Op::exp, [](Real x) { return std::exp(x); }, -3.4e38f, 3.4e38f, 2},
    {"exp, to denormals", Op::exp, [](Real x) { return std::exp(x); }, -105, -80, 2},
    {"log", Op::log, [](Real x) { return std::log(x); }, 1e-45f, 3.4e38f, 2},
    {"sqrt", Op::sqrt, [](Real x) { return std::sqrt(x); }, 0, 3.4e38f, 0.5},
    {"inversesqrt", Op::inversesqrt, [](Real x) { return 1 / std::sqrt(x); }, 1e-45f, 3.4e38f, 2},
    {"erf", Op::erf, [](Real x) { return std::erf(x); }, -3.4e38f, 3.4e38f, 4},
    {"erfc", Op::erfc, [](Real x) { return std::erfc(x); }, -20, 20, 7},
    {"floor", Op::floor, [](Real x) { return std::floor(x); }, -3.4e38f, 3.4e38f, 0},
    {"ceil", Op::ceil, [](Real x) { return std::ceil(x); }, -3.4e38f, 3.4e38f, 0},
    {"round", Op::round, [](Real x) { return std::round(x); }, -3.4e38f, 3.4e38f, 0},
};

/// 512 lanes of up to six columns, results first.
class Batch {
 public:
  static constexpr uint32_t kLanes = 512;
  explicit Batch(int isa) : isa_(isa) {
    data_ = static_cast<float*>(std::aligned_alloc(64, sizeof(float) * kLanes * 8));
  }
  ~Batch() { std::free(data_); }
  Batch(const Batch&) = delete;
  Batch& operator=(const Batch&) = delete;
  float* column(int c) { return data_ + size_t(c) * kLanes; }
  /// Widths of the operands in components, from column 0 on.
  void run(Op op, std::initializer_list<int> widths) {
    Operand args[6];
    uint32_t n = 0;
    int at = 0;
    for (int w : widths) args[n++] = {column(at), kLanes, ~0u}, at += w;
    KernelCall c;
    c.arg = args, c.argCount = n, c.lanes = kLanes;
    ASSERT_NE(kernelsOf(isa_).op[size_t(op)], nullptr);
    kernelsOf(isa_).op[size_t(op)](c);
  }

 private:
  int isa_;
  float* data_;
};

/// All floats between two others, or every nth of them: floats in order are integers in order.
int64_t ordered(float x) {
  const auto b = int64_t(std::bit_cast<uint32_t>(x));
  return b & 0x80000000 ? 0x80000000 - b : b;
}
float fromOrdered(int64_t i) { return std::bit_cast<float>(uint32_t(i < 0 ? 0x80000000 - i : i)); }

class Arithmetic : public ::testing::TestWithParam<Function> {};

TEST_P(Arithmetic, IsRightToTheLastPlaces) {
  const Function& f = GetParam();
  Batch b{int(currentIsa())};
  const int64_t lo = ordered(f.lo), hi = ordered(f.hi);
  const int64_t step = std::max<int64_t>(1, (hi - lo) / int64_t(effort(400'000, 1ull << 32)));
  double worst = 0;
  float where = 0, gave = 0;
  for (int64_t i = lo; i <= hi;) {
    uint32_t n = 0;
    for (; n < Batch::kLanes; ++n, i = std::min(i + step, hi + (n + 1 == Batch::kLanes)))
      b.column(1)[n] = fromOrdered(std::min(i, hi));
    b.run(f.op, {1, 1});
    for (uint32_t k = 0; k < n; ++k) {
      const float x = b.column(1)[k];
      const Real exact = f.exact(Real(x));
      if (std::fabs(Real(b.column(0)[k]) - exact) < Real(f.close)) continue;
      const double off = ulps(b.column(0)[k], exact);
      if (off > worst) worst = off, where = x, gave = b.column(0)[k];
    }
    if (b.column(1)[n - 1] >= f.hi) break;
  }
  std::printf("| %-17s | %11.5g ... %-11.5g | %8.3g | at %.9g\n", f.name, double(f.lo), double(f.hi), worst,
              double(where));
  EXPECT_LE(worst, f.bound) << f.name << "(" << where << ") gave " << gave << ", not "
                            << double(f.exact(Real(where)));
}

INSTANTIATE_TEST_SUITE_P(Functions, Arithmetic, ::testing::ValuesIn(kFunctions), [](const auto& p) {
  std::string name;
  for (const char* c = p.param.name; *c; ++c)
    if (std::isalnum(*c)) name += *c;
  return name;
});

TEST(ArithmeticOfTwo, PowersAnglesAndRemainders) {
  Batch b{int(currentIsa())};
  Counted random(5);
  const auto anyFloat = [&](float lo, float hi) {
    const int64_t a = ordered(lo), e = ordered(hi);
    return fromOrdered(a + int64_t(double(random()) * double(e - a)));
  };
  double pow = 0, atan2 = 0, mod = 0, normal = 0, length = 0;
  for (uint64_t turn = effort(400, 400'000); turn > 0; --turn) {
    // Results from overflow down to denormal numbers, of any base and of those near 1.
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      float& x = b.column(1)[k];
      x = k % 2 ? anyFloat(1e-45f, 3.4e38f) : 0.5f + 1.5f * random();
      b.column(2)[k] = x == 1 ? 1e30f : (208 * random() - 104) / std::log(x);
    }
    b.run(Op::pow, {1, 1, 1});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const Real exact = std::pow(Real(b.column(1)[k]), Real(b.column(2)[k]));
      // Rounding the logarithm is what remains: it counts for as much as the exponent is large.
      pow = std::max(pow, ulps(b.column(0)[k], exact) / (4 + 2.5 * double(std::fabs(std::log(exact)))));
    }
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      b.column(1)[k] = anyFloat(-1e15f, 1e15f), b.column(2)[k] = anyFloat(-1e15f, 1e15f);
    b.run(Op::atan2, {1, 1, 1});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const Real exact = std::atan2(Real(b.column(1)[k]), Real(b.column(2)[k]));
      if (std::fabs(exact) > 1e-37L) atan2 = std::max(atan2, ulps(b.column(0)[k], exact));
    }
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      b.column(1)[k] = 1000 * random() - 500, b.column(2)[k] = 0.1f + 10 * random();
    b.run(Op::mod, {1, 1, 1});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const Real x = b.column(1)[k], y = b.column(2)[k], exact = x - y * std::floor(x / y);
      // In units of the argument's last place: that is what subtraction leaves.
      const Real off = std::fabs(Real(b.column(0)[k]) - exact);
      mod = std::max(mod, double(std::min(off, std::fabs(off - y)) / (std::fabs(x) * 0x1p-23L)));
    }
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      for (int c = 0; c < 3; ++c)
        b.column(3 + c)[k] = k % 3 == 0   ? anyFloat(-1.9e38f, 1.9e38f)
                             : k % 3 == 1 ? anyFloat(-1e-38f, 1e-38f)
                                          : anyFloat(1e37f, 1.9e38f);
    b.run(Op::length, {3, 3});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const Real x = b.column(3)[k], y = b.column(4)[k], z = b.column(5)[k];
      length = std::max(length, ulps(b.column(0)[k], std::sqrt(x * x + y * y + z * z)));
    }
    b.run(Op::normalize, {3, 3});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const Real x = b.column(3)[k], y = b.column(4)[k], z = b.column(5)[k];
      const Real l = std::sqrt(x * x + y * y + z * z);
      for (int c = 0; c < 3; ++c)
        if (const Real exact = Real(b.column(3 + c)[k]) / l; std::fabs(exact) > 1e-6L)
          normal = std::max(normal, ulps(b.column(c)[k], exact));
    }
  }
  std::printf("| pow %.3g of its bound | atan2 %.3g | mod %.3g | normalize %.3g | length %.3g\n", pow, atan2,
              mod, normal, length);
  EXPECT_LE(pow, 1);
  EXPECT_LE(length, 2);
  EXPECT_LE(atan2, 4);
  EXPECT_LE(mod, 2);
  EXPECT_LE(normal, 4);
}

/// Whatever goes in: no NaN comes out of a function whose domain is guarded.
TEST(ArithmeticAtTheEnds, NeverNaN) {
  const float denormal = 1e-40f, huge = std::numeric_limits<float>::max(), nan = std::nanf("");
  const float values[] = {0.0f,   -0.0f, denormal, -denormal, 1.0f,  -1.0f, 0.5f,
                          1e-38f, huge,  -huge,    kInf,      -kInf, nan};
  constexpr size_t n = std::size(values);
  Batch b{int(currentIsa())};
  for (const Function& f : kFunctions) {
    for (uint32_t k = 0; k < Batch::kLanes; ++k) b.column(1)[k] = values[k % (n - 3)];
    b.run(f.op, {1, 1});
    for (uint32_t k = 0; k < n - 3; ++k)
      EXPECT_TRUE(std::isfinite(b.column(0)[k]))
          << f.name << "(" << b.column(1)[k] << ") = " << b.column(0)[k];
  }
  for (const auto& [op, name] : {std::pair(Op::pow, "pow"),
                                 {Op::atan2, "atan2"},
                                 {Op::mod, "mod"},
                                 {Op::div_f, "div"},
                                 {Op::log2arg, "log"}}) {
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const size_t i = k % ((n - 3) * (n - 3));
      b.column(1)[k] = values[i % (n - 3)], b.column(2)[k] = values[i / (n - 3)];
    }
    b.run(op, {1, 1, 1});
    for (uint32_t k = 0; k < (n - 3) * (n - 3); ++k)
      EXPECT_FALSE(std::isnan(b.column(0)[k]))
          << name << "(" << b.column(1)[k] << ", " << b.column(2)[k] << ") = " << b.column(0)[k];
  }
}

TEST(ArithmeticAtTheEnds, TinyAndHugeVectorsHaveDirections) {
  Batch b{int(currentIsa())};
  for (const float size : {1e-44f, 1e-38f, 1e-30f, 1e-20f, 1e-6f, 1.0f, 1e6f, 1e15f, 1e19f, 1e25f, 3e37f}) {
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      b.column(3)[k] = 3 * size, b.column(4)[k] = -4 * size, b.column(5)[k] = 0;
    b.run(Op::length, {3, 3});
    const double rounding = size < 1e-37f ? 0.2 : 1e-6;  // denormal numbers have few digits
    EXPECT_NEAR(b.column(0)[0] / (5 * size), 1, rounding) << "length at " << size;
    b.run(Op::normalize, {3, 3});
    EXPECT_NEAR(b.column(0)[0], 0.6f, rounding) << size;
    EXPECT_NEAR(b.column(1)[0], -0.8f, rounding) << size;
  }
}

/// Gradient noise: 0.5 at lattice points, whole everywhere (no jump, no NaN), also far from the origin.
TEST(ArithmeticOfNoise, ContinuousAndBounded) {
  Batch b{int(currentIsa())};
  Counted random(11);
  float steepest = 0, least = 1, most = 0;
  for (uint64_t turn = effort(200, 100'000); turn > 0; --turn) {
    const float far = turn % 4 ? 0.0f : std::pow(10.0f, 6 * random());
    float before[Batch::kLanes];
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      for (int c = 0; c < 3; ++c) b.column(1 + c)[k] = far + 40 * random() - 20;
    b.run(Op::noise_f_t, {1, 3});
    std::memcpy(before, b.column(0), sizeof before);
    float x[Batch::kLanes];
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      x[k] = b.column(1)[k], b.column(1)[k] = std::nextafter(x[k], kInf) + 1e-3f;
    b.run(Op::noise_f_t, {1, 3});
    for (uint32_t k = 0; k < Batch::kLanes; ++k) {
      const float v = b.column(0)[k];
      ASSERT_TRUE(v >= 0 && v <= 1) << v;
      least = std::min(least, v), most = std::max(most, v);
      steepest = std::max(steepest, std::abs(v - before[k]) / (b.column(1)[k] - x[k]));
    }
  }
  EXPECT_LT(steepest, 4);
  EXPECT_LT(least, 0.2f);
  EXPECT_GT(most, 0.8f);
  for (uint32_t k = 0; k < Batch::kLanes; ++k)
    for (int c = 0; c < 3; ++c) b.column(1 + c)[k] = float(int(k * 7 + uint32_t(c) * 3) - 1000);
  b.run(Op::noise_f_t, {1, 3});
  for (uint32_t k = 0; k < Batch::kLanes; ++k) EXPECT_NEAR(b.column(0)[k], 0.5f, 1e-6f);
  for (const float x : {kInf, -kInf, 1e30f, -1e30f, 1e-40f, -0.0f}) {
    for (uint32_t k = 0; k < Batch::kLanes; ++k)
      for (int c = 0; c < 3; ++c) b.column(1 + c)[k] = x;
    b.run(Op::noise_f_t, {1, 3});
    EXPECT_TRUE(b.column(0)[0] >= 0 && b.column(0)[0] <= 1) << x << " " << b.column(0)[0];
  }
}

}  // namespace
}  // namespace fr::test
