// In which order the rays of a batch are traced. Internal to tracer/.
//
// An answer does not depend on it. As long as all trees stay in memory it makes no difference in time either
// (sorting 8 M rays of ambient occlusion cost what it saved), so they are traced as they come. When trees of
// clusters are given back and built again, rays that meet the same clusters follow one another (Pharr,
// Kolb, Gershbein and Hanrahan, "Rendering complex scenes with memory-coherent ray tracing", 1997, keep
// queues of rays by cell for that; here it is an order within a batch).
#pragma once

#include <algorithm>
#include <array>
#include <utility>

#include "oracle/ray_query.h"
#include "scene_cache/morton.h"
#include "tracer/ray_scene.h"

namespace fr::tracer {

/// Fills order[0, count) with the indices of `count` rays (kMaxRays at most). `rayOf(i)`: origin and
/// direction of ray i, not necessarily of unit length, nor finite.
template <class RayOf>
void orderRays(const RayScene* scene, uint32_t count, uint32_t* order, RayOf&& rayOf) {
  if (!scene || !scene->treesComeAndGo()) {
    for (uint32_t i = 0; i < count; ++i) order[i] = i;
    return;
  }
  std::array<std::pair<uint64_t, uint32_t>, kMaxRays> keys;
  const Box3f& box = scene->bound();
  for (uint32_t i = 0; i < count; ++i) {
    const auto [origin, direction] = rayOf(i);
    const uint64_t octant = (direction.x < 0 ? 1 : 0) | (direction.y < 0 ? 2 : 0) | (direction.z < 0 ? 4 : 0);
    const bool sane = isFinite(origin) && isFinite(box.min) && isFinite(box.max);
    keys[i] = {octant << 60 | (sane ? cache::mortonCode(origin, box) : 0), i};
  }
  std::sort(keys.begin(), keys.begin() + count);
  for (uint32_t i = 0; i < count; ++i) order[i] = keys[i].second;
}

}  // namespace fr::tracer
