#include "tracer/ray_scene.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <tuple>

#include "base/random.h"
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

/// Only rays along a surface can stay between it and its facets, whose slope to it is about four deviations
/// in a cell; cells may be much longer than wide.
constexpr float kGrazing = 0.25f;
constexpr float kGrazingSagittas = 16;
/// A facet is no farther than this from a point that lies on the surface or on the facets as shaded.
constexpr float kProbeSagittas = 3;

float grazingCosine(float deviation, float cellSize) {
  return std::max(kGrazing, kGrazingSagittas * deviation / cellSize);
}

/// A direction within rounding of this one (2^-20), as different from it for every ray as its last bits are.
Vec3 nudged(const Vec3& d) {
  const auto bits = [](float x) { return std::bit_cast<uint32_t>(x); };
  const uint64_t h = mix64(uint64_t(bits(d.x)) << 32 ^ uint64_t(bits(d.y)) << 16 ^ bits(d.z));
  const auto number = [](uint64_t x) { return float(int32_t(x & 0xffff) - 0x8000) * 0x1p-35f; };
  return glm::normalize(d + Vec3(number(h), number(h >> 16), number(h >> 32)));
}

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
  const Hit hit = intersect(ray);
  // A ray that has passed something would meet it again: beside its aim it is not at the same distance.
  if (hit.any() || ray.passedEntry != cache::kNone) return hit;
  // Of rays that are aimed exactly at a vertex, Embree lets one or two in a hundred through between the
  // facets around it. Hardly any comes through beside it as well.
  Ray beside = ray;
  beside.direction = nudged(ray.direction);
  return intersect(beside);
}

Hit RayScene::intersect(const Ray& ray) const {
  HitFilter filter(this, &ray);
  RTCRayHit rh;
  rh.ray = embreeRay(ray);
  rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(embree_->main.scene, &filter.rtc, &rh);
  filter.takeDip();
  return filter.best;
}

bool RayScene::anyHit(Ray& ray, void* who, void (*fill)(void* who, Ray& ray)) const {
  HitFilter filter(this, &ray);
  filter.fill = fill, filter.filler = who;
  RTCRay r = embreeRay(ray);
  rtcOccluded1(embree_->main.scene, &filter.rtc, &r);
  return r.tfar < 0 || filter.takeDip();
}

std::optional<LeavingRays> RayScene::leavingRays(cache::NodeId node) const {
  LeavingRays leaving;
  const uint32_t index = entryOf(node);
  leaving.onSurface = index != cache::kNone || node < cache_->nodeCount();
  if (index == cache::kNone) return leaving;
  const SurfaceEntry& e = entries_[index];
  if (cache_->skeleton().attributes()[e.attributes].bias >= 0) return std::nullopt;
  leaving.lift = e.shadedDeviation;
  if (e.deviation > 0) leaving.grazing = grazingCosine(e.deviation, e.cellSize);
  return leaving;
}

Obstacle RayScene::obstacle(const Ray& asked) const {
  // Most of these rays meet nothing, so a second one would cost too much: all go a little beside their aim.
  Ray ray = asked;
  ray.direction = nudged(asked.direction);
  HitFilter filter(this, &ray, true);
  RTCRay r = embreeRay(ray);
  r.mask = kOpaqueShadowRay | kFilteredShadowRay;
  rtcOccluded1(embree_->main.scene, &filter.rtc, &r);
  if (r.tfar < 0 || filter.takeDip()) return Obstacle::kOpaque;
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
  if (index != cache::kNone) d.lift = entries_[index].shadedDeviation;
  return d;
}

void RayScene::leave(Ray& ray, cache::NodeId node, const Vec3& normal) const {
  ray.departure = departure(node, ray.direction, normal);
  const Departure& d = ray.departure;
  ray.nearDistance = d.nearDistance;
  if (d.surfaceGroup == cache::kNone) return;
  const Vec3 start = ray.origin;
  // Rays that are as good as in the surface have a side too.
  const float side = glm::dot(ray.direction, normal) < 0 ? -1.0f : 1.0f;
  const Vec3 up = normal * (side / glm::length(normal));
  const float rounding = kRounding * largestCoordinate(start);
  // Where two surfaces meet, a point of one lies on the other, as far as rounding goes. Over its own surface,
  // and a little less behind itself, a ray misses the other one where the two make an edge, and meets it
  // where they make a corner.
  ray.origin += std::max(d.lift, 0.125f * rounding) * up - 0.0625f * rounding * ray.direction;
  // In a hollow the facets stand over the surface, and a ray along it that starts under them could end
  // between them and the surface, which it would have hit. It starts from the facet.
  if (!(d.deviation > 0) || std::abs(d.cosine) > grazingCosine(d.deviation, d.cellSize)) return;
  Ray probe = ray;
  probe.direction = up;
  probe.origin = start - rounding * up;
  probe.nearDistance = 0;
  // Where there are clusters, the ray's footprint may choose facets that are farther off.
  const float deviation =
      clusters_ ? std::max(d.deviation, Clusters::kHiddenDeviation * ray.radius) : d.deviation;
  probe.farDistance = kProbeSagittas * deviation + 2 * rounding;
  HitFilter filter(this, &probe);
  filter.probing = true;
  filter.sense = side;
  RTCRayHit rh;
  rh.ray = embreeRay(probe);
  rh.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(embree_->main.scene, &filter.rtc, &rh);
  // A start on the facet itself is not under it.
  if (filter.best.distance < kInfinity && filter.best.distance > 2 * rounding)
    ray.origin = probe.origin + (filter.best.distance + rounding) * up;
}

void RayScene::stepBehind(Ray& ray, const Hit& hit) const {
  ray.passedEntry = hit.entry;
  ray.passedCell = hit.cell;
  ray.passedDistance = hit.distance;
  ray.passedSide = glm::dot(ray.direction, hit.normal);
}

uint64_t RayScene::giveBack(uint64_t bytes) const { return clusters_ ? clusters_->giveBack(bytes) : 0; }
bool RayScene::treesComeAndGo() const { return clusters_ && clusters_->hasGivenBack(); }

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
