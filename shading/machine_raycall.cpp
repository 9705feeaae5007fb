// The ray functions of RSL: trace, transmission, occlusion, gather and their kin, from operands to results.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "base/sobol.h"
#include "shading/machine_light.h"
#include "shading/machine_ray.h"

namespace fr {

namespace {

constexpr float kRightAngle = 1.5707963f;
/// More samples than anyone waits for.
constexpr float kMostSamples = 4096.0f;

template <size_t N>
void copyText(char (&to)[N], std::string_view from) {
  const size_t n = std::min(from.size(), N - 1);
  std::copy_n(from.data(), n, to);
  std::fill(to + n, to + N, '\0');
}

bool isEnvironment(Op op) {
  return op == Op::environment_f || op == Op::environment_t || op == Op::environment4_f ||
         op == Op::environment4_t;
}
bool isShadow(Op op) {
  return op == Op::shadow_f || op == Op::shadow_t || op == Op::shadow4_f || op == Op::shadow4_t;
}
bool isFourCornered(Op op) {
  return op == Op::environment4_f || op == Op::environment4_t || op == Op::shadow4_f || op == Op::shadow4_t;
}

}  // namespace

/// environment("raytrace", ...) and shadow("raytrace", ...).
bool Machine::asksByMapName(Frame& f, const Step& s) const {
  return (isEnvironment(s.op) || isShadow(s.op)) && text(f, s, 1) == "raytrace";
}

/// What the optional parameters of any ray call say about its rays: values of the first active point.
void Machine::readTerms(Frame& f, const Step& s, uint32_t fixed, RayTerms& t) {
  const float limit = optionFloat(f, s, fixed, "maxdist", 0.0f);
  t.maxDistance = limit > 0.0f && limit < 1e29f ? limit : 0.0f;
  if (const float bias = optionFloat(f, s, fixed, "bias", -1.0f); bias >= 0.0f)
    t.bias = bias, t.flags |= RayTerms::kHasBias;
  const std::string_view sides = optionString(f, s, fixed, "hitsides");
  if (sides == "front") t.flags |= RayTerms::kFrontOnly;
  if (sides == "back") t.flags |= RayTerms::kBackOnly;
  const std::string_view mode = optionString(f, s, fixed, "hitmode");
  if (mode == "primitive") t.hitMode = HitMode::kPrimitive;
  if (mode == "shader") t.hitMode = HitMode::kShader;
  copyText(t.label, optionString(f, s, fixed, "label"));
  copyText(t.subset, optionString(f, s, fixed, "subset"));
  copyText(t.excludeSubset, optionString(f, s, fixed, "excludesubset"));
}

namespace {
/// Values that travel with the answers under a name of the call, but for those that every answer has.
bool isExtra(std::string_view name) {
  for (const std::string_view prefix : {"surface:", "displacement:", "volume:", "primitive:", "attribute:"})
    if (name.substr(0, prefix.size()) == prefix)
      return name != "surface:Ci" && name != "volume:Ci" && name != "primitive:P" && name != "primitive:N";
  return false;
}
}  // namespace

/// Asks for the written operands of a gather that only the hit knows.
void Machine::wantExtras(Frame& f, const Step& s, uint32_t fixed, RayTerms& t) {
  std::string wanted;
  uint32_t columns = 0;
  for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
    if (!isWritten(f, s, k + 1)) continue;
    const std::string_view name = text(f, s, k);
    const Symbol& symbol = f.exe().program().symbols[symbolOf(f, s, k + 1)];
    const uint32_t components = slTypeFloats(symbol.type);
    if (!isExtra(name) || symbol.isArray() || (components != 1 && components != 3)) continue;
    const std::string line = fmt::format("{} {}\n", components, name);
    if (columns + components > kMaxExtraAnswers || wanted.size() + line.size() >= sizeof t.extras) {
      reportOnce("shading.gather.extras." + f.exe().program().name,
                 makeError(RiError::kLimit, "shader \"{}\": gather asks for more than {} values of a hit",
                           f.exe().program().name, kMaxExtraAnswers));
      break;
    }
    wanted += line, columns += components;
  }
  copyText(t.extras, wanted);
}

void Machine::describe(Frame& f, const Step& s, RayCall& c) {
  using Result = RayCall::Result;
  const Operand* a = f.args(s);
  Question& q = c.question;
  bool hemisphere = false, sampled = true;
  float samples = -1;
  switch (s.op) {
    case Op::trace_t:
      c.fixed = 3, q.kind = RayKind::kTrace;
      break;
    case Op::trace_f:
      c.fixed = 3, q.kind = RayKind::kHitTest, c.result = Result::kDistance, sampled = false;
      break;
    case Op::visibility:
    case Op::transmission:
      c.fixed = 3, q.kind = RayKind::kVisibility, q.toPoint = true;
      break;
    case Op::rayhittest:
      c.outputs = 3, c.fixed = 5, q.kind = RayKind::kHitTest, c.result = Result::kHit, sampled = false;
      break;
    case Op::fulltrace:
      c.outputs = 7, c.fixed = 9, q.kind = RayKind::kFullTrace, c.result = Result::kFull, sampled = false;
      break;
    case Op::occlusion:
      c.fixed = 4, q.kind = RayKind::kHitTest, c.result = Result::kHidden, hemisphere = true;
      samples = a[3].at(0);
      break;
    case Op::indirectdiffuse:
      c.fixed = 4, q.kind = RayKind::kTrace, hemisphere = true;
      samples = a[3].at(0);
      break;
    case Op::indirect:
      c.fixed = 3, q.kind = RayKind::kTrace, hemisphere = true;
      samples = optionFloat(f, s, 3, "samples", float(std::max(16u, f.instance().samples)));
      break;
    case Op::areashadow:
      c.fixed = 3, q.kind = RayKind::kVisibility, q.toPoint = true, c.aimed = true;
      samples = a[2].at(0);
      break;
    default: {  // environment, shadow: result, name, channel, places
      c.fixed = isFourCornered(s.op) ? 7 : 4;
      const bool scalar = s.op == Op::environment_f || s.op == Op::environment4_f || s.op == Op::shadow_f ||
                          s.op == Op::shadow4_f;
      if (isShadow(s.op)) {
        q.kind = RayKind::kVisibility, q.toPoint = true, c.aimed = true, c.result = Result::kShadow;
        q.from = a[3];
      } else {
        q.kind = RayKind::kTrace;
        if (scalar) c.result = Result::kChannel;
        q.from = batch_.globals[size_t(GlobalId::k_P)];
        q.direction = a[3];
      }
      q.cone =
          optionFloat(f, s, c.fixed, "samplecone", optionFloat(f, s, c.fixed, "blur", 0.0f) * 3.1415927f);
      break;
    }
  }
  if (!q.from.data) q.from = a[c.outputs];
  if (!q.direction.data) q.direction = c.aimed ? q.from : a[c.outputs + 1];
  if (samples < 0) samples = sampled ? optionFloat(f, s, c.fixed, "samples", 1) : 1;
  q.samples = uint32_t(std::clamp(samples, 1.0f, kMostSamples));
  if (hemisphere) {
    q.cone = optionFloat(f, s, c.fixed, "coneangle", kRightAngle);
    q.cosine = optionString(f, s, c.fixed, "distribution") != "uniform";
  } else if (sampled && q.cone == 0.0f) {
    q.cone = optionFloat(f, s, c.fixed, "samplecone", 0.0f);
  }
  q.base = sampled ? std::clamp(optionFloat(f, s, c.fixed, "samplebase", 0.0f), 0.0f, 8.0f) : 0.0f;
  // The same ray again would say the same.
  if (!(q.cone > 0.0f) && !(q.base > 0.0f) && !hemisphere && !c.aimed) q.samples = 1;
  c.averaged = q.samples > 1 || hemisphere;
  c.maxDistance = optionFloat(f, s, c.fixed, "maxdist", 1e30f);
  c.falloff = hemisphere ? std::max(0.0f, optionFloat(f, s, c.fixed, "falloff", 0)) : 0.0f;
  c.polynomial = hemisphere && optionFloat(f, s, c.fixed, "falloffmode", 0) == 1.0f;
  c.mask = f.mask;
  q.mask = f.mask;
  q.site = hashStep(f.instance().id, f.pc);
  q.counter = f.counter(s.counter);
  q.sample = f.raySample;
  readTerms(f, s, c.fixed, q.terms);
  q.terms.rayClass = hemisphere ? RayClass::kDiffuse : RayClass::kSpecular;
  if (s.op == Op::trace_t && option(f, s, c.fixed, "transmission")) {
    const Operand* out = option(f, s, c.fixed, "transmission");
    if (isWritten(f, s, uint32_t(out - a)))
      copyText(q.terms.extras, "3 ray:transmission\n"), c.averaged = true;
  }
}

/// The ends of rays towards a light, in aim_: the one that asks, or the one that lights the points now.
/// False: there is none.
bool Machine::aimAtLight(Frame& f, const RayCall& c) {
  const uint32_t n = batch_.lanes;
  LightState* light = lightOf(f);
  const bool own = light != nullptr;
  for (uint32_t k = f.depth; !light && k-- > 0;) {
    const Control& block = f.control[k];
    if (block.kind == Control::Kind::kLights && block.light >= 0 && block.light < int32_t(lightCount_))
      light = lights_[size_t(block.light)].get();
  }
  if (!light) return false;
  aim_.reserve(size_t(n) * 7);
  const Operand to{aim_.data(), n, ~0u}, normals{aim_.data() + size_t(n) * 3, n, ~0u};
  const Question& q = c.question;
  if (light->instance->emitter && light->instance->emitter->ready() && own) {
    // Points of its geometry, other ones than those it is lit by.
    if (pairs_.size() < n) pairs_.resize(n);
    for (uint32_t i = 0; i < n; ++i) {
      uint64_t seed = hashStep(batch_.seed ? batch_.seed[i] : batch_.batchSeed, q.site);
      if (q.counter) seed = hashStep(seed, q.counter[i]);
      pairs_[i] = sobolOwen2(q.sample, uint32_t(seed >> 32));
    }
    light->instance->emitter->sample(
        {q.from, pairs_.data(), q.mask, n, to, normals, aim_.data() + size_t(n) * 6});
    return true;
  }
  const Operand P = light->frame.global(GlobalId::k_P);
  const Vec3 origin = transformPoint(Mat4(light->instance->toCurrent), Vec3(0));
  const float far = host_.sceneDiameter();
  for (uint32_t i = 0; i < n; ++i)
    for (uint32_t k = 0; k < 3; ++k) {
      // A distant light, as far as its last solar statement said where it is.
      const float distant = q.from.at(i, k) - light->L.at(i, k) * far;
      to.comp(k)[i] = light->frame.solar ? distant : own && P.data ? P.at(i, k) : origin[int(k)];
    }
  return true;
}

/// Adds one sample's answers to the running sums.
void Machine::accumulate(const RayCall& c) {
  const PendingRays& r = *rays_;
  const Question& q = c.question;
  const uint32_t n = batch_.lanes;
  float* const sum = accumulator_.data();
  const bool passes = q.kind == RayKind::kVisibility;
  const bool through = q.terms.extras[0] != 0;
  for (uint32_t k = 0; k < r.count; ++k) {
    const uint32_t i = r.lane[k];
    const bool hit = !passes && r.hitDistance[k] < c.maxDistance;
    // What is missed has a colour where a volume fills the way.
    for (uint32_t m = 0; m < 3; ++m) sum[(kSumColor + m) * n + i] += r.color[m][k];
    for (uint32_t m = 0; m < 3; ++m)
      sum[(kSumThrough + m) * n + i] += through ? r.extra[m][k] : hit ? 0.0f : 1.0f;
    if (hit) {
      const float d = r.hitDistance[k];
      const float fall = c.falloff <= 0.0f ? 1.0f
                         : c.polynomial && c.maxDistance < 1e29f
                             ? std::pow(std::max(0.0f, 1.0f - d / c.maxDistance), c.falloff)
                             : std::exp(-c.falloff * d);
      sum[kSumHidden * n + i] += fall;
    } else {
      for (uint32_t m = 0; m < 3; ++m) sum[(kSumClear + m) * n + i] += r.direction[m][k];
    }
  }
}

/// From answers, or their sums, to the operation's results.
void Machine::finish(Frame& f, const Step& s, const RayCall& c) {
  using Result = RayCall::Result;
  const Operand* a = f.args(s);
  PendingRays& r = *rays_;
  const uint32_t n = batch_.lanes;
  if (c.averaged) {
    const float* const sum = accumulator_.data();
    const float scale = 1.0f / float(c.question.samples);
    const auto mean = [&](uint32_t column, uint32_t components, float(*to)[kMaxRays]) {
      for (uint32_t k = 0; k < r.count; ++k)
        for (uint32_t m = 0; m < components; ++m) to[m][k] = sum[(column + m) * n + r.lane[k]] * scale;
    };
    const auto output = [&](std::string_view name, uint32_t column, bool unit, uint32_t components = 3) {
      const Operand* out = option(f, s, c.fixed, name);
      if (!out || !isWritten(f, s, uint32_t(out - a))) return;
      const Symbol& symbol = f.exe().program().symbols[symbolOf(f, s, uint32_t(out - a))];
      if (slTypeFloats(symbol.type) != components || symbol.isArray()) return;
      mean(column, components, r.hitN);
      for (uint32_t k = 0; unit && k < r.count; ++k) {
        const float length = std::hypot(r.hitN[0][k], r.hitN[1][k], r.hitN[2][k]);
        for (int m = 0; length > 0 && m < 3; ++m) r.hitN[m][k] /= length;
      }
      answer(*out, components, r.hitN, f.mask);
    };
    if (c.question.kind != RayKind::kVisibility) {
      output("transmission", kSumThrough, false);
      output("environmentdir", kSumClear, true);
      if (s.op == Op::indirectdiffuse) output("occlusion", kSumHidden, false, 1);
    }
    mean(c.result == Result::kHidden ? kSumHidden : kSumColor, c.result == Result::kHidden ? 1 : 3, r.color);
  }
  switch (c.result) {
    case Result::kColor:
      answer(a[0], 3, r.color, f.mask);
      break;
    case Result::kHidden:
      answer(a[0], 1, r.color, f.mask);
      break;
    case Result::kChannel: {
      const uint32_t channel = uint32_t(std::clamp(a[2].at(0), 0.0f, 2.0f));
      answer(a[0], 1, r.color + channel, f.mask);
      break;
    }
    case Result::kShadow: {
      const bool color = s.op == Op::shadow_t || s.op == Op::shadow4_t;
      for (uint32_t k = 0; k < r.count; ++k) {
        const float mean = (r.color[0][k] + r.color[1][k] + r.color[2][k]) * (1.0f / 3);
        for (int m = 0; m < 3; ++m) r.color[m][k] = 1.0f - (color ? r.color[m][k] : mean);
      }
      answer(a[0], color ? 3 : 1, r.color, f.mask);
      break;
    }
    case Result::kDistance:
      for (uint32_t k = 0; k < r.count; ++k)
        if (!(r.hitDistance[k] < c.maxDistance)) r.hitDistance[k] = kNoHit;
      answer(a[0], 1, &r.hitDistance, f.mask);
      break;
    case Result::kHit:
      answer(a[0], 1, &r.hitDistance, f.mask);
      answer(a[1], 3, r.hitP, f.mask);
      answer(a[2], 3, r.hitN, f.mask);
      break;
    case Result::kFull:
      answer(a[0], 1, &r.missDepth, f.mask);
      answer(a[1], 3, r.color, f.mask);
      answer(a[2], 1, &r.hitDistance, f.mask);
      answer(a[3], 3, r.hitP, f.mask);
      answer(a[4], 3, r.hitN, f.mask);
      answer(a[5], 3, r.missP, f.mask);
      answer(a[6], 3, r.missR, f.mask);
      break;
  }
}

Machine::Next Machine::rayOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const uint32_t n = batch_.lanes;
  if (s.op == Op::photons || s.op == Op::caustic) {  // there is no photon map
    reportOnce(std::string("shading.photons.") + opInfo(s.op).name,
               Error{RiError::kUnimplemented,
                     Severity::kWarning,
                     {},
                     fmt::format("{}(): photon maps are not available; black", opInfo(s.op).name)});
    for (uint32_t c = 0; c < 3; ++c) std::fill_n(a[0].comp(c), a[0].varying() ? n : kLanePad, 0.0f);
    return Next::kGo;
  }
  RayCall c;
  describe(f, s, c);
  Question& q = c.question;
  for (;;) {
    q.sample = f.raySample;
    if (f.rayPhase == 0) {
      if (c.averaged && f.raySample == 0) {
        accumulator_.reserve(size_t(n) * kSumColumns);
        std::memset(accumulator_.data(), 0, size_t(n) * kSumColumns * sizeof(float));
      }
      if (c.aimed) {
        if (aimAtLight(f, c))
          q.direction = Operand{aim_.data(), n, ~0u};
        else
          q.noRays = true;
      }
      const bool wait = ask(q);
      f.rayPhase = 1;
      if (wait) return Next::kSuspend;
    }
    f.rayPhase = 0;
    if (c.averaged) accumulate(c);
    if (++f.raySample >= q.samples) break;
  }
  f.raySample = 0;
  uint32_t* const counter = f.counter(s.counter);
  for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);
  finish(f, s, c);
  return Next::kGo;
}

/// Goes on with a gather loop: the next sample's rays, then the body for the points that hit.
Machine::Next Machine::gatherTurn(Frame& f) {
  Control& c = f.top();
  const Step& s = f.exe().steps()[c.begin];
  const Operand* a = f.args(s);  // category, P, direction, angle, samples
  const uint32_t n = f.lanes();
  constexpr uint32_t fixed = 5;
  uint32_t* const counter = f.counter(s.counter);
  // "samplepattern" wants directions alone; every point takes the else branch.
  const bool pattern = text(f, s, 0) == "samplepattern";
  if (c.phase == Control::Phase::kNext) {
    if (c.turns == 0) c.samples = uint32_t(std::clamp(a[4].at(0), 0.0f, kMostSamples));
    if (c.turns >= c.samples || !any(c.other)) {
      std::memcpy(f.mask, c.saved, n * sizeof(int32_t));
      for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);
      f.active = any(f.mask);
      f.pop();
      f.pc = f.exe().steps()[s.jump].jump + 1;
      return Next::kGo;
    }
    std::memcpy(f.mask, c.other, n * sizeof(int32_t));
    Question q;
    q.kind = RayKind::kHitTest;
    for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
      if (!isWritten(f, s, k + 1)) continue;
      const std::string_view name = text(f, s, k);
      if (name.substr(0, 8) == "surface:" || name.substr(0, 7) == "volume:" ||
          name.substr(0, 13) == "displacement:")
        q.kind = RayKind::kFullTrace;
    }
    q.from = a[1], q.direction = a[2];
    q.mask = c.other;
    q.site = hashStep(f.instance().id, c.begin);
    q.counter = counter;
    q.cone = a[3].at(0);
    q.cosine = optionString(f, s, fixed, "distribution") != "uniform";
    q.base = std::clamp(optionFloat(f, s, fixed, "samplebase", 0.0f), 0.0f, 8.0f);
    q.sample = c.turns, q.samples = c.samples;
    q.noRays = pattern;
    readTerms(f, s, fixed, q.terms);
    wantExtras(f, s, fixed, q.terms);
    if (q.cone > batch_.specularThreshold) q.terms.rayClass = RayClass::kDiffuse;
    const bool wait = ask(q);
    c.phase = Control::Phase::kReturned;
    if (wait) return Next::kSuspend;
  }
  ++c.turns;
  PendingRays& r = *rays_;
  const float maxDistance = std::min(optionFloat(f, s, fixed, "maxdist", 1e30f), 0.99e30f);
  std::memset(c.third, 0, n * sizeof(int32_t));
  for (uint32_t k = 0; k < r.count; ++k)
    if (!pattern && r.hitDistance[k] < maxDistance) c.third[r.lane[k]] = -1;
  if (r.single && r.count) {
    const int32_t hit = c.third[r.lane[0]];
    for (uint32_t i = 0; i < n; ++i) c.third[i] = c.other[i] & hit;
  } else if (batch_.copyPeriod) {
    for (uint32_t i = batch_.copyPeriod; i < n; ++i) c.third[i] = c.other[i] & c.third[i % batch_.copyPeriod];
  }
  uint32_t column = 0;
  std::string_view rest = r.terms.extras;
  for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
    if (!isWritten(f, s, k + 1)) continue;
    const std::string_view name = text(f, s, k);
    const Operand& out = a[k + 1];
    const Symbol& symbol = f.exe().program().symbols[symbolOf(f, s, k + 1)];
    const uint32_t components = slTypeFloats(symbol.type);
    if (name == "sample:randompair" && symbol.type == SlType::kFloat && symbol.arrayLength == 2) {
      answer(out, 2, r.pair, c.other);
    } else if (symbol.isArray()) {
      continue;
    } else if (components == 1) {
      if (name == "ray:length")
        answer(out, 1, &r.hitDistance, c.other);
      else if (name == "effectivesamples")
        setFloat(f, out, float(c.samples));
    } else if (components == 3) {
      if (name == "ray:direction")
        answer(out, 3, r.direction, c.other);
      else if (name == "ray:origin")
        answer(out, 3, r.origin, c.other);
      else if (name == "primitive:P")
        answer(out, 3, r.hitP, c.third);
      else if (name == "primitive:N")
        answer(out, 3, r.hitN, c.third);
      else if (name == "surface:Ci" || name == "volume:Ci")
        answer(out, 3, r.color, c.third);
    }
    if (isExtra(name) && (components == 1 || components == 3) && !rest.empty() &&
        column + components <= kMaxExtraAnswers) {
      answer(out, components, r.extra + column, c.third);
      column += components;
      rest.remove_prefix(std::min(rest.find('\n'), rest.size() - 1) + 1);
    }
  }
  std::memcpy(f.mask, c.third, n * sizeof(int32_t));
  f.active = any(f.mask);
  f.pc = f.active ? c.begin + 1 : s.jump;
  c.phase = Control::Phase::kBody;
  return Next::kGo;
}

}  // namespace fr
