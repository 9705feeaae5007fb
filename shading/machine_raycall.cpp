// The ray functions of RSL: trace, transmission, occlusion, gather and their kin, from operands to results.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "shading/machine_light.h"
#include "shading/machine_ray.h"

namespace fr {

namespace {

constexpr float kRightAngle = 1.5707963f;

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

/// What the optional parameters of any ray call say about its rays.
void Machine::readTerms(Frame& f, const Step& s, uint32_t fixed, Question& q) {
  q.maxDistance = term(f, s, fixed, "maxdist", 1e30f);
  q.bias = term(f, s, fixed, "bias", -1.0f);
  RayTerms& t = q.terms;
  const std::string_view sides = optionString(f, s, fixed, "hitsides");
  if (sides == "front") t.flags |= RayTerms::kFrontOnly;
  if (sides == "back") t.flags |= RayTerms::kBackOnly;
  const std::string_view mode = optionString(f, s, fixed, "hitmode");
  if (mode == "primitive") t.hitMode = HitMode::kPrimitive;
  if (mode == "shader") t.hitMode = HitMode::kShader;
  copyText(t.label, optionString(f, s, fixed, "label"));
  copyText(t.subset, optionString(f, s, fixed, "subset"));
  copyText(t.excludeSubset, optionString(f, s, fixed, "excludesubset"));
  if (const Operand* o = option(f, s, fixed, "othreshold"); o && o->data) {
    const bool color = isTriple(f.exe().program().symbols[symbolOf(f, s, uint32_t(o - f.args(s)))].type);
    const uint32_t lane = firstActive(f);
    t.flags |= RayTerms::kHasOpaque;
    for (uint32_t c = 0; c < 3; ++c) t.opaque[c] = o->at(lane, color ? c : 0);
  }
}

void Machine::describe(Frame& f, const Step& s, RayCall& c) {
  using Result = RayCall::Result;
  const Operand* a = f.args(s);
  Question& q = c.question;
  bool sampled = true, counted = false;
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
      c.fixed = 4, q.kind = RayKind::kHitTest, c.result = Result::kHidden, q.hemisphere = true;
      q.samples.given = a[3], counted = true;
      break;
    case Op::indirectdiffuse:
      c.fixed = 4, q.kind = RayKind::kTrace, q.hemisphere = true;
      q.samples.given = a[3], counted = true;
      break;
    case Op::indirect:
      c.fixed = 3, q.kind = RayKind::kTrace, q.hemisphere = true;
      q.samples = term(f, s, 3, "samples", float(std::max(16u, f.instance().samples))), counted = true;
      break;
    case Op::areashadow:
      c.fixed = 3, q.kind = RayKind::kVisibility, q.toPoint = true, q.aimed = true;
      q.samples.given = a[2], counted = true;
      break;
    default: {  // environment, shadow: result, name, channel, places
      c.fixed = isFourCornered(s.op) ? 7 : 4;
      const bool scalar = s.op == Op::environment_f || s.op == Op::environment4_f || s.op == Op::shadow_f ||
                          s.op == Op::shadow4_f;
      if (isShadow(s.op)) {
        q.kind = RayKind::kVisibility, q.toPoint = true, q.aimed = true, c.result = Result::kShadow;
        q.from = a[3];
      } else {
        q.kind = RayKind::kTrace;
        if (scalar) c.result = Result::kChannel;
        q.from = batch_.globals[size_t(GlobalId::k_P)];
        q.direction = a[3];
      }
      // "blur" in units of half a turn, as textures' blur is in units of the map.
      q.cone = term(f, s, c.fixed, "blur", 0.0f);
      q.cone.scale = 3.1415927f;
      if (option(f, s, c.fixed, "samplecone")) q.cone = term(f, s, c.fixed, "samplecone", 0.0f);
      break;
    }
  }
  if (!q.from.data) q.from = a[c.outputs];
  if (!q.direction.data) q.direction = q.aimed ? q.from : a[c.outputs + 1];
  if (!counted) q.samples = sampled ? term(f, s, c.fixed, "samples", 1) : Term{{}, 1};
  if (q.hemisphere) {
    q.cone = term(f, s, c.fixed, "coneangle", kRightAngle);
    q.cosine = optionString(f, s, c.fixed, "distribution") != "uniform";
    c.falloff = term(f, s, c.fixed, "falloff", 0);
    c.polynomial = optionFloat(f, s, c.fixed, "falloffmode", 0) == 1.0f;
  } else if (sampled && !q.cone.given.data) {
    q.cone = term(f, s, c.fixed, "samplecone", 0.0f);
  }
  if (sampled) q.base = term(f, s, c.fixed, "samplebase", 0.0f);
  c.samples = mostSamples(f, q);
  c.averaged = c.samples > 1 || q.hemisphere;
  q.site = hashStep(f.instance().id, f.pc);
  q.counter = f.counter(s.counter);
  readTerms(f, s, c.fixed, q);
  q.terms.rayClass = q.hemisphere ? RayClass::kDiffuse : RayClass::kSpecular;
  if (q.kind != RayKind::kVisibility && c.result != Result::kDistance) {
    c.environment = optionString(f, s, c.fixed, "environmentmap");
    c.environmentIn = optionString(f, s, c.fixed, "environmentspace");
  }
  if (c.result == Result::kHit || c.result == Result::kFull) c.environment = {};
  if (c.result == Result::kHidden)
    q.terms.flags |= c.falloff.given.data ? RayTerms::kOnlyDistance : RayTerms::kOnlyWhether;
  if (c.result == Result::kDistance) q.terms.flags |= RayTerms::kOnlyDistance;
  bool through = !c.environment.empty() && q.kind == RayKind::kTrace;
  if (const Operand* out = s.op == Op::trace_t ? option(f, s, c.fixed, "transmission") : nullptr)
    through |= isWritten(f, s, uint32_t(out - a));
  if (through) copyText(q.terms.extras, "3 ray:transmission\n"), c.averaged = true;
  if (c.averaged) chooseSums(f, s, c);
}

/// Which running sums the call's results are made of.
void Machine::chooseSums(const Frame& f, const Step& s, RayCall& c) const {
  const auto wanted = [&](std::string_view name) {
    const Operand* const out = option(f, s, c.fixed, name);
    return out && isWritten(f, s, uint32_t(out - f.args(s)));
  };
  c.sums[kOfColor] = c.result != RayCall::Result::kHidden;
  c.sums[kOfHidden] = c.result == RayCall::Result::kHidden || wanted("occlusion");
  c.sums[kOfThrough] = wanted("transmission");
  c.sums[kOfClear] = wanted("environmentdir");
  c.sums[kOfEnvironment] = wanted("environmentcolor");
}

void Machine::clearSums(const RayCall& c) {
  const uint32_t n = batch_.lanes;
  accumulator_.reserve(size_t(n) * kSumColumns);
  constexpr uint32_t kFirst[] = {kSumColor, kSumHidden, kSumThrough, kSumClear, kSumEnvironment, kSumColumns};
  for (uint32_t k = 0; k < std::size(c.sums); ++k)
    if (c.sums[k])
      std::memset(accumulator_.data() + size_t(n) * kFirst[k], 0,
                  size_t(n) * (kFirst[k + 1] - kFirst[k]) * sizeof(float));
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
    SeedHash seeds;
    seeds.site = q.site, seeds.counter = q.counter;
    choosePairs(seeds, q.sample);
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
void Machine::accumulate(const Frame& f, const RayCall& c) {
  const PendingRays& r = *rays_;
  const Question& q = c.question;
  const uint32_t n = batch_.lanes;
  const bool passes = q.kind == RayKind::kVisibility;
  const bool through = q.terms.extras[0] != 0;
  const bool environment = (c.sums[kOfColor] || c.sums[kOfEnvironment]) && !c.environment.empty() &&
                           lookUpEnvironment(f, c.environment, c.environmentIn);
  const auto add = [&](uint32_t column, const auto& value) {
    float* const sum = accumulator_.data() + size_t(column) * n;
    if (r.inOrder)
      for (uint32_t k = 0; k < r.count; ++k) sum[k] += value(k);
    else
      for (uint32_t k = 0; k < r.count; ++k) sum[r.lane[k]] += value(k);
  };
  const bool farVaries = q.maxDistance.varies();
  const float farthest = q.maxDistance.at(0);
  const auto hits = [&](uint32_t k) {
    return !passes && r.hitDistance[k] < (farVaries ? q.maxDistance.at(r.lane[k]) : farthest);
  };
  for (uint32_t m = 0; m < 3; ++m) {
    // What is missed has a colour where a volume fills the way.
    const auto passed = [&](uint32_t k) { return through ? r.extra[m][k] : hits(k) ? 0.0f : 1.0f; };
    const auto beyond = [&](uint32_t k) { return passed(k) * missColor_.data()[m * kMaxRays + k]; };
    if (c.sums[kOfColor] && environment)
      add(kSumColor + m, [&](uint32_t k) { return r.color[m][k] + beyond(k); });
    else if (c.sums[kOfColor])
      add(kSumColor + m, [&](uint32_t k) { return r.color[m][k]; });
    if (c.sums[kOfThrough]) add(kSumThrough + m, passed);
    if (c.sums[kOfClear]) add(kSumClear + m, [&](uint32_t k) { return hits(k) ? 0.0f : r.direction[m][k]; });
    if (c.sums[kOfEnvironment] && environment) add(kSumEnvironment + m, beyond);
  }
  if (!c.sums[kOfHidden]) return;
  if (!c.falloff.varies() && !(c.falloff.at(0) > 0.0f))
    return add(kSumHidden, [&](uint32_t k) { return hits(k) ? 1.0f : 0.0f; });
  add(kSumHidden, [&](uint32_t k) {
    const float limit = q.maxDistance.at(r.lane[k]), falloff = c.falloff.at(r.lane[k]);
    if (!hits(k)) return 0.0f;
    if (!(falloff > 0.0f)) return 1.0f;
    return c.polynomial && limit < 1e29f ? std::pow(std::max(0.0f, 1.0f - r.hitDistance[k] / limit), falloff)
                                         : std::exp(-falloff * r.hitDistance[k]);
  });
}

/// From sums of all samples of all points to the answers that finish() knows: means, by point.
void Machine::averageSums(Frame& f, const Step& s, const RayCall& c) {
  PendingRays& r = *rays_;
  const Operand* a = f.args(s);
  const Question& q = c.question;
  const uint32_t n = batch_.lanes;
  const float* const sum = accumulator_.data();
  // The last block may have held some of the points alone.
  Question all = q;
  all.mask = f.mask;
  listAsking(all);
  const bool samplesVary = q.samples.varies() || q.cone.varies() || q.base.varies();
  const float common = 1.0f / float(q.samplesAt(0));
  const auto mean = [&](uint32_t column, uint32_t components, float(*to)[kRayRow]) {
    for (uint32_t m = 0; m < components; ++m) {
      const float* const from = sum + size_t(column + m) * n;
      if (r.inOrder && !samplesVary)
        for (uint32_t k = 0; k < r.count; ++k) to[m][k] = from[k] * common;
      else
        for (uint32_t k = 0; k < r.count; ++k)
          to[m][k] = from[r.lane[k]] * (samplesVary ? 1.0f / float(q.samplesAt(r.lane[k])) : common);
    }
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
  if (q.kind != RayKind::kVisibility) {
    output("transmission", kSumThrough, false);
    output("environmentdir", kSumClear, true);
    output("environmentcolor", kSumEnvironment, false);
    if (s.op == Op::indirectdiffuse) output("occlusion", kSumHidden, false, 1);
  }
  const bool hidden = c.result == RayCall::Result::kHidden;
  mean(hidden ? kSumHidden : kSumColor, hidden ? 1 : 3, r.color);
}

/// From answers to the operation's results, for the points of `mask`.
void Machine::finish(Frame& f, const Step& s, const RayCall& c, const int32_t* mask) {
  using Result = RayCall::Result;
  const Operand* a = f.args(s);
  PendingRays& r = *rays_;
  const auto give = [&](uint32_t k, uint32_t components, const float(*values)[kRayRow]) {
    if (!(s.unread >> k & 1)) answer(a[k], components, values, mask);
  };
  switch (c.result) {
    case Result::kColor:
      give(0, 3, r.color);
      break;
    case Result::kHidden:
      give(0, 1, r.color);
      break;
    case Result::kChannel: {
      const uint32_t channel = uint32_t(std::clamp(a[2].at(0), 0.0f, 2.0f));
      give(0, 1, r.color + channel);
      break;
    }
    case Result::kShadow: {
      const bool color = s.op == Op::shadow_t || s.op == Op::shadow4_t;
      for (uint32_t k = 0; k < r.count; ++k) {
        const float mean = (r.color[0][k] + r.color[1][k] + r.color[2][k]) * (1.0f / 3);
        for (int m = 0; m < 3; ++m) r.color[m][k] = 1.0f - (color ? r.color[m][k] : mean);
      }
      give(0, color ? 3 : 1, r.color);
      break;
    }
    case Result::kDistance:
      for (uint32_t k = 0; k < r.count; ++k)
        if (!(r.hitDistance[k] < c.question.maxDistance.at(r.lane[k]))) r.hitDistance[k] = kNoHit;
      give(0, 1, &r.hitDistance);
      break;
    case Result::kHit:
      give(0, 1, &r.hitDistance);
      give(1, 3, r.hitP);
      give(2, 3, r.hitN);
      break;
    case Result::kFull:
      give(0, 1, &r.missDepth);
      give(1, 3, r.color);
      give(2, 1, &r.hitDistance);
      give(3, 3, r.hitP);
      give(4, 3, r.hitN);
      give(5, 3, r.missP);
      give(6, 3, r.missR);
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
  // Comes here again when the rays are answered.
  if (!rayCall_) rayCall_ = std::make_unique<RayCall>();
  RayCall& c = *rayCall_;
  if (f.rayPhase == 0) {
    c = RayCall();
    describe(f, s, c);
    if (c.averaged) clearSums(c);
  }
  Question& q = c.question;
  // Sample by sample, or as many as fill a block; for each of them, group by group of points whose rays may
  // share a block.
  if (f.rayPhase == 0 && c.averaged && !q.aimed) {
    uint32_t asking = 0;
    for (uint32_t i = 0; i < batch_.asking; ++i) asking += f.mask[i] != 0;
    q.run = std::clamp(kMaxRays / std::max(1u, asking), 1u, c.samples);
  }
  for (; f.raySample < c.samples; f.raySample += q.run) {
    q.sample = f.raySample;
    if (f.rayPhase == 0) beginGroups(f.mask, q);
    for (;;) {
      if (f.rayPhase == 0) {
        if (!nextGroup(q)) break;
        if (q.aimed) {
          if (aimAtLight(f, c))
            q.direction = Operand{aim_.data(), n, ~0u};
          else
            q.noRays = true;
        }
        f.rayPhase = 1;
        if (ask(q)) return Next::kSuspend;
      }
      f.rayPhase = 0;
      if (c.averaged)
        accumulate(f, c);
      else
        finish(f, s, c, groups_.asked);
    }
  }
  f.raySample = 0;
  uint32_t* const counter = f.counter(s.counter);
  for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);
  if (!c.averaged) return Next::kGo;
  averageSums(f, s, c);
  finish(f, s, c, f.mask);
  return Next::kGo;
}

}  // namespace fr
