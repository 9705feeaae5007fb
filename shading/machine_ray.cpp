// Ray operations: from registers to rays, from answers to registers.
#include "shading/machine_ray.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
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

/// The points of `mask`, which does not change before they are answered, that want this sample have yet to
/// ask.
void Machine::beginGroups(const int32_t* mask, const Question& q) {
  const uint32_t n = batch_.lanes;
  groups_.whole = nullptr;
  if (!q.maxDistance.varies() && !q.bias.varies() && !q.cone.varies() && !q.base.varies() &&
      !q.samples.varies()) {
    groups_.whole = mask;
    groups_.left.clear();
    return;
  }
  groups_.left.assign(mask, mask + n);
  if (q.sample == 0) return;
  for (uint32_t i = 0; i < n; ++i)
    if (groups_.left[i] && q.samplesAt(i) <= q.sample) groups_.left[i] = 0;
}

/// Takes out points whose rays can share a block, and says so in the question. False: nobody is left.
bool Machine::nextGroup(Question& q) {
  std::vector<int32_t>&left = groups_.left, &now = groups_.now;
  const int32_t* const whole = groups_.whole;
  const auto n = whole ? batch_.lanes : uint32_t(left.size());
  uint32_t first = 0;
  while (first < n && !(whole ? whole[first] : left[first])) ++first;
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
  if (whole) {
    groups_.whole = nullptr;
  } else if (q.maxDistance.varies() || q.bias.varies() || q.cone.varies()) {
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
  q.mask = groups_.asked = whole ? whole : now.data();
  return true;
}

void PendingRays::missAll() {
  std::fill_n(hitDistance, count, kind == RayKind::kFullTrace ? kNoHitFullTrace : kNoHit);
  if (kind == RayKind::kHitTest && terms.flags & (RayTerms::kOnlyDistance | RayTerms::kOnlyWhether)) return;
  const size_t bytes = count * sizeof(float);
  const float passes = kind == RayKind::kVisibility ? 1.0f : 0.0f;
  for (int k = 0; k < 3; ++k) {
    std::fill_n(color[k], count, passes);
    std::memset(hitP[k], 0, bytes), std::memset(hitN[k], 0, bytes);
    std::memcpy(missP[k], origin[k], bytes), std::memcpy(missR[k], direction[k], bytes);
  }
  std::fill_n(missDepth, count, 1.0f);
  if (terms.extras[0] == 0) return;
  const float value = std::string_view(terms.extras).find("ray:transmission") == 2 ? 1.0f : 0.0f;
  for (auto& column : extra) std::fill_n(column, count, value);
}

namespace {
/// Columns of rayColumns_: what a question is made of, then rays of all lanes where those of some are wanted.
enum RayColumn : uint32_t {
  kUnit = 0,
  kShift = 3,
  kCone = 6,
  kSamples = 7,
  kHigh = 8,
  kSeed = 9,  // two columns
  kOrigin = 11,
  kRayRadius = 14,
  kRaySpread = 15,
  kOnSurface = 16,
  kRayColumns = 17
};
/// Columns of sampleColumns_, for each of the samples that are made together.
enum SampleColumn : uint32_t {
  kTo = 0,
  kPair = 3,
  kSampleSeed = 5,  // two columns
  kSampleColumns = 7
};
/// Columns of footprints_.
constexpr uint32_t kRadius = 0, kSpread = 1, kInward = 2, kFootprintColumns = 5;

template <class Record>
void takeStencil(const DerivativeStencil& d, Record& r) {
  r.lo[0] = d.uLo.data(), r.hi[0] = d.uHi.data(), r.lo[1] = d.vLo.data(), r.hi[1] = d.vHi.data();
  r.scale[0] = d.uScale.data(), r.scale[1] = d.vScale.data();
  r.cell[0] = d.uCell.data(), r.cell[1] = d.vCell.data();
}
}  // namespace

/// Radius and spread of every point, once per batch: given for ray hits, from the neighbours of P on grids.
void Machine::computeFootprints() {
  const uint32_t n = batch_.lanes;
  footprints_.reserve(size_t(n) * kFootprintColumns);
  Footprints f;
  f.lanes = n;
  f.P = batch_.globals[size_t(GlobalId::k_P)];
  f.givenRadius = batch_.footprint, f.givenSpread = batch_.spread;
  if (batch_.stencil) takeStencil(*batch_.stencil, f);
  f.radius = footprints_.data() + size_t(n) * kRadius, f.spread = footprints_.data() + size_t(n) * kSpread;
  f.inward = footprints_.data() + size_t(n) * kInward;
  kernels().footprints(f);
  footprintsKnown_ = true;
}

/// Who asks: a ray for each of them, or one for all.
void Machine::listAsking(const Question& q) {
  PendingRays& r = *rays_;
  r.single = !q.from.varying() && !q.direction.varying() && !q.cone.varies() && q.coneAt(0) == 0.0f &&
             !q.base.varies() && q.baseAt(0) == 0.0f && !q.maxDistance.varies() && !q.bias.varies() &&
             !q.samples.varies();
  uint32_t count = std::min(batch_.asking, kMaxRays);
  int32_t all = -1;
  for (uint32_t i = 0; i < count; ++i) all &= q.mask[i];
  if (all) {
    for (uint32_t i = 0; i < count; ++i) r.lane[i] = i;
  } else {
    count = 0;
    for (uint32_t i = 0; i < batch_.asking && count < kMaxRays; ++i) {
      r.lane[count] = i;
      count += q.mask[i] ? 1u : 0u;
    }
  }
  r.inOrder = count == std::min(batch_.asking, kMaxRays) && !r.single;
  r.count = r.single ? std::min(count, 1u) : count;
}

void Machine::hashSeeds(const Question& q, uint64_t* seeds, uint32_t* high) const {
  const uint32_t n = padLanes(batch_.asking);
  SeedHash h;
  h.base = batch_.seed, h.one = batch_.batchSeed, h.site = q.site, h.counter = q.counter;
  h.lanes = n, h.out = seeds, h.high = high;
  kernels().hashSeeds(h);
}

/// pairs_: point `index` of a low-discrepancy set for every lane, by the seeds that `h` makes of the batch's.
void Machine::choosePairs(SeedHash h, uint32_t index) {
  const uint32_t n = batch_.lanes;
  rayColumns_.reserve(size_t(n) * kRayColumns);
  const auto column = [&](uint32_t c) { return rayColumns_.data() + size_t(c) * n; };
  h.base = batch_.seed, h.one = batch_.batchSeed, h.lanes = n;
  h.out = reinterpret_cast<uint64_t*>(column(kSeed)), h.high = reinterpret_cast<uint32_t*>(column(kHigh));
  kernels().hashSeeds(h);
  SobolPairs s;
  s.index = index, s.lanes = n, s.seed = h.high, s.x = column(kUnit), s.y = column(kUnit + 1);
  kernels().sobolPairs(s);
  if (pairs_.size() < n) pairs_.resize(n);
  for (uint32_t i = 0; i < n; ++i) pairs_[i] = {s.x[i], s.y[i]};
}

/// Origins anywhere on the surroundings that the points stand for: three columns of what to add to them.
void Machine::spreadOrigins(const Question& q, uint32_t sample, float* shift) const {
  const uint32_t n = batch_.lanes;
  const auto side = [&](GlobalId tangent, GlobalId size, uint32_t i, float part) {
    const Operand along = batch_.globals[size_t(tangent)], length = batch_.globals[size_t(size)];
    return along.data && length.data ? at3(along, i) * (length.at(i) * part) : Vec3(0);
  };
  const auto* const seeds = reinterpret_cast<const uint64_t*>(rayColumns_.data() + size_t(kSeed) * n);
  for (uint32_t i = 0; i < n; ++i) {
    Vec3 all(0);
    if (const float base = i < batch_.asking ? q.baseAt(i) : 0.0f; base > 0.0f) {
      const Vec2 xi = sobolOwen2(sample, uint32_t(seeds[i])) - Vec2(0.5f);
      all = side(GlobalId::k_dPdu, GlobalId::k_du, i, base) * xi.x +
            side(GlobalId::k_dPdv, GlobalId::k_dv, i, base) * xi.y;
      if (!isFinite(all)) all = Vec3(0);
    }
    for (uint32_t c = 0; c < 3; ++c) shift[c * n + i] = all[int(c)];
  }
}

/// How many of this block's samples each point asks, one after the other.
void Machine::listSamples(const Question& q) {
  PendingRays& r = *rays_;
  groups_.points.assign(r.lane, r.lane + r.count);
  groups_.first.resize(r.count), groups_.many.resize(r.count);
  uint32_t count = 0;
  for (uint32_t j = 0; j < groups_.points.size(); ++j) {
    const uint32_t end = std::min(q.samplesAt(groups_.points[j]), q.sample + q.run);
    const uint32_t many = std::min(q.run == 1 ? 1 : end - q.sample, kMaxRays - count);
    groups_.first[j] = count, groups_.many[j] = many;
    for (uint32_t k = 0; k < many; ++k) r.lane[count++] = groups_.points[j];
  }
  r.count = count;
  r.inOrder = r.inOrder && q.run == 1;
}

/// From columns of all points to the rays of those that ask, when all ask the block's kMany samples.
template <uint32_t kMany>
void Machine::takeAll(const RayMaking& m, const uint64_t* seeds) {
  PendingRays& r = *rays_;
  const uint32_t* const points = groups_.points.data();
  const auto count = uint32_t(groups_.points.size());
  const auto take = [&](auto* to, const auto* from, size_t next) {
    for (uint32_t j = 0; j < count; ++j)
      for (uint32_t k = 0; k < kMany; ++k) to[j * kMany + k] = from[k * next + points[j]];
  };
  const auto repeat = [&](auto* to, const auto* from) {
    for (uint32_t j = 0; j < count; ++j) {
      const auto value = from[points[j]];
      for (uint32_t k = 0; k < kMany; ++k) to[j * kMany + k] = value;
    }
  };
  for (uint32_t c = 0; c < 3; ++c) repeat(r.origin[c], m.origin[c]), take(r.direction[c], m.to[c], m.next);
  for (uint32_t c = 0; c < 2 && m.pair[0]; ++c) take(r.pair[c], m.pair[c], m.next);
  repeat(r.radius, m.rayRadius), repeat(r.spread, m.raySpread), repeat(r.onSurface, m.onSurface);
  take(r.seed, seeds, m.next / 2);
}

/// The same of m.many samples, counted from the block's first, however many each point asks.
void Machine::takeRays(const RayMaking& m, const uint64_t* seeds, uint32_t sample) {
  PendingRays& r = *rays_;
  const uint32_t* const points = groups_.points.data();
  const uint32_t *const first = groups_.first.data(), *const many = groups_.many.data();
  const auto count = uint32_t(groups_.points.size());
  if (sample == 0 && std::all_of(many, many + count, [&](uint32_t samples) { return samples == m.many; })) {
    if (m.many == 1) return takeAll<1>(m, seeds);
    if (m.many == 4) return takeAll<4>(m, seeds);
    if (m.many == 8) return takeAll<8>(m, seeds);
  }
  const auto take = [&](auto* to, const auto* from, size_t next) {
    for (uint32_t j = 0; j < count; ++j)
      for (uint32_t k = 0; k < m.many && sample + k < many[j]; ++k)
        to[first[j] + sample + k] = from[k * next + points[j]];
  };
  for (uint32_t c = 0; c < 3; ++c) take(r.origin[c], m.origin[c], 0), take(r.direction[c], m.to[c], m.next);
  for (uint32_t c = 0; c < 2 && m.pair[0]; ++c) take(r.pair[c], m.pair[c], m.next);
  take(r.radius, m.rayRadius, 0), take(r.spread, m.raySpread, 0), take(r.onSurface, m.onSurface, 0);
  take(r.seed, seeds, m.next / 2);
}

/// Rays of all points, then of those that ask.
void Machine::makeRays(const Question& q) {
  PendingRays& r = *rays_;
  const uint32_t n = batch_.lanes, asking = padLanes(batch_.asking);
  rayColumns_.reserve(size_t(n) * kRayColumns);
  const auto column = [&](uint32_t c) { return rayColumns_.data() + size_t(c) * n; };
  const bool segment = r.kind == RayKind::kVisibility;
  // Unit directions, of neighbours too.
  const Operand unit{column(kUnit), n, ~0u};
  KernelCall call;
  call.lanes = n;
  if (!segment) {
    const Operand pair[] = {unit, q.direction};
    call.arg = pair, call.argCount = 2;
    kernels().op[size_t(Op::normalize)](call);
  }
  const bool direct = r.inOrder && q.run == 1 && asking <= kMaxRays;
  if (!direct) listSamples(q);
  const bool wide = q.cone.varies() || q.coneAt(0) > 0.0f, based = q.base.varies() || q.baseAt(0) > 0.0f;
  const bool samplesVary = q.cone.varies() || q.base.varies() || q.samples.varies();
  const bool several = samplesVary || q.samplesAt(0) > 1;
  // As many samples at once as have the same origins.
  const uint32_t together = based ? 1 : q.run;
  const size_t next = size_t(n) * kSampleColumns;
  sampleColumns_.reserve(next * together);
  const auto ofSample = [&](uint32_t c) { return sampleColumns_.data() + size_t(c) * n; };
  auto* const sampleSeeds = direct ? r.seed : reinterpret_cast<uint64_t*>(ofSample(kSampleSeed));
  auto* const pointSeeds = several || based ? reinterpret_cast<uint64_t*>(column(kSeed)) : sampleSeeds;
  auto* const high = reinterpret_cast<uint32_t*>(column(kHigh));
  hashSeeds(q, pointSeeds, wide ? high : nullptr);

  RayMaking m;
  m.lanes = asking;
  m.from = q.from, m.direction = q.direction, m.unit = segment ? q.direction : unit;
  m.toPoint = q.toPoint, m.segment = segment;
  m.P = batch_.globals[size_t(GlobalId::k_P)];
  m.radius = footprints_.data() + size_t(n) * kRadius, m.spread = footprints_.data() + size_t(n) * kSpread;
  m.inwardComponent = m.shiftComponent = n;
  const DerivativeStencil* const d = batch_.stencil;
  if (d && !batch_.copyPeriod) m.inward = footprints_.data() + size_t(n) * kInward;
  if (d && !r.single && !segment) {
    takeStencil(*d, m);
    if (kernels().countActive(q.mask, n) < d->used) m.neighbourMask = q.mask;
  }
  if (wide) {
    float *const cones = column(kCone), *const samples = column(kSamples);
    for (uint32_t i = 0; i < (samplesVary ? asking : kLanePad); ++i)
      cones[i] = q.coneAt(i), samples[i] = float(q.samplesAt(i));
    const uint32_t indexMask = samplesVary ? ~0u : kLanePad - 1;
    m.cone = {cones, n, indexMask}, m.samples = {samples, n, indexMask};
    m.cosine = q.cosine, m.seed = high;
  }
  for (uint32_t c = 0; c < 3; ++c) {
    m.origin[c] = direct ? r.origin[c] : column(kOrigin + c);
    m.to[c] = direct ? r.direction[c] : ofSample(kTo + c);
  }
  m.rayRadius = direct ? r.radius : column(kRayRadius), m.raySpread = direct ? r.spread : column(kRaySpread);
  for (uint32_t c = 0; c < 2 && q.pairs; ++c) m.pair[c] = direct ? r.pair[c] : ofSample(kPair + c);
  m.onSurface = direct ? r.onSurface : reinterpret_cast<int32_t*>(column(kOnSurface));
  m.many = together, m.next = next;
  for (uint32_t k = 0; k < q.run; k += together) {
    m.sample = q.sample + k;
    if (based) spreadOrigins(q, m.sample, column(kShift)), m.shift = column(kShift);
    kernels().makeRays(m);
    // Every sample has a path of its own.
    for (uint32_t j = 0; j < together; ++j) {
      uint64_t* const seeds = sampleSeeds + j * next / 2;
      if (samplesVary) {
        for (uint32_t i = 0; i < batch_.asking; ++i)
          seeds[i] = q.samplesAt(i) > 1 ? hashStep(pointSeeds[i], m.sample + j) : pointSeeds[i];
      } else if (several) {
        SeedHash h;
        h.base = pointSeeds, h.out = seeds, h.site = m.sample + j, h.lanes = asking;
        kernels().hashSeeds(h);
      } else if (seeds != pointSeeds) {
        std::copy_n(pointSeeds, asking, seeds);
      }
    }
    if (!direct) takeRays(m, sampleSeeds, k);
  }
}

/// Makes rays of a question. True: run() has to return. False: there is nothing to wait for; the answers of
/// the rays, if any, are misses.
bool Machine::ask(Question& q) {
  if (!rays_) rays_ = std::make_unique<PendingRays>();
  if (!footprintsKnown_) computeFootprints();
  PendingRays& r = *rays_;
  r.kind = q.kind;
  r.terms = q.terms;
  const bool segment = q.kind == RayKind::kVisibility;
  const bool diffuse = q.terms.rayClass == RayClass::kDiffuse;
  r.terms.diffuseDepth = batch_.diffuseDepth + (diffuse && !segment ? 1u : 0u);
  r.terms.shadowDepth = batch_.shadowDepth + (segment ? 1u : 0u);
  listAsking(q);
  if (r.count == 0) return false;
  makeRays(q);
  if (mayAsk(q)) return true;
  r.missAll();
  return false;
}

bool Machine::mayAsk(const Question& q) {
  const RayTerms& t = rays_->terms;
  if (q.kind != RayKind::kVisibility) {
    // Level of the new rays, less the diffuse ones and those of shadows.
    const uint32_t level = batch_.level + 1, others = t.diffuseDepth + t.shadowDepth;
    const uint32_t specularDepth = level > others ? level - others : 0;
    if (t.rayClass == RayClass::kDiffuse ? t.diffuseDepth > batch_.maxDiffuseDepth
                                         : specularDepth > batch_.maxSpecularDepth)
      return false;
  }
  if (q.noRays) return false;
  if (batch_.raysAllowed) return true;
  if (!batch_.saysMisses) return false;
  reportOnce("shading.rays." + main_.exe().program().name,
             Error{RiError::kIncapable,
                   Severity::kWarning,
                   {},
                   fmt::format(
                       "shader \"{}\" asks for rays where there are none (displacement or imager): they miss",
                       main_.exe().program().name)});
  return false;
}

/// Scatters answers into a register. Points that asked nothing get what the first ray got when it stands for
/// all; the neighbours of a hit get the hit's own.
void Machine::answer(const Operand& out, uint32_t components, const float (*values)[kRayRow],
                     const int32_t* mask) {
  const PendingRays& r = *rays_;
  const uint32_t n = batch_.lanes;
  if (r.count == 0) return;
  int32_t all = r.inOrder ? -1 : 0;
  for (uint32_t k = 0; r.inOrder && k < r.count; ++k) all &= mask[k];
  for (uint32_t c = 0; c < components; ++c) {
    float* const to = out.comp(c);
    if (!out.varying()) {
      std::fill_n(to, kLanePad, values[c][0]);
    } else if (r.single) {
      for (uint32_t i = 0; i < n; ++i) to[i] = mask[i] ? values[c][0] : to[i];
    } else {
      if (all)
        std::memcpy(to, values[c], r.count * sizeof(float));
      else
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
