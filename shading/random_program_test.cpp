// Random shaders: the virtual machine, at every level of optimisation and at odd batch sizes, against an
// interpreter that knows one point at a time. Bit by bit: both use the same elementary operations.
//
// FR_STRESS=1 runs for ten minutes (FR_STRESS_SECONDS), with new programs every time (FR_SEED to repeat one).
#include <gtest/gtest.h>

#include <bit>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <list>

#include "shading/lexer.h"
#include "shading/machine_fixture.h"
#include "shading/parser.h"
#include "shading/testing/random_program.h"
#include "shading/testing/reference_interpreter.h"

namespace fr {
namespace {

struct Parsed {
  PreprocessedSource source;
  ast::File file;
};

void parse(const std::string& text, Parsed& p) {
  Diagnostics d;
  ASSERT_TRUE(preprocess("random.sl", text, {}, p.source, d)) << d.str();
  NoLintLines noLint;
  parseFile(tokenize(p.source, d, noLint), p.source, d, {}, p.file);
  ASSERT_FALSE(d.hasErrors()) << d.str() << text;
}

/// What the shader left, as "name component lane value" of the first difference; "" when all is equal.
std::string firstDifference(const std::string& text, uint64_t seed, const std::string& referenceText = {}) {
  Parsed parsed;
  parse(referenceText.empty() ? text : referenceText, parsed);
  if (testing::Test::HasFatalFailure()) return "not parsed";
  ReferenceInterpreter reference(parsed.file);
  const uint32_t sizes[][2] = {{0, 0}, {2, 0}, {4, 2}, {6, 4}, {15, 0}, {16, 0}, {10, 5}};
  const auto& size = sizes[seed % std::size(sizes)];
  const bool varyingTint = seed % 3 == 0;
  // Every level of optimisation with kernels and with machine code.
  for (int way = 0; way < 6; ++way) {
    const int optimize = way / 2;
    MachineFixture m(size[0], size[1]);
    m.native = way % 2 == 1;
    const ShaderInstance* s = nullptr;
    const auto held = m.shader(
        text, {}, varyingTint ? std::vector<std::string>{"tint", "gain"} : std::vector<std::string>{},
        optimize);
    s = held.get();
    if (!s) return "not compiled: " + m.error;
    AlignedFloats columns;
    columns.reserve(size_t(m.lanes) * 4);
    Batch::Override overrides[2];
    if (varyingTint) {
      for (uint32_t i = 0; i < 4 * m.lanes; ++i)
        columns.data()[i] = float(hashStep(seed, i) >> 40) / 8388608.0f - 0.5f;
      overrides[0] = {s->program().findParameter("tint"), Operand{columns.data(), m.lanes, ~0u}};
      overrides[1] = {s->program().findParameter("gain"),
                      Operand{columns.data() + 3 * m.lanes, m.lanes, ~0u}};
      m.batch.overrides = overrides;
    }
    m.run(*s);
    for (uint32_t i = 0; i < m.count; ++i) {
      std::map<std::string, ReferenceValue> globals;
      for (size_t g = 0; g < size_t(GlobalId::kCount); ++g) {
        const GlobalInfo& info = globalInfo(GlobalId(g));
        const uint32_t width = slTypeFloats(info.type);
        if (width > 3) continue;
        ReferenceValue value{width, false, std::vector<float>(width, 0.0f)};
        const Operand& o = m.batch.globals[g];
        for (uint32_t c = 0; o.data && c < width; ++c) value.data[c] = o.at(i, c);
        globals[info.name] = value;
      }
      globals.erase("Ci");
      globals["Ci"] = {3, false, {0, 0, 0}};
      if (varyingTint) {
        globals["tint"] = {3, false, {0, 0, 0}};
        for (uint32_t c = 0; c < 3; ++c) globals["tint"].data[c] = columns.data()[c * m.lanes + i];
        globals["gain"] = {1, false, {columns.data()[3 * m.lanes + i]}};
      }
      std::map<std::string, ReferenceValue> expected;
      try {
        expected = reference.run(globals);
      } catch (const std::exception& e) {
        return e.what();
      }
      for (const char* name : {"Ci", "Oi", "aov", "trail"}) {
        const Operand o = m.machine.result(name);
        const ReferenceValue& v = expected[name];
        for (uint32_t c = 0; c < v.width; ++c) {
          const float got = o.data ? o.at(i, c) : 0.0f;
          if (std::memcmp(&got, &v.data[c], sizeof(float)) != 0 && !(got == v.data[c]) &&
              !(std::isnan(got) && std::isnan(v.data[c])))
            return fmt::format("{}[{}] of point {} of {}: {} instead of {}, optimize {}{}", name, c, i,
                               m.count, got, v.data[c], optimize, m.native ? ", machine code" : "");
        }
      }
    }
  }
  return "";
}

// A uniform parameter that a primitive variable makes varying makes conditions varying, and what stands in
// them masked.
TEST(RandomPrograms, AConditionMayBecomeVarying) {
  const std::string text =
      "surface random_shader(float gain = 1.5; color tint = color(0.25, 0.5, 1);\n"
      "    output varying color aov = 0; output varying float trail = 0;) {\n"
      "  Ci = ((gain <= 0 || (trail = v) > 0.25) ? color (1, 2, 3) : color (4, 5, 6));\n"
      "  float x = 2;\n"
      "  if (gain > 0.1) x = v * 3;\n"
      "  Oi = color (x, 0, 1);\n}\n";
  for (const uint64_t seed : {3, 6, 9, 12, 15, 18, 21}) EXPECT_EQ(firstDifference(text, seed), "") << seed;
}

TEST(RandomPrograms, MachineAgreesWithTheReference) {
  setReportSink([](const Error&) {});
  const bool stress = std::getenv("FR_STRESS") != nullptr;
  const char* const given = std::getenv("FR_SEED");
  const char* const limit = std::getenv("FR_STRESS_SECONDS");
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(limit ? std::atoi(limit) : 600);
  const uint64_t first = given    ? std::strtoull(given, nullptr, 0)
                         : stress ? uint64_t(std::chrono::system_clock::now().time_since_epoch().count())
                                  : 1;
  uint64_t count = 0;
  int failures = 0;
  for (uint64_t seed = first; failures < 5; ++seed, ++count) {
    if (given ? count >= 1 : stress ? std::chrono::steady_clock::now() > end : count >= 150) break;
    const std::string text = randomShader(seed);
    const std::string difference = firstDifference(text, seed);
    if (difference.empty()) continue;
    ++failures;
    ADD_FAILURE() << "seed " << seed << ": " << difference << "\n" << text;
  }
  if (stress)
    std::printf("%llu programs from seed %llu\n", (unsigned long long)count, (unsigned long long)first);
  setReportSink({});
}

/// Geometry of an area light: anywhere, by the numbers that it is given.
class ScatteredEmitter final : public Emitter {
 public:
  bool ready() const override { return true; }
  void sample(const EmitterQuery& q) const override {
    for (uint32_t i = 0; i < q.lanes; ++i) {
      if (!q.mask[i]) continue;
      const float x = q.xi[i].x, y = q.xi[i].y;
      const float P[3] = {x, y, x * y - 1}, N[3] = {0.6f, 0, 0.8f};
      for (uint32_t c = 0; c < 3; ++c) q.P.comp(c)[i] = P[c], q.N.comp(c)[i] = N[c];
      q.factor[i] = 0.25f + x;
    }
  }
};

/// Whatever a ray sees depends on the ray alone.
void answerByRay(PendingRays& r) {
  for (uint32_t k = 0; k < r.count; ++k) {
    uint64_t h = r.seed[k];
    for (uint32_t c = 0; c < 3; ++c)
      h = hashStep(h, std::bit_cast<uint32_t>(r.origin[c][k]) ^ std::bit_cast<uint32_t>(r.direction[c][k]) ^
                          std::bit_cast<uint32_t>(r.radius[k]));
    for (uint32_t c = 0; c < 3; ++c) r.color[c][k] = toUnitFloat64(hashStep(h, c));
  }
}

/// Kernels and machine code over the same points and lights.
struct LightsInRuns {
  uint64_t written = 0;  // evaluations of lights that are part of runs
  uint64_t ahead = 0;    // runs that other lights run before
};
std::string litDifference(uint64_t seed, LightsInRuns& inRuns) {
  const std::string text = randomLitShader(seed);
  const uint32_t sizes[][2] = {{0, 0}, {6, 0}, {7, 0}, {8, 0}, {4, 2}, {15, 0}, {16, 0}, {10, 5}};
  const auto& size = sizes[seed % std::size(sizes)];
  MachineFixture kernels(size[0], size[1]), native(size[0], size[1]);
  kernels.native = false;
  std::vector<const ShaderInstance*> lights[2];
  std::list<ShaderInstance> instances;
  kernels.oracle = native.oracle = &answerByRay;
  std::string all = text;
  int at = 0;
  for (MachineFixture* m : {&kernels, &native}) {
    for (uint64_t k = 0; k < seed % 4; ++k) {
      const std::string light = randomLight(seed * 4 + k);
      if (at == 0) all += light;
      const auto l = m->shader(light);
      if (!l) return "light not compiled: " + m->error + light;
      // Some are the geometry's, or throw shadows.
      ShaderInstance& instance = instances.emplace_back(*l);
      instance.shadows = (seed + k) % 5 == 0;
      if ((seed + k) % 7 == 0)
        instance.emitter = std::make_shared<ScatteredEmitter>(), instance.samples = 2,
        instance.id = uint32_t(k);
      lights[at].push_back(&instance);
    }
    ++at;
  }
  const auto a = kernels.shader(text), b = native.shader(text);
  if (!a || !b) return "not compiled: " + kernels.error + text;
  // Normals that are turned to the lights at some points and away at others.
  for (MachineFixture* m : {&kernels, &native})
    for (uint32_t i = 0; i < m->lanes; ++i)
      for (uint32_t c = 0; c < 3; ++c)
        m->batch.globals[size_t(GlobalId::k_N)].comp(c)[i] =
            float(hashStep(seed, 3 * i + c) >> 40) / 8388608.0f - 1;
  // Twice: what the first batch leaves behind must not matter.
  for (int turn = 0; turn < 2; ++turn) {
    kernels.run(*a, lights[0]);
    native.run(*b, lights[1]);
    for (const char* name : {"Ci", "Oi", "aov", "trail"}) {
      const Operand x = kernels.machine.result(name), y = native.machine.result(name);
      const uint32_t width = name == std::string_view("trail") ? 1 : 3;
      for (uint32_t i = 0; i < kernels.count; ++i)
        for (uint32_t c = 0; c < width; ++c) {
          const float want = x.at(i, c), got = y.at(i, c);
          if (std::memcmp(&want, &got, sizeof want) != 0 && !(std::isnan(want) && std::isnan(got)))
            return fmt::format("{}[{}] of point {} of {}, batch {}: {} instead of {}\n{}", name, c, i,
                               kernels.count, turn, got, want, all);
        }
    }
  }
  const NativeCode* const code = native.machine.code();
  for (uint32_t k = 0; code && k < b->program().code.size(); ++k)
    if (const NativeCode::Run* const run = code->at(k)) {
      inRuns.written += run->lights;
      inRuns.ahead += run->loopAhead != kNoIndex;
    }
  return "";
}

TEST(RandomPrograms, MachineCodeAgreesUnderLights) {
  setReportSink([](const Error&) {});
  const bool stress = std::getenv("FR_STRESS") != nullptr;
  const char* const given = std::getenv("FR_SEED");
  const char* const limit = std::getenv("FR_STRESS_SECONDS");
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(limit ? std::atoi(limit) : 600);
  const uint64_t first = given    ? std::strtoull(given, nullptr, 0)
                         : stress ? uint64_t(std::chrono::system_clock::now().time_since_epoch().count())
                                  : 1;
  int failures = 0;
  LightsInRuns lightsInRuns;
  uint64_t count = 0;
  for (uint64_t seed = first; failures < 3; ++seed, ++count) {
    if (given ? count >= 1 : stress ? std::chrono::steady_clock::now() > end : count >= 300) break;
    const std::string difference = litDifference(seed, lightsInRuns);
    if (difference.empty()) continue;
    ++failures;
    ADD_FAILURE() << "seed " << seed << ": " << difference;
  }
  // Found by long runs: lights that call random() had run for points that their loop does not reach.
  if (!given) {
    for (const uint64_t seed : {1795697400649553819ull, 1795697500944015078ull})
      EXPECT_EQ(litDifference(seed, lightsInRuns), "");
  }
  if (!given && failures == 0) {
    EXPECT_GT(lightsInRuns.written, count / 4) << "light loops are not written out any more";
    EXPECT_GT(lightsInRuns.ahead, count / 8) << "lights do not run before machine code any more";
  }
  setReportSink({});
}

TEST(RandomPrograms, ADifferenceIsSeen) {
  const char* const kText =
      "surface a(float gain = 1; color tint = 1; output varying color aov = 0; output varying float trail = "
      "0) {"
      " float i; for (i = 0; i < 4; i += 1) { if (u * 4 < i) break; trail += 1; } Ci = trail; Oi = 1; }";
  EXPECT_EQ(firstDifference(kText, 5), "");
  std::string other = kText;
  other.replace(other.find("u * 4 < i"), 9, "u * 4 > i");
  EXPECT_NE(firstDifference(kText, 5, other), "");
}

}  // namespace
}  // namespace fr
