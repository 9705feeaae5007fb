// For tests and benchmarks of the virtual machine: RSL text in, values per point out, without a scene.
#pragma once

#include <functional>
#include <map>

#include "base/random.h"
#include "shading/compile.h"
#include "shading/machine.h"

namespace fr {

class FixtureHost final : public ShaderHost {
 public:
  bool spaceToCurrent(std::string_view name, DMat4& m) const override {
    const auto it = spaces.find(std::string(name));
    if (it == spaces.end()) return false;
    m = it->second;
    return true;
  }
  bool objectToCurrent(uint32_t object, DMat4& m) const override {
    m = DMat4(1.0);
    m[3] = DVec4(double(object), 0, 0, 1);
    return true;
  }
  bool attribute(std::string_view name, uint32_t, ShaderValue& v) const override {
    if (name != "ShadingRate") return false;
    v.floats = {0.25f};
    return true;
  }
  bool option(std::string_view name, ShaderValue& v) const override {
    if (name != "Format") return false;
    v.floats = {640, 480, 1};
    v.arrayLength = 3;
    return true;
  }
  bool rendererInfo(std::string_view name, ShaderValue& v) const override {
    if (name != "renderer") return false;
    v.type = SlType::kString;
    v.strings = {"frankenrender"};
    return true;
  }
  Vec2 clipping() const override { return {1, 11}; }
  float sceneDiameter() const override { return 100; }
  void print(std::string_view text) const override { printed += text; }
  int textureCallUnavailable(std::string_view) const override { return 0; }
  const TextureLibrary* textures() const override { return library; }
  Vec2 shadowBias() const override { return bias; }
  std::map<std::string, DMat4> spaces = {{"world", DMat4(1.0)}, {"camera", DMat4(1.0)}};
  mutable std::string printed;
  const TextureLibrary* library = nullptr;
  Vec2 bias{0, -1};
};

/// One batch: a flat grid in z = 1, x = u, y = v, or any columns that a test sets.
class MachineFixture {
 public:
  explicit MachineFixture(uint32_t nu = 7, uint32_t nv = 4) { resize(nu, nv); }

  void resize(uint32_t nu, uint32_t nv) {
    count = (nu + 1) * (nv + 1);
    lanes = padLanes(count);
    memory_.assign(size_t(lanes) * 40 + 64, 0.0f);
    seeds_.resize(lanes);
    float* at = memory_.data();
    at += (64 - (reinterpret_cast<uintptr_t>(at) & 63)) / 4 % 16;
    const auto column = [&](GlobalId g) {
      Operand& o = batch.globals[size_t(g)];
      o = Operand{at, lanes, ~0u};
      at += size_t(slTypeFloats(globalInfo(g).type)) * lanes;
      return o;
    };
    batch = Batch{};
    const Operand P = column(GlobalId::k_P), N = column(GlobalId::k_N), Ng = column(GlobalId::k_Ng);
    const Operand u = column(GlobalId::k_u), v = column(GlobalId::k_v), s = column(GlobalId::k_s),
                  t = column(GlobalId::k_t);
    const Operand I = column(GlobalId::k_I), Cs = column(GlobalId::k_Cs), Os = column(GlobalId::k_Os);
    const Operand du = column(GlobalId::k_du), dv = column(GlobalId::k_dv);
    batch.globals[size_t(GlobalId::k_Oi)] = Os;
    auto* mask = reinterpret_cast<int32_t*>(at);
    stencil_.resize(lanes);
    for (uint32_t i = 0; i < lanes; ++i) {
      const uint32_t k = std::min(i, count - 1);
      const float x = float(k % (nu + 1)) / float(std::max(1u, nu)),
                  y = float(k / (nu + 1)) / float(std::max(1u, nv));
      P.comp(0)[i] = x, P.comp(1)[i] = y, P.comp(2)[i] = 1;
      N.comp(2)[i] = Ng.comp(2)[i] = -1;
      u.data[i] = s.data[i] = x, v.data[i] = t.data[i] = y;
      for (uint32_t c = 0; c < 3; ++c) I.comp(c)[i] = P.at(i, c), Cs.comp(c)[i] = 1, Os.comp(c)[i] = 1;
      du.data[i] = 1 / float(std::max(1u, nu)), dv.data[i] = 1 / float(std::max(1u, nv));
      mask[i] = i < count ? -1 : 0;
      seeds_[i] = hashStep(17, i);
    }
    batch.lanes = lanes;
    batch.points = batch.asking = count;
    batch.mask = mask;
    batch.seed = seeds_.data();
  }

  /// Compiles and binds; an empty pointer (and the message in `error`) when the source is wrong.
  std::shared_ptr<const ShaderInstance> shader(const std::string& source,
                                               const std::vector<ParameterSetting>& settings = {},
                                               const std::vector<std::string>& varying = {},
                                               int optimize = 2) {
    Diagnostics diagnostics;
    CompileOptions options;
    options.optimize = optimize;
    options.includePaths = includePaths;
    options.shadeopPaths = shadeopPaths;
    auto program = compileShaderString(source, options, diagnostics);
    if (!program) {
      error = program.error().str();
      return nullptr;
    }
    auto exe =
        std::make_shared<Executable>(std::make_shared<const ShaderProgram>(std::move(*program)), varying);
    if (native) exe->makeNativeAtOnce();
    kept_.push_back(bindShader(exe, shaderToCurrent, settings, host));
    return kept_.back();
  }

  /// Runs to the end; rays are answered by `oracle` (default: everything misses). Counts the suspensions.
  void run(const ShaderInstance& s, const std::vector<const ShaderInstance*>& lights = {},
           Machine::Partners partners = {}) {
    suspensions = 0;
    machine.begin(batch, s, lights, partners);
    while (machine.run() == Machine::Status::kNeedsRays) {
      ++suspensions;
      machine.rays().missAll();
      if (oracle) oracle(machine.rays());
    }
  }
  float Ci(uint32_t i, uint32_t c = 0) const { return machine.result(GlobalId::k_Ci).at(i, c); }

  FixtureHost host;
  DMat4 shaderToCurrent{1.0};
  Machine machine{host};
  Batch batch;
  uint32_t count = 0, lanes = 0;
  std::string error;
  std::vector<std::string> includePaths, shadeopPaths;
  int suspensions = 0;
  bool native = true;  // machine code from the first batch on
  std::function<void(PendingRays&)> oracle;

 private:
  std::vector<std::shared_ptr<const ShaderInstance>> kept_;
  std::vector<float> memory_;
  std::vector<uint64_t> seeds_;
  DerivativeStencil stencil_;
};

}  // namespace fr
