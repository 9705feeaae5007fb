#include "shading/machine.h"

#include <algorithm>
#include <cstring>

#include "base/error.h"
#include "shading/machine_light.h"

namespace fr {

namespace {
void reportEndedLoop(const Frame& f) {
  reportOnce("shading.turns." + f.exe().program().name,
             makeError(RiError::kLimit, "shader \"{}\": a loop ran {} times and was ended",
                       f.exe().program().name, kMostTurns));
}
/// Every sample of an area light keeps its own results.
constexpr uint32_t kMostLightSamples = 256;
alignas(64) constexpr int32_t kAllActive[kLanePad] = {-1, -1, -1, -1, -1, -1, -1, -1,
                                                      -1, -1, -1, -1, -1, -1, -1, -1};

Operand maskOperand(int32_t* m, uint32_t lanes) { return {reinterpret_cast<float*>(m), lanes, ~0u}; }

void runHelper(Helper h, std::initializer_list<Operand> args, uint32_t lanes, const int32_t* mask = nullptr) {
  KernelCall c;
  c.arg = args.begin(), c.argCount = uint32_t(args.size()), c.lanes = lanes, c.mask = mask;
  kernels().helper[size_t(h)](c);
}
}  // namespace

void DerivativeStencil::resize(size_t lanes) {
  for (auto* v : {&uLo, &uHi, &vLo, &vHi}) v->assign(lanes, 0);
  for (auto* v : {&uScale, &vScale, &uCell, &vCell}) v->assign(lanes, 0.0f);
}

bool Machine::any(const int32_t* m) const { return kernels().anyActive(m, batch_.lanes); }

namespace {
/// Globals that the machine itself changes while a shader runs.
bool changesWhileRunning(GlobalId id, ShaderType type) {
  if (id == GlobalId::k_L || id == GlobalId::k_Cl || id == GlobalId::k_Ol) return true;
  return type == ShaderType::kLight &&
         (id == GlobalId::k_P || id == GlobalId::k_N || id == GlobalId::k_Ns || id == GlobalId::k_Ps);
}
}  // namespace

void Machine::setGlobals(Frame& f) {
  const Executable& e = f.exe();
  for (const GlobalId id : e.usedGlobals()) {
    const Operand in = batch_.globals[size_t(id)];
    const uint32_t s = e.global(id);
    const Operand& now = f.symbol(s);
    // Where the last batch has put it.
    if (in.data && now.data == in.data && now.component == in.component && now.indexMask == in.indexMask)
      continue;
    // What the program writes has always had a register of its own.
    if (!(e.program().writesGlobals & globalBit(id))) {
      if (!changesWhileRunning(id, e.program().type) && f.alias(id, in)) continue;
      f.unalias(id);
    }
    if (!e.liveAtEntry(s)) continue;
    const Operand out = f.symbol(s);
    const uint32_t n = out.varying() ? f.lanes() : kLanePad;
    for (uint32_t c = 0; c < e.program().symbols[s].floats(); ++c) {
      float* const to = out.comp(c);
      if (!in.data)
        std::memset(to, 0, n * sizeof(float));
      else if (in.varying())
        std::memcpy(to, in.comp(c), n * sizeof(float));
      else
        std::fill_n(to, n, in.comp(c)[0]);
    }
  }
}

void Machine::begin(const Batch& batch, const ShaderInstance& shader,
                    std::span<const ShaderInstance* const> lights, const Partners& partners) {
  beginWithKernels(batch, shader, lights, partners);
  main_.useNative(nativeCode(shader));
}

void Machine::beginWithKernels(const Batch& batch, const ShaderInstance& shader,
                               std::span<const ShaderInstance* const> lights, const Partners& partners) {
  FR_CHECK(batch.lanes % kLanePad == 0 && batch.lanes > 0 && batch.mask);
  // A call: the compiler's own copy of so many bytes takes three times as long to begin.
  static_assert(std::is_trivially_copyable_v<Batch>);
  std::memmove(static_cast<void*>(&batch_), &batch, sizeof batch);
  partners_ = partners;
  footprintsKnown_ = false;
  if (!texts_.empty()) texts_.clear();
  textBytes_ = 0;
  main_.prepare(shader, batch.lanes);
  setGlobals(main_);
  for (const Batch::Override& o : batch.overrides) {
    const uint32_t s = shader.program().parameters[o.parameter].symbol;
    const Operand& out = main_.symbol(s);
    if (!out.data || !out.varying()) continue;
    for (uint32_t c = 0; c < shader.program().symbols[s].floats(); ++c)
      std::memcpy(out.comp(c), o.values.comp(c), batch.lanes * sizeof(float));
  }
  main_.start(batch.mask);
  lightCount_ = 0;
  for (const ShaderInstance* light : lights) {
    // An area light is one light for each of its samples. Diffuse rays are averaged anyway: one is enough.
    const bool area = light->emitter && light->emitter->ready();
    const uint32_t samples =
        area && batch.diffuseDepth == 0 ? std::clamp(light->samples, 1u, kMostLightSamples) : 1;
    for (uint32_t k = 0; k < samples; ++k) {
      if (lights_.size() == lightCount_) lights_.push_back(std::make_unique<LightState>());
      LightState& l = *lights_[lightCount_++];
      l.instance = light;
      l.begun = false;
      l.emitter = area ? light->emitter.get() : nullptr;
      l.sample = k, l.samples = samples;
    }
  }
  columnsKnown_ = false;
  stack_.clear();
  stack_.reserve(4);
  stack_.push_back(&main_);
}

/// Of the shader under the lights of this batch.
const NativeCode* Machine::nativeCode(const ShaderInstance& shader) {
  runLights_.clear();
  if (shader.exe->has(kProgramUsesLights))
    for (uint32_t k = 0; k < lightCount_; ++k) {
      const LightState& l = *lights_[k];
      const bool shadowed = l.instance->shadows, plain = l.instance->exe->plainLight() && !shadowed;
      runLights_.push_back({l.instance->exe.get(), plain, shadowed, plain && l.emitter});
    }
  const auto address = reinterpret_cast<uintptr_t>(shader.exe.get());
  KnownNative& known = knownNatives_[(address >> 6 ^ address >> 11) % knownNatives_.size()];
  if (known.exe == shader.exe && known.lights == runLights_) return known.code;
  bool final = false;
  const NativeCode* const code = shader.exe->native(
      runLights_, [&](uint32_t k) { return lights_[k]->instance->exe; }, &final);
  if (final) known = {shader.exe, runLights_, code};
  return code;
}

Machine::Status Machine::run() {
  while (!stack_.empty()) {
    Frame& f = *stack_.back();
    if (execute(f) == Next::kSuspend) return Status::kNeedsRays;
    if (f.finished) stack_.pop_back();
  }
  return Status::kDone;
}

Operand Machine::result(std::string_view name) const {
  const ShaderProgram& p = main_.exe().program();
  const uint32_t i = p.findParameter(name);
  if (i != kNoIndex) return main_.symbol(p.parameters[i].symbol);
  for (size_t g = 0; g < size_t(GlobalId::kCount); ++g)
    if (name == globalInfo(GlobalId(g)).name) return main_.global(GlobalId(g));
  return {};
}

void Machine::beginDefaults(const ShaderInstance& shader) {
  Batch b;
  b.lanes = kLanePad;
  b.points = b.asking = 1;
  b.mask = kAllActive;
  b.raysAllowed = false;
  beginWithKernels(b, shader, {}, {});
}

ShaderValue Machine::runDefault(const Parameter& p) {
  main_.pc = p.codeBegin;
  main_.end = p.codeEnd;
  run();
  const Symbol& s = main_.exe().program().symbols[p.symbol];
  ShaderValue v;
  v.type = s.type;
  v.arrayLength = s.arrayLength;
  if (s.type == SlType::kString)
    for (uint32_t k = 0; k < std::max(1u, s.arrayLength); ++k)
      v.strings.emplace_back(main_.strings(p.symbol)[k]);
  else
    for (uint32_t c = 0; c < s.floats(); ++c) v.floats.push_back(main_.symbol(p.symbol).at(0, c));
  return v;
}

Machine::Next Machine::execute(Frame& f) {
  const std::vector<Step>& steps = f.exe().steps();
  const uint32_t end = f.end;
  const NativeCode* const native = f.native();
  while (f.pc < end) {
    const Step& s = steps[f.pc];
    if (s.control) {
      const Next n = control(f, s);
      if (n != Next::kGo) return n;
      continue;
    }
    if (!f.active) {
      ++f.pc;
      continue;
    }
    if (const NativeCode::Run* const run = native ? native->at(f.pc) : nullptr) {
      if (run->loopAhead != kNoIndex) {
        const Next n = runLightsAhead(f, run->loopAhead);
        if (n != Next::kGo) return n;
      }
      if (run->varyingSteps) {
        statistics_.lanesActive += uint64_t(f.activeCount) * run->varyingSteps;
        statistics_.lanesTotal += uint64_t(f.lanes()) * run->varyingSteps;
      }
      statistics_.steps += run->steps;
      if (run->lights) {
        statistics_.lightPoints += uint64_t(f.activeCount) * run->lights;
      }
      float* const* const columns = !run->differences.empty() ? columnsWithDifferences(f, *run)
                                    : run->readsLights        ? columnsWithLights(f)
                                                              : f.columns();
      if (run->function(columns, f.lanes() * sizeof(float), f.mask)) reportEndedLoop(f);
      f.pc = run->end;
      continue;
    }
    ++statistics_.steps;
    if (s.kernel) {
      KernelCall c;
      c.arg = f.args(s);
      c.argCount = s.argCount;
      c.lanes = s.varying ? f.lanes() : kLanePad;
      c.mask = s.varying ? f.mask : kAllActive;
      if (s.varying) {
        statistics_.lanesActive += f.activeCount, statistics_.lanesTotal += c.lanes;
      }
      s.kernel(c);
      ++f.pc;
      continue;
    }
    const uint32_t flags = opInfo(s.op).flags;
    if ((flags & kOpRay) || ((flags & kOpTexture) && asksByMapName(f, s))) {
      if (rayOp(f, s) == Next::kSuspend) return Next::kSuspend;
      ++f.pc;
      continue;
    }
    call(f, s);
    ++f.pc;
  }
  f.finished = true;
  return Next::kGo;
}

/// The active points leave every block above `outermost` (an index into f.control): none of them wakes them
/// again.
void Machine::leave(Frame& f, uint32_t outermost) {
  const Operand m = maskOperand(f.mask, f.lanes());
  for (uint32_t i = f.depth; i-- > outermost;) {
    Control& c = f.control[i];
    if (c.kind == Control::Kind::kUniformIf) continue;
    const Operand saved = maskOperand(c.saved, f.lanes());
    runHelper(Helper::maskAndNot, {saved, saved, m}, f.lanes());
    if (c.kind == Control::Kind::kLoop || c.kind == Control::Kind::kLights ||
        c.kind == Control::Kind::kGather) {
      const Operand other = maskOperand(c.other, f.lanes());
      runHelper(Helper::maskAndNot, {other, other, m}, f.lanes());
    }
  }
  std::memset(f.mask, 0, f.lanes() * sizeof(int32_t));
  f.active = false;
}

Machine::Next Machine::control(Frame& f, const Step& s) {
  const size_t bytes = f.lanes() * sizeof(int32_t);
  const uint32_t lanes = f.lanes();
  const Operand mask = maskOperand(f.mask, lanes);
  switch (s.op) {
    case Op::if_begin: {
      const Step& partner = f.exe().steps()[s.jump];
      const bool hasElse = partner.op == Op::if_else;
      if (!f.active) {
        f.pc = (hasElse ? partner.jump : s.jump) + 1;
        break;
      }
      const Operand& condition = f.args(s)[0];
      if (!condition.varying()) {
        f.push(Control::Kind::kUniformIf);
        // A jump past if_else enters the else branch; the one that the then branch ends at skips it.
        f.pc = condition.at(0) != 0.0f ? f.pc + 1 : hasElse ? s.jump + 1 : s.jump;
        break;
      }
      Control& c = f.push(Control::Kind::kIf);
      std::memcpy(c.saved, f.mask, bytes);
      if (hasElse) runHelper(Helper::maskAndZero, {maskOperand(c.other, lanes), mask, condition}, lanes);
      runHelper(Helper::maskAndNonZero, {mask, mask, condition}, lanes);
      f.countActive();
      f.pc = f.active ? f.pc + 1 : s.jump;
      break;
    }
    case Op::if_else: {
      Control& c = f.top();
      if (c.kind == Control::Kind::kUniformIf) {
        f.pc = s.jump;
        break;
      }
      f.activate(c.other);
      f.pc = f.active ? f.pc + 1 : s.jump;
      break;
    }
    case Op::if_end:
      if (f.top().kind == Control::Kind::kIf) f.activate(f.top().saved);
      f.pop();
      ++f.pc;
      break;
    case Op::loop_begin: {
      if (!f.active) {
        f.pc = s.jump + 1;
        break;
      }
      Control& c = f.push(Control::Kind::kLoop);
      std::memcpy(c.saved, f.mask, bytes);
      std::memset(c.other, 0, bytes);
      ++f.pc;
      break;
    }
    case Op::loop_test: {
      const Operand& condition = f.args(s)[0];
      if (condition.varying()) {
        runHelper(Helper::maskAndNonZero, {mask, mask, condition}, lanes);
        f.countActive();
      } else if (condition.at(0) == 0.0f) {
        f.active = false;
      }
      if (f.active) {
        ++f.pc;
        break;
      }
      f.activate(f.top().saved);
      f.pop();
      f.pc = s.jump + 1;
      break;
    }
    case Op::loop_step: {
      Control& c = f.top();
      if (c.anyContinued) {
        const Operand other = maskOperand(c.other, lanes);
        runHelper(Helper::maskOr, {mask, mask, other}, lanes);
        std::memset(c.other, 0, bytes);
        c.anyContinued = false;
        f.countActive();
      }
      if (f.active) {
        ++f.pc;
        break;
      }
      f.activate(c.saved);
      f.pop();
      f.pc = s.jump + 1;
      break;
    }
    case Op::loop_end: {
      Control& c = f.top();
      if (++c.turns >= kMostTurns) {
        reportEndedLoop(f);
        f.activate(c.saved);
        f.pop();
        ++f.pc;
        break;
      }
      f.pc = s.jump + 1;
      break;
    }
    case Op::break_loop:
    case Op::continue_loop: {
      if (f.active) {
        uint32_t n = std::max(1u, uint32_t(std::clamp(f.args(s)[0].at(0), 1.0f, 64.0f)));
        uint32_t target = f.depth;
        while (target > 0) {
          const Control::Kind k = f.control[target - 1].kind;
          const bool loop =
              k == Control::Kind::kLoop || k == Control::Kind::kLights || k == Control::Kind::kGather;
          if (loop && --n == 0) break;
          --target;
        }
        if (target == 0) {  // cannot be: the compiler checks nesting
          ++f.pc;
          break;
        }
        Control& c = f.control[target - 1];
        const Operand other = maskOperand(c.other, lanes);
        if (s.op == Op::continue_loop) {
          // Points of a light or gather loop sleep until the next turn, which starts from `other` anyway.
          if (c.kind == Control::Kind::kLoop) {
            runHelper(Helper::maskOr, {other, other, mask}, lanes);
            c.anyContinued = true;
          }
        } else if (c.kind != Control::Kind::kLoop) {
          runHelper(Helper::maskAndNot, {other, other, mask}, lanes);
        } else if (c.anyContinued) {
          runHelper(Helper::maskAndNot, {other, other, mask}, lanes);
        }
        leave(f, target);
      }
      ++f.pc;
      break;
    }
    case Op::inline_begin: {
      if (!f.active) {
        f.pc = s.jump + 1;
        break;
      }
      std::memcpy(f.push(Control::Kind::kInline).saved, f.mask, bytes);
      ++f.pc;
      break;
    }
    case Op::inline_return: {
      if (f.active) {
        uint32_t target = f.depth;
        while (target > 0 && f.control[target - 1].kind != Control::Kind::kInline) --target;
        leave(f, target);
      }
      ++f.pc;
      break;
    }
    case Op::inline_end:
      f.activate(f.top().saved);
      f.pop();
      ++f.pc;
      break;
    case Op::illuminance_begin:
    case Op::illuminance_cone_begin:
    case Op::ambient_begin: {
      // Comes here again after the light shader has returned.
      if (f.depth > 0 && f.top().kind == Control::Kind::kLights && f.top().begin == f.pc) return lightTurn(f);
      if (!f.active) {
        f.pc = s.jump + 1;
        break;
      }
      Control& c = f.push(Control::Kind::kLights);
      std::memcpy(c.saved, f.mask, bytes);
      std::memcpy(c.other, f.mask, bytes);
      return lightTurn(f);
    }
    case Op::illuminance_end:
      f.pc = f.top().begin;
      f.top().phase = Control::Phase::kNext;
      return lightTurn(f);
    case Op::illuminate_begin:
    case Op::illuminate_cone_begin:
    case Op::solar_begin:
    case Op::solar_cone_begin: {
      if (!f.active) {
        f.pc = s.jump + 1;
        break;
      }
      std::memcpy(f.push(Control::Kind::kIlluminate).saved, f.mask, bytes);
      emit(f, s);
      f.countActive();
      f.pc = f.active ? f.pc + 1 : s.jump;
      break;
    }
    case Op::illuminate_end:
    case Op::solar_end:
      f.activate(f.top().saved);
      f.pop();
      ++f.pc;
      break;
    case Op::gather_begin: {
      if (f.depth > 0 && f.top().kind == Control::Kind::kGather && f.top().begin == f.pc)
        return gatherTurn(f);
      if (!f.active) {
        f.pc = f.exe().steps()[s.jump].jump + 1;
        break;
      }
      Control& c = f.push(Control::Kind::kGather);
      std::memcpy(c.saved, f.mask, bytes);
      std::memcpy(c.other, f.mask, bytes);
      c.light = 0;
      return gatherTurn(f);
    }
    case Op::gather_else: {
      Control& c = f.top();
      // third: points that hit; the others of those still in the loop missed.
      runHelper(Helper::maskAndNot, {mask, maskOperand(c.other, lanes), maskOperand(c.third, lanes)}, lanes);
      f.countActive();
      f.pc = f.active ? f.pc + 1 : s.jump;
      break;
    }
    case Op::gather_end:
      f.pc = f.top().begin;
      f.top().phase = Control::Phase::kNext;
      return gatherTurn(f);
    default:
      ++f.pc;
      break;
  }
  return Next::kGo;
}

}  // namespace fr
