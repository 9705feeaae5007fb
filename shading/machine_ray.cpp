// Ray operations: from registers to rays, from answers to registers.
#include "shading/machine_ray.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/error.h"
#include "base/random.h"
#include "base/sobol.h"

namespace fr {

namespace {
Vec3 at3(const Operand& o, uint32_t lane) { return {o.at(lane, 0), o.at(lane, 1), o.at(lane, 2)}; }

/// Two directions perpendicular to the unit vector n and each other (Duff et al. 2017, JCGT 6(1)).
void basis(const Vec3& n, Vec3& x, Vec3& y) {
  const float sign = std::copysign(1.0f, n.z);
  const float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
  x = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
  y = {b, sign + n.y * n.y * a, -n.y};
}
/// A unit direction within the cone about the unit vector d.
Vec3 sampleCone(const Vec3& d, float cone, bool cosine, const Vec2& r) {
  float z, rho;
  if (cosine) {
    const float limit = std::sin(std::min(cone, 1.5707963f));
    rho = limit * std::sqrt(r.x);
    z = std::sqrt(std::max(0.0f, 1.0f - rho * rho));
  } else {
    z = 1.0f - r.x * (1.0f - std::cos(std::min(cone, 3.1415927f)));
    rho = std::sqrt(std::max(0.0f, 1.0f - z * z));
  }
  Vec3 x, y;
  basis(d, x, y);
  const float phi = 6.2831853f * r.y;
  return x * (rho * std::cos(phi)) + y * (rho * std::sin(phi)) + d * z;
}
/// Unit vector, or 0 when there is no direction to speak of.
Vec3 unit(const Vec3& v) {
  const float m = std::max({std::fabs(v.x), std::fabs(v.y), std::fabs(v.z)});
  if (!(m > 0.0f) || !std::isfinite(m)) return Vec3(0);
  const Vec3 w = v / m;
  return w / std::sqrt(glm::dot(w, w));
}
}  // namespace

/// Radius and spread of every point, once per batch: given for ray hits, from the neighbours of P on grids.
void Machine::computeFootprints() {
  const uint32_t n = batch_.lanes;
  footprints_.reserve(size_t(n) * 8);
  float* radius = footprints_.data();
  float* spread = radius + n;
  const Operand P = batch_.globals[size_t(GlobalId::k_P)];
  const DerivativeStencil* d = batch_.stencil;
  for (uint32_t i = 0; i < n; ++i) {
    spread[i] = batch_.spread.data ? batch_.spread.at(i) : 0.0f;
    if (batch_.footprint.data) {
      radius[i] = batch_.footprint.at(i);
    } else if (d && P.data) {
      // Half of the cell's larger side: the surroundings that this point stands for.
      const Vec3 du = (at3(P, d->uHi[i]) - at3(P, d->uLo[i])) * (d->uScale[i] * d->uCell[i]);
      const Vec3 dv = (at3(P, d->vHi[i]) - at3(P, d->vLo[i])) * (d->vScale[i] * d->vCell[i]);
      radius[i] = 0.5f * std::sqrt(std::max(glm::dot(du, du), glm::dot(dv, dv)));
    } else {
      radius[i] = 0.0f;
    }
    if (!std::isfinite(radius[i])) radius[i] = 0.0f;
    if (!std::isfinite(spread[i])) spread[i] = 0.0f;
  }
  footprintsKnown_ = true;
}

/// Makes rays of a question. True: run() has to return. False: there is nothing to wait for; the answers of
/// the rays, if any, are misses.
bool Machine::ask(const Question& q) {
  if (!rays_) rays_ = std::make_unique<PendingRays>();
  if (!footprintsKnown_) computeFootprints();
  PendingRays& r = *rays_;
  r.kind = q.kind;
  r.count = 0;
  r.single = !q.from.varying() && !q.direction.varying() && q.cone == 0.0f;
  const Operand P = batch_.globals[size_t(GlobalId::k_P)];
  const DerivativeStencil* const d = batch_.stencil;
  const float* const radius = footprints_.data();
  const float* const spread = radius + batch_.lanes;
  const bool segment = q.kind == RayKind::kVisibility;
  // Directions, and unit directions, of all lanes.
  const uint32_t n = batch_.lanes;
  const Operand raw{footprints_.data() + size_t(n) * 2, n, ~0u},
      units{footprints_.data() + size_t(n) * 5, n, ~0u};
  KernelCall call;
  call.lanes = n;
  {
    const Operand args[] = {raw, q.direction, q.from};
    call.arg = args, call.argCount = 3;
    if (q.toPoint) {
      kernels().op[size_t(Op::sub_t)](call);
    } else {
      for (uint32_t c = 0; c < 3; ++c)
        for (uint32_t i = 0; i < n; ++i) raw.comp(c)[i] = q.direction.at(i, c);
    }
    const Operand pair[] = {units, raw};
    call.arg = pair, call.argCount = 2;
    kernels().op[size_t(Op::normalize)](call);
  }
  for (uint32_t i = 0; i < batch_.asking && r.count < kMaxRays; ++i) {
    if (!q.mask[i]) continue;
    Vec3 from = at3(q.from, i);
    Vec3 direction = at3(raw, i);
    if (!isFinite(from) || !isFinite(direction)) from = direction = Vec3(0);  // hits nothing
    const uint32_t k = r.count;
    r.radius[k] = radius[i];
    r.spread[k] = spread[i];
    const auto near = [&](const Vec3& p) {
      if (!P.data) return false;
      const Vec3 off = p - at3(P, i);
      const float limit = 2.0f * radius[i] + 1e-6f * (1.0f + glm::length(p));
      return glm::dot(off, off) <= limit * limit;
    };
    r.onSurface[k] = near(from);
    if (segment && !r.onSurface[k] && near(from + direction)) {
      // The same question from the other end: then the tracer knows which surface the ray must not hit by
      // mistake.
      from += direction;
      direction = -direction;
      r.onSurface[k] = true;
    }
    uint64_t seed = hashStep(batch_.seed ? batch_.seed[i] : batch_.batchSeed, q.site);
    if (q.counter) seed = hashStep(seed, q.counter[i]);
    if (!segment) direction = isFinite(at3(units, i)) ? at3(units, i) : Vec3(0);
    if (d && d->uScale[i] != 0.0f && !r.single && !segment) {
      // How much the direction turns over the footprint.
      const auto turn = [&](uint32_t lo, uint32_t hi, float scale) {
        if (!q.mask[lo] || !q.mask[hi]) return 0.0f;
        const Vec3 t = at3(units, hi) - at3(units, lo);
        const float squared = glm::dot(t, t) * scale * scale * 0.25f;
        return std::isfinite(squared) ? squared : 0.0f;
      };
      const float u = turn(d->uLo[i], d->uHi[i], d->uScale[i] * d->uCell[i]);
      const float v = turn(d->vLo[i], d->vHi[i], d->vScale[i] * d->vCell[i]);
      r.spread[k] = std::min(1.0f, std::max(r.spread[k], std::sqrt(std::max(u, v))));
    }
    if (q.cone > 0.0f) {
      const Vec2 xi = sobolOwen2(q.sample, uint32_t(seed >> 32));
      const float length = segment ? glm::length(direction) : 1.0f;
      direction = sampleCone(segment ? unit(direction) : direction, q.cone, q.cosine, xi) * length;
      // The samples share the cone.
      const float share = std::tan(std::min(q.cone, 1.5f)) / std::sqrt(float(std::max(1u, q.samples)));
      r.spread[k] = std::min(1.0f, std::max(r.spread[k], share));
    }
    if (q.samples > 1) seed = hashStep(seed, q.sample);
    r.seed[k] = seed;
    r.lane[k] = i;
    for (int c = 0; c < 3; ++c) r.origin[c][k] = from[c], r.direction[c][k] = direction[c];
    ++r.count;
    if (r.single) break;
  }
  if (r.count == 0) return false;
  if (!batch_.raysAllowed) {
    reportOnce(
        "shading.rays." + main_.exe().program().name,
        Error{RiError::kIncapable,
              Severity::kWarning,
              {},
              fmt::format(
                  "shader \"{}\" asks for rays where there are none (displacement or imager): they miss",
                  main_.exe().program().name)});
    r.missAll();
    return false;
  }
  return true;
}

/// Scatters answers into a register. Points that asked nothing get what the first ray got when it stands for
/// all; the neighbours of a hit get the hit's own.
void Machine::answer(const Operand& out, uint32_t components, const float (*values)[kMaxRays],
                     const int32_t* mask) {
  const PendingRays& r = *rays_;
  const uint32_t n = batch_.lanes;
  for (uint32_t c = 0; c < components; ++c) {
    float* const to = out.comp(c);
    if (r.count == 0) continue;
    if (!out.varying()) {
      std::fill_n(to, kLanePad, values[c][0]);
    } else if (r.single) {
      for (uint32_t i = 0; i < n; ++i) to[i] = mask[i] ? values[c][0] : to[i];
    } else {
      for (uint32_t k = 0; k < r.count; ++k) to[r.lane[k]] = values[c][k];
      if (batch_.copyPeriod)
        for (uint32_t i = batch_.copyPeriod; i < n; ++i) to[i] = mask[i] ? to[i % batch_.copyPeriod] : to[i];
    }
  }
}

const Operand* Machine::option(const Frame& f, const Step& s, uint32_t fixed, std::string_view name) const {
  const ShaderProgram& p = f.exe().program();
  for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
    const uint32_t symbol = symbolOf(f, s, k);
    if (p.symbols[symbol].type != SlType::kString) continue;
    if (const_cast<Frame&>(f).strings(symbol)[0] == name) return f.args(s) + k + 1;
  }
  return nullptr;
}
std::string_view Machine::optionString(Frame& f, const Step& s, uint32_t fixed, std::string_view name) {
  const Operand* o = option(f, s, fixed, name);
  return o ? text(f, s, uint32_t(o - f.args(s))) : std::string_view();
}
float Machine::optionFloat(const Frame& f, const Step& s, uint32_t fixed, std::string_view name,
                           float fallback) const {
  const Operand* o = option(f, s, fixed, name);
  if (!o || !o->data) return fallback;
  // One value for the batch: that of the first active point.
  uint32_t lane = 0;
  if (o->varying())
    while (lane + 1 < f.lanes() && !f.mask[lane]) ++lane;
  return o->at(lane);
}

namespace {
struct RayShape {
  RayKind kind;
  uint32_t outputs;  // written operands before the inputs
  uint32_t fixed;    // operands before the optional ones
};
RayShape shapeOf(Op op) {
  switch (op) {
    case Op::trace_t:
      return {RayKind::kTrace, 1, 3};
    case Op::trace_f:
      return {RayKind::kHitTest, 1, 3};
    case Op::visibility:
    case Op::transmission:
      return {RayKind::kVisibility, 1, 3};
    case Op::rayhittest:
      return {RayKind::kHitTest, 3, 5};
    case Op::fulltrace:
      return {RayKind::kFullTrace, 7, 9};
    case Op::occlusion:
      return {RayKind::kHitTest, 1, 4};
    case Op::indirectdiffuse:
      return {RayKind::kTrace, 1, 4};
    case Op::indirect:
      return {RayKind::kTrace, 1, 3};
    case Op::areashadow:
      return {RayKind::kVisibility, 1, 3};
    default:
      return {RayKind::kTrace, 1, 0};
  }
}
}  // namespace

/// Adds one sample's answers to the running sums: color in 0..2, occlusion in 3.
void Machine::accumulate(const Question& q, const int32_t* mask, float maxDistance, float falloff) {
  (void)mask;
  const PendingRays& r = *rays_;
  const uint32_t n = batch_.lanes;
  float* const sum = accumulator_.data();
  for (uint32_t k = 0; k < r.count; ++k) {
    const uint32_t i = r.lane[k];
    const bool hit = r.hitDistance[k] < maxDistance;
    for (uint32_t c = 0; c < 3; ++c)
      sum[c * n + i] += q.kind == RayKind::kVisibility || hit ? r.color[c][k] : 0.0f;
    if (hit) sum[3 * n + i] += falloff > 0 ? std::exp(-falloff * r.hitDistance[k]) : 1.0f;
  }
}

Machine::Next Machine::rayOp(Frame& f, const Step& s) {
  const Operand* a = f.args(s);
  const RayShape shape = shapeOf(s.op);
  const uint32_t n = batch_.lanes;
  if (shape.fixed == 0) {  // photons, caustic: there is no photon map
    reportOnce(std::string("shading.photons.") + opInfo(s.op).name,
               Error{RiError::kUnimplemented,
                     Severity::kWarning,
                     {},
                     fmt::format("{}(): photon maps are not available; black", opInfo(s.op).name)});
    for (uint32_t c = 0; c < 3; ++c) std::fill_n(a[0].comp(c), a[0].varying() ? n : kLanePad, 0.0f);
    return Next::kGo;
  }
  const bool hemisphere = s.op == Op::occlusion || s.op == Op::indirectdiffuse || s.op == Op::indirect;
  const bool sampled =
      hemisphere || s.op == Op::trace_t || s.op == Op::transmission || s.op == Op::visibility;
  const float maxDistance =
      sampled || s.op == Op::trace_f ? optionFloat(f, s, shape.fixed, "maxdist", 1e30f) : 1e38f;
  float samples = 1;
  if (s.op == Op::occlusion || s.op == Op::indirectdiffuse)
    samples = a[3].at(0);
  else if (s.op == Op::indirect)
    samples = optionFloat(f, s, shape.fixed, "samples", float(std::max(16u, f.instance().samples)));
  else if (sampled)
    samples = optionFloat(f, s, shape.fixed, "samples", 1);

  Question q;
  q.kind = shape.kind;
  q.from = a[shape.outputs];
  q.direction = a[shape.outputs + 1];
  q.toPoint = s.op == Op::visibility || s.op == Op::transmission;
  q.mask = f.mask;
  q.site = hashStep(f.instance().id, f.pc);
  uint32_t* const counter = f.counter(s.counter);
  q.counter = counter;
  q.samples = uint32_t(std::clamp(samples, 1.0f, 4096.0f));
  if (hemisphere) {
    q.cone = optionFloat(f, s, shape.fixed, "coneangle", 1.5707963f);
    const std::string_view distribution = optionString(f, s, shape.fixed, "distribution");
    q.cosine = distribution != "uniform";
  } else if (sampled) {
    q.cone = optionFloat(f, s, shape.fixed, "samplecone", 0.0f);
  }
  if (!(q.cone > 0.0f) && !hemisphere) q.samples = 1;
  if (s.op == Op::areashadow) {
    // Towards the light's own position.
    q.direction = f.global(GlobalId::k_P);
    q.toPoint = true;
    if (!q.direction.data) q.direction = q.from;
  }
  const bool summed = q.samples > 1 || hemisphere || s.op == Op::trace_t;

  for (;;) {
    q.sample = f.raySample;
    if (f.rayPhase == 0) {
      if (summed && f.raySample == 0) {
        accumulator_.reserve(size_t(n) * 4);
        std::memset(accumulator_.data(), 0, size_t(n) * 4 * sizeof(float));
      }
      const bool wait = ask(q);
      f.rayPhase = 1;
      if (wait) return Next::kSuspend;
    }
    f.rayPhase = 0;
    if (summed)
      accumulate(q, f.mask, maxDistance, hemisphere ? optionFloat(f, s, shape.fixed, "falloff", 0) : 0);
    if (++f.raySample >= q.samples) break;
  }
  f.raySample = 0;
  for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);

  PendingRays& r = *rays_;
  if (summed) {
    const float* const sum = accumulator_.data();
    const float scale = 1.0f / float(q.samples);
    const bool scalar = s.op == Op::occlusion;
    for (uint32_t k = 0; k < r.count; ++k)
      for (uint32_t c = 0; c < 3; ++c) r.color[c][k] = sum[(scalar ? 3 : c) * n + r.lane[k]] * scale;
    answer(a[0], scalar ? 1 : 3, r.color, f.mask);
    return Next::kGo;
  }
  switch (s.op) {
    case Op::trace_f:
      for (uint32_t k = 0; k < r.count; ++k)
        if (!(r.hitDistance[k] < maxDistance)) r.hitDistance[k] = kNoHit;
      answer(a[0], 1, &r.hitDistance, f.mask);
      break;
    case Op::visibility:
    case Op::transmission:
    case Op::areashadow:
      answer(a[0], 3, r.color, f.mask);
      break;
    case Op::rayhittest:
      answer(a[0], 1, &r.hitDistance, f.mask);
      answer(a[1], 3, r.hitP, f.mask);
      answer(a[2], 3, r.hitN, f.mask);
      break;
    case Op::fulltrace:
      answer(a[0], 1, &r.missDepth, f.mask);
      answer(a[1], 3, r.color, f.mask);
      answer(a[2], 1, &r.hitDistance, f.mask);
      answer(a[3], 3, r.hitP, f.mask);
      answer(a[4], 3, r.hitN, f.mask);
      answer(a[5], 3, r.missP, f.mask);
      answer(a[6], 3, r.missR, f.mask);
      break;
    default:
      break;
  }
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
  const auto wants = [&](uint32_t k, std::string_view prefix) {
    return isWritten(f, s, k + 1) && text(f, s, k).substr(0, prefix.size()) == prefix;
  };
  for (;;) {
    if (c.phase == Control::Phase::kNext) {
      if (c.turns == 0) c.samples = uint32_t(std::clamp(a[4].at(0), 0.0f, 4096.0f));
      if (c.turns >= c.samples || !any(c.other)) {
        std::memcpy(f.mask, c.saved, n * sizeof(int32_t));
        for (uint32_t i = 0; i < n; ++i) counter[i] += uint32_t(-f.mask[i]);
        f.active = any(f.mask);
        f.pop();
        f.pc = f.exe().steps()[s.jump].jump + 1;
        return Next::kGo;
      }
      Question q;
      q.kind = RayKind::kHitTest;
      for (uint32_t k = fixed; k + 1 < s.argCount; k += 2)
        if (wants(k, "surface:") || wants(k, "volume:")) q.kind = RayKind::kFullTrace;
      q.from = a[1], q.direction = a[2];
      q.mask = c.other;
      q.site = hashStep(f.instance().id, c.begin);
      q.counter = counter;
      q.cone = a[3].at(0);
      q.cosine = optionString(f, s, fixed, "distribution") != "uniform";
      q.sample = c.turns, q.samples = c.samples;
      std::memcpy(f.mask, c.other, n * sizeof(int32_t));
      const bool wait = ask(q);
      c.phase = Control::Phase::kReturned;
      if (wait) return Next::kSuspend;
    }
    ++c.turns;
    PendingRays& r = *rays_;
    const float maxDistance = std::min(optionFloat(f, s, fixed, "maxdist", 1e30f), 0.99e30f);
    std::memset(c.third, 0, n * sizeof(int32_t));
    const bool pattern = text(f, s, 0) == "samplepattern";
    for (uint32_t k = 0; k < r.count; ++k)
      if (!pattern && r.hitDistance[k] < maxDistance) c.third[r.lane[k]] = -1;
    if (r.single && r.count) {
      const int32_t hit = c.third[r.lane[0]];
      for (uint32_t i = 0; i < n; ++i) c.third[i] = c.other[i] & hit;
    } else if (batch_.copyPeriod) {
      for (uint32_t i = batch_.copyPeriod; i < n; ++i)
        c.third[i] = c.other[i] & c.third[i % batch_.copyPeriod];
    }
    for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
      if (!isWritten(f, s, k + 1)) continue;
      const std::string_view name = text(f, s, k);
      const Operand& out = a[k + 1];
      const uint32_t components = slTypeFloats(f.exe().program().symbols[symbolOf(f, s, k + 1)].type);
      if (name == "ray:length" && components == 1)
        answer(out, 1, &r.hitDistance, c.other);
      else if (components != 3)
        continue;
      else if (name == "ray:direction")
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
    std::memcpy(f.mask, c.third, n * sizeof(int32_t));
    f.active = any(f.mask);
    f.pc = f.active ? c.begin + 1 : s.jump;
    c.phase = Control::Phase::kBody;
    return Next::kGo;
  }
}

}  // namespace fr
