#include "tracer/ray_scene.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "tracer/clusters.h"
#include "tracer/hit_filter.h"
#include "tracer/ray_scene_embree.h"

namespace fr::tracer {

RayScene::RayScene() : embree_(std::make_unique<Embree>()) {}
RayScene::~RayScene() = default;

bool RayScene::isBefore(uint32_t entryA, uint32_t a, uint32_t entryB, uint32_t b) const {
  if (entryA == entryB) return a < b;
  const SurfaceEntry &ea = entries_[entryA], &eb = entries_[entryB];
  if (ea.object != eb.object) return ea.object < eb.object;
  const auto rootOf = [&](const SurfaceEntry& e) {
    return e.node < cache_->nodeCount() ? cache_->node(e.node).root : cache::kNone;
  };
  const auto key = [&](const SurfaceEntry& e, uint32_t cell) {
    return std::tuple(rootOf(e), e.v0, e.u0, cell);
  };
  return key(ea, a) < key(eb, b);
}

uint32_t RayScene::entryOf(cache::NodeId node) const {
  if (node < entryOfNode_.size() && entryOfNode_[node] != cache::kNone) return entryOfNode_[node];
  return clusters_ ? clusters_->entryOf(node) : cache::kNone;
}

namespace {

RTCRay embreeRay(const Ray& ray) {
  RTCRay r;
  r.org_x = ray.origin.x, r.org_y = ray.origin.y, r.org_z = ray.origin.z;
  r.dir_x = ray.direction.x, r.dir_y = ray.direction.y, r.dir_z = ray.direction.z;
  // Embree's near distance is exclusive; the filter decides about distances equal to that of a passed hit.
  r.tnear = ray.nearDistance;
  if (ray.passedEntry != cache::kNone)
    r.tnear = std::max(r.tnear, std::nextafter(ray.passedDistance, -kInfinity));
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
  rtcIntersect1(embree_->main.scene, &filter.rtc, &rh);
  return filter.best;
}

Obstacle RayScene::obstacle(const Ray& ray) const {
  HitFilter filter(this, &ray, true);
  RTCRay r = embreeRay(ray);
  r.mask = kOpaqueShadowRay | kFilteredShadowRay;
  rtcOccluded1(embree_->main.scene, &filter.rtc, &r);
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
}

uint64_t RayScene::giveBack(uint64_t bytes) const { return clusters_ ? clusters_->giveBack(bytes) : 0; }

RaySceneStatistics RayScene::statistics() const {
  RaySceneStatistics s = statistics_;
  s.embreeBytes = uint64_t(std::max<int64_t>(0, embree_->bytes.load()));
  s.peakBytes = uint64_t(std::max<int64_t>(0, embree_->peak.load()));
  s.recordBytes = entries_.size() * sizeof(SurfaceEntry) + entryOfNode_.size() * sizeof(uint32_t);
  s.recordBytes += embree_->main.recordBytes();
  for (const TracedPart& part : embree_->solids) s.recordBytes += part.recordBytes();
  for (const TracedPart& part : embree_->prototypes) s.recordBytes += part.recordBytes();
  s.recordBytes += instances_.size() * sizeof(Instance);
  if (clusters_) clusters_->count(s);
  return s;
}

}  // namespace fr::tracer
