#include "tracer/ray_scene.h"

#include <algorithm>
#include <cmath>

#include "scene_cache/trim.h"
#include "tracer/ray_scene_embree.h"

namespace fr::tracer {
namespace {

/// Positions are floats that went through a few transformations: what is nearer than this fraction of the
/// largest coordinate may be the same point.
constexpr float kRounding = 0x1p-18f;

/// The plane of a chord facet whose sagitta is d lies at most this many d from a point of the surface within
/// two and a half cells: on a circle of radius R with cells of length c, d = c^2 / 8R and the height at x is
/// x^2 / 2R - d, so 24 d at x = 2.5 c.
constexpr float kDepartureSagittas = 32;
/// How far a grazing ray's start can be over a chord that it runs into from outside.
constexpr float kSaddleSagittas = 4;
/// The same for the end point of a ray, whose patch is not known: 8 d at x = 1.5 c.
constexpr float kArrivalSagittas = 8;
/// No facet that is farther than this many cells from a point can be the one that the point lies on.
constexpr float kReachCells = 2;

float largestCoordinate(const Vec3& p) { return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}); }

}  // namespace

RayScene::RayScene() : embree_(std::make_unique<Embree>()) {}
RayScene::~RayScene() = default;

/// Sees every candidate that Embree finds before it counts as a hit. The context is the first member, so
/// Embree's pointer to it is a pointer to this.
struct HitFilter {
  RTCIntersectContext rtc;
  const RayScene* scene;
  const Ray* ray;
  bool onlyOpaque;
  bool sawFiltered = false;
  Hit best;

  HitFilter(const RayScene* s, const Ray* r, bool opaque = false) : scene(s), ray(r), onlyOpaque(opaque) {
    rtcInitIntersectContext(&rtc);
    rtc.filter = &HitFilter::call;
  }

  static void call(const RTCFilterFunctionNArguments* a) {
    // Only single-ray queries are made, so N is 1 and the structures have the layout of RTCRay and RTCHit.
    auto* self = reinterpret_cast<HitFilter*>(a->context);
    const auto* r = reinterpret_cast<const RTCRay*>(a->ray);
    const auto* h = reinterpret_cast<const RTCHit*>(a->hit);
    if (a->valid[0] && !self->accept(r->tfar, *h)) a->valid[0] = 0;
  }

  bool accept(float t, const RTCHit& h) {
    uint32_t entryIndex = scene->entryOfPrimitive_[h.geomID][h.primID];
    float gridU = h.u, gridV = h.v;
    if (entryIndex & RayScene::kStitch) {
      const StitchTriangle& s = scene->stitches_[entryIndex & ~RayScene::kStitch];
      entryIndex = s.grid;
      const SurfaceEntry& e = scene->entries_[entryIndex];
      const float w = 1 - h.u - h.v;
      gridU = (w * s.i[0] + h.u * s.i[1] + h.v * s.i[2]) / float(e.cellsU << e.level);
      gridV = (w * s.j[0] + h.u * s.j[1] + h.v * s.j[2]) / float(e.cellsV << e.level);
    } else if (const SurfaceEntry& e = scene->entries_[entryIndex]; e.stitched) {
      gridU = (e.inner[0] + h.u * float(e.inner[1] - e.inner[0])) / float(e.cellsU);
      gridV = (e.inner[2] + h.v * float(e.inner[3] - e.inner[2])) / float(e.cellsV);
    }
    const SurfaceEntry& e = scene->entries_[entryIndex];
    const Vec3 raw(h.Ng_x, h.Ng_y, h.Ng_z);
    const float length = glm::length(raw);
    if (!(length > 0)) return false;
    const Vec3 normal = raw * (e.orientation / length);
    const float cosine = glm::dot(ray->direction, normal);
    if (e.oneSided && cosine > 0) return false;
    if (cosine * float(ray->side) > 0) return false;
    if (ray->seen && !ray->seen[e.attributes]) return false;

    if (e.trimmed && scene->cache_->trimOf(e.node).removed(e.u0 + e.uScale * gridU, e.v0 + e.vScale * gridV))
      return false;

    const float rounding = kRounding * std::max(largestCoordinate(ray->origin),
                                                largestCoordinate(ray->origin + t * ray->direction));
    if (isDepartingSurface(e, t, cosine, rounding) || isArrivalSurface(e, t, cosine, rounding)) return false;

    uint32_t cell;
    float hitU = gridU, hitV = gridV;
    if (e.meshlet) {
      cell = h.primID - e.firstTriangle;
    } else if (e.strip) {
      // The triangle of the meshlet, and where in it.
      const float x = gridU * float(e.cellsU), y = gridV * float(e.cellsV);
      const int cu = std::clamp(int(x), 0, e.cellsU - 1), cv = std::clamp(int(y), 0, e.cellsV - 1);
      hitU = std::clamp(x - float(cu), 0.0f, 1.0f), hitV = std::clamp(y - float(cv), 0.0f, 1.0f);
      const bool second = hitU + hitV > 1;
      if (second) hitU = 1 - hitU, hitV = 1 - hitV;
      cell = e.firstTriangle + 2 * (uint32_t(cv) * e.cellsU + uint32_t(cu)) + second;
    } else {
      const int cu = std::clamp(int(gridU * float(e.cellsU)), 0, e.cellsU - 1);
      const int cv = std::clamp(int(gridV * float(e.cellsV)), 0, e.cellsV - 1);
      cell = uint32_t(cv) * e.cellsU + uint32_t(cu);
    }
    if (ray->passedEntry != cache::kNone && wasPassed(e, entryIndex, cell, t, cosine, rounding)) return false;
    if (onlyOpaque) {
      // Embree goes on behind a rejected candidate: the first opaque one ends the question.
      sawFiltered |= !e.opaqueCaster;
      return e.opaqueCaster;
    }

    // Entries are in the order of (object, patch): the lowest wins among equals.
    if (t == best.distance && std::pair(entryIndex, cell) >= std::pair(best.entry, best.cell)) return false;
    best.distance = t;
    best.entry = entryIndex;
    best.cell = cell;
    const bool asIs = e.meshlet || e.strip;
    best.u = asIs ? hitU : e.u0 + e.uScale * gridU;
    best.v = asIs ? hitV : e.v0 + e.vScale * gridV;
    best.normal = normal;
    return true;
  }

  /// The start point lies on the smooth surface, the facets are chords of it: a ray that starts under its own
  /// facet leaves through it in the sense in which it left the surface, nearby. Anything that it meets from
  /// the other side, or farther away, or whose plane is farther off than the surface bends, is something
  /// else.
  bool isDepartingSurface(const SurfaceEntry& e, float t, float cosine, float rounding) const {
    const Departure& d = ray->departure;
    if (d.surfaceGroup != e.surfaceGroup || d.surfaceGroup == cache::kNone) return false;
    const float height = t * std::abs(cosine);
    if (height <= 0.25f * rounding) return true;  // along its plane: the sense is rounding too
    if (t > kReachCells * std::max(d.cellSize, e.cellSize) + rounding) return false;
    const float deviation = std::max(d.deviation, e.deviation);
    const float rise = t * std::abs(d.cosine);  // over the tangent plane of the start
    if (cosine * d.cosine >= 0)
      return rise <= rounding || height <= kDepartureSagittas * deviation + rounding;
    return rise <= deviation && height <= kSaddleSagittas * deviation;
  }

  /// The end point may lie on a surface (a light on a wall): its facets do not hide it.
  bool isArrivalSurface(const SurfaceEntry& e, float t, float cosine, float rounding) const {
    if (!ray->endsOnSurface) return false;
    const float rest = ray->farDistance - t;
    if (rest > kReachCells * e.cellSize + rounding) return false;
    return rest * std::abs(cosine) <= kArrivalSagittas * e.deviation + rounding;
  }

  /// A surface is passed once, also where the ray goes through an edge between two facets.
  bool wasPassed(const SurfaceEntry& e, uint32_t entryIndex, uint32_t cell, float t, float cosine,
                 float rounding) const {
    if (t < ray->passedDistance) return true;
    if (t == ray->passedDistance &&
        std::pair(entryIndex, cell) <= std::pair(ray->passedEntry, ray->passedCell))
      return true;
    const float step = t - ray->passedDistance;
    return e.surfaceGroup == scene->entries_[ray->passedEntry].surfaceGroup && cosine * ray->passedSide > 0 &&
           step <= kReachCells * e.cellSize + rounding && step * std::abs(cosine) <= 0.25f * rounding;
  }
};

namespace {

RTCRay embreeRay(const Ray& ray) {
  RTCRay r;
  r.org_x = ray.origin.x, r.org_y = ray.origin.y, r.org_z = ray.origin.z;
  r.dir_x = ray.direction.x, r.dir_y = ray.direction.y, r.dir_z = ray.direction.z;
  r.tnear = ray.nearDistance;
  r.tfar = ray.farDistance;
  r.time = ray.time;
  r.mask = ray.mask;
  r.id = 0;
  r.flags = 0;
  return r;
}

}  // namespace

Hit RayScene::closest(const Ray& ray) const {
  HitFilter filter(this, &ray);
  RTCRayHit rh;
  rh.ray = embreeRay(ray);
  rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(embree_->scene, &filter.rtc, &rh);
  return filter.best;
}

Obstacle RayScene::obstacle(const Ray& ray) const {
  HitFilter filter(this, &ray, true);
  RTCRay r = embreeRay(ray);
  r.mask = kOpaqueShadowRay | kFilteredShadowRay;
  rtcOccluded1(embree_->scene, &filter.rtc, &r);
  if (r.tfar < 0) return Obstacle::kOpaque;
  return filter.sawFiltered ? Obstacle::kFiltered : Obstacle::kNone;
}

Departure RayScene::departure(cache::NodeId node, const Vec3& direction, const Vec3& normal) const {
  Departure d;
  const float length = glm::length(normal);
  if (!(length > 0) || !std::isfinite(length)) return d;
  const uint32_t index = entryOf(node);
  if (index != cache::kNone) {
    const SurfaceEntry& e = entries_[index];
    if (const float bias = cache_->skeleton().attributes()[e.attributes].bias; bias >= 0) {
      d.nearDistance = bias;
      return d;
    }
    d.surfaceGroup = e.surfaceGroup;
    d.cellSize = e.cellSize;
    d.deviation = e.deviation;
  } else if (node < cache_->nodeCount()) {
    d.surfaceGroup = cache_->objectOf(node).surfaceGroup;
  } else {
    return d;
  }
  const float cosine = glm::dot(direction, normal) / length;
  d.cosine = std::abs(cosine) > kRounding ? cosine : 0.0f;
  // A start point inside a shaded facet lies up to shadedDeviation under the true surface: a ray along the
  // surface would run into the vertices around it, which lie on it.
  if (index != cache::kNone)
    d.lift = normal * ((d.cosine < 0 ? -1.0f : 1.0f) * entries_[index].shadedDeviation / length);
  return d;
}

void RayScene::stepBehind(Ray& ray, const Hit& hit) const {
  ray.passedEntry = hit.entry;
  ray.passedCell = hit.cell;
  ray.passedDistance = hit.distance;
  ray.passedSide = glm::dot(ray.direction, hit.normal);
  // Embree's near distance is exclusive; the filter decides about equal distances.
  ray.nearDistance = std::max(ray.nearDistance, std::nextafter(hit.distance, -kInfinity));
}

RaySceneStatistics RayScene::statistics() const {
  RaySceneStatistics s = statistics_;
  s.embreeBytes = uint64_t(std::max<int64_t>(0, embree_->bytes.load()));
  s.peakBytes = uint64_t(std::max<int64_t>(0, embree_->peak.load()));
  s.recordBytes = entries_.size() * sizeof(SurfaceEntry) + entryOfNode_.size() * sizeof(uint32_t);
  for (const auto& p : entryOfPrimitive_) s.recordBytes += p.size() * sizeof(uint32_t);
  for (const auto& b : embree_->descriptors) s.recordBytes += b.size() * sizeof(uint32_t);
  s.recordBytes += stitches_.size() * sizeof(StitchTriangle);
  return s;
}

}  // namespace fr::tracer
