// Machine code against the kernels, bit for bit: every operation alone, with operands of all kinds and with
// numbers of all kinds; and what the compiler of runs has to get right by itself.
#include "shading/native_code.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>

#include "shading/machine_fixture.h"
#include "shading/recorded_kernels.h"

namespace fr {
namespace {

constexpr uint32_t kTestLanes = 64;

/// Columns in a row, each as long as the batch.
struct Columns {
  explicit Columns(uint32_t n) : count(n) {
    memory.reserve(size_t(n) * kTestLanes);
    for (uint32_t c = 0; c < n; ++c) pointers.push_back(memory.data() + size_t(c) * kTestLanes);
    std::memset(memory.data(), 0, size_t(n) * kTestLanes * sizeof(float));
  }
  uint32_t count;
  AlignedFloats memory;
  std::vector<float*> pointers;
};

class PlainRecorder final : public OperandRecorder {
 public:
  PlainRecorder(ValueGraph& graph, std::vector<uint32_t> first, std::vector<bool> uniform)
      : graph_(graph), first_(std::move(first)), uniform_(std::move(uniform)) {}
  NodeIndex read(uint32_t operand, uint32_t component) override {
    const uint32_t column = first_[operand] + component;
    for (const RunOutput& o : outputs)
      if (o.column == column) return o.value;
    return graph_.load(column, uniform_[operand]);
  }
  void write(uint32_t operand, uint32_t component, NodeIndex value) override {
    const uint32_t column = first_[operand] + component;
    std::erase_if(outputs, [&](const RunOutput& o) { return o.column == column; });
    outputs.push_back({column, value, uniform_[operand], false});
  }
  std::vector<RunOutput> outputs;

 private:
  ValueGraph& graph_;
  std::vector<uint32_t> first_;
  std::vector<bool> uniform_;
};

struct Compiled {
  std::unique_ptr<NativeMemory> memory;
  RunFunction function = nullptr;
};
Compiled compiled(const ValueGraph& graph, const std::vector<RunOutput>& outputs, bool skip) {
  Compiled c;
  c.memory = NativeMemory::of(compileRun(graph, outputs, skip));
  if (c.memory) c.function = reinterpret_cast<RunFunction>(reinterpret_cast<uintptr_t>(c.memory->at(0)));
  return c;
}

/// Numbers of every size, integers, zeros of both signs, and what is no number.
float someNumber(std::mt19937& random, bool wild) {
  const auto kind = uint32_t(random() % (wild ? 16u : 10u));
  const float unit = float(random() >> 8) * 0x1p-24f, sign = random() & 1 ? 1.0f : -1.0f;
  if (kind < 5) return sign * unit * 4;
  if (kind < 7) return float(int(random() % 9) - 4);
  if (kind < 9) return sign * std::exp((unit - .5f) * 40);
  if (kind == 9) return sign * 0.0f;
  if (kind == 10) return sign * INFINITY;
  if (kind == 11) return NAN;
  if (kind == 12) return sign * 3.4e38f * unit;
  if (kind == 13) return sign * 1e-38f * unit;
  if (kind == 14) return sign * 1e9f * unit;
  return sign * std::exp((unit - .5f) * 170);
}
bool same(float a, float b) { return std::memcmp(&a, &b, sizeof a) == 0 || (std::isnan(a) && std::isnan(b)); }
uint32_t floatsOf(char c) {
  return c == 'F' || c == 'f' ? 1 : c == 'T' || c == 't' || c == '!' ? 3 : c == 'M' || c == 'm' ? 16 : 0;
}

class NativeRuns : public testing::Test {
 protected:
  void SetUp() override {
    if (!nativeCodeAvailable()) GTEST_SKIP() << "no machine code here";
  }
};

TEST_F(NativeRuns, EveryOperationAgreesWithItsKernel) {
  int tested = 0;
  for (size_t k = 0; k < size_t(Op::kCount); ++k) {
    const OpInfo& info = opInfo(Op(k));
    if (!recordedKernels().op[k]) continue;
    ASSERT_NE(kernels().op[k], nullptr) << info.name;
    // setcomp_m is the one whose first operand is a matrix.
    std::string signature = info.signature;
    const bool matrix = Op(k) == Op::setcomp_m;
    for (int round = 0; round < 24; ++round) {
      std::mt19937 random(uint32_t(k * 100 + size_t(round)));
      std::vector<uint32_t> first, width;
      std::vector<bool> uniform;
      uint32_t columns = 0;
      // All varying, all uniform, mixtures.
      for (const char c : signature) {
        first.push_back(columns);
        width.push_back(c == '!' && matrix ? 16 : floatsOf(c));
        ASSERT_GT(width.back(), 0u) << info.name << ' ' << signature;
        uniform.push_back(round % 4 == 0 ? false : round % 4 == 1 ? true : random() % 2 == 0);
        columns += width.back();
      }
      bool all = true;
      for (size_t o = 0; o < signature.size(); ++o)
        if (!std::isupper(signature[o]) && signature[o] != '!') all = all && uniform[o];
      for (size_t o = 0; o < signature.size(); ++o)
        if (std::isupper(signature[o]) || signature[o] == '!') uniform[o] = all && uniform[o];
      Columns a(columns), b(columns);
      for (size_t o = 0; o < signature.size(); ++o)
        for (uint32_t c = first[o]; c < first[o] + width[o]; ++c) {
          const float fixed = someNumber(random, round >= 8);
          for (uint32_t i = 0; i < kTestLanes; ++i)
            a.pointers[c][i] = b.pointers[c][i] = uniform[o] ? fixed : someNumber(random, round >= 8);
        }
      std::vector<Operand> operands;
      for (size_t o = 0; o < signature.size(); ++o)
        operands.push_back({a.pointers[first[o]], kTestLanes, uniform[o] ? kLanePad - 1 : ~0u});
      alignas(64) int32_t mask[kTestLanes];
      std::fill_n(mask, kTestLanes, -1);
      KernelCall call;
      call.arg = operands.data(), call.argCount = uint32_t(operands.size());
      call.lanes = uniform[0] ? kLanePad : kTestLanes, call.mask = mask;
      kernels().op[k](call);

      ValueGraph graph;
      PlainRecorder recorder(graph, first, uniform);
      {
        const RecordingScope scope(graph);
        std::vector<recorded::Operand> r;
        for (uint32_t o = 0; o < signature.size(); ++o) r.push_back({&recorder, o});
        recorded::KernelCall recording;
        recording.arg = r.data(), recording.argCount = uint32_t(r.size());
        recordedKernels().op[k](recording);
      }
      const Compiled run = compiled(graph, recorder.outputs, false);
      ASSERT_NE(run.function, nullptr);
      run.function(b.pointers.data(), kTestLanes * sizeof(float), mask);
      for (uint32_t c = 0; c < columns; ++c)
        for (uint32_t i = 0; i < (uniform[0] ? kLanePad : kTestLanes); ++i)
          ASSERT_TRUE(same(a.pointers[c][i], b.pointers[c][i]))
              << info.name << " round " << round << " column " << c << " lane " << i << ": "
              << b.pointers[c][i] << " instead of " << a.pointers[c][i];
    }
    ++tested;
  }
  EXPECT_GT(tested, 100);
}

TEST_F(NativeRuns, MoreValuesThanRegistersAndColumnsThatChangePlaces) {
  // Sums of all pairs of 24 columns, all alive until the end; then columns are rotated among themselves.
  constexpr uint32_t n = 24;
  ValueGraph graph;
  std::vector<NodeIndex> loads, sums;
  for (uint32_t c = 0; c < n; ++c) loads.push_back(graph.load(c, false));
  for (uint32_t c = 0; c < n; ++c)
    for (uint32_t d = 0; d < c; ++d)
      sums.push_back(graph.binary(VectorOp::kSub, graph.binary(VectorOp::kMul, loads[c], loads[d]),
                                  graph.constant(float(c) + .5f)));
  NodeIndex total = graph.constant(0.0f);
  for (size_t k = sums.size(); k-- > 0;) total = graph.binary(VectorOp::kAdd, sums[k], total);
  std::vector<RunOutput> outputs;
  for (uint32_t c = 0; c < n; ++c) outputs.push_back({c, loads[(c + 1) % n], false, false});
  outputs.push_back({n, total, false, true});
  graph.mask();
  Columns a(n + 1);
  std::mt19937 random(5);
  std::vector<std::vector<float>> before(n, std::vector<float>(kTestLanes));
  alignas(64) int32_t mask[kTestLanes];
  for (uint32_t i = 0; i < kTestLanes; ++i) {
    mask[i] = i / 8 == 2 || i % 3 == 1 ? 0 : -1;
    a.pointers[n][i] = 77;
    for (uint32_t c = 0; c < n; ++c) before[c][i] = a.pointers[c][i] = float(random() % 1000) / 16;
  }
  const Compiled run = compiled(graph, outputs, true);
  ASSERT_NE(run.function, nullptr);
  run.function(a.pointers.data(), kTestLanes * sizeof(float), mask);
  for (uint32_t i = 0; i < kTestLanes; ++i) {
    // Vectors without an active point are left alone altogether.
    const bool skipped = i / 8 == 2;
    float sum = 0;
    for (uint32_t c = n; c-- > 0;)
      for (uint32_t d = c; d-- > 0;) sum = before[c][i] * before[d][i] - (float(c) + .5f) + sum;
    EXPECT_EQ(a.pointers[n][i], mask[i] ? sum : 77.0f) << i;
    for (uint32_t c = 0; c < n; ++c)
      EXPECT_EQ(a.pointers[c][i], skipped ? before[c][i] : before[(c + 1) % n][i]) << c << ' ' << i;
  }
}

TEST_F(NativeRuns, EqualValuesAreOneNodeAndConstantsAreFolded) {
  ValueGraph g;
  const NodeIndex x = g.load(0, false), y = g.load(1, false), two = g.constant(2.0f);
  EXPECT_EQ(g.binary(VectorOp::kAdd, x, y), g.binary(VectorOp::kAdd, y, x));
  EXPECT_NE(g.binary(VectorOp::kSub, x, y), g.binary(VectorOp::kSub, y, x));
  EXPECT_EQ(g.binary(VectorOp::kMul, two, two), g.constant(4.0f));
  EXPECT_EQ(g.binary(VectorOp::kMul, x, g.constant(1.0f)), x);
  EXPECT_EQ(g.binary(VectorOp::kDiv, x, two), g.binary(VectorOp::kMul, x, g.constant(.5f)));
  // x + 0 is not x where x is -0.
  EXPECT_NE(g.binary(VectorOp::kAdd, x, g.constant(0.0f)), x);
  EXPECT_EQ(g.binary(VectorOp::kAdd, x, g.constant(-0.0f)), x);
  const NodeIndex m = g.binary(VectorOp::kCompare, x, y, uint32_t(Compare::kLess));
  EXPECT_EQ(g.select(m, x, x), x);
  EXPECT_EQ(g.select(g.constant(~0u), x, y), x);
  EXPECT_EQ(g.select(g.binary(VectorOp::kXor, m, g.constant(~0u)), x, y), g.select(m, y, x));
}

/// Ci of a shader by kernels and by machine code, at one size of batch.
void expectSameColors(const std::string& source, uint32_t nu, uint32_t nv) {
  MachineFixture kernelsOnly(nu, nv), code(nu, nv);
  kernelsOnly.native = false;
  const auto a = kernelsOnly.shader(source), b = code.shader(source);
  ASSERT_TRUE(a && b) << kernelsOnly.error;
  EXPECT_EQ(a->exe->native() != nullptr, false);
  ASSERT_NE(b->exe->native(), nullptr);
  kernelsOnly.run(*a);
  code.run(*b);
  for (uint32_t i = 0; i < code.count; ++i)
    for (uint32_t c = 0; c < 3; ++c)
      EXPECT_TRUE(same(kernelsOnly.Ci(i, c), code.Ci(i, c))) << i << ' ' << c << ' ' << code.Ci(i, c);
}

TEST_F(NativeRuns, ShadersWithControlFlowAndStateBetweenRuns) {
  const char* const sources[] = {
      "surface a() { float x = u, y = 0; if (x > .5) { y = sqrt(x); x = v; } else y = -x;"
      " float i; for (i = 0; i < 3; i += 1) { if (v < .3) break; y += x * i; } Ci = color (x, y, i); Oi = 1; "
      "}",
      "surface b() { float f(float x) { if (x > .6) return 2; return noise(4 * P); }"
      " Ci = color (f(u), f(v), f(u * v)) + normalize(P) * 1e-30; Oi = 1; }",
      "surface c() { float k[4]; float i; for (i = 0; i < 4; i += 1) k[i] = u * i; Ci = k[floor(4 * v)]; Oi "
      "= 1; }",
      // A variable that an operation writes directly, since all points are active or none is.
      "surface u(float gain = 0;) { color c = Cs * u; if (gain == 1) c = mix(color (.1, .1, .5), Cs, v); Ci "
      "= c; Oi = 1; }",
      // A value that is carried from turn to turn, and two that change places.
      "surface d() { float p = u, q = v, i; for (i = 0; i < 5; i += 1) { float r = p; p = q; q = r + .1 * i; "
      "}"
      " Ci = color (p, q, pow(p, q)); Oi = 1; }",
      // Loops that points leave at different times: on their way, to the next turn, out of functions.
      "surface l() { float i, s = 0; for (i = 0; i < 10 * u; i += 1) { if (mod(i, 3) == 1) continue; s += v "
      "+ i;"
      " if (s > 4) break; } Ci = color (s, i, u); Oi = 1; }",
      "surface m() { float a = u, b = v, n = 0; while (a + b < 3 * noise(5 * P)) { float r = a; a = b; b = r "
      "+ .3;"
      " n += 1; } float k; for (k = n; k < 4 + u; k += 1) a *= 1.5; Ci = color (a, b, n + k); Oi = 1; }",
      "surface n() { float f(float x) { float i; for (i = 0; i < 20 * x; i += 1) if (noise(P * (i + 1)) > "
      ".55)"
      " return i; return -1; } float s = 0, i; for (i = 0; i < 5 * v; i += 1) { float g(float y) { if (y > 2)"
      " return y * y; return sqrt(y); } if (u > .3) s += g(i); else s -= sin(1e5 * i); }"
      " Ci = color (f(u), f(v), s); Oi = 1; }",
      "surface o() { color c = Cs; float i = 0; while (comp(c, 0) > v + .01) { c *= color (.7, .8, noise(u, i)); i "
      "+= 1;"
      " if (u > .9) { i += 10; break; } } float x = 0; for (; x < 3 * u; x += 1) c += P * x; Ci = c * i; Oi "
      "= 1; }",
      "surface e() { vector V = vector (1e30 * u, 1e-30, 1e25); Ci = color (length(V), sin(1e6 * u), "
      "exp(88.3 * v)) +"
      " color normalize(V); Oi = 1; }",
  };
  for (const char* s : sources)
    for (const auto& [nu, nv] :
         {std::pair(0u, 0u), std::pair(2u, 0u), std::pair(6u, 4u), std::pair(15u, 16u)}) {
      SCOPED_TRACE(s);
      expectSameColors(s, nu, nv);
    }
}

TEST_F(NativeRuns, LoopsThatPointsLeaveAtDifferentTimesArePartOfRuns) {
  MachineFixture f(7, 7);
  const auto light = f.shader("light l(float k = 1) { illuminate (point (0, 0, -3)) Cl = k; }");
  const auto s = f.shader(
      "surface t() { color c = 0; float i; for (i = 0; i < 5 * u; i += 1) illuminance (P + i * N) c += Cl * "
      "i;"
      " Ci = c; }");
  ASSERT_TRUE(light && s) << f.error;
  f.run(*s, {light.get()});
  EXPECT_EQ(f.machine.code()->runCount(), 1u);
  for (uint32_t i = 0; i < f.count; ++i) {
    float sum = 0;
    for (int k = 0; float(k) < 5 * (float(i % 8) / 7); ++k) sum += float(k);
    EXPECT_EQ(f.Ci(i), sum) << i;
  }
}

TEST_F(NativeRuns, EndlessLoopsAreEnded) {
  std::vector<Error> errors;
  setReportSink([&](const Error& e) { errors.push_back(e); });
  MachineFixture f(7, 0);
  const auto s = f.shader("surface endless() { float n = 0; while (u > .9) n += 1; Ci = color (n, u, 0); }");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  setReportSink({});
  EXPECT_EQ(f.machine.code()->runCount(), 1u);
  EXPECT_EQ(f.Ci(0), 0);
  EXPECT_EQ(f.Ci(7), float(kMostTurns));
  ASSERT_EQ(errors.size(), 1u);
  EXPECT_EQ(errors[0].code, RiError::kLimit);
}

TEST_F(NativeRuns, DifferencesBetweenNeighbours) {
  const char* const sources[] = {
      // Of variables and globals, twice the same, of what the run itself computes.
      "surface a() { float x = u * v; point Q = P * (1 + noise(3 * P)); float w = abs(Du(x)) + abs(Dv(x));"
      " normal n = calculatenormal(Q); Ci = color (w, Du(x) + Du(u), 0) + color (n) + color (Dv(Q)); Oi = 1; "
      "}",
      // Of differences, under conditions, of what is uniform.
      "surface b(float k = 2) { float x = Du(Dv(u * v * v)); float y = 0; if (u > .4) y = Du(x + v); else y "
      "= 2;"
      " Ci = color (x, y + Dv(y), Du(k)); Oi = 1; }",
      "surface c() { float f(float x) { if (x > .6) return Dv(x); return Du(x * x); }"
      " Ci = color (f(u), Du(f(v)), area(P)) + color (calculatenormal(point (0, 0, 1))); Oi = 1; }",
  };
  for (const char* source : sources)
    for (const auto& [nu, nv] : {std::pair(1u, 1u), std::pair(6u, 4u), std::pair(15u, 15u)})
      for (const bool whole : {true, false}) {
        SCOPED_TRACE(source);
        MachineFixture kernelsOnly(nu, nv), code(nu, nv);
        kernelsOnly.native = false;
        DerivativeStencil stencil;
        gridStencil(stencil, nu, nv, code.lanes, 1 / float(nu), 1 / float(nv));
        alignas(64) std::array<int32_t, 256> mask{};
        for (uint32_t i = 0; i < code.count; ++i) mask[i] = whole || i % 5 != 1 ? -1 : 0;
        for (MachineFixture* f : {&kernelsOnly, &code}) {
          f->batch.stencil = &stencil, f->batch.mask = mask.data(), f->batch.orientation = -1;
          const auto s = f->shader(source);
          ASSERT_TRUE(s) << f->error;
          f->run(*s);
        }
        for (uint32_t i = 0; i < code.count; ++i)
          for (uint32_t c = 0; c < 3 && mask[i]; ++c)
            EXPECT_TRUE(same(kernelsOnly.Ci(i, c), code.Ci(i, c)))
                << i << ' ' << c << ' ' << code.Ci(i, c) << " instead of " << kernelsOnly.Ci(i, c);
      }
  // One run up to the variable, one with the differences.
  MachineFixture f(7, 7);
  const auto s = f.shader("surface t() { float x = u * v; Ci = color (Du(x), Dv(x), Du(v)); }");
  ASSERT_TRUE(s) << f.error;
  f.run(*s);
  EXPECT_EQ(f.machine.code()->runCount(), 2u);
}

TEST_F(NativeRuns, WhatIsSentToALightIsForgottenBehindTheLoop) {
  MachineFixture f(7, 7);
  const auto light =
      f.shader("light l(float k = 1) { illuminate (point (0, 0, -3)) { Cl = k; if (k > 2) Cl = 5; } }");
  const auto s = f.shader(
      "surface t() { float a = 0, b = 0, c = 0; illuminance (P) { a += comp(Cl, 0); }"
      " illuminance (P, \"send:k\", 3) { b += comp(Cl, 0); } illuminance (P) { c += comp(Cl, 0); }"
      " Ci = color (a, b, c); }");
  ASSERT_TRUE(light && s) << f.error;
  for (int batch = 0; batch < 2; ++batch) {
    f.run(*s, {light.get()});
    EXPECT_EQ(f.Ci(9, 0), 1);
    EXPECT_EQ(f.Ci(9, 1), 5);
    EXPECT_EQ(f.Ci(9, 2), 1);
  }
  // Another shader without options, in the same machine.
  const auto plain = f.shader("surface p() { Ci = 0; illuminance (P) { Ci += Cl; } }");
  f.run(*plain, {light.get()});
  EXPECT_EQ(f.Ci(9, 0), 1);
}

TEST_F(NativeRuns, LightLoopsBehindRaysAreMachineCode) {
  // What a condition begins with is not read again behind it: variables of the loops stay in the run.
  MachineFixture f(7, 7);
  const auto light = f.shader("light l(float k = 1) { illuminate (point (0, 0, -3)) Cl = k; }");
  const auto s = f.shader(
      "surface t(float Kr = 1) { color sum = 0; uniform float b = Kr * 2; if (b > 1) { sum = trace(P, N);"
      " uniform float a = Kr + 1; sum += a * diffuse(N) + specular(N, N, a * .1); } Ci = sum; }");
  ASSERT_TRUE(light && s) << f.error;
  f.run(*s, {light.get()});
  const NativeCode* const code = f.machine.code();
  ASSERT_NE(code, nullptr);
  bool lit = false;
  for (uint32_t i = 0; i < s->program().code.size(); ++i) lit |= code->at(i) && code->at(i)->lights > 0;
  EXPECT_TRUE(lit);
}

TEST_F(NativeRuns, NumbersDecideBranchesButNotWherePointsDiffer) {
  MachineFixture f(7, 7);
  const std::string source =
      "surface t(float k = 1) { Ci = color (u, v, 0); if (k > 2) Ci = trace(P, N) + 5; else if (0 < k) Ci += "
      "1; }";
  const auto number = [](float k) { return ParameterSetting{"k", {SlType::kFloat, 0, {k}, {}}}; };
  for (const float k : {-1.0f, 1.0f, 3.0f}) {
    const auto s = f.shader(source, {number(k)});
    ASSERT_TRUE(s) << f.error;
    f.run(*s);
    EXPECT_EQ(f.suspensions, k > 2 ? 1 : 0);
    EXPECT_EQ(f.Ci(9, 0), k > 2 ? 5 : k > 0 ? 1 + 1 / 7.0f : 1 / 7.0f);
    EXPECT_EQ(f.machine.code()->runCount(), k > 2 ? 2u : 1u);
  }
  // A primitive variable in the place of the parameter.
  const auto s = f.shader(source, {}, {"k"});
  ASSERT_TRUE(s) << f.error;
  alignas(64) std::array<float, 64> values;
  for (uint32_t i = 0; i < 64; ++i) values[i] = float(i % 4) - 0.5f;
  const Batch::Override overrides[] = {{0, Operand{values.data(), 64, ~0u}}};
  f.batch.overrides = overrides;
  f.run(*s);
  for (uint32_t i = 0; i < 64; ++i)
    EXPECT_EQ(f.Ci(i, 1), values[i] > 2 ? 5 : float(i / 8) / 7 + (values[i] > 0 ? 1 : 0)) << i;
}

/// A light shader with local variables, textures and rays that its text parameter switches off is written
/// out in the shaders that it lights.
TEST_F(NativeRuns, TextParametersDecideBranches) {
  MachineFixture f(7, 7), kernelsOnly(7, 7);
  kernelsOnly.native = false;
  const std::string lightSource =
      "light l(string mode = \"\"; float k = 1) { illuminate (point (0, 0, -3)) { color c = k / (L . L);"
      " if (mode == \"raytrace\") c *= visibility(Ps, point (0, 0, -3)); else if (mode != \"\" && k > 0) c "
      "*= "
      "2; Cl = c; } }";
  const std::string source =
      "surface t(string name = \"\") { Ci = diffuse(N); if (name == \"a\") Ci += color (u, 0, 0);"
      " else { if (name != \"b\") Ci += color (0, v, 0); Ci += color (0, 0, u); } }";
  const auto text = [](const char* name, const char* value) {
    return ParameterSetting{name, {SlType::kString, 0, {}, {value}}};
  };
  for (const char* mode : {"", "raytrace", "other"})
    for (const char* name : {"", "a", "b"}) {
      SCOPED_TRACE(std::string(mode) + "/" + name);
      for (MachineFixture* m : {&f, &kernelsOnly}) {
        const auto light = m->shader(lightSource, {text("mode", mode)});
        const auto s = m->shader(source, {text("name", name)});
        ASSERT_TRUE(light && s) << m->error;
        m->run(*s, {light.get()});
        EXPECT_EQ(m->suspensions, *mode == 'r' ? 1 : 0);
        EXPECT_TRUE(*mode != 0 || light->exe->plainLight());
      }
      for (uint32_t i = 0; i < f.count; ++i) {
        const float x = float(i % 8) / 7, y = float(i / 8) / 7;
        const float k = (*mode == 'o' ? 2.0f : 1.0f) * 4 /
                        std::pow(x * x + y * y + 16, 1.5f);  // cosine by the square of the distance
        const bool a = *name == 'a', b = *name == 'b';
        EXPECT_NEAR(f.Ci(i, 0), k + (a ? x : 0), 1e-5);
        EXPECT_NEAR(f.Ci(i, 1), k + (a || b ? 0 : y), 1e-5);
        EXPECT_NEAR(f.Ci(i, 2), k + (a ? 0 : x), 1e-5);
        for (uint32_t c = 0; c < 3; ++c) EXPECT_TRUE(same(f.Ci(i, c), kernelsOnly.Ci(i, c)));
      }
    }
}

TEST_F(NativeRuns, MadeAfterSomeBatches) {
  MachineFixture f(7, 7);
  f.native = false;
  const auto s = f.shader("surface a() { Ci = u * v + noise(P); Oi = 1; }");
  ASSERT_TRUE(s);
  std::vector<float> first;
  for (int k = 0; k < 10; ++k) {
    f.run(*s);
    for (uint32_t i = 0; i < f.count; ++i) {
      if (k == 0) first.push_back(f.Ci(i));
      EXPECT_EQ(f.Ci(i), first[i]);
    }
  }
  EXPECT_NE(s->exe->native(), nullptr);
}

}  // namespace
}  // namespace fr
