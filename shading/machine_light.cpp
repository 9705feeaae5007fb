// The light loop: illuminance, ambient, illuminate and solar.
#include "shading/machine_light.h"

#include <algorithm>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "shading/machine_ray.h"

namespace fr {

namespace {
Operand maskOperand(int32_t* m, uint32_t lanes) { return {reinterpret_cast<float*>(m), lanes, ~0u}; }
void runHelper(Helper h, std::initializer_list<Operand> args, uint32_t lanes, const int32_t* mask = nullptr) {
  KernelCall c;
  c.arg = args.begin(), c.argCount = uint32_t(args.size()), c.lanes = lanes, c.mask = mask;
  kernels().helper[size_t(h)](c);
}
bool listed(std::string_view list, std::string_view word) {
  while (!list.empty()) {
    const size_t comma = std::min(list.find(','), list.size());
    std::string_view item = list.substr(0, comma);
    while (!item.empty() && item.front() == ' ') item.remove_prefix(1);
    while (!item.empty() && item.back() == ' ') item.remove_suffix(1);
    if (item == word) return true;
    list.remove_prefix(std::min(comma + 1, list.size()));
  }
  return false;
}
bool shinesFromAfar(const ShaderProgram& p) {
  return std::any_of(p.code.begin() + p.bodyBegin, p.code.end(), [](const Instruction& in) {
    return in.op == Op::solar_begin || in.op == Op::solar_cone_begin;
  });
}
/// Operands of a light loop before the optional ones.
uint32_t lightOptions(Op op) {
  return op == Op::illuminance_cone_begin ? 4 : op == Op::illuminance_begin ? 2 : 1;
}
}  // namespace

bool Machine::matchesCategory(const LightState& l, std::string_view category) const {
  if (category.empty()) return true;
  if (category[0] == '-') return !listed(l.category, category.substr(1));
  return listed(l.category, category);
}

void Machine::beginLight(LightState& l) {
  const uint32_t n = batch_.lanes;
  l.begun = true;
  columnsKnown_ = false;
  const bool sent = l.sentTo;
  l.sentTo = false;
  l.ambient = l.instance->exe->has(kProgramAmbientLight);
  const ShaderProgram& p = l.instance->program();
  l.readsNormal = (p.readsGlobals & (globalBit(GlobalId::k_N) | globalBit(GlobalId::k_Ns))) != 0;
  const ShaderValue* category = l.instance->parameter("__category");
  l.category =
      category && !category->strings.empty() ? std::string_view(category->strings[0]) : std::string_view();
  const size_t columns = l.emitter ? 26 : 19;
  // What unlit points hold is never looked at.
  if (l.memory.reserve(size_t(n) * columns)) std::memset(l.memory.data(), 0, l.memory.size() * sizeof(float));
  float* at = l.memory.data();
  for (Operand* o : {&l.Ps, &l.N, &l.L, &l.Cl, &l.Ol}) *o = Operand{at, n, ~0u}, at += 3 * n;
  for (int32_t** m : {&l.evaluated, &l.lit, &l.shadowed, &l.scratch})
    *m = reinterpret_cast<int32_t*>(at), at += n;
  if (l.emitter) {
    for (Operand* o : {&l.emitterP, &l.emitterN}) *o = Operand{at, n, ~0u}, at += 3 * n;
    l.factor = at;
  }
  for (int32_t* m : {l.evaluated, l.lit, l.shadowed}) std::memset(m, 0, n * sizeof(int32_t));
  l.frame.prepare(*l.instance, n, sent);
  l.frame.useNative(l.instance->exe->native());
  setGlobals(l.frame);
  placeAtOrigin(l, n);
}

/// P is the light's own origin.
void Machine::placeAtOrigin(LightState& l, uint32_t lanes) {
  const Operand P = l.frame.global(GlobalId::k_P);
  if (!P.data) return;
  const Vec3 origin = transformPoint(Mat4(l.instance->toCurrent), Vec3(0));
  for (int c = 0; c < 3; ++c) std::fill_n(P.comp(uint32_t(c)), P.varying() ? lanes : kLanePad, origin[c]);
}

/// The columns of a surface followed by those of its lights, for machine code that lights have been written
/// out in: their parameters and their P are all that it reads. Lights that are not plain add their results
/// (light_column).
float* const* Machine::columnsWithLights(Frame& f) {
  if (columnsKnown_) return columns_.data();
  columnsKnown_ = true;
  columns_.assign(f.columns(), f.columns() + f.exe().columnCount());
  for (uint32_t k = 0; k < runLights_.size(); ++k) {  // none of a shader that asks for no lights
    LightState& l = *lights_[k];
    const Executable& e = *l.instance->exe;
    if (runLights_[k].plain && !l.begun) {
      if (l.sentTo || !l.frame.holds(*l.instance, batch_.lanes)) {
        l.frame.prepare(*l.instance, batch_.lanes, l.sentTo);
        l.sentTo = false;
      }
      l.frame.unalias(GlobalId::k_P);
      placeAtOrigin(l, kLanePad);
    }
    const bool plain = runLights_[k].plain;
    const bool known = plain ? !runLights_[k].emitter || l.aimed.size() > 0 : l.begun;
    if (plain || known)
      columns_.insert(columns_.end(), l.frame.columns(), l.frame.columns() + e.columnCount());
    else
      columns_.resize(columns_.size() + e.columnCount(), nullptr);
    const size_t results = columns_.size();
    columns_.resize(results + light_column::count(runLights_[k]), nullptr);
    if (!known) continue;
    if (plain) {
      for (uint32_t c = 0; c < light_column::count(runLights_[k]); ++c)
        columns_[results + c] = l.aimed.data() + size_t(c) * batch_.lanes;
      continue;
    }
    for (uint32_t c = 0; c < 3; ++c) {
      columns_[results + light_column::kL + c] = l.L.comp(c);
      columns_[results + light_column::kCl + c] = l.Cl.comp(c);
      columns_[results + light_column::kOl + c] = l.Ol.comp(c);
    }
    columns_[results + light_column::kLit] = reinterpret_cast<float*>(l.lit);
  }
  return columns_.data();
}

Machine::LightState* Machine::lightOf(const Frame& f) const {
  const auto owner =
      std::find_if(lights_.begin(), lights_.end(), [&](const auto& l) { return &l->frame == &f; });
  return owner == lights_.end() ? nullptr : owner->get();
}

/// Chooses the point of an area light from which it shines on each of the points of `need`.
void Machine::sampleEmitter(LightState& l, const Operand& Ps, const int32_t* need, const Operand& P,
                            const Operand& N, float* factor) {
  // The samples of a point are one low-discrepancy set; points and lights differ in its scramble.
  SeedHash seeds;
  seeds.site = 0xa4ea11967, seeds.next = l.instance->id, seeds.hasNext = true;
  choosePairs(seeds, l.sample);
  l.emitter->sample({Ps, pairs_.data(), need, batch_.lanes, P, N, factor});
}

/// Of the loop's area lights that are written out in code. False: other lights have to run before it.
bool Machine::aimEmitters(Frame& f, const Step& loop) {
  const bool ambient = loop.op == Op::ambient_begin;
  const uint32_t n = batch_.lanes;
  bool all = true;
  for (uint32_t k = 0; k < lightCount_; ++k) {
    LightState& l = *lights_[k];
    const Executable& e = *l.instance->exe;
    if (e.has(kProgramAmbientLight) != ambient) continue;
    all = all && runLights_[k].plain;
    if (!runLights_[k].emitter) continue;
    if (l.aimed.reserve(size_t(n) * light_column::kSamples)) columnsKnown_ = false;
    const auto columns = [&](uint32_t c) { return l.aimed.data() + size_t(c) * n; };
    float* const dim = columns(light_column::kDim);
    sampleEmitter(l, f.args(loop)[ambient ? 0 : 1], f.mask, {columns(light_column::kFrom), n, ~0u},
                  {columns(light_column::kNormal), n, ~0u}, dim);
    const float share = 1.0f / float(l.samples);
    const bool local = !ambient && !shinesFromAfar(e.program());
    for (uint32_t i = 0; i < n; ++i) dim[i] = local ? share * dim[i] : share;
  }
  return all;
}

/// The same of a light that runs as a shader.
void Machine::placeOnEmitter(LightState& l, const int32_t* need) {
  const uint32_t n = batch_.lanes;
  sampleEmitter(l, l.Ps, need, l.emitterP, l.emitterN, l.factor);
  for (const auto& [global, from] :
       {std::pair(GlobalId::k_P, l.emitterP), std::pair(GlobalId::k_N, l.emitterN)}) {
    const Operand to = l.frame.global(global);
    if (to.data) runHelper(Helper::assignTripleMasked, {to, from}, n, need);
  }
}

/// What the renderer adds to an area light's colour: the cosine at the light, and the mean of its samples.
void Machine::dimByEmitter(LightState& l, const int32_t* need) {
  const uint32_t n = batch_.lanes;
  const float share = 1.0f / float(l.samples);
  const bool local = !l.ambient && !l.frame.solar;
  for (uint32_t c = 0; c < 3; ++c) {
    float* const Cl = l.Cl.comp(c);
    for (uint32_t i = 0; i < n; ++i) {
      const float dimmed = Cl[i] * (local ? share * l.factor[i] : share);
      Cl[i] = need[i] ? dimmed : Cl[i];
    }
  }
}

/// illuminate and solar: sets L and narrows the mask to the points that the statement reaches.
void Machine::emit(Frame& f, const Step& s) {
  LightState* const owner = lightOf(f);
  if (!owner) return;  // not run as a light: nothing is lit
  LightState& l = *owner;
  const uint32_t n = f.lanes();
  const Operand mask = maskOperand(f.mask, n), lit = maskOperand(f.lit, n);
  const Operand* a = f.args(s);
  scratch_.reserve(size_t(n) * 8);
  const Operand direction{scratch_.data(), n, ~0u};
  KernelCall c;
  c.lanes = n;
  f.solar = s.op == Op::solar_begin || s.op == Op::solar_cone_begin;
  if (!f.solar) {
    runHelper(Helper::subTriple, {direction, l.Ps, a[0]}, n);
    if (s.op == Op::illuminate_cone_begin)
      runHelper(Helper::maskCone, {mask, mask, direction, a[1], a[2]}, n);
  } else {
    // Light from everywhere arrives along the surface normal.
    const bool cone = s.op == Op::solar_cone_begin;
    const Operand args[] = {direction, cone ? a[0] : l.N};
    c.arg = args, c.argCount = 2;
    kernels().op[size_t(cone ? Op::normalize : Op::neg_t)](c);
  }
  const Operand L = f.global(GlobalId::k_L);
  if (L.data) runHelper(Helper::assignTripleMasked, {L, direction}, n, f.mask);
  runHelper(Helper::maskOr, {lit, lit, mask}, n);
  runHelper(Helper::assignTripleMasked, {l.L, direction}, n, f.mask);
}

/// The light's frame has finished for the points of `need`: takes its results over.
void Machine::collectLight(LightState& l, const int32_t* need) {
  const uint32_t n = batch_.lanes;
  const Operand needed = maskOperand(const_cast<int32_t*>(need), n);
  const Operand evaluated = maskOperand(l.evaluated, n), lit = maskOperand(l.lit, n);
  const Operand Cl = l.frame.global(GlobalId::k_Cl), Ol = l.frame.global(GlobalId::k_Ol);
  if (Cl.data) runHelper(Helper::assignTripleMasked, {l.Cl, Cl}, n, need);
  if (l.emitter) dimByEmitter(l, need);
  if (Ol.data) {
    runHelper(Helper::assignTripleMasked, {l.Ol, Ol}, n, need);
  } else {
    for (uint32_t c = 0; c < 3; ++c) std::fill_n(l.Ol.comp(c), n, 1.0f);
  }
  // A light that sets L itself shines along that, whatever its illuminate or solar has said.
  const Operand L = l.frame.global(GlobalId::k_L);
  if (L.data && (l.instance->program().writesGlobals & globalBit(GlobalId::k_L)) != 0)
    runHelper(Helper::assignTripleMasked, {l.L, L}, n, l.frame.lit);
  for (uint32_t i = 0; i < n; ++i) l.lit[i] = need[i] ? l.frame.lit[i] : l.lit[i];
  runHelper(Helper::maskAndNot, {maskOperand(l.shadowed, n), maskOperand(l.shadowed, n), needed}, n);
  runHelper(Helper::maskOr, {evaluated, evaluated, needed}, n);
  (void)lit;
}

/// Rays from the points that the loop's body would run for and whose shadow is not known yet. False: none.
bool Machine::prepareShadowRays(Frame& f, Control& c, LightState& l) {
  const uint32_t n = batch_.lanes;
  const Operand want = maskOperand(c.third, n);
  runHelper(Helper::maskAndNot, {want, maskOperand(f.mask, n), maskOperand(l.shadowed, n)}, n);
  runHelper(Helper::maskNonBlack, {want, want, l.Cl}, n);
  const Operand shadowed = maskOperand(l.shadowed, n);
  runHelper(Helper::maskOr, {shadowed, shadowed, maskOperand(f.mask, n)}, n);
  if (!any(c.third)) return false;
  // Towards the light: back along L; distant lights out of the scene.
  scratch_.reserve(size_t(n) * 8);
  const Operand direction{scratch_.data(), n, ~0u};
  const float far = host_.sceneDiameter();
  for (uint32_t i = 0; i < n; ++i) {
    const Vec3 d(l.L.at(i, 0), l.L.at(i, 1), l.L.at(i, 2));
    const float length = glm::length(d);
    const float scale = !l.frame.solar ? -1.0f : length > 0 ? -far / length : 0.0f;
    for (uint32_t k = 0; k < 3; ++k) direction.comp(k)[i] = d[int(k)] * scale;
  }
  Question q;
  q.kind = RayKind::kVisibility;
  q.from = l.Ps;
  q.direction = direction;
  q.mask = c.third;
  q.site = hashStep(0x11647, uint64_t(c.light));
  return ask(q);
}

void Machine::applyShadowRays(Control& c, LightState& l) {
  const uint32_t n = batch_.lanes;
  scratch_.reserve(size_t(n) * 8);
  const Operand seen{scratch_.data(), n, ~0u};
  answer(seen, 3, rays_->color, c.third);
  for (uint32_t k = 0; k < 3; ++k)
    for (uint32_t i = 0; i < n; ++i)
      if (c.third[i]) l.Cl.comp(k)[i] *= seen.comp(k)[i];
}

/// Runs the lights of a loop, and asks their shadow rays, for the code that the loop is part of.
Machine::Next Machine::runLightsAhead(Frame& f, uint32_t loop) {
  // Comes here again after a light's shader has returned.
  const bool open = f.depth > 0 && f.top().ahead && f.top().begin == loop;
  if (!open) {
    if (aimEmitters(f, f.exe().steps()[loop])) return Next::kGo;
    const size_t bytes = f.lanes() * sizeof(int32_t);
    Control& c = f.push(Control::Kind::kLights);
    c.begin = loop;
    c.ahead = true;
    std::memcpy(c.saved, f.mask, bytes);
    std::memcpy(c.other, f.mask, bytes);
  }
  return lightTurn(f);
}

/// Goes on with a light loop: the next light, run if need be, its shadow rays, then the body. Sets the
/// program counter.
Machine::Next Machine::lightTurn(Frame& f) {
  Control& c = f.top();
  const Step& s = f.exe().steps()[c.begin];
  const uint32_t n = f.lanes();
  const size_t bytes = n * sizeof(int32_t);
  const bool ambient = s.op == Op::ambient_begin;
  const Operand* a = f.args(s);
  const Operand P = ambient ? a[0] : a[1];
  const Operand mask = maskOperand(f.mask, n), other = maskOperand(c.other, n),
                third = maskOperand(c.third, n);
  for (;;) {
    switch (c.phase) {
      case Control::Phase::kNext: {
        const std::string_view category = ambient ? std::string_view() : text(f, s, 0);
        for (++c.light; c.light < int32_t(lightCount_); ++c.light) {
          // Those that are written out in the code need not run.
          if (c.ahead && runLights_[size_t(c.light)].plain) continue;
          LightState& candidate = *lights_[size_t(c.light)];
          if (!candidate.begun) beginLight(candidate);
          // A light that is running cannot light itself.
          if (&candidate.frame != &f && candidate.ambient == ambient && matchesCategory(candidate, category))
            break;
        }
        if (c.light >= int32_t(lightCount_) || !any(c.other)) {
          std::memcpy(f.mask, c.saved, bytes);
          f.countActive();
          if (!c.ahead) f.pc = s.jump + 1;
          f.pop();
          return Next::kGo;
        }
        LightState& l = *lights_[size_t(c.light)];
        if (sendToLight(f, s, l) || optionString(f, s, lightOptions(s.op), "lightcache") == "refresh")
          std::memset(l.evaluated, 0, bytes);
        // Points whose position (or normal, where the light reads it) has changed are forgotten.
        const Operand N = f.global(GlobalId::k_N);
        const Operand changed = maskOperand(l.scratch, n), evaluated = maskOperand(l.evaluated, n);
        runHelper(Helper::maskDifferent, {changed, l.Ps, P}, n);
        runHelper(Helper::maskAndNot, {evaluated, evaluated, changed}, n);
        if (l.readsNormal && N.data) {
          runHelper(Helper::maskDifferent, {changed, l.N, N}, n);
          runHelper(Helper::maskAndNot, {evaluated, evaluated, changed}, n);
        }
        runHelper(Helper::maskAndNot, {third, other, evaluated}, n);
        c.phase = Control::Phase::kAimed;
        if (any(c.third)) {
          c.phase = Control::Phase::kReturned;
          runHelper(Helper::assignTripleMasked, {l.Ps, P}, n, c.third);
          if (N.data) runHelper(Helper::assignTripleMasked, {l.N, N}, n, c.third);
          const Operand Ps = l.frame.global(GlobalId::k_Ps);
          if (Ps.data) runHelper(Helper::assignTripleMasked, {Ps, l.Ps}, n, c.third);
          for (GlobalId g : {GlobalId::k_N, GlobalId::k_Ns}) {
            const Operand o = l.frame.global(g);
            if (o.data && N.data) runHelper(Helper::assignTripleMasked, {o, l.N}, n, c.third);
          }
          if (l.emitter) placeOnEmitter(l, c.third);
          // Unless the light says otherwise it is black and opaque.
          for (GlobalId g : {GlobalId::k_Cl, GlobalId::k_Ol}) {
            const Operand o = l.frame.global(g);
            const uint32_t lanes = o.varying() ? n : kLanePad;
            if (o.data)
              for (uint32_t k = 0; k < 3; ++k)
                std::fill_n(o.comp(k), lanes, g == GlobalId::k_Cl ? 0.0f : 1.0f);
          }
          std::memset(l.frame.lit, 0, bytes);
          l.frame.start(c.third);
          statistics_.lightPoints += kernels().countActive(c.third, n);
          stack_.push_back(&l.frame);
          return Next::kCall;
        }
        break;
      }
      case Control::Phase::kReturned:
        collectLight(*lights_[size_t(c.light)], c.third);
        c.phase = Control::Phase::kAimed;
        break;
      case Control::Phase::kAimed: {
        LightState& l = *lights_[size_t(c.light)];
        if (c.ahead && !l.instance->shadows) {
          c.phase = Control::Phase::kNext;
          break;
        }
        std::memcpy(f.mask, c.other, bytes);
        if (!ambient) {
          runHelper(Helper::maskAnd, {mask, mask, maskOperand(l.lit, n)}, n);
          if (s.op == Op::illuminance_cone_begin) {
            scratch_.reserve(size_t(n) * 8);
            const Operand toLight{scratch_.data(), n, ~0u};
            KernelCall k;
            const Operand args[] = {toLight, l.L};
            k.arg = args, k.argCount = 2, k.lanes = n;
            kernels().op[size_t(Op::neg_t)](k);
            runHelper(Helper::maskCone, {mask, mask, toLight, a[2], a[3]}, n);
          }
        }
        c.phase = Control::Phase::kBody;
        if (l.instance->shadows && !ambient && any(f.mask) && prepareShadowRays(f, c, l)) {
          c.phase = Control::Phase::kShadowed;
          return Next::kSuspend;
        }
        break;
      }
      case Control::Phase::kShadowed:
        applyShadowRays(c, *lights_[size_t(c.light)]);
        c.phase = Control::Phase::kBody;
        break;
      case Control::Phase::kBody: {
        LightState& l = *lights_[size_t(c.light)];
        // What waits for its lights is active until they are known.
        f.countActive();
        f.active = f.active || c.ahead;
        if (!f.active || c.ahead) {
          c.phase = Control::Phase::kNext;
          break;
        }
        const Operand L = f.global(GlobalId::k_L), Cl = f.global(GlobalId::k_Cl),
                      Ol = f.global(GlobalId::k_Ol);
        if (L.data && !ambient) runHelper(Helper::negateMasked, {L, l.L}, n, f.mask);
        if (Cl.data) runHelper(Helper::assignTripleMasked, {Cl, l.Cl}, n, f.mask);
        if (Ol.data) runHelper(Helper::assignTripleMasked, {Ol, l.Ol}, n, f.mask);
        for (uint32_t k = lightOptions(s.op); k + 1 < s.argCount; k += 2) {
          const std::string_view name = text(f, s, k);
          if (isWritten(f, s, k + 1) && name.substr(0, 6) == "light:")
            copyRegister(f, symbolOf(f, s, k + 1), a[k + 1], l.frame, name.substr(6));
        }
        f.pc = c.begin + 1;
        return Next::kGo;
      }
    }
  }
}

/// "send:name", value: sets the light's parameter for this loop. True: there was one, and the light has to
/// run anew.
bool Machine::sendToLight(Frame& f, const Step& s, LightState& l) {
  bool sent = l.sentTo;
  if (l.sentTo) beginLight(l);  // the parameters of the last loop are gone
  l.sentTo = false;
  for (uint32_t k = lightOptions(s.op); k + 1 < s.argCount; k += 2) {
    const std::string_view name = text(f, s, k);
    if (name.substr(0, 5) != "send:") continue;
    const uint32_t index = l.instance->program().findParameter(name.substr(5));
    if (index == kNoIndex) continue;
    const uint32_t to = l.instance->program().parameters[index].symbol, from = symbolOf(f, s, k + 1);
    const Symbol& x = l.instance->program().symbols[to];
    const Symbol& y = f.exe().program().symbols[from];
    const Operand& out = l.frame.symbol(to);
    const Operand& in = f.args(s)[k + 1];
    if (x.type == SlType::kString || x.arrayLength != y.arrayLength || x.floats() != y.floats()) continue;
    if (in.varying() && !out.varying()) continue;
    for (uint32_t c = 0; c < x.floats(); ++c)
      for (uint32_t i = 0; i < (out.varying() ? f.lanes() : kLanePad); ++i) out.comp(c)[i] = in.at(i, c);
    sent = l.sentTo = true;
  }
  return sent;
}

}  // namespace fr
