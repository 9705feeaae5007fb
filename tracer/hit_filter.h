// What Embree finds on its way, and what of that a ray hits. Internal to tracer/.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

#include "scene_cache/trim.h"
#include "tracer/ray_scene_embree.h"

namespace fr::tracer {

/// Positions are floats that went through a few transformations: what is nearer than this fraction of the
/// largest coordinate may be the same point.
inline constexpr float kRounding = 0x1p-18f;

/// The plane of a chord facet whose sagitta is d lies at most this many d from a point of the surface within
/// two and a half cells: on a circle of radius R with cells of length c, d = c^2 / 8R and the height at x is
/// x^2 / 2R - d, so 24 d at x = 2.5 c.
inline constexpr float kDepartureSagittas = 32;
/// How far a grazing ray's start can be over a chord that it runs into from outside.
inline constexpr float kSaddleSagittas = 4;
/// The same for the end point of a ray, whose patch is not known: 8 d at x = 1.5 c.
inline constexpr float kArrivalSagittas = 8;
/// No facet that is farther than this many cells from a point can be the one that the point lies on.
inline constexpr float kReachCells = 2;

inline float largestCoordinate(const Vec3& p) {
  return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

/// A facet that a ray meets.
struct Candidate {
  float distance;
  uint32_t entry, cell;
  float u, v;            // as in Hit
  float patchU, patchV;  // of the root patch; meshlets: nothing
  Vec3 normal;           // as in Hit
  float cosine;          // of the ray and the normal
  float rounding;        // of positions here
};

/// What a facet of the surface that a ray leaves is to the ray.
enum class Leaving {
  kNo,       // not the place that it leaves: a hit like any other
  kEmerges,  // the start was under this facet
  kDips      // the ray was over the surface and runs under this facet
};

/// Sees every candidate that Embree finds before it counts as a hit. The context is the first member, so
/// Embree's pointer to it is a pointer to this.
struct HitFilter {
  RTCIntersectContext rtc;
  const RayScene* scene;
  const Ray* ray;
  bool onlyOpaque;
  bool sawFiltered = false;
  const TracedPart* within = nullptr;  // the cluster's tree that is being walked through
  /// Asks for the nearest facet of the surface that is left alone, crossed in the sense of leaving.
  bool probing = false;
  float sense = 1;  // probing: along the oriented normals, or -1
  Hit best;
  /// RayScene::anyHit(): not nullptr as long as the ray is not whole.
  void (*fill)(void* who, Ray& ray) = nullptr;
  void* filler = nullptr;
  /// The last places where the ray came out of the surface that it leaves, and where it went under it again.
  /// Facets are found in any order.
  float emerged = -kInfinity;
  Candidate dip{-kInfinity, cache::kNone, 0, 0, 0, 0, 0, Vec3(0), 0, 0};

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

  /// Whoever wants to know more of the ray than Embree does calls this first.
  void wake() {
    if (!fill) return;
    fill(filler, const_cast<Ray&>(*ray));
    fill = nullptr;
  }

  bool accept(float t, const RTCHit& h) {
    wake();
    Candidate c;
    const RayScene::Instance* instance = nullptr;
    if (h.instID[0] != RTC_INVALID_GEOMETRY_ID)
      instance = &scene->instances_[h.instID[0] - scene->firstInstance_];
    const RayScene::Embree& embree = *scene->embree_;
    const TracedPart& part = within     ? *within
                             : instance ? embree.prototypes[instance->prototype]
                                        : embree.main;
    if (!describe(part, t, h, c, instance) || isTrimmed(c)) return false;
    const SurfaceEntry& e = scene->entries_[c.entry];
    if (probing) {
      if (e.surfaceGroup != ray->departure.surfaceGroup || c.cosine * sense <= 0) return false;
      if (c.distance < best.distance) best.distance = c.distance;
      return true;
    }
    const Leaving leaving = leaves(e, c.distance, c.cosine, c.rounding);
    if (leaving == Leaving::kEmerges) emerged = std::max(emerged, c.distance);
    if (leaving == Leaving::kEmerges || !isSeen(c)) return false;
    if (leaving == Leaving::kDips) {
      if (c.distance > dip.distance) dip = c;
      return false;
    }
    return take(c);
  }

  /// When all was seen: a ray that went under the surface that it leaves and did not come out again has hit
  /// it there.
  bool takeDip() { return dip.distance > emerged && dip.distance < best.distance && take(dip); }

  /// False: a facet without area, or of a grid that an instance lacks. `part`: that the hit is of.
  bool describe(const TracedPart& part, float t, const RTCHit& h, Candidate& c,
                const RayScene::Instance* instance = nullptr) const {
    float gridU = h.u, gridV = h.v;
    uint32_t entryIndex = part.entryOf(h.geomID, h.primID, gridU, gridV);
    if (entryIndex & TracedPart::kStitch) {
      const StitchQuad& s = part.stitches[entryIndex & ~TracedPart::kStitch];
      entryIndex = s.grid;
      const SurfaceEntry& e = scene->entries_[entryIndex];
      const bool second = h.u + h.v > 1;
      const int a = second ? 2 : 0, b = second ? 3 : 1, c2 = second ? 1 : 3;
      const float u = second ? 1 - h.u : h.u, v = second ? 1 - h.v : h.v, w = 1 - u - v;
      gridU = (w * s.i[a] + u * s.i[b] + v * s.i[c2]) / float(e.cellsU << e.level);
      gridV = (w * s.j[a] + u * s.j[b] + v * s.j[c2]) / float(e.cellsV << e.level);
    } else if (const SurfaceEntry& e = scene->entries_[entryIndex]; e.stitched) {
      gridU = (e.inner[0] + gridU * float(e.inner[1] - e.inner[0])) / float(e.cellsU);
      gridV = (e.inner[2] + gridV * float(e.inner[3] - e.inner[2])) / float(e.cellsV);
    }
    // What an instance shows lies in the prototype's grids as it does in the prototype.
    if (instance) entryIndex += instance->shift;
    const SurfaceEntry& e = scene->entries_[entryIndex];
    if (instance && e.node == cache::kNone) return false;
    Vec3 raw(h.Ng_x, h.Ng_y, h.Ng_z);
    if (instance) raw = instance->normals * raw;
    const float length = glm::length(raw);
    if (!(length > 0)) return false;
    c.distance = t;
    c.entry = entryIndex;
    c.normal = raw * (e.orientation / length);
    c.cosine = glm::dot(ray->direction, c.normal);
    c.rounding = kRounding * std::max(largestCoordinate(ray->origin),
                                      largestCoordinate(ray->origin + t * ray->direction));
    c.patchU = e.u0 + e.uScale * gridU, c.patchV = e.v0 + e.vScale * gridV;
    c.u = c.patchU, c.v = c.patchV;
    if (e.meshlet) {
      c.cell = part.leaves[h.geomID]->triangleOf(h.primID);
      c.u = gridU, c.v = gridV;
    } else if (e.strip) {
      // The triangle of the meshlet, and where in it.
      const float x = gridU * float(e.cellsU), y = gridV * float(e.cellsV);
      const int cu = std::clamp(int(x), 0, e.cellsU - 1), cv = std::clamp(int(y), 0, e.cellsV - 1);
      c.u = std::clamp(x - float(cu), 0.0f, 1.0f), c.v = std::clamp(y - float(cv), 0.0f, 1.0f);
      const bool second = c.u + c.v > 1;
      if (second) c.u = 1 - c.u, c.v = 1 - c.v;
      c.cell = e.firstTriangle + 2 * (uint32_t(cv) * e.cellsU + uint32_t(cu)) + second;
    } else {
      const int cu = std::clamp(int(gridU * float(e.cellsU)), 0, e.cellsU - 1);
      const int cv = std::clamp(int(gridV * float(e.cellsV)), 0, e.cellsV - 1);
      c.cell = uint32_t(cv) * e.cellsU + uint32_t(cu);
    }
    return true;
  }

  /// The ray sees this side of this surface.
  bool isSeen(const Candidate& c) const {
    const SurfaceEntry& e = scene->entries_[c.entry];
    if (e.oneSided && c.cosine > 0) return false;
    if (c.cosine * float(ray->side) > 0) return false;
    if (scene->thinned_) {
      const float* thinning = scene->cache_->skeleton().attributes()[e.attributes].thinning;
      if (ray->chance < thinning[0] || ray->chance >= 1 - thinning[1]) return false;
    }
    return !ray->seen || ray->seen[e.attributes];
  }

  bool isTrimmed(const Candidate& c) const {
    const SurfaceEntry& e = scene->entries_[c.entry];
    return e.trimmed && scene->cache_->trimOf(e.node).removed(c.patchU, c.patchV);
  }

  /// There is a surface here, and the ray crosses it.
  bool exists(const Candidate& c) const {
    return !isTrimmed(c) &&
           leaves(scene->entries_[c.entry], c.distance, c.cosine, c.rounding) == Leaving::kNo;
  }

  /// Makes what exists and is seen the ray's hit, unless there is a better one.
  bool take(const Candidate& c) {
    const SurfaceEntry& e = scene->entries_[c.entry];
    if (isArrivalSurface(e, c.distance, c.cosine, c.rounding)) return false;
    if (ray->passedEntry != cache::kNone && wasPassed(e, c.entry, c.cell, c.distance, c.cosine, c.rounding))
      return false;
    if (onlyOpaque) {
      // Embree goes on behind a rejected candidate: the first opaque one ends the question.
      sawFiltered |= !e.opaqueCaster;
      return e.opaqueCaster;
    }
    if (c.distance == best.distance && best.any() && !scene->isBefore(c.entry, c.cell, best.entry, best.cell))
      return false;
    best = {c.distance, c.entry, c.cell, c.u, c.v, c.normal};
    return true;
  }

  /// The start point lies on the smooth surface, the facets are chords of it: a ray that starts under its own
  /// facet leaves through it in the sense in which it left the surface, nearby; in a saddle it may pass under
  /// chords that stand over the surface. Anything that it meets farther away, or whose plane is farther off
  /// than the surface bends there, is something else.
  Leaving leaves(const SurfaceEntry& e, float t, float cosine, float rounding) const {
    const Departure& d = ray->departure;
    if (d.surfaceGroup != e.surfaceGroup || d.surfaceGroup == cache::kNone) return Leaving::kNo;
    const float height = t * std::abs(cosine);
    if (height <= 0.5f * rounding) return Leaving::kEmerges;  // along its plane: the sense is rounding too
    if (t > kReachCells * std::max(d.cellSize, e.cellSize) + rounding) return Leaving::kNo;
    const float deviation = std::max(d.deviation, e.deviation);
    const float rise = t * std::abs(d.cosine);  // over the tangent plane of the start
    if (cosine * d.cosine >= 0)
      return rise <= rounding || height <= kDepartureSagittas * deviation + rounding ? Leaving::kEmerges
                                                                                     : Leaving::kNo;
    return rise <= deviation && height <= kSaddleSagittas * deviation ? Leaving::kDips : Leaving::kNo;
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
    if (t == ray->passedDistance && !scene->isBefore(ray->passedEntry, ray->passedCell, entryIndex, cell))
      return true;
    const float step = t - ray->passedDistance;
    return e.surfaceGroup == scene->entries_[ray->passedEntry].surfaceGroup && cosine * ray->passedSide > 0 &&
           step <= kReachCells * e.cellSize + rounding && step * std::abs(cosine) <= 0.25f * rounding;
  }
};

}  // namespace fr::tracer
