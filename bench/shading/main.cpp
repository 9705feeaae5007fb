// Nanoseconds per shaded point: every standard shader and some patterns through the virtual machine, beside
// the same computations written by hand in SIMD C++, by turns in one run.
//
//   shading_bench [--json=FILE] [--seconds=0.05] [name part...]
//
// The best of many turns counts on both sides: what others do to the machine only ever adds.
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/texture.h>
#include <fmt/core.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/isa.h"
#include "bench/shading/cases.h"
#include "shading/machine_fixture.h"
#include "shading/texture_library.h"

namespace fr::bench {
namespace {

constexpr uint32_t kSizes[] = {1, 16, 64, 256, 1024};
constexpr size_t kGoalSize = 3;  // 256
constexpr uint32_t kColumn = 1024 + 32;

std::string readFile(const std::string& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}
double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// A texture of 1024 x 1024 pixels.
std::string makeTextureFile() {
  const std::string base =
      (std::filesystem::temp_directory_path() / fmt::format("fr_shading_bench.{}", ::getpid())).string();
  constexpr int n = 1024;
  std::vector<uint8_t> texels;
  for (int k = 0; k < n * n * 3; ++k) texels.push_back(uint8_t((uint32_t(k) * 2654435761u) >> 24));
  const auto out = OIIO::ImageOutput::create("tiff");
  out->open(base + ".tif", OIIO::ImageSpec(n, n, 3, OIIO::TypeDesc::UINT8));
  out->write_image(OIIO::TypeDesc::UINT8, texels.data());
  out->close();
  TextureRequest r;
  r.pictures = {base + ".tif"}, r.texture = base + ".tx", r.sWrap = r.tWrap = "periodic";
  if (const auto made = makeTexture(r); !made) report(made.error());
  std::filesystem::remove(base + ".tif");
  return base + ".tx";
}
std::string theTexture;

/// A loop over OpenImageIO, as the hand-written shaders look textures up.
void lookUp(const HandTask& t, const float* const changes[4], float* const color[3]) {
  static OIIO::TextureSystem* const system = OIIO::TextureSystem::create(false);
  static auto* const thread = system->get_perthread_info();
  static auto* const handle = system->get_texture_handle(OIIO::ustring(theTexture));
  OIIO::TextureOpt options;
  options.interpmode = OIIO::TextureOpt::InterpBilinear;
  for (uint32_t i = 0; i < t.count; ++i) {
    float r[3];
    system->texture(handle, thread, options, t.s[i], t.t[i], changes[0][i], changes[1][i], changes[2][i],
                    changes[3][i], 3, r);
    for (int c = 0; c < 3; ++c) color[c][i] = r[c];
  }
}

/// What PendingRays::missAll() is to the machine.
void missAll(HandRays& r) {
  for (uint32_t i = 0; i < r.count; ++i) {
    for (int c = 0; c < 3; ++c) r.color[c][i] = 0, r.missR[c][i] = r.direction[c][i];
    r.hitDistance[i] = 1e38f, r.missDepth[i] = 1;
  }
}

/// An area light that is one point, facing +z, and shines as evenly as arealight's shader says.
class PointEmitter final : public Emitter {
 public:
  bool ready() const override { return true; }
  void sample(const EmitterQuery& q) const override {
    for (uint32_t c = 0; c < 3; ++c) {
      std::fill_n(q.P.comp(c), q.lanes, 0.0f);
      std::fill_n(q.N.comp(c), q.lanes, c == 2 ? 1.0f : 0.0f);
    }
    std::fill_n(q.factor, q.lanes, 1.0f);
  }
};

/// The same for those who write by hand.
void onePoint(const HandTask& t, const float* const*, float* const P[3], float* const N[3], float* factor) {
  for (uint32_t c = 0; c < 3; ++c) {
    std::fill_n(P[c], t.count, 0.0f);
    std::fill_n(N[c], t.count, c == 2 ? 1.0f : 0.0f);
  }
  std::fill_n(factor, t.count, 1.0f);
}

/// The same points for both sides: a bent sheet, normals that are not unit, colours.
struct Points {
  explicit Points(uint32_t n)
      : row(n == 1 ? 1 : uint32_t(std::lround(std::sqrt(double(n))))), fixture(row - 1, row - 1) {
    MachineFixture& f = fixture;
    Batch& b = f.batch;
    gridStencil(stencil, row - 1, row - 1, f.lanes, 1.0f / float(std::max(1u, row - 1)),
                1.0f / float(std::max(1u, row - 1)));
    b.stencil = &stencil;
    const auto g = [&](GlobalId id) -> Operand& { return b.globals[size_t(id)]; };
    const Operand P = g(GlobalId::k_P), N = g(GlobalId::k_N), I = g(GlobalId::k_I), Cs = g(GlobalId::k_Cs);
    for (uint32_t i = 0; i < f.lanes; ++i) {
      const float x = P.at(i, 0), y = P.at(i, 1);
      const float normal[3] = {1.4f * (x - .5f), 1.2f * (y - .5f), -1.0f};
      const float place[3] = {x, y, 2 + .3f * std::sin(3 * x) * std::cos(2 * y)};
      for (uint32_t c = 0; c < 3; ++c) {
        N.comp(c)[i] = normal[c];
        P.comp(c)[i] = I.comp(c)[i] = place[c];
        Cs.comp(c)[i] = .3f + .2f * float(c);
      }
    }
    memory.assign(size_t(kColumn) * 80, 0.0f);
    auto* at = memory.data();
    at += (64 - (reinterpret_cast<uintptr_t>(at) & 63)) / 4 % 16 + 16;
    const auto column = [&] {
      float* const c = at;
      at += kColumn;
      return c;
    };
    const auto copied = [&](const Operand& o, uint32_t c) {
      float* const to = column();
      for (uint32_t i = 0; i < f.lanes; ++i) to[i] = o.at(i, c);
      return to;
    };
    HandTask& t = task;
    t.count = f.count, t.row = row, t.rows = row;
    for (uint32_t c = 0; c < 3; ++c) {
      t.P[c] = copied(P, c), t.N[c] = copied(N, c), t.I[c] = copied(I, c), t.Cs[c] = copied(Cs, c);
      t.Os[c] = copied(g(GlobalId::k_Os), c);
      t.Ci[c] = column(), t.Oi[c] = column(), t.outP[c] = column(), t.outN[c] = column();
      rays.origin[c] = column(), rays.direction[c] = column(), rays.color[c] = column(),
      rays.missR[c] = column();
      // What volumes and imagers find.
      Operand& Ci = g(GlobalId::k_Ci);
      if (!Ci.data) Ci = Operand{extra.data(), f.lanes, ~0u};
      Operand& alpha = g(GlobalId::k_alpha);
      if (!alpha.data) alpha = Operand{extra.data() + 3 * 1024, f.lanes, ~0u};
      for (uint32_t i = 0; i < f.lanes; ++i) Ci.comp(c)[i] = .2f, alpha.data[i] = .5f;
    }
    t.s = copied(g(GlobalId::k_s), 0), t.t = copied(g(GlobalId::k_t), 0);
    t.alpha = column();
    rays.radius = column(), rays.spread = column(), rays.hitDistance = column(), rays.missDepth = column();
    seeds.resize(kColumn), lane.resize(kColumn);
    for (uint32_t i = 0; i < f.lanes; ++i) seeds[i] = b.seed[i];
    rays.seed = seeds.data() + 0, rays.lane = lane.data();
    raySeeds = seeds, t.seed = raySeeds.data();
    calls.assign(kColumn, 0), t.calls = calls.data();
    t.rays = &rays, t.ask = &missAll, t.texture = &lookUp, t.emitters = &onePoint;
    t.scratch = column();
    at += 24 * size_t(kColumn);
  }
  /// Imagers and volumes change their colours in place.
  void resetResults() {
    for (uint32_t c = 0; c < 3; ++c)
      for (uint32_t i = 0; i < fixture.lanes; ++i)
        task.Ci[c][i] = .2f, task.Oi[c][i] = 1, task.alpha[i] = .5f;
  }
  uint32_t row;
  MachineFixture fixture;
  DerivativeStencil stencil;
  HandTask task;
  HandRays rays;
  std::vector<uint64_t> seeds, raySeeds;
  std::vector<uint32_t> lane, calls;
  std::vector<float> memory;
  alignas(64) std::array<float, 4 * 1024> extra{};
};

struct Sides {
  double machine = 1e30, hand = 1e30;  // nanoseconds per point
  double lanes = 1;                    // active / total of the machine's kernels
  std::string mismatch;
};

double differenceOf(float a, float b) {
  return std::fabs(double(a) - double(b)) / std::max({1.0, std::fabs(double(a)), std::fabs(double(b))});
}

Sides measure(const Case& c, uint32_t n, double seconds, const TextureLibrary& textures) {
  Sides r;
  auto points = std::make_unique<Points>(n);
  MachineFixture& f = points->fixture;
  f.includePaths = {FR_SHADER_DIR};
  f.host.library = &textures;
  const auto load = [&](const std::string& name, const std::string& source,
                        const std::vector<ParameterSetting>& settings) {
    return f.shader(source.empty() ? readFile(FR_SHADER_DIR "/" + name + ".sl") : source, settings);
  };
  const auto shader = load(c.shader, c.source, c.settings);
  if (!shader) {
    r.mismatch = f.error;
    return r;
  }
  std::vector<const ShaderInstance*> lights;
  std::vector<std::unique_ptr<ShaderInstance>> areaLights;
  std::vector<HandLight> handLights;
  for (const LightCase& l : c.lights) {
    lights.push_back(load(l.shader, {}, l.settings).get());
    if (l.hand.kind == HandLight::kArea) {
      areaLights.push_back(std::make_unique<ShaderInstance>(*lights.back()));
      areaLights.back()->emitter = std::make_shared<PointEmitter>();
      lights.back() = areaLights.back().get();
    }
    handLights.push_back(l.hand);
  }
  HandTask& t = points->task;
  if (c.tell) c.tell(t);
  t.lights = handLights.data(), t.lightCount = uint32_t(handLights.size());
  const HandShader hand = handShader(c.hand, int(currentIsa()));
  if (!hand) {
    r.mismatch = "there is no hand-written version";
    return r;
  }
  const auto runMachine = [&] { f.run(*shader, lights); };
  const auto runHand = [&] { hand(t); };
  runMachine();
  points->resetResults();
  runHand();
  double sums[2][6] = {};
  for (uint32_t i = 0; i < f.count; ++i)
    for (uint32_t k = 0; k < 6; ++k) {
      const GlobalId id =
          c.comparePN ? (k < 3 ? GlobalId::k_P : GlobalId::k_N) : (k < 3 ? GlobalId::k_Ci : GlobalId::k_Oi);
      const Operand o = f.machine.result(id);
      const float* const* const want = c.comparePN ? (k < 3 ? t.outP : t.outN) : (k < 3 ? t.Ci : t.Oi);
      if (!o.data) continue;
      const float got = o.at(i, k % 3), expected = want[k % 3][i];
      sums[0][k] += double(got), sums[1][k] += double(expected);
      if (!c.meansOnly && !(differenceOf(got, expected) < c.tolerance) && r.mismatch.empty())
        r.mismatch = fmt::format("point {} component {}: {} by the machine, {} by hand", i, k, got, expected);
    }
  for (uint32_t k = 0; k < 6 && c.meansOnly && n >= 64; ++k)
    if (!(differenceOf(float(sums[0][k] / n), float(sums[1][k] / n)) < c.tolerance))
      r.mismatch = fmt::format("mean {}: {} by the machine, {} by hand", k, sums[0][k] / n, sums[1][k] / n);

  // Turns of about 100 microseconds: long against the clock, short against the scheduler.
  const auto turn = [&](const auto& run, uint32_t repetitions) {
    const double begin = now();
    for (uint32_t k = 0; k < repetitions; ++k) {
      run();
      asm volatile("" ::: "memory");
    }
    return (now() - begin) / repetitions * 1e9 / f.count;
  };
  const auto repetitionsFor = [&](const auto& run) {
    const double once = std::max(1e-8, turn(run, 1) * f.count * 1e-9);
    const double better = std::max(1e-8, turn(run, 8) * f.count * 1e-9);
    return uint32_t(std::clamp(1e-4 / std::min(once, better), 1.0, 10000.0));
  };
  f.machine.statistics() = {};
  runMachine();
  const MachineStatistics& s = f.machine.statistics();
  r.lanes = s.lanesTotal ? double(s.lanesActive) / double(s.lanesTotal) : 1.0;
  const uint32_t a = repetitionsFor(runMachine), b = repetitionsFor(runHand);
  const double end = now() + seconds;
  for (int k = 0; k < 5 || now() < end; ++k) {
    r.machine = std::min(r.machine, turn(runMachine, a));
    points->resetResults();
    r.hand = std::min(r.hand, turn(runHand, b));
  }
  return r;
}

/// A shader of about `lines` lines of the kind that exporters write: many parameters, layers of patterns,
/// lights.
std::string longShader(int lines) {
  std::string s = "surface exported(float Ka = 1; float Kd = .7;";
  for (int k = 0; k < 40; ++k)
    s += fmt::format(" float amount{0} = .{0}1; color tint{0} = color (.1, .2, .{0});\n", k);
  s += ")\n{\n normal Nf = faceforward(normalize(N), I);\n vector V = -normalize(I);\n color layer = Cs;\n "
       "float m;\n";
  const int used = 46;
  for (int k = 0; used + k * 9 + 6 < lines; ++k) {
    s += fmt::format(
        " point P{0} = transform(\"shader\", P) * ({0} + 1);\n"
        " m = smoothstep(.2, .8, noise(P{0})) * amount{1};\n"
        " if (m > .{1}) {{\n"
        "  layer = mix(layer, tint{1}, m);\n"
        "  layer *= 1 + .1 * sin(s * {0} + t);\n"
        " }} else {{\n"
        "  layer += .01 * cellnoise(P{0});\n"
        " }}\n"
        " layer = clamp(layer, color 0, color 1);\n",
        k, k % 40);
  }
  return s + " Oi = Os;\n Ci = Os * layer * (Ka * ambient() + Kd * diffuse(Nf)) + specular(Nf, V, .1);\n}\n";
}

double compileMilliseconds(const std::string& source) {
  double best = 1e30;
  for (int k = 0; k < 7; ++k) {
    const double begin = now();
    Diagnostics diagnostics;
    auto program = compileShaderString(source, {}, diagnostics);
    if (!program) return -1;
    const Executable exe(std::make_shared<const ShaderProgram>(std::move(*program)));
    best = std::min(best, (now() - begin) * 1e3);
  }
  return best;
}

}  // namespace
}  // namespace fr::bench

int main(int argc, char** argv) {
  using namespace fr::bench;
  std::string jsonFile;
  double seconds = 0.05;
  std::vector<std::string> parts;
  for (int k = 1; k < argc; ++k) {
    const std::string a = argv[k];
    if (a.rfind("--json=", 0) == 0)
      jsonFile = a.substr(7);
    else if (a.rfind("--seconds=", 0) == 0)
      seconds = std::atof(a.c_str() + 10);
    else if (a[0] == '-') {
      fmt::print(stderr, "usage: shading_bench [--json=FILE] [--seconds=S] [part of a name ...]\n");
      return 1;
    } else
      parts.push_back(a);
  }
  fr::setReportSink([](const fr::Error& e) {
    if (e.severity != fr::Severity::kWarning) fmt::print(stderr, "{}\n", e.message);
  });
  theTexture = makeTextureFile();
  const fr::TextureLibrary textures({});
  nlohmann::json json;
  json["isa"] = fr::isaName(fr::currentIsa());
  fmt::print("{}; nanoseconds a point, machine / by hand, by points of a batch\n",
             fr::isaName(fr::currentIsa()));
  fmt::print("{:<26}", "shader");
  for (uint32_t n : kSizes) fmt::print("{:>17}", n);
  fmt::print("{:>8}{:>6}{:>7}\n", "ratio", "goal", "lanes");
  int missed = 0, wrong = 0;
  for (const Case& c : allCases(theTexture)) {
    if (!parts.empty() && std::none_of(parts.begin(), parts.end(), [&](const std::string& p) {
          return c.name.find(p) != std::string::npos;
        }))
      continue;
    nlohmann::json entry{{"shader", c.name}, {"goal", c.goal}};
    std::string mismatch;
    double ratio = 0, lanes = 0;
    fmt::print("{:<26}", c.name);
    for (size_t k = 0; k < std::size(kSizes); ++k) {
      const Sides s = measure(c, kSizes[k], seconds, textures);
      if (!s.mismatch.empty()) mismatch = fmt::format("{} points: {}", kSizes[k], s.mismatch);
      fmt::print("{:>9.2f}/{:<7.2f}", s.machine, s.hand);
      std::fflush(stdout);
      entry["points"].push_back(
          {{"count", kSizes[k]}, {"machine", s.machine}, {"hand", s.hand}, {"lanes", s.lanes}});
      if (k == kGoalSize) ratio = s.machine / s.hand, lanes = s.lanes;
    }
    entry["ratio"] = ratio;
    fmt::print("{:>8.2f}{:>6.1f}{:>7.2f}{}\n", ratio, c.goal, lanes, ratio > c.goal ? "  missed" : "");
    if (!mismatch.empty()) fmt::print("  results differ: {}\n", mismatch);
    missed += ratio > c.goal, wrong += !mismatch.empty();
    json["shaders"].push_back(entry);
  }
  if (parts.empty()) {
    const std::string source = longShader(900);
    const double ms = compileMilliseconds(source);
    const auto lines = std::count(source.begin(), source.end(), '\n');
    fmt::print("compiling a shader of {} lines: {:.1f} ms\n", lines, ms);
    json["compile"] = {{"lines", lines}, {"milliseconds", ms}};
  }
  fmt::print("{} above their goal, {} with other results\n", missed, wrong);
  json["missed"] = missed;
  if (!jsonFile.empty()) std::ofstream(jsonFile) << json.dump(1) << '\n';
  std::filesystem::remove(theTexture);
  return wrong ? 1 : 0;
}
