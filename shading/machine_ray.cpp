// Ray operations: from registers to rays, from answers to registers.
#include "shading/machine_ray.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <string_view>
#include <tuple>

#include "base/error.h"
#include "base/random.h"
#include "base/sobol.h"

namespace fr {

namespace {
/// More samples than anyone waits for.
constexpr float kMostSamples = 4096.0f;

Vec3 at3(const Operand& o, uint32_t lane) { return {o.at(lane, 0), o.at(lane, 1), o.at(lane, 2)}; }

/// Two directions perpendicular to the unit vector n and each other (Duff et al. 2017, JCGT 6(1)).
void basis(const Vec3& n, Vec3& x, Vec3& y) {
  const float sign = std::copysign(1.0f, n.z);
  const float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
  x = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
  y = {b, sign + n.y * n.y * a, -n.y};
}
/// The unit directions within an angle of a unit vector.
struct Cone {
  Vec3 axis, x, y;
  bool cosine;
  float limit;

  Cone(const Vec3& d, float angle, bool byCosine)
      : axis(d),
        cosine(byCosine),
        limit(cosine ? std::sin(std::min(angle, 1.5707963f)) : 1.0f - std::cos(std::min(angle, 3.1415927f))) {
    basis(d, x, y);
  }
  Vec3 direction(const Vec2& r) const {
    float z, rho;
    if (cosine) {
      rho = limit * std::sqrt(r.x);
      z = std::sqrt(std::max(0.0f, 1.0f - rho * rho));
    } else {
      z = 1.0f - r.x * limit;
      rho = std::sqrt(std::max(0.0f, 1.0f - z * z));
    }
    const float phi = 6.2831853f * r.y;
    return x * (rho * std::cos(phi)) + y * (rho * std::sin(phi)) + axis * z;
  }
};
/// Unit vector, or 0 when there is no direction to speak of.
Vec3 unit(const Vec3& v) {
  const float m = std::max({std::fabs(v.x), std::fabs(v.y), std::fabs(v.z)});
  if (!(m > 0.0f) || !std::isfinite(m)) return Vec3(0);
  const Vec3 w = v / m;
  return w / std::sqrt(glm::dot(w, w));
}
}  // namespace

float Machine::Question::coneAt(uint32_t lane) const {
  const float angle = cone.at(lane);
  return angle > 0.0f ? std::min(angle, 3.1415927f) : 0.0f;
}
float Machine::Question::baseAt(uint32_t lane) const {
  const float part = base.at(lane);
  return part > 0.0f ? std::min(part, 8.0f) : 0.0f;
}
/// The same ray again would say the same: without a cone one is enough.
uint32_t Machine::Question::samplesAt(uint32_t lane) const {
  const float wanted = samples.at(lane);
  const bool differ = several || hemisphere || aimed || coneAt(lane) > 0.0f || baseAt(lane) > 0.0f;
  return differ && wanted > 1.0f ? uint32_t(std::min(wanted, kMostSamples)) : 1u;
}

/// The most samples that any active point wants.
uint32_t Machine::mostSamples(const Frame& f, const Question& q) const {
  if (!q.samples.varies() && !q.cone.varies() && !q.base.varies()) return q.samplesAt(0);
  uint32_t most = 1;
  for (uint32_t i = 0; i < batch_.asking; ++i)
    if (f.mask[i]) most = std::max(most, q.samplesAt(i));
  return most;
}

/// The points of `mask` that want this sample have yet to ask.
void Machine::beginGroups(const int32_t* mask, const Question& q) {
  const uint32_t n = batch_.lanes;
  groups_.left.assign(mask, mask + n);
  if (q.sample == 0) return;
  for (uint32_t i = 0; i < n; ++i)
    if (groups_.left[i] && q.samplesAt(i) <= q.sample) groups_.left[i] = 0;
}

/// Takes out points whose rays can share a block, and says so in the question. False: nobody is left.
bool Machine::nextGroup(Question& q) {
  std::vector<int32_t>&left = groups_.left, &now = groups_.now;
  const uint32_t n = batch_.lanes;
  uint32_t first = 0;
  while (first < n && !left[first]) ++first;
  if (first == n) return false;
  const auto bitsOf = [](float x) {
    uint32_t b;
    std::memcpy(&b, &x, sizeof b);
    return b;
  };
  const auto key = [&](uint32_t i) {
    return std::tuple(bitsOf(q.maxDistance.at(i)), bitsOf(q.bias.at(i)), q.coneAt(i) > q.diffuseBeyond);
  };
  const auto common = key(first);
  if (q.maxDistance.varies() || q.bias.varies() || q.cone.varies()) {
    now.assign(n, 0);
    for (uint32_t i = first; i < n; ++i)
      if (left[i] && key(i) == common) now[i] = left[i], left[i] = 0;
  } else {
    now = left;
    std::fill(left.begin(), left.end(), 0);
  }
  RayTerms& t = q.terms;
  const float limit = q.maxDistance.at(first), bias = q.bias.at(first);
  t.maxDistance = limit < 1e29f ? std::max(limit, 1e-30f) : 0.0f;
  t.flags &= ~uint32_t(RayTerms::kHasBias), t.bias = 0;
  if (bias >= 0.0f) t.bias = bias, t.flags |= RayTerms::kHasBias;
  if (q.diffuseBeyond < std::numeric_limits<float>::infinity())
    t.rayClass = q.coneAt(first) > q.diffuseBeyond ? RayClass::kDiffuse : RayClass::kSpecular;
  q.mask = now.data();
  return true;
}

void PendingRays::missAll() {
  std::fill_n(hitDistance, count, kind == RayKind::kFullTrace ? kNoHitFullTrace : kNoHit);
  if (kind == RayKind::kHitTest && terms.flags & (RayTerms::kOnlyDistance | RayTerms::kOnlyWhether)) return;
  const float c = kind == RayKind::kVisibility ? 1.0f : 0.0f;
  for (int k = 0; k < 3; ++k) {
    std::fill_n(color[k], count, c);
    std::fill_n(hitP[k], count, 0.0f), std::fill_n(hitN[k], count, 0.0f);
    std::copy_n(origin[k], count, missP[k]), std::copy_n(direction[k], count, missR[k]);
  }
  std::fill_n(missDepth, count, 1.0f);
  if (terms.extras[0] == 0) return;
  const float value = std::string_view(terms.extras).find("ray:transmission") == 2 ? 1.0f : 0.0f;
  for (auto& column : extra) std::fill_n(column, count, value);
}

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

/// For points at the border of a grid, and the vertices of meshlets: a small step into the surface.
Vec3 Machine::fromTheEdge(const Operand& P, const DerivativeStencil& d, uint32_t lane) {
  Vec3 all(0);
  const Vec3 here = at3(P, lane);
  const auto step = [&](uint32_t lo, uint32_t hi) {
    if ((lo == lane) == (hi == lane)) return;
    const Vec3 side = at3(P, lo == lane ? hi : lo) - here;
    const float length = glm::length(side);
    // Of the cell, but not lost in rounding far from the origin.
    const float far = std::max({std::fabs(here.x), std::fabs(here.y), std::fabs(here.z)});
    const float part = std::min(std::max(0x1p-10f, 1e-6f * far / length), 0.25f);
    if (length > 0.0f && isFinite(side)) all += side * part;
  };
  step(d.uLo[lane], d.uHi[lane]);
  step(d.vLo[lane], d.vHi[lane]);
  return all;
}

/// Makes rays of a question. True: run() has to return. False: there is nothing to wait for; the answers of
/// the rays, if any, are misses.
bool Machine::ask(Question& q) {
  if (!rays_) rays_ = std::make_unique<PendingRays>();
  if (!footprintsKnown_) computeFootprints();
  PendingRays& r = *rays_;
  r.kind = q.kind;
  r.count = 0;
  r.single = !q.from.varying() && !q.direction.varying() && !q.cone.varies() && q.coneAt(0) == 0.0f &&
             !q.base.varies() && q.baseAt(0) == 0.0f && !q.maxDistance.varies() && !q.bias.varies() &&
             !q.samples.varies();
  r.terms = q.terms;
  const bool segment = q.kind == RayKind::kVisibility;
  const bool diffuse = q.terms.rayClass == RayClass::kDiffuse;
  r.terms.diffuseDepth = batch_.diffuseDepth + (diffuse && !segment ? 1u : 0u);
  r.terms.shadowDepth = batch_.shadowDepth + (segment ? 1u : 0u);
  const Operand P = batch_.globals[size_t(GlobalId::k_P)];
  const DerivativeStencil* const d = batch_.stencil;
  const float* const radius = footprints_.data();
  const float* const spread = radius + batch_.lanes;
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
    uint64_t pointSeed = hashStep(batch_.seed ? batch_.seed[i] : batch_.batchSeed, q.site);
    if (q.counter) pointSeed = hashStep(pointSeed, q.counter[i]);
    const uint32_t samples = q.samplesAt(i);
    const float base = q.baseAt(i), angle = q.coneAt(i);
    const auto near = [&](const Vec3& p) {
      if (!P.data) return false;
      const Vec3 off = p - at3(P, i);
      const float limit = 2.0f * radius[i] + 1e-6f * (1.0f + glm::length(p));
      return glm::dot(off, off) <= limit * limit;
    };
    struct Start {
      Vec3 from, direction;
      bool onSurface;
    };
    const auto startAt = [&](Vec3 from, Vec3 direction) {
      if (!isFinite(from) || !isFinite(direction)) from = direction = Vec3(0);  // hits nothing
      bool onSurface = near(from);
      if (segment && !onSurface && near(from + direction)) {
        // The same question from the other end: then the tracer knows which surface the ray must not hit by
        // mistake.
        from += direction;
        direction = -direction;
        onSurface = true;
      }
      if (onSurface && d && !batch_.copyPeriod) {
        // Where surfaces meet in an edge, a point of the one lies exactly on the other: its rays must start
        // on the near side of that, or half of them would leave through the corner of a closed room.
        const Vec3 inward = fromTheEdge(P, *d, i);
        from += inward;
        if (segment) direction -= inward;
      }
      if (!segment) direction = isFinite(at3(units, i)) ? at3(units, i) : Vec3(0);
      return Start{from, direction, onSurface};
    };
    float widest = spread[i];
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
      widest = std::min(1.0f, std::max(widest, std::sqrt(std::max(u, v))));
    }
    // The samples share the cone's solid angle.
    if (angle > 0.0f)
      widest = std::min(1.0f, std::max(widest, std::sqrt(2.0f * (1.0f - std::cos(angle)) / float(samples))));

    Start start = startAt(at3(q.from, i), at3(raw, i));
    std::optional<Cone> cone;
    float length = 1.0f;
    const uint32_t end = std::min(samples, q.sample + q.run);
    for (uint32_t sample = q.sample; sample < end && r.count < kMaxRays; ++sample) {
      if (base > 0.0f) {
        // Anywhere on the surroundings that the point stands for.
        const Vec2 xi = sobolOwen2(sample, uint32_t(pointSeed)) - Vec2(0.5f);
        const auto side = [&](GlobalId tangent, GlobalId size) {
          const Operand along = batch_.globals[size_t(tangent)], extent = batch_.globals[size_t(size)];
          return along.data && extent.data ? at3(along, i) * (extent.at(i) * base) : Vec3(0);
        };
        Vec3 shift =
            side(GlobalId::k_dPdu, GlobalId::k_du) * xi.x + side(GlobalId::k_dPdv, GlobalId::k_dv) * xi.y;
        if (!isFinite(shift)) shift = Vec3(0);
        start = startAt(at3(q.from, i) + shift, q.toPoint ? at3(raw, i) - shift : at3(raw, i));
      }
      const uint32_t k = r.count++;
      r.radius[k] = radius[i];
      r.spread[k] = widest;
      r.onSurface[k] = start.onSurface;
      Vec3 direction = start.direction;
      r.pair[0][k] = r.pair[1][k] = 0.5f;
      if (angle > 0.0f) {
        const Vec2 xi = sobolOwen2(sample, uint32_t(pointSeed >> 32));
        r.pair[0][k] = xi.x, r.pair[1][k] = xi.y;
        if (!cone || base > 0.0f) {
          if (segment) length = glm::length(direction);
          cone.emplace(segment ? unit(direction) : direction, angle, q.cosine);
        }
        direction = cone->direction(xi) * length;
      }
      r.seed[k] = samples > 1 ? hashStep(pointSeed, sample) : pointSeed;
      r.lane[k] = i;
      for (int c = 0; c < 3; ++c) r.origin[c][k] = start.from[c], r.direction[c][k] = direction[c];
    }
    if (r.single) break;
  }
  if (r.count == 0) return false;
  if (!segment) {
    // Level of the new rays, less the diffuse ones and those of shadows.
    const uint32_t level = batch_.level + 1, others = r.terms.diffuseDepth + r.terms.shadowDepth;
    const uint32_t specularDepth = level > others ? level - others : 0;
    if (diffuse ? r.terms.diffuseDepth > batch_.maxDiffuseDepth : specularDepth > batch_.maxSpecularDepth) {
      r.missAll();
      return false;
    }
  }
  if (q.noRays) {
    r.missAll();
    return false;
  }
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
void Machine::answer(const Operand& out, uint32_t components, const float (*values)[kRayRow],
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
      for (uint32_t k = 0; k < r.count; ++k)
        if (mask[r.lane[k]]) to[r.lane[k]] = values[c][k];
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
  return o->at(o->varying() ? firstActive(f) : 0);
}
uint32_t Machine::firstActive(const Frame& f) {
  uint32_t lane = 0;
  while (lane + 1 < f.lanes() && !f.mask[lane]) ++lane;
  return lane;
}
Machine::Term Machine::term(const Frame& f, const Step& s, uint32_t fixed, std::string_view name,
                            float fallback) const {
  Term t;
  t.fallback = fallback;
  if (const Operand* o = option(f, s, fixed, name); o && o->data) t.given = *o;
  return t;
}

}  // namespace fr
