#include "tracer/ray_solids.h"

#include "tracer/hit_filter.h"

namespace fr::tracer {
namespace {

/// What one ray needs at a time; kept, so that nothing is allocated per ray.
struct Scratch {
  std::vector<Candidate> crossings;
  std::vector<cache::SolidCrossing> line;
  std::vector<uint32_t> inside;
};
Scratch& scratch() {
  static thread_local Scratch s;
  return s;
}

/// Gathers every crossing: Embree is told of each that it is no hit.
struct Gather {
  RTCIntersectContext rtc;
  const HitFilter* filter;
  const TracedPart* part;
  std::vector<Candidate>* crossings;

  static void call(const RTCFilterFunctionNArguments* a) {
    if (!a->valid[0]) return;
    a->valid[0] = 0;
    const auto* self = reinterpret_cast<const Gather*>(a->context);
    const auto* r = reinterpret_cast<const RTCRay*>(a->ray);
    const auto* h = reinterpret_cast<const RTCHit*>(a->hit);
    Candidate c;
    if (self->filter->describe(*self->part, r->tfar, *h, c) && self->filter->exists(c))
      self->crossings->push_back(c);
  }
};

/// Embree may report both facets at an edge that a ray goes through; the surface is crossed once.
bool isSameCrossing(const Candidate& a, const Candidate& b, uint32_t groupA, const SurfaceEntry& e) {
  const float step = b.distance - a.distance;
  return groupA == e.surfaceGroup && a.cosine * b.cosine > 0 &&
         step <= kReachCells * e.cellSize + b.rounding && step * std::abs(b.cosine) <= 0.25f * b.rounding;
}

}  // namespace

float SolidRays::firstTaken(HitFilter& filter, uint32_t tree, uint32_t mask, float near, float far) {
  filter.wake();
  if (filter.probing) return kInfinity;  // what is surface of a tree is found out by crossings
  const RayScene& scene = *filter.scene;
  const Ray& ray = *filter.ray;
  Scratch& s = scratch();
  s.crossings.clear(), s.line.clear();
  Gather gather;
  rtcInitIntersectContext(&gather.rtc);
  gather.rtc.filter = &Gather::call;
  gather.filter = &filter, gather.part = &scene.embree_->solids[tree];
  gather.crossings = &s.crossings;
  RTCRayHit rh;
  rh.ray.org_x = ray.origin.x, rh.ray.org_y = ray.origin.y, rh.ray.org_z = ray.origin.z;
  rh.ray.dir_x = ray.direction.x, rh.ray.dir_y = ray.direction.y, rh.ray.dir_z = ray.direction.z;
  // Where the ray starts and what it has passed does not matter: it is the same line.
  rh.ray.tnear = ray.nearDistance, rh.ray.tfar = kInfinity;
  rh.ray.time = ray.time, rh.ray.mask = ~0u, rh.ray.id = 0, rh.ray.flags = 0;
  rh.hit.geomID = rh.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(gather.part->scene, &gather.rtc, &rh);

  std::sort(s.crossings.begin(), s.crossings.end(), [&](const Candidate& a, const Candidate& b) {
    if (a.distance != b.distance) return a.distance < b.distance;
    return scene.isBefore(a.entry, a.cell, b.entry, b.cell);
  });
  for (uint32_t i = 0; i < s.crossings.size(); ++i) {
    const Candidate& c = s.crossings[i];
    const SurfaceEntry& e = scene.entries_[c.entry];
    const cache::SolidId leaf = cache::solidOf(scene.cache_->skeleton().objects()[e.object]);
    // The last crossing of the same leaf.
    size_t k = s.line.size();
    while (k > 0 && s.line[k - 1].leaf != leaf) --k;
    if (k > 0) {
      const Candidate& last = s.crossings[s.line[k - 1].item];
      if (isSameCrossing(last, c, scene.entries_[last.entry].surfaceGroup, e)) continue;
    }
    s.line.push_back({c.distance, leaf, uint64_t(c.entry) << 32 | c.cell, i});
  }
  float taken = kInfinity;
  cache::SolidState state(scene.solids_, s.inside);
  cache::forEachSurface(std::span(s.line), state, kRounding, kRounding * largestCoordinate(ray.origin),
                        [&](const cache::SolidCrossing& crossing) {
                          const Candidate& c = s.crossings[crossing.item];
                          if (c.distance > far) return false;
                          if (c.distance <= near || !(scene.entries_[c.entry].mask & mask) ||
                              !filter.isSeen(c) || !filter.take(c))
                            return true;
                          taken = c.distance;
                          return false;
                        });
  return taken;
}

void SolidRays::bounds(const RTCBoundsFunctionArguments* a) {
  const auto& scene = *static_cast<const RayScene*>(a->geometryUserPtr);
  Box3f box = scene.solids_.bound(a->primID);
  if (!scene.embree_->solids[a->primID].scene || box.empty()) {
    // Embree leaves out what is not finite.
    a->bounds_o->lower_x = a->bounds_o->lower_y = a->bounds_o->lower_z = kInfinity;
    a->bounds_o->upper_x = a->bounds_o->upper_y = a->bounds_o->upper_z = -kInfinity;
    return;
  }
  box.grow(8 * kRounding * std::max(largestCoordinate(box.min), largestCoordinate(box.max)));
  a->bounds_o->lower_x = box.min.x, a->bounds_o->lower_y = box.min.y, a->bounds_o->lower_z = box.min.z;
  a->bounds_o->upper_x = box.max.x, a->bounds_o->upper_y = box.max.y, a->bounds_o->upper_z = box.max.z;
}

// Only single-ray queries are made: N is 1, and the context is the first member of a HitFilter.

void SolidRays::intersect(const RTCIntersectFunctionNArguments* a) {
  if (!a->valid[0]) return;
  auto& filter = *reinterpret_cast<HitFilter*>(a->context);
  auto& rh = *reinterpret_cast<RTCRayHit*>(a->rayhit);
  if (!(filter.scene->solidTrees_[a->primID].mask & rh.ray.mask)) return;
  const float t = firstTaken(filter, a->primID, rh.ray.mask, rh.ray.tnear, rh.ray.tfar);
  if (!(t < kInfinity)) return;
  rh.ray.tfar = t;
  rh.hit.geomID = a->geomID, rh.hit.primID = a->primID;
}

void SolidRays::occluded(const RTCOccludedFunctionNArguments* a) {
  if (!a->valid[0]) return;
  auto& filter = *reinterpret_cast<HitFilter*>(a->context);
  auto& ray = *reinterpret_cast<RTCRay*>(a->ray);
  if (!(filter.scene->solidTrees_[a->primID].mask & ray.mask)) return;
  if (firstTaken(filter, a->primID, ray.mask, ray.tnear, ray.tfar) < kInfinity) ray.tfar = -kInfinity;
}

void SolidRays::attach(RayScene& scene) {
  RTCGeometry g = rtcNewGeometry(scene.embree_->device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(g, unsigned(scene.solids_.treeCount()));
  rtcSetGeometryUserData(g, &scene);
  rtcSetGeometryBoundsFunction(g, &SolidRays::bounds, nullptr);
  rtcSetGeometryIntersectFunction(g, &SolidRays::intersect);
  rtcSetGeometryOccludedFunction(g, &SolidRays::occluded);
  uint32_t mask = 0;
  for (const RayScene::SolidTree& tree : scene.solidTrees_) mask |= tree.mask;
  rtcSetGeometryMask(g, mask);
  rtcCommitGeometry(g);
  rtcAttachGeometry(scene.embree_->main.scene, g);
  rtcReleaseGeometry(g);
  scene.embree_->main.entryOfPrimitive.emplace_back();  // its number in the scene is taken
}

}  // namespace fr::tracer
