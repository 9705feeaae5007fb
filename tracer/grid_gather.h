// From patches to checked records of the grids that rays see. Internal to tracer/.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "scene_cache/cache.h"
#include "tracer/ray_scene.h"

namespace fr::tracer {

/// What the attributes of an object say about tracing it.
struct ObjectFacts {
  uint32_t mask = 0;  // RayMask; 0: no ray sees it
  int level = 0;      // stride 2^level
  bool oneSided = false;
  cache::CastsShadows castsShadows = cache::CastsShadows::kOpaque;
  bool opaqueCaster = false;
};
ObjectFacts factsOf(const cache::Skeleton& skeleton, cache::ObjectId id,
                    const std::function<bool(cache::ObjectId)>& opaqueCaster, const RaySceneOptions& options);

/// Grids of one class share an Embree geometry.
struct ClassKey {
  bool meshlet;
  uint32_t mask;
  uint32_t level;
  uint32_t keys;
  uint64_t keyBytes;
  uint64_t window;
  auto operator<=>(const ClassKey&) const = default;
};

/// A checked grid.
struct GatheredGrid {
  SurfaceEntry entry;
  ClassKey key;
  uint32_t startVertex;  // in units of the class's byte stride, from its window's start
  uint32_t rowStride;
  uint64_t indices;   // meshlets
  bool open = false;  // what it borders on may be part of another Embree scene
};

/// Vertex buffers are addressed by 32-bit indices and end 16 GB after their start (Embree); windows of half
/// of that always hold a grid that starts in them.
inline constexpr uint64_t kWindow = (uint64_t(8) << 30) / cache::kPositionAlign * cache::kPositionAlign;

/// Vertex `index` of a grid at its traced stride.
inline const float* vertexOf(const cache::SceneCache& cache, const GatheredGrid& g, uint64_t index) {
  const uint64_t at = g.key.window * kWindow + (uint64_t(12) << g.key.level) * g.startVertex + 12 * index;
  return reinterpret_cast<const float*>(cache.arena().data() + at);
}

/// Dices `node` and all below it if nobody has, and appends its grids, always in the same order. Grids that
/// fail validation are reported and left out. Thread-safe.
void gatherNode(cache::SceneCache& cache, cache::NodeId node, cache::ObjectId object,
                const ObjectFacts& facts, std::vector<GatheredGrid>& to);

/// Sets which way dPdu x dPdv points in cache space against the oriented normal: one answer per object, voted
/// for by its first grids (a pole or a fold may be undecided or wrong). Grids of an object must stand
/// together. `normals`: of an instance, takes products of two edges to cache space; nullptr: they are there.
void orientGrids(const cache::SceneCache& cache, std::span<GatheredGrid> grids, const Mat3* normals);

}  // namespace fr::tracer
