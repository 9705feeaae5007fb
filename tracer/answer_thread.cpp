// The four questions: trace and fulltrace return radiance, visibility what comes through between two points,
// rayhittest the nearest surface without shading (BMRT 2.6 manual, chapter "Ray tracing with rendrib").
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <span>

#include "base/random.h"
#include "tracer/answer_level.h"
#include "tracer/ray_order.h"

namespace fr::tracer {

using namespace cache;

namespace {

/// visibility(): less than this is darkness.
constexpr float kDark = 1.0f / 1024;
/// trace(): surfaces behind this little are not shaded.
constexpr float kCovered = 1.0f / 4096;
/// No ray passes more surfaces than this.
constexpr uint32_t kMaxSteps = 4096;
/// First index of a shadow ray's seeds, so that they differ from those of radiance rays through the same
/// surfaces.
constexpr uint64_t kShadowSeed = 1ull << 32;

float largest(const Color& c) { return std::max({c.x, c.y, c.z}); }

/// Shaders may return anything.
Color sane(const Color& c) {
  return {std::isfinite(c.x) ? c.x : 0, std::isfinite(c.y) ? c.y : 0, std::isfinite(c.z) ? c.z : 0};
}
Color saneOpacity(const Color& c) {
  const auto f = [](float x) { return std::isnan(x) ? 1.0f : std::clamp(x, 0.0f, 1.0f); };
  return {f(c.x), f(c.y), f(c.z)};
}

/// The same of the volumes through which rays leave the scene.
constexpr uint64_t kVolumeSeed = 2ull << 32;

uint32_t rayMask(RayKind kind, const RayTerms& terms) {
  if (kind == RayKind::kVisibility) return kOpaqueShadowRay | kFilteredShadowRay;
  return terms.rayClass == RayClass::kDiffuse ? kDiffuseRay : kReflectionRay;
}
/// Rays that are answered together. What is not shaded stays in the nearest cache; shading wants many points.
uint32_t partOf(RayKind kind) {
  return kind == RayKind::kHitTest || kind == RayKind::kVisibility ? 256u : kMaxRays;
}
float missDistance(RayKind kind) { return kind == RayKind::kHitTest ? kNoHit : kNoHitFullTrace; }

}  // namespace

AnswerThread::AnswerThread(RayTracer& tracer, CounterRow* row) : tracer_(tracer), row_(row) {}

AnswerThread::~AnswerThread() {
  std::lock_guard lock(tracer_.mutex_);
  tracer_.counted_ += counts_;
}

AnswerThread::Level& AnswerThread::level(size_t depth) {
  while (levels_.size() <= depth) levels_.push_back(std::unique_ptr<Level>(new Level));
  return *levels_[depth];
}

void AnswerThread::answer(RayQuery& query) {
  const auto start = std::chrono::steady_clock::now();
  (void)tracer_.prepare();  // an error was reported; everything is a miss then
  answerAt(query, 0);
  counts_.answerSeconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  counts_.batches += 1;
  countInRow();
  publishCounts();
}

void AnswerThread::countInRow() {
  if (!row_) return;
  const auto add = [this](Counter c, uint64_t n) {
    if (n > 0) row_->add(c, n);
  };
  for (uint32_t k = 0; k < 4; ++k) {
    add(Counter(uint32_t(Counter::kTrace) + k), counts_.rays[k]);
    add(Counter(uint32_t(Counter::kNestedTrace) + k), counts_.nestedRays[k]);
  }
  add(Counter::kIntersections, counts_.intersections);
  add(Counter::kRejected, counts_.rejected);
  add(Counter::kHitsShaded, counts_.hitsShaded);
  add(Counter::kPointsShaded, counts_.pointsShaded);
  add(Counter::kBusyNanoseconds, uint64_t(counts_.answerSeconds * 1e9));
}

void AnswerThread::publishCounts() {
  std::lock_guard lock(tracer_.mutex_);
  tracer_.counted_ += counts_;
  counts_ = {};
}

void AnswerThread::answerAt(RayQuery& query, size_t depth) {
  Level& at = level(depth);
  const volatile RayQuery& q = query;  // read once: the client may be writing
  const RayKind kind = q.kind;
  const uint32_t count = q.count, rayLevel = q.level;
  const uint32_t all = std::min(count, kMaxRays);
  at.rayLevel = std::clamp(rayLevel, 1u, 1u << 20);
  readTerms(query.terms, at);
  if (uint32_t(kind) > uint32_t(RayKind::kFullTrace)) return;  // no question of ours: nothing to write
  (depth == 0 ? counts_.rays : counts_.nestedRays)[uint32_t(kind)] += all;
  // Shaders' own trace() wants to know what missed.
  const bool full = kind == RayKind::kFullTrace || (kind == RayKind::kTrace && depth > 0);
  if (kind == RayKind::kHitTest && at.extras.empty()) return answerHitTests(query, all, at);
  const uint32_t part = partOf(kind);
  for (uint32_t first = 0; first < all; first += part) {
    at.count = std::min(part, all - first);
    readRays(query, first, at, rayMask(kind, at.terms));
    runAt(kind, at, depth);
    writeAnswers(kind, at, full, query, first);
    if (!at.extras.empty() && kind != RayKind::kVisibility) writeExtras(at, query, first);
  }
}

bool AnswerThread::answerOne(const SingleRayMail& mail, SingleAnswer& answer) {
  answer = {};
  if (mail.ray.kind > uint32_t(RayKind::kFullTrace)) return false;
  const RayKind kind = RayKind(mail.ray.kind);
  if (counts_.batches > 0) publishCounts();  // the caller has not
  (void)tracer_.prepare();
  Level& at = level(0);
  at.count = 1;
  at.rayLevel = std::max<uint32_t>(mail.ray.level, 1);
  readTerms(RayTerms{}, at);
  const auto vec = [](const float(&f)[3]) { return Vec3(f[0], f[1], f[2]); };
  const AskedRay asked{vec(mail.ray.origin), vec(mail.ray.direction), vec(mail.start.normal), mail.ray.time,
                       mail.ray.radius,      mail.ray.spread,         mail.start.node,        mail.ray.seed};
  startPath(at.path[0], asked, rayMask(kind, at.terms), at);
  runAt(kind, at, 0);
  const PathRay& p = at.path[0];
  const auto put = [](float(&f)[3], const Vec3& v) { f[0] = v.x, f[1] = v.y, f[2] = v.z; };
  const bool full = kind == RayKind::kFullTrace;
  if (kind == RayKind::kVisibility) {
    put(answer.color, p.through);
  } else {
    answer.hitDistance = p.firstHit.any() ? p.firstHit.distance : missDistance(kind);
    answer.hitNode = hitNode(p.firstHit);
    if (kind != RayKind::kHitTest) put(answer.color, p.color);
    if (full || kind == RayKind::kHitTest) {
      Vec3 P(0), N(0);
      if (p.firstHit.any()) hitPoint(p.ray, p.firstHit, P, N);
      put(answer.hitP, P), put(answer.hitN, N);
    }
    if (full) {
      answer.missDepth = float(p.missDepth);
      put(answer.missP, p.missP), put(answer.missR, p.missR);
    }
  }
  counts_.rays[uint32_t(kind)] += 1;
  counts_.batches += 1;
  countInRow();
  return true;
}

/// Rays that are asked for nothing but what they hit have no path to keep, and are done one by one.
void AnswerThread::answerHitTests(RayQuery& query, uint32_t count, const Level& at) {
  const RayScene* scene = tracer_.scene();
  const uint32_t mask = rayMask(RayKind::kHitTest, at.terms), flags = at.terms.flags;
  const bool node = flags & RayTerms::kWantsNode, whether = flags & RayTerms::kOnlyWhether && !node;
  const bool point = !(flags & (RayTerms::kOnlyDistance | RayTerms::kOnlyWhether));
  if (whether) return answerWhether(query, count, mask, at);
  uint32_t order[kMaxRays];
  const volatile RayQuery& q = query;
  orderRays(scene, count, order, [&q](uint32_t i) {
    return std::pair(Vec3(q.origin[0][i], q.origin[1][i], q.origin[2][i]),
                     Vec3(q.direction[0][i], q.direction[1][i], q.direction[2][i]));
  });
  for (const uint32_t k : std::span(order, count)) {
    Ray ray;
    const bool sane = startRay(ray, askedRay(query, k), mask, at);
    counts_.intersections += sane;
    const Hit hit = sane ? scene->closest(ray) : Hit{};
    query.hitDistance[k] = hit.any() ? hit.distance : kNoHit;
    if (node) query.hitNode[k] = hitNode(hit);
    if (!point) continue;
    Vec3 P(0), N(0);
    if (hit.any()) hitPoint(ray, hit, P, N);
    for (int c = 0; c < 3; ++c) query.hitP[c][k] = P[c], query.hitN[c][k] = N[c];
  }
}

void AnswerThread::runAt(RayKind kind, Level& at, size_t depth) {
  if (kind == RayKind::kVisibility) return runVisibility(at, depth);
  if (kind != RayKind::kHitTest) return runTrace(at, depth);
  const RayScene* scene = tracer_.scene();
  for (uint32_t i = 0; i < at.count; ++i) {
    PathRay& p = at.path[i];
    if (p.going) p.firstHit = scene->closest(p.ray), counts_.intersections += 1;
  }
  if (at.extras.empty()) return;
  // Values of what was hit: no shader runs for them.
  at.orderCount = 0;
  for (uint32_t i = 0; i < at.count; ++i) {
    PathRay& p = at.path[i];
    if (!p.firstHit.any()) continue;
    p.hit = p.firstHit, p.steps = 1;
    at.order[at.orderCount++] = i;
  }
  if (at.orderCount) shadeHits(at, depth, Purpose::kValues);
}

void AnswerThread::writeExtras(const Level& at, RayQuery& query, uint32_t first) {
  for (const Level::Extra& e : at.extras)
    for (uint32_t c = 0; c < e.components; ++c)
      for (uint32_t i = 0; i < at.count; ++i) {
        const PathRay& p = at.path[i];
        const Color& through = p.through;
        const int k = int(std::min(c, 2u));
        const float t = e.components == 1 ? (through.x + through.y + through.z) * (1.0f / 3) : through[k];
        query.extra[e.column + c][first + i] = e.name == "surface:Oi"         ? 1 - t
                                               : e.name == "ray:transmission" ? t
                                               : p.firstHit.any()             ? at.extra[e.column + c][i]
                                                                              : 0.0f;
      }
}

void AnswerThread::writeAnswers(RayKind kind, const Level& at, bool full, RayQuery& query, uint32_t first) {
  const bool distance = kind != RayKind::kVisibility, hit = full || kind == RayKind::kHitTest;
  const bool node = distance && at.terms.flags & RayTerms::kWantsNode;
  for (uint32_t i = 0; i < at.count; ++i) {
    const PathRay& p = at.path[i];
    const uint32_t k = first + i;
    if (kind != RayKind::kHitTest) {
      const Color& color = distance ? p.color : p.through;
      for (int c = 0; c < 3; ++c) query.color[c][k] = color[c];
    }
    if (distance) query.hitDistance[k] = p.firstHit.any() ? p.firstHit.distance : missDistance(kind);
    if (node) query.hitNode[k] = hitNode(p.firstHit);
    if (!hit) continue;
    Vec3 P(0), N(0);
    if (p.firstHit.any()) hitPoint(p.ray, p.firstHit, P, N);
    for (int c = 0; c < 3; ++c) query.hitP[c][k] = P[c], query.hitN[c][k] = N[c];
    if (!full) continue;
    query.missDepth[k] = float(p.missDepth);
    for (int c = 0; c < 3; ++c) query.missP[c][k] = p.missP[c], query.missR[c][k] = p.missR[c];
  }
}

NodeId AnswerThread::hitNode(const Hit& hit) const {
  return hit.any() ? tracer_.scene()->entry(hit.entry).node : kNone;
}

void AnswerThread::hitPoint(const Ray& ray, const Hit& hit, Vec3& P, Vec3& N) {
  const SurfaceEntry& e = tracer_.scene()->entry(hit.entry);
  SurfaceOut out;
  for (int c = 0; c < 3; ++c) out.P[c] = &P[c], out.N[c] = &N[c];
  tracer_.cache().evaluateDiced(e.node, 1, &hit.cell, &hit.u, &hit.v, out);
  // The cache evaluates at shutter open; what moves was hit somewhere else.
  if (e.moving) P = ray.origin + hit.distance * ray.direction;
}

Color AnswerThread::attributeOpacity(const Hit& hit) {
  const SurfaceEntry& e = tracer_.scene()->entry(hit.entry);
  const Skeleton& skeleton = tracer_.cache().skeleton();
  const ObjectRecord& o = skeleton.objects()[e.object];
  Color opacity = skeleton.attributes()[e.attributes].opacity;
  if (const ParamRecord* os = skeleton.find(o.primvars, "Os");
      os && os->type == ParamType::kColor && os->arrayLength == 1) {
    Color value(1);
    float* out[3] = {&value.x, &value.y, &value.z};
    if (tracer_.cache().evaluatePrimvar(e.node, *os, 1, &hit.cell, &hit.u, &hit.v, out)) opacity = value;
  }
  return saneOpacity(opacity);
}

/// In which order the rays of the paths are traced.
void AnswerThread::orderPaths(const Level& at, uint32_t* order) const {
  orderRays(tracer_.scene(), at.count, order,
            [&at](uint32_t i) { return std::pair(at.path[i].ray.origin, at.path[i].ray.direction); });
}

void AnswerThread::runVisibility(Level& at, size_t depth) {
  const RayScene* scene = tracer_.scene();
  // A shader that asks for visibility while it is asked for its own opacity would go on for ever.
  const bool mayShade =
      at.rayLevel <= uint32_t(tracer_.maxRayLevel()) + 1 && at.terms.hitMode != HitMode::kPrimitive;
  // Every surface that is not opaque whatever happens is asked.
  const bool allShade = mayShade && at.terms.hitMode == HitMode::kShader;
  const auto dim = [](PathRay& p, const Color& opacity) {
    p.through *= Color(1) - opacity;
    if (largest(p.through) < kDark) p.through = Color(0), p.going = false;
  };

  uint32_t order[kMaxRays];
  orderPaths(at, order);
  for (const uint32_t i : std::span(order, at.count)) {
    PathRay& p = at.path[i];
    if (!p.going) continue;
    counts_.intersections += 1;
    const Obstacle obstacle = scene->obstacle(p.ray);
    if (allShade && obstacle != Obstacle::kNone) {
      p.ray.mask = kFilteredShadowRay | kOpaqueShadowRay;
      continue;
    }
    if (obstacle == Obstacle::kOpaque) p.through = Color(0);
    p.going = obstacle == Obstacle::kFiltered;
    p.ray.mask = kFilteredShadowRay;
  }
  // The others go from surface to surface; those that stand on one whose shader must be asked wait for each
  // other.
  for (bool any = true; any;) {
    any = false;
    at.orderCount = 0;
    for (uint32_t i = 0; i < at.count; ++i) {
      PathRay& p = at.path[i];
      while (p.going) {
        p.hit = scene->closest(p.ray);
        counts_.intersections += 1;
        if (!p.hit.any() || ++p.steps > kMaxSteps) {
          p.going = false;
          break;
        }
        scene->stepBehind(p.ray, p.hit);
        const SurfaceEntry& e = scene->entry(p.hit.entry);
        const bool opaque = allShade && (e.castsShadows == CastsShadows::kOpaque ||
                                         (e.opaqueCaster && tracer_.shading().isOpaque(e.attributes)));
        if (mayShade && !opaque && (allShade || e.castsShadows == CastsShadows::kShade)) {
          at.order[at.orderCount++] = i;
          any = true;
          break;
        }
        dim(p, opaque ? Color(1) : attributeOpacity(p.hit));
      }
    }
    if (at.orderCount) shadeHits(at, depth, Purpose::kOpacity);
    for (uint32_t k = 0; k < at.orderCount; ++k) {
      PathRay& p = at.path[at.order[k]];
      dim(p, p.hitOpacity);
    }
  }
}

void AnswerThread::runTrace(Level& at, size_t depth) {
  const RayScene* scene = tracer_.scene();
  const bool tooDeep = at.rayLevel > uint32_t(tracer_.maxRayLevel());
  bool leaving = false;  // some ray leaves the scene through a volume
  uint32_t order[kMaxRays];
  for (bool any = !tooDeep; any;) {
    any = false;
    at.orderCount = 0;
    orderPaths(at, order);
    for (const uint32_t i : std::span(order, at.count))
      if (PathRay& p = at.path[i]; p.going) p.hit = scene->closest(p.ray);
    for (uint32_t i = 0; i < at.count; ++i) {
      PathRay& p = at.path[i];
      if (!p.going) continue;
      counts_.intersections += 1;
      if (!p.hit.any()) {
        p.going = false;
        if (p.missDepth == 0) p.missDepth = 1, p.missP = p.askedOrigin, p.missR = p.askedDirection;
        leaving |= volumeKey(p) != 0;
        continue;
      }
      if (p.steps++ == 0) p.firstHit = p.hit;
      at.order[at.orderCount++] = i;
      any = true;
    }
    if (at.orderCount) shadeHits(at, depth, Purpose::kRadiance);
    for (uint32_t k = 0; k < at.orderCount; ++k) {
      PathRay& p = at.path[at.order[k]];
      p.color += p.through * p.hitColor;
      p.through *= Color(1) - p.hitOpacity;
      const RayTerms& t = at.terms;
      const bool opaque = (t.flags & RayTerms::kHasOpaque) && 1 - p.through.x >= t.opaque[0] &&
                          1 - p.through.y >= t.opaque[1] && 1 - p.through.z >= t.opaque[2];
      if (opaque || largest(p.through) < kCovered || p.steps >= kMaxSteps) {
        p.going = false;
      } else {
        p.volumeOf = scene->entry(p.hit.entry).attributes;
        p.inside = glm::dot(p.ray.direction, p.hit.normal) < 0;
        p.segmentStart = p.hit.distance;
        scene->stepBehind(p.ray, p.hit);
      }
    }
  }
  if (leaving) shadeMisses(at, depth);
}

/// Which Interior or Exterior a ray's present segment lies in: 0 none, else 1 + twice the attribute state,
/// plus 1 inside.
uint32_t AnswerThread::volumeKey(const PathRay& p) const {
  const auto attributes = tracer_.cache().skeleton().attributes();
  if (p.volumeOf >= attributes.size()) return 0;
  const AttributeRecord& a = attributes[p.volumeOf];
  if ((p.inside ? a.interior : a.exterior) == kNone) return 0;
  return 1 + 2 * p.volumeOf + (p.inside ? 1 : 0);
}

namespace {
void setVolume(ShadePoints& points, uint32_t key) {
  if (key == 0) return;
  points.volumeAttributes = (key - 1) / 2;
  points.volume = (key - 1) & 1 ? ShadePoints::Volume::kInterior : ShadePoints::Volume::kExterior;
}
}  // namespace

void AnswerThread::shadeHits(Level& at, size_t depth, Purpose purpose) {
  const RayScene* scene = tracer_.scene();
  for (uint32_t k = 0; k < at.orderCount; ++k) {
    const uint32_t i = at.order[k];
    at.group[i] = tracer_.shading().shadeGroup(scene->entry(at.path[i].hit.entry).attributes);
    at.volume[i] = purpose == Purpose::kRadiance ? volumeKey(at.path[i]) : 0;
  }
  std::sort(at.order, at.order + at.orderCount, [&](uint32_t a, uint32_t b) {
    const auto key = [&](uint32_t i) {
      return std::tuple(at.group[i], at.volume[i], at.path[i].hit.entry, i);
    };
    return key(a) < key(b);
  });
  for (size_t first = 0; first < at.orderCount;) {
    size_t end = first + 1;
    const uint32_t i = at.order[first];
    while (end < at.orderCount && at.group[at.order[end]] == at.group[i] &&
           at.volume[at.order[end]] == at.volume[i])
      ++end;
    shadeGroup(at, depth, first, end, purpose);
    first = end;
  }
}

void AnswerThread::shadeGroup(Level& at, size_t depth, size_t first, size_t end, Purpose purpose) {
  const RayScene* scene = tracer_.scene();
  const size_t n = end - first;
  for (size_t k = 0; k < n; ++k) {
    const PathRay& p = at.path[at.order[first + k]];
    at.node[k] = scene->entry(p.hit.entry).node;
    at.cell[k] = p.hit.cell;
    at.u[k] = p.hit.u, at.v[k] = p.hit.v;
    at.distance[k] = p.hit.distance;
    at.seed[k] = hashStep(p.seed, p.steps + (purpose == Purpose::kOpacity ? kShadowSeed : 0));
  }
  ShadePoints points;
  points.topology = ShadePoints::Topology::kHits;
  points.node = at.node, points.cell = at.cell, points.u = at.u, points.v = at.v;
  points.shadowRay = purpose == Purpose::kOpacity;
  points.valuesOnly = purpose == Purpose::kValues;
  points.hitMode = at.terms.hitMode;
  setVolume(points, at.volume[at.order[first]]);
  shadePoints(at, depth, first, n, points, purpose);

  ShadeTask& task = *at.task;
  for (size_t k = 0; k < n; ++k) {
    PathRay& p = at.path[at.order[first + k]];
    const auto take = [&](auto get) { return Color(get(0)[k], get(1)[k], get(2)[k]); };
    p.hitOpacity = saneOpacity(take([&](int c) { return task.opacity(c); }));
    p.hitColor = purpose == Purpose::kOpacity ? Color(0) : sane(take([&](int c) { return task.color(c); }));
  }
  if (purpose != Purpose::kOpacity)
    for (const Level::Extra& e : at.extras)
      for (uint32_t c = 0; c < e.components; ++c) {
        const float* values = task.output(e.name, int(c));
        for (size_t k = 0; k < n; ++k) {
          const uint32_t i = at.order[first + k];
          if (at.path[i].steps == 1)
            at.extra[e.column + c][i] = values && std::isfinite(values[k]) ? values[k] : 0.0f;
        }
      }
  counts_.hitsShaded += n;
}

/// Volumes between the last surface and nothing: they end where the scene does.
void AnswerThread::shadeMisses(Level& at, size_t depth) {
  at.orderCount = 0;
  for (uint32_t i = 0; i < at.count; ++i) {
    const PathRay& p = at.path[i];
    if (!p.sane || p.going || p.hit.any() || largest(p.through) <= 0) continue;
    at.volume[i] = volumeKey(p);
    if (at.volume[i] != 0) at.order[at.orderCount++] = i;
  }
  std::sort(at.order, at.order + at.orderCount,
            [&](uint32_t a, uint32_t b) { return std::pair(at.volume[a], a) < std::pair(at.volume[b], b); });
  for (size_t first = 0; first < at.orderCount;) {
    size_t end = first + 1;
    const uint32_t key = at.volume[at.order[first]];
    while (end < at.orderCount && at.volume[at.order[end]] == key) ++end;
    const size_t n = end - first;
    for (size_t k = 0; k < n; ++k) {
      const PathRay& p = at.path[at.order[first + k]];
      at.distance[k] = p.ray.farDistance;
      at.seed[k] = hashStep(p.seed, p.steps + 1 + kVolumeSeed);
    }
    ShadePoints points;
    points.topology = ShadePoints::Topology::kVolume;
    setVolume(points, key);
    shadePoints(at, depth, first, n, points, Purpose::kRadiance);
    for (size_t k = 0; k < n; ++k) {
      PathRay& p = at.path[at.order[first + k]];
      const auto take = [&](auto get) { return Color(get(0)[k], get(1)[k], get(2)[k]); };
      p.color += p.through * sane(take([&](int c) { return at.task->color(c); }));
      p.through *= Color(1) - saneOpacity(take([&](int c) { return at.task->opacity(c); }));
    }
    first = end;
  }
}

/// Runs the shaders of paths [first, first + n) of the order, and answers what they ask.
void AnswerThread::shadePoints(Level& at, size_t depth, size_t first, size_t n, ShadePoints& points,
                               Purpose purpose) {
  for (size_t k = 0; k < n; ++k) {
    const PathRay& p = at.path[at.order[first + k]];
    for (int c = 0; c < 3; ++c) at.direction[c][k] = p.ray.direction[c], at.origin[c][k] = p.ray.origin[c];
    at.radius[k] = std::max(0.0f, p.radius + p.spread * at.distance[k]);
    at.spread[k] = p.spread;
    at.time[k] = p.ray.time;
    at.segmentStart[k] = p.segmentStart;
  }
  points.count = n;
  for (int c = 0; c < 3; ++c) points.direction[c] = at.direction[c], points.origin[c] = at.origin[c];
  points.distance = at.distance, points.radius = at.radius, points.spread = at.spread, points.time = at.time;
  points.segmentStart = at.segmentStart;
  points.seed = at.seed;
  points.level = at.rayLevel;
  points.rayClass = at.terms.rayClass;
  points.diffuseDepth = at.terms.diffuseDepth, points.shadowDepth = at.terms.shadowDepth;
  points.label = at.terms.label;

  if (!at.task) at.task = std::make_unique<ShadeTask>(tracer_.shading());
  ShadeTask& task = *at.task;
  task.begin(points);
  while (task.run() == ShadeTask::Status::kNeedsRays) {
    RayQuery& child = at.child;
    std::memset(child.point, 0x7f, sizeof child.point);  // nobody's, unless the task says whose
    child.terms = RayTerms{};
    task.writeRays(child);
    child.level = at.rayLevel + 1;
    answerAt(child, depth + 1);
    if (purpose == Purpose::kRadiance &&
        (child.kind == RayKind::kTrace || child.kind == RayKind::kFullTrace)) {
      for (uint32_t r = 0; r < std::min(child.count, kMaxRays); ++r) {
        if (child.missDepth[r] < 1) continue;
        const auto deepen = [&](size_t k) {
          PathRay& p = at.path[at.order[first + k]];
          const uint32_t missDepth = uint32_t(child.missDepth[r]) + 1;
          if (missDepth <= p.missDepth) return;
          p.missDepth = missDepth;
          p.missP = {child.missP[0][r], child.missP[1][r], child.missP[2][r]};
          p.missR = {child.missR[0][r], child.missR[1][r], child.missR[2][r]};
        };
        if (child.point[r] < n) {
          deepen(child.point[r]);
        } else if (child.point[r] == kNone) {
          for (size_t k = 0; k < n; ++k) deepen(k);
        }
      }
    }
    task.readAnswers(child);
  }
}

}  // namespace fr::tracer
