// One batch in flight: bump mapping, the surface shader with its lights, the volume before it.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string_view>

#include "base/random.h"
#include "shading/point_columns.h"

namespace fr {

struct ShadeTask::Impl {
  explicit Impl(ShadingSystem::Impl& s) : system(s), columns(s), surface(s.host) {}

  enum class Stage { kIdle, kSurface, kVolume, kDone };
  ShadingSystem::Impl& system;
  PointColumns columns;
  Machine surface;
  std::unique_ptr<Machine> other;  // bump mapping, then the volume
  const ShadeSetup* setup = nullptr;
  ShadePoints points;
  Stage stage = Stage::kIdle;
  std::vector<float> times;  // per point, 0..1
  bool timed = false;        // they came with the points
  mutable AlignedFloats broadcast;
  AlignedFloats results;

  bool surfaceRan = false, displacementRan = false;

  Machine& running() { return stage == Stage::kVolume ? *other : surface; }
  const Machine& running() const { return stage == Stage::kVolume ? *other : surface; }
  Machine& second() {
    if (!other) other = std::make_unique<Machine>(system.host);
    return *other;
  }
  void bump();
  void runDisplacement(const Batch& b);
  void applyAttributes();
  bool beginVolume();
  const float* broadcastColumn(const Operand& o, uint32_t component) const;
  const float* broadcastValue(const ShaderValue& v, uint32_t component) const;
  const float* hitValue(std::string_view name, uint32_t component) const;
  void collect(const Machine& m);
  template <class Lane>
  void writePlaces(const PendingRays& r, RayQuery& q, const Lane& lane) const;
};

ShadeTask::ShadeTask(ShadingSystem& system) : impl_(std::make_unique<Impl>(*system.impl_)) {}
ShadeTask::~ShadeTask() = default;
ShadeTask::ShadeTask(ShadeTask&&) noexcept = default;
ShadeTask& ShadeTask::operator=(ShadeTask&&) noexcept = default;

/// For its normals, or for what others ask it by displacement("x", v).
void ShadeTask::Impl::runDisplacement(const Batch& b) {
  Machine& m = second();
  m.begin(b, *setup->displacement, {}, setup->partners());
  m.run();
  displacementRan = true;
}

/// A displacement shader that moves nothing runs here, for its normals.
void ShadeTask::Impl::bump() {
  // A solid has one shape, whether it is added or taken away.
  if (columns.subtracted()) columns.turnOver();
  Batch b = columns.batch();
  b.raysAllowed = false;
  b.overrides = columns.displacementOverrides(*setup);
  runDisplacement(b);
  const Operand N = second().result(GlobalId::k_N);
  const Operand to = b.globals[size_t(GlobalId::k_N)];
  if (N.data)
    for (uint32_t c = 0; c < 3; ++c)
      for (uint32_t i = 0; i < b.lanes; ++i) to.comp(c)[i] = N.at(i, c);
  if (columns.subtracted()) columns.turnOver();
}

void ShadeTask::begin(const ShadePoints& points) {
  Impl& t = *impl_;
  const bool volume = points.topology == ShadePoints::Topology::kVolume;
  const bool hits = points.topology == ShadePoints::Topology::kHits;
  const cache::AttributeId attributes =
      volume ? points.volumeAttributes
             : t.system.scene.objectOf(hits ? points.node[0] : points.grid->node).attributes;
  t.points = points;
  t.setup = &t.system.setup(attributes);
  t.surfaceRan = t.displacementRan = false;
  if (volume)
    t.columns.fillVolume(points, *t.setup);
  else
    t.columns.fill(points, *t.setup);
  t.times.assign(t.columns.count(), 0.0f);
  t.timed = (hits || volume) && points.time;
  if (t.timed)
    for (uint32_t i = 0; i < t.columns.count(); ++i)
      t.times[i] = points.time[i] >= 0.0f && points.time[i] <= 1.0f ? points.time[i] : 0.0f;
  if (volume || points.valuesOnly) {
    const size_t n = size_t(t.columns.batch().lanes) * 6;
    t.results.reserve(n);
    std::memset(t.results.data(), 0, n * sizeof(float));
    t.stage = volume && t.beginVolume() ? Impl::Stage::kVolume : Impl::Stage::kDone;
    return;
  }
  const uint32_t flags = t.system.scene.skeleton().attributes()[attributes].flags;
  const uint32_t byClass = points.level == 0                       ? cache::kCameraHitsPrimitive
                           : points.rayClass == RayClass::kDiffuse ? cache::kDiffuseHitsPrimitive
                                                                   : cache::kSpecularHitsPrimitive;
  // What shadow rays ask of their hits, the tracer knows.
  if (points.hitMode == HitMode::kPrimitive ||
      (points.hitMode == HitMode::kDefault && !points.shadowRay && (flags & byClass))) {
    t.applyAttributes();
    t.stage = t.beginVolume() ? Impl::Stage::kVolume : Impl::Stage::kDone;
    return;
  }
  t.stage = Impl::Stage::kSurface;
  if (t.setup->bumpOnly)
    t.bump();
  else if (t.setup->displacementIsAsked)
    t.runDisplacement(t.columns.beforeDisplacement(*t.setup));
  // A shadow ray wants the opacity alone: no light has to run.
  const std::span<const ShaderInstance* const> lights =
      points.shadowRay ? std::span<const ShaderInstance* const>()
                       : std::span<const ShaderInstance* const>(t.setup->lights);
  Machine::Partners partners = t.setup->partners();
  if (t.displacementRan) partners.ranDisplacement = t.other.get();
  Batch batch = t.columns.batch();
  if (t.setup->surfaceDisplaces) {
    // It moves its points itself, once more.
    const auto overrides = batch.overrides;
    const bool raysAllowed = batch.raysAllowed;
    batch = t.columns.beforeDisplacement(*t.setup);
    batch.overrides = overrides, batch.raysAllowed = raysAllowed;
  }
  t.surface.begin(batch, *t.setup->surface, lights, partners);
}

/// Ci = Os Cs, Oi = Os: what a surface looks like without its shader.
void ShadeTask::Impl::applyAttributes() {
  const Batch& b = columns.batch();
  results.reserve(size_t(b.lanes) * 6);
  const Operand Cs = b.globals[size_t(GlobalId::k_Cs)], Os = b.globals[size_t(GlobalId::k_Os)];
  for (uint32_t c = 0; c < 3; ++c)
    for (uint32_t i = 0; i < b.lanes; ++i) {
      results.data()[c * b.lanes + i] = Cs.at(i, c) * Os.at(i, c);
      results.data()[(3 + c) * b.lanes + i] = Os.at(i, c);
    }
}

/// Copies Ci and Oi out of a machine; what is not finite becomes 0.
void ShadeTask::Impl::collect(const Machine& m) {
  const uint32_t lanes = columns.batch().lanes;
  results.reserve(size_t(lanes) * 6);
  for (uint32_t k = 0; k < 6; ++k) {
    const GlobalId id = k < 3 ? GlobalId::k_Ci : GlobalId::k_Oi;
    Operand from = m.result(id);
    if (!from.data) from = columns.batch().globals[size_t(id)];
    float* const to = results.data() + size_t(k) * lanes;
    for (uint32_t i = 0; i < lanes; ++i) {
      const float x = from.at(i, k % 3);
      to[i] = std::isfinite(x) ? x : 0.0f;
    }
  }
}

/// Starts the volume shader between the points and where their rays came from. False: there is none.
bool ShadeTask::Impl::beginVolume() {
  using Volume = ShadePoints::Volume;
  if (points.shadowRay) return false;
  const ShadeSetup* owner = setup;
  const ShaderInstance* volume = nullptr;
  if (points.volume != Volume::kAtmosphere && points.volumeAttributes < system.setups.size()) {
    const ShadeSetup& of = system.setup(points.volumeAttributes);
    volume = (points.volume == Volume::kInterior ? of.interior : of.exterior).get();
    if (volume) owner = &of;
  }
  const bool segment = volume != nullptr;
  if (!volume && points.topology != ShadePoints::Topology::kVolume) volume = setup->atmosphere.get();
  if (!volume) return false;

  Batch b = columns.batch();
  b.overrides = {};
  b.attributes = owner->attributes;
  const uint32_t lanes = b.lanes;
  for (uint32_t k = 0; k < 6; ++k) {
    const Operand& to = b.globals[size_t(k < 3 ? GlobalId::k_Ci : GlobalId::k_Oi)];
    std::memcpy(to.comp(k % 3), results.data() + size_t(k) * lanes, lanes * sizeof(float));
  }
  // The ray of a volume starts at P - I.
  const Operand P = b.globals[size_t(GlobalId::k_P)], I = b.globals[size_t(GlobalId::k_I)];
  if (points.level == 0 && !system.host.perspective()) {
    for (uint32_t i = 0; i < lanes; ++i) I.comp(0)[i] = I.comp(1)[i] = 0, I.comp(2)[i] = P.at(i, 2);
  } else if (segment && points.segmentStart && points.distance) {
    for (uint32_t i = 0; i < lanes; ++i) {
      const uint32_t k = b.copyPeriod ? i % b.copyPeriod : i;
      if (k >= columns.count()) continue;
      const float start = points.segmentStart[k], end = columns.distance(k);
      const float part = end > 0 ? std::clamp((end - start) / end, 0.0f, 1.0f) : 0.0f;
      for (uint32_t c = 0; c < 3; ++c) I.comp(c)[i] *= part;
    }
  }
  Machine::Partners partners = setup->partners();
  if (surfaceRan) partners.ranSurface = &surface;
  second().begin(b, *volume, owner->lights, partners);
  return true;
}

ShadeTask::Status ShadeTask::run() {
  Impl& t = *impl_;
  if (t.stage == Impl::Stage::kDone) return Status::kDone;
  if (t.stage == Impl::Stage::kSurface) {
    if (t.surface.run() == Machine::Status::kNeedsRays) return Status::kNeedsRays;
    t.collect(t.surface);
    t.surfaceRan = true;
    t.stage = t.beginVolume() ? Impl::Stage::kVolume : Impl::Stage::kDone;
  }
  if (t.stage == Impl::Stage::kVolume) {
    if (t.other->run() == Machine::Status::kNeedsRays) return Status::kNeedsRays;
    t.collect(*t.other);
    t.stage = Impl::Stage::kDone;
    t.system.addStatistics(t.other->statistics(), 0);
  }
  t.system.addStatistics(t.surface.statistics(), t.columns.count());
  return Status::kDone;
}

uint32_t ShadeTask::rayCount() const { return impl_->running().rays().count; }

namespace {

/// RAYSERVER_JITTER_TIMES=0: every ray at shutter open, as in 1998. Jittered is the default here.
bool jitterRayTimes() {
  static const bool jitter = [] {
    const char* v = std::getenv("RAYSERVER_JITTER_TIMES");
    return !v || std::string_view(v) != "0";
  }();
  return jitter;
}

/// In [0, 1), from the ray's seed: the same whoever asks.
float rayTime(uint64_t seed) { return float(hashStep(seed, 0x74696d65) >> 40) * 0x1p-24f; }

/// Columns of points or directions, transformed. The sums are those of m * v.
template <size_t N, size_t M>
void transformColumns(const Mat4& m, bool points, const float (&from)[3][N], float (&to)[3][M],
                      uint32_t count) {
  const bool affine = m[0][3] == 0.0f && m[1][3] == 0.0f && m[2][3] == 0.0f && m[3][3] == 1.0f;
  if (points && !affine) {
    for (uint32_t k = 0; k < count; ++k) {
      const Vec3 p = transformPoint(m, Vec3(from[0][k], from[1][k], from[2][k]));
      for (int c = 0; c < 3; ++c) to[c][k] = p[c];
    }
    return;
  }
  for (int c = 0; c < 3; ++c) {
    const float x = m[0][c], y = m[1][c], z = m[2][c], w = m[3][c];
    if (points)
      for (uint32_t k = 0; k < count; ++k)
        to[c][k] = (x * from[0][k] + y * from[1][k]) + (z * from[2][k] + w);
    else
      for (uint32_t k = 0; k < count; ++k) to[c][k] = x * from[0][k] + y * from[1][k] + z * from[2][k];
  }
}

}  // namespace

/// What rays take from the points that ask them; `lane`(k): of ray k.
template <class Lane>
void ShadeTask::Impl::writePlaces(const PendingRays& r, RayQuery& q, const Lane& lane) const {
  const uint32_t period = columns.batch().copyPeriod;
  for (uint32_t k = 0; k < r.count; ++k) {
    const bool on = r.onSurface[k] != 0;
    q.node[k] = on ? columns.node(lane(k)) : cache::kNone;
    q.cell[k] = on ? columns.cell(lane(k)) : cache::kNone;
    q.u[k] = on ? columns.u(lane(k)) : 0.0f;
    q.v[k] = on ? columns.v(lane(k)) : 0.0f;
  }
  for (uint32_t k = 0; k < r.count; ++k)
    q.point[k] = r.single ? cache::kNone : period ? lane(k) % period : lane(k);
  const Operand Ng = columns.batch().globals[size_t(GlobalId::k_Ng)];
  const Mat3& m = system.currentToCacheNormal;
  for (uint32_t k = 0; k < r.count; ++k) {
    const float x = Ng.at(lane(k), 0), y = Ng.at(lane(k), 1), z = Ng.at(lane(k), 2);
    float n[3];
    for (int c = 0; c < 3; ++c) n[c] = m[0][c] * x + m[1][c] * y + m[2][c] * z;
    const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    const bool known = r.onSurface[k] != 0 && length > 0 && length <= std::numeric_limits<float>::max();
    for (int c = 0; c < 3; ++c) q.normal[c][k] = known ? n[c] / length : 0.0f;
  }
}

void ShadeTask::writeRays(RayQuery& q) const {
  const Impl& t = *impl_;
  const PendingRays& r = t.running().rays();
  q.kind = r.kind;
  q.count = r.count;
  q.level = t.columns.batch().level + 1;
  q.terms = r.terms;
  const Mat4& m = t.system.currentToCache;
  const float scale = std::cbrt(std::fabs(glm::determinant(Mat3(m))));  // cameras may scale
  q.terms.maxDistance *= scale, q.terms.bias *= scale;
  transformColumns(m, true, r.origin, q.origin, r.count);
  transformColumns(m, false, r.direction, q.direction, r.count);
  if (r.inOrder)
    t.writePlaces(r, q, [](uint32_t k) { return k; });
  else
    t.writePlaces(r, q, [&](uint32_t k) { return r.lane[k]; });
  // What the camera sees is shaded at shutter open; its rays look about in the whole shutter. Rays of hits
  // keep the time of the ray that hit.
  const bool atCamera = !t.timed && jitterRayTimes();
  for (uint32_t k = 0; k < r.count; ++k) q.time[k] = atCamera ? rayTime(r.seed[k]) : t.times[r.lane[k]];
  for (uint32_t k = 0; k < r.count; ++k) q.radius[k] = r.radius[k] * scale;
  std::copy_n(r.spread, r.count, q.spread);
  std::copy_n(r.seed, r.count, q.seed);
  std::fill_n(q.importance, r.count, 0x3f800000u);  // 1.0f
}

void ShadeTask::readAnswers(const RayQuery& q) {
  Impl& t = *impl_;
  PendingRays& r = t.running().rays();
  // What cannot be right is a miss, ray by ray.
  r.missAll();
  const Mat4& m = t.system.cacheToCurrent;
  const Mat3 linear(m);
  const float scale = std::cbrt(std::fabs(glm::determinant(linear)));
  const auto vec = [](const float(&a)[3][kRayRow], uint32_t k) { return Vec3(a[0][k], a[1][k], a[2][k]); };
  const bool distanceAlone =
      r.kind == RayKind::kHitTest && r.terms.flags & (RayTerms::kOnlyDistance | RayTerms::kOnlyWhether);
  if (r.terms.extras[0] != 0 && r.kind != RayKind::kVisibility)
    for (uint32_t c = 0; c < kMaxExtraAnswers; ++c)
      for (uint32_t k = 0; k < r.count; ++k)
        if (std::isfinite(q.extra[c][k])) r.extra[c][k] = q.extra[c][k];
  for (uint32_t k = 0; k < r.count; ++k) {
    const Vec3 color = vec(q.color, k);
    const bool colored =
        r.kind == RayKind::kTrace || r.kind == RayKind::kVisibility || r.kind == RayKind::kFullTrace;
    const bool distanced = r.kind != RayKind::kVisibility;
    if (colored && !isFinite(color)) continue;
    if (distanced && !(q.hitDistance[k] >= 0.0f)) continue;
    const bool hit = distanced && q.hitDistance[k] < 0.99e30f;
    if (colored)
      for (int c = 0; c < 3; ++c) r.color[c][k] = color[c];
    if (r.kind == RayKind::kFullTrace && std::isfinite(q.missDepth[k]) && isFinite(vec(q.missP, k)) &&
        isFinite(vec(q.missR, k))) {
      r.missDepth[k] = std::max(0.0f, q.missDepth[k]);
      const Vec3 P = transformPoint(m, vec(q.missP, k)), R = linear * vec(q.missR, k);
      for (int c = 0; c < 3; ++c) r.missP[c][k] = P[c], r.missR[c][k] = R[c];
    }
    if (!hit) continue;
    if (r.kind == RayKind::kTrace || distanceAlone) {
      r.hitDistance[k] = q.hitDistance[k] * scale;
      continue;
    }
    const Vec3 P = transformPoint(m, vec(q.hitP, k)), N = t.system.cacheToCurrentNormal * vec(q.hitN, k);
    if (!isFinite(P) || !isFinite(N)) continue;
    r.hitDistance[k] = q.hitDistance[k] * scale;
    for (int c = 0; c < 3; ++c) r.hitP[c][k] = P[c], r.hitN[c][k] = N[c];
  }
}

void ShadeTask::missAll() { impl_->running().rays().missAll(); }

const float* ShadeTask::color(int component) const {
  return impl_->results.data() + size_t(component) * impl_->columns.batch().lanes;
}
const float* ShadeTask::opacity(int component) const {
  return impl_->results.data() + size_t(3 + component) * impl_->columns.batch().lanes;
}

const float* ShadeTask::output(std::string_view name, int component) const {
  const Impl& t = *impl_;
  if (name.find(':') != std::string_view::npos) return t.hitValue(name, uint32_t(component));
  if (name == "Ci") return component < 3 ? color(component) : nullptr;
  if (name == "Oi") return component < 3 ? opacity(component) : nullptr;
  Operand o = t.surface.result(name);
  uint32_t components = 0;
  const ShaderProgram& p = t.setup->surface->program();
  const uint32_t parameter = p.findParameter(name);
  if (parameter != kNoIndex) components = p.symbols[p.parameters[parameter].symbol].floats();
  for (size_t g = 0; g < size_t(GlobalId::kCount); ++g)
    if (name == globalInfo(GlobalId(g)).name) {
      components = slTypeFloats(globalInfo(GlobalId(g)).type);
      if (!o.data) o = t.columns.batch().globals[g];
    }
  if (!o.data || component < 0 || uint32_t(component) >= components) return nullptr;
  return t.broadcastColumn(o, uint32_t(component));
}

const float* ShadeTask::Impl::broadcastColumn(const Operand& o, uint32_t component) const {
  if (o.varying()) return o.comp(component);
  const uint32_t lanes = columns.batch().lanes;
  broadcast.reserve(size_t(lanes) * 16);
  float* const to = broadcast.data() + size_t(lanes) * size_t(component % 16);
  std::fill_n(to, lanes, o.at(0, component));
  return to;
}

const float* ShadeTask::Impl::broadcastValue(const ShaderValue& v, uint32_t component) const {
  if (component >= v.floats.size()) return nullptr;
  alignas(64) float value[kLanePad];
  std::fill_n(value, kLanePad, v.floats[component]);
  const uint32_t lanes = columns.batch().lanes;
  broadcast.reserve(size_t(lanes) * 16);
  float* const to = broadcast.data() + size_t(lanes) * size_t(component % 16);
  std::fill_n(to, lanes, value[0]);
  return to;
}

/// Values by the names that gather() has for them.
const float* ShadeTask::Impl::hitValue(std::string_view name, uint32_t component) const {
  const size_t colon = name.find(':');
  const std::string_view source = name.substr(0, colon), what = name.substr(colon + 1);
  const auto parameter = [&](const ShaderInstance* i) -> const float* {
    const ShaderValue* v = i ? i->parameter(what) : nullptr;
    return v ? broadcastValue(*v, component) : nullptr;
  };
  if (source == "surface") {
    if (surfaceRan) {
      const Operand o = surface.result(what);
      if (o.data) return broadcastColumn(o, component);
    }
    return parameter(setup->surface.get());
  }
  if (source == "displacement") return parameter(setup->displacement.get());
  if (source == "volume") {
    if (const float* v = parameter(setup->interior.get())) return v;
    return parameter(setup->atmosphere.get());
  }
  if (source == "attribute") {
    ShaderValue v;
    return system.host.attribute(what, setup->attributes, v) ? broadcastValue(v, component) : nullptr;
  }
  if (source != "primitive") return nullptr;
  for (size_t g = 0; g < size_t(GlobalId::kCount); ++g)
    if (what == globalInfo(GlobalId(g)).name && columns.batch().globals[g].data &&
        component < slTypeFloats(globalInfo(GlobalId(g)).type))
      return broadcastColumn(columns.batch().globals[g], component);
  return columns.primvar(what, component);
}

}  // namespace fr
