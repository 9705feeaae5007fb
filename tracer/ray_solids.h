// Rays against solids. Internal to tracer/.
//
// A tree of solids is one primitive of the ray scene, as large as the tree's surface can be, with an Embree
// scene of its own. A ray that enters its bounds asks there for everything that it crosses, from its start to
// infinity, and scene_cache/solids.h says what of that is the surface of the whole.
#pragma once

#include <embree3/rtcore.h>

#include "tracer/ray_scene.h"

namespace fr::tracer {

struct SolidRays {
  /// Attaches the trees to the scene as one geometry. Their own scenes must have been committed.
  static void attach(RayScene& scene);

 private:
  static void bounds(const RTCBoundsFunctionArguments* a);
  static void intersect(const RTCIntersectFunctionNArguments* a);
  static void occluded(const RTCOccludedFunctionNArguments* a);
  /// Offers the tree's surfaces in (near, far] to the filter, nearest first, until it takes one: returns its
  /// distance, or infinity.
  static float firstTaken(struct HitFilter& filter, uint32_t tree, uint32_t mask, float near, float far);
};

}  // namespace fr::tracer
