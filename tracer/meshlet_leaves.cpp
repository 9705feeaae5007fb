#include "tracer/meshlet_leaves.h"

#include <algorithm>
#include <cmath>

#include "base/isa.h"
#include "base/math.h"
#include "tracer/hit_filter.h"

namespace fr::tracer {

namespace {
/// Embree leaves out what goes beyond.
constexpr float kLargestCoordinate = 1.8e18f;
/// What a box costs beside its area, in areas of boxes of full leaves.
constexpr double kBoxShare = 0.5;
}  // namespace

MeetLeaf leafKernel() { return forIsa(sse4::meetLeaf, avx2::meetLeaf, avx512::meetLeaf); }

/// Of corners that Embree can bear, whatever the shared memory holds; else empty.
Box3f MeshletLeaves::boundOf(const LeafTriangles& t, uint32_t triangle) {
  Box3f box;
  for (uint32_t c = 0; c < 3; ++c) {
    const uint32_t index = t.indices[3 * triangle + c];
    const float* p = t.vertices + 3 * (index < t.vertexCount ? index : 0);
    const Vec3 corner(p[0], p[1], p[2]);
    if (!(largestCoordinate(corner) <= kLargestCoordinate) || corner != corner) return {};
    box.extend(corner);
  }
  return box;
}

/// Neighbours on a Morton curve may be far apart: the sequence is cut where the boxes have the smallest areas
/// in all, each with a share for being a box.
void MeshletLeaves::add(uint32_t entry, const std::byte* vertices, uint32_t vertexCount,
                        const std::byte* indices, uint32_t triangleCount) {
  meshlets_.push_back({vertices, indices, entry, vertexCount});
  LeafTriangles all;
  all.vertices = reinterpret_cast<const float*>(vertices), all.vertexCount = vertexCount;
  all.indices = reinterpret_cast<const uint8_t*>(indices), all.count = triangleCount;
  const auto area = [](const Box3f& b) {
    if (b.empty()) return 0.0;
    const DVec3 d(b.max - b.min);
    return d.x * d.y + d.y * d.z + d.z * d.x;
  };
  bounds_.clear();
  double share = 0, leaves = 0;
  Box3f full;
  for (uint32_t i = 0; i < triangleCount; ++i) {
    bounds_.push_back(boundOf(all, i));
    full.extend(bounds_.back());
    if ((i + 1) % kLeafTriangles != 0 && i + 1 < triangleCount) continue;
    share += area(full), leaves += 1;
    full = {};
  }
  share *= kBoxShare / leaves;
  // The best way to cut the first i, and how many its last leaf has.
  costs_.assign(triangleCount + 1u, kInfinity), lasts_.assign(triangleCount + 1u, 1);
  costs_[0] = 0;
  for (uint32_t i = 1; i <= triangleCount; ++i) {
    Box3f box;
    for (uint32_t n = 1; n <= std::min(i, kLeafTriangles); ++n) {
      box.extend(bounds_[i - n]);
      const double cost = costs_[i - n] + area(box) + share;
      if (cost < costs_[i]) costs_[i] = cost, lasts_[i] = uint16_t(n);
    }
  }
  const size_t firstLeaf = leaves_.size();
  for (uint32_t end = triangleCount; end > 0; end -= lasts_[end])
    leaves_.push_back({uint32_t(meshlets_.size() - 1), uint16_t(end - lasts_[end]), lasts_[end]});
  std::reverse(leaves_.begin() + std::ptrdiff_t(firstLeaf), leaves_.end());
}

RTCGeometry MeshletLeaves::geometry(RTCDevice device) {
  meshlets_.shrink_to_fit(), leaves_.shrink_to_fit();
  RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(g, unsigned(leaves_.size()));
  rtcSetGeometryTimeStepCount(g, keys_);
  rtcSetGeometryUserData(g, this);
  rtcSetGeometryBoundsFunction(g, &MeshletLeaves::bounds, nullptr);
  rtcSetGeometryIntersectFunction(g, &MeshletLeaves::intersect);
  rtcSetGeometryOccludedFunction(g, &MeshletLeaves::occluded);
  return g;
}

LeafTriangles MeshletLeaves::leaf(uint32_t number, uint32_t key) const {
  const Leaf& l = leaves_[number];
  const Meshlet& m = meshlets_[l.meshlet];
  LeafTriangles t;
  t.vertices = reinterpret_cast<const float*>(m.vertices + key * keyBytes_);
  t.vertexCount = m.vertexCount;
  t.indices = reinterpret_cast<const uint8_t*>(m.indices) + 3 * l.first;
  t.count = l.count;
  return t;
}

LeafTriangles MeshletLeaves::leafAt(uint32_t number, float time) const {
  if (keys_ == 1) return leaf(number, 0);
  const float at = time * float(keys_ - 1);
  const uint32_t key = std::min(uint32_t(std::max(at, 0.0f)), keys_ - 2);
  LeafTriangles t = leaf(number, key);
  t.later = reinterpret_cast<const float*>(reinterpret_cast<const std::byte*>(t.vertices) + keyBytes_);
  t.part = at - float(key);
  return t;
}

void MeshletLeaves::bounds(const RTCBoundsFunctionArguments* a) {
  const auto& self = *static_cast<const MeshletLeaves*>(a->geometryUserPtr);
  const LeafTriangles t = self.leaf(a->primID, a->timeStep);
  Box3f box;
  for (uint32_t i = 0; i < t.count; ++i) box.extend(boundOf(t, i));
  // Embree's boxes of user geometries are met only as far as rounding goes.
  box.grow(kRounding * std::max(largestCoordinate(box.min), largestCoordinate(box.max)));
  a->bounds_o->lower_x = box.min.x, a->bounds_o->lower_y = box.min.y, a->bounds_o->lower_z = box.min.z;
  a->bounds_o->upper_x = box.max.x, a->bounds_o->upper_y = box.max.y, a->bounds_o->upper_z = box.max.z;
}

bool MeshletLeaves::meet(RTCIntersectContext* context, RTCRay& ray, uint32_t number, uint32_t geometryId,
                         bool any) const {
  const LeafRay asked{
      {ray.org_x, ray.org_y, ray.org_z}, {ray.dir_x, ray.dir_y, ray.dir_z}, ray.tnear, ray.tfar};
  LeafHits hits;
  kernel_(asked, leafAt(number, ray.time), hits);
  bool taken = false;
  for (uint32_t rest = hits.mask; rest != 0; rest &= rest - 1) {
    const int i = __builtin_ctz(rest);
    if (hits.distance[i] > ray.tfar) continue;
    RTCHit hit;
    hit.Ng_x = hits.normal[0][i], hit.Ng_y = hits.normal[1][i], hit.Ng_z = hits.normal[2][i];
    hit.u = hits.u[i], hit.v = hits.v[i];
    hit.primID = number * kLeafTriangles + uint32_t(i), hit.geomID = geometryId;
    hit.instID[0] = context->instID[0];
    const float far = ray.tfar;
    ray.tfar = hits.distance[i];
    int valid = -1;
    const RTCFilterFunctionNArguments call{
        &valid, nullptr, context, reinterpret_cast<RTCRayN*>(&ray), reinterpret_cast<RTCHitN*>(&hit), 1};
    context->filter(&call);
    if (!valid) {
      ray.tfar = far;
      continue;
    }
    taken = true;
    if (any) break;
  }
  return taken;
}

// Only single-ray queries are made: N is 1.

void MeshletLeaves::intersect(const RTCIntersectFunctionNArguments* a) {
  if (!a->valid[0]) return;
  auto& rh = *reinterpret_cast<RTCRayHit*>(a->rayhit);
  // Who asks knows the hit from the filter.
  if (static_cast<const MeshletLeaves*>(a->geometryUserPtr)
          ->meet(a->context, rh.ray, a->primID, a->geomID, false))
    rh.hit.geomID = a->geomID, rh.hit.primID = a->primID;
}

void MeshletLeaves::occluded(const RTCOccludedFunctionNArguments* a) {
  if (!a->valid[0]) return;
  auto& ray = *reinterpret_cast<RTCRay*>(a->ray);
  if (static_cast<const MeshletLeaves*>(a->geometryUserPtr)
          ->meet(a->context, ray, a->primID, a->geomID, true))
    ray.tfar = -kInfinity;
}

}  // namespace fr::tracer
