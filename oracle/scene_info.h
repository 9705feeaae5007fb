// What a ray server tells its clients about its scene, and the one place where world space becomes cache
// space.
//
// Rays travel as floats in cache space: world space minus a double-precision origin near the camera (no
// rotation, no scale), so that scenes far from the origin keep their precision. Clients speak world space, in
// doubles or floats, and convert here: points subtract or add the origin in double; directions, normals,
// distances and colours are the same in both.
#pragma once

#include <cstdint>
#include <type_traits>

#include "base/math.h"
#include "oracle/ray_query.h"
#include "oracle/single_ray.h"

namespace fr {

/// Fixed layout: it travels between processes.
struct RaySceneInfo {
  double origin[3] = {};          // of cache space, in world space
  double worldToCamera[16] = {};  // at shutter open; columns, points are column vectors
  double shutter[2] = {};         // open, close. Times of rays go from 0 (open) to 1 (close)
  float boundMin[3] = {};         // of everything that rays can see, cache space; min > max: nothing
  float boundMax[3] = {};
  uint64_t scene =
      0;  // hash of the scene as loaded: equal means that node numbers mean the same root patches
  int32_t frame = 0;
  int32_t maxRayLevel = 0;
  float patchMultiplier = 0;
  int32_t threads = 0;
  int32_t processId = 0;
  int32_t reserved = 0;
};
static_assert(std::is_trivially_copyable_v<RaySceneInfo> && sizeof(RaySceneInfo) == 224);

/// World space to cache space and back. Cheap to copy.
class WorldSpace {
 public:
  WorldSpace() = default;
  explicit WorldSpace(const RaySceneInfo& info) : origin_(info.origin[0], info.origin[1], info.origin[2]) {}
  explicit WorldSpace(const DVec3& origin) : origin_(origin) {}

  Vec3 pointToCache(const DVec3& world) const { return Vec3(world - origin_); }
  DVec3 pointToWorld(const Vec3& cache) const { return DVec3(cache) + origin_; }

  /// Origin of ray `i` of a block. REQUIRES i < kMaxRays.
  void setOrigin(RayQuery& q, uint32_t i, const DVec3& world) const {
    const Vec3 p = pointToCache(world);
    for (int c = 0; c < 3; ++c) q.origin[c][i] = p[c];
  }
  /// Both ends of ray `i` of a kVisibility block: the difference is taken in double.
  void setSegment(RayQuery& q, uint32_t i, const DVec3& from, const DVec3& to) const {
    setOrigin(q, i, from);
    const Vec3 d(to - from);
    for (int c = 0; c < 3; ++c) q.direction[c][i] = d[c];
  }
  void setOrigin(SingleRay& r, const DVec3& world) const {
    const Vec3 p = pointToCache(world);
    for (int c = 0; c < 3; ++c) r.origin[c] = p[c];
  }
  DVec3 hitPoint(const RayQuery& q, uint32_t i) const {
    return pointToWorld({q.hitP[0][i], q.hitP[1][i], q.hitP[2][i]});
  }
  DVec3 missPoint(const RayQuery& q, uint32_t i) const {
    return pointToWorld({q.missP[0][i], q.missP[1][i], q.missP[2][i]});
  }
  DVec3 hitPoint(const SingleAnswer& a) const { return pointToWorld({a.hitP[0], a.hitP[1], a.hitP[2]}); }
  DVec3 missPoint(const SingleAnswer& a) const { return pointToWorld({a.missP[0], a.missP[1], a.missP[2]}); }

 private:
  DVec3 origin_{0};
};

}  // namespace fr
