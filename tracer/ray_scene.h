// The geometry that rays see: Embree's acceleration structure over the grids of the scene cache.
//
// Embree reads the vertices where the cache keeps them (12 k bytes apart for the surface of stride k); what
// this class owns is one small validated record per grid and Embree's tree. Nothing else that stands in
// shared memory is looked at again: a hit is (entry, cell, u, v), and entry is an index into our own records.
//
// Thread safety: build() once; everything const afterwards, any number of threads.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "base/error.h"
#include "scene_cache/cache.h"
#include "scene_cache/solids.h"
#include "tracer/entry_store.h"
#include "tracer/ray_start_kernel.h"

namespace fr::tracer {

/// What a ray is, as a mask: a surface answers the kinds that its attributes let see it.
/// Shadow rays come in two: casters that are opaque whatever happens, and casters whose opacity must be asked
/// for.
enum RayMask : uint32_t {
  kCameraRay = 1,
  kReflectionRay = 2,
  kOpaqueShadowRay = 4,
  kFilteredShadowRay = 8,
  kDiffuseRay = 16,
};

/// Option "trace" "string levels".
enum class LevelChoice : uint8_t {
  kAuto,  // by a ray's footprint in scenes that are traced in clusters
  kOn,    // by a ray's footprint: all scenes are traced in clusters
  kOff,   // what patch_multiplier says, for all rays
};

struct RaySceneOptions {
  /// Where an object has no Attribute "render" "patch_multiplier". A ray server's default is 0.5.
  float patchMultiplier = 0.5f;
  /// Threads that resolve grids and build; 0: one per core.
  int threads = 0;
  /// Also holds objects that only camera rays can see.
  bool cameraRays = false;
  /// Cells of grids that are traced as Embree's quadrilaterals: a hundred bytes each instead of 16, and
  /// quicker. What is more in all, beside clusters, stays grids.
  double quadCells = 128 * 1024;
  /// Scenes of more micropolygons than this, as far as can be told before they are diced, are traced in
  /// clusters (tracer/clusters.h); the others as one flat tree, but for what stands outside the picture.
  double flatMicropolygons = 16e6;
  /// Of a cluster.
  double clusterMicropolygons = 32 * 1024;
  /// Where the scene has no Option "trace" "levels".
  LevelChoice levels = LevelChoice::kAuto;
  /// Bytes of trees that giveBack() leaves: with none at all, each ray would build its trees anew.
  int64_t leastTreeBytes = int64_t(16) << 20;
};

/// One grid or meshlet as traced. Private and checked.
struct SurfaceEntry {
  cache::NodeId node;
  cache::ObjectId object;
  cache::AttributeId attributes;
  uint32_t surfaceGroup;
  float u0, v0, uScale, vScale;  // root patch (u,v) = (u0,v0) + scale * grid (u,v)
  float cellSize;                // longest cell diagonal at the traced stride
  float deviation;               // between the traced surface and the true one
  float shadedDeviation;         // between the surface as shaded (stride 1) and the true one
  union {
    uint32_t firstTriangle;  // strips: triangle of the meshlet
    uint8_t inner[4];        // stitched grids: the cells that Embree sees as a grid (BorderedGrid::inner)
  };
  uint16_t cellsU, cellsV;  // at the traced stride; meshlets: vertices, triangles
  float orientation;        // +1, or -1 when the oriented normal points against dPdu x dPdv
  uint8_t level;
  uint8_t mask;  // RayMask: what can hit it
  cache::CastsShadows castsShadows;
  uint8_t oneSided : 1;
  uint8_t meshlet : 1;
  uint8_t moving : 1;
  uint8_t opaqueCaster : 1;  // stops shadow rays without being asked
  uint8_t strip : 1;         // a piece of a curve's ribbon: a grid of cells of two triangles of a meshlet
  uint8_t trimmed : 1;       // parts are cut away: SceneCache::trimOf()
  uint8_t stitched : 1;      // the outer cells are triangles
};
static_assert(sizeof(SurfaceEntry) <= 64);

/// Where a ray leaves, enough to know the leaving surface again without a tuned distance.
struct Departure {
  uint32_t surfaceGroup = cache::kNone;  // kNone: does not start on a surface
  float cosine = 0;                      // dot(direction, oriented unit normal); 0: as good as in the surface
  float cellSize = 0;                    // of the starting patch, as traced
  float deviation = 0;                   // of the starting patch, as traced
  float lift = 0;          // from the start point off the surface as shaded, to the side where the ray goes
  float nearDistance = 0;  // Attribute "trace" "bias" of the surface, which then stands for all of the above
};

/// One ray. Cache space; direction is unit, so distances are lengths.
struct Ray {
  Vec3 origin;
  Vec3 direction;
  float nearDistance = 0;
  float farDistance = kInfinity;
  float time = 0;
  uint32_t mask = kReflectionRay;
  bool endsOnSurface =
      false;  // farDistance is a point that may lie on a surface: that surface is no occluder
  Departure departure;
  const uint8_t* seen = nullptr;  // by AttributeId: what the ray can hit; nullptr: everything
  float chance = 0.5f;            // of a representation in transition (AttributeRecord::thinning)
  int side = 0;                   // 1: hits front sides alone, -1: back sides
  /// Footprint: its radius at the origin, and its growth per unit of distance. What it hides, clusters need
  /// not show. Both 0: everything is shown as finely as its attributes say.
  float radius = 0, spread = 0;
  // Stepping through surfaces: hits up to and including this one are behind us.
  uint32_t passedEntry = cache::kNone;
  uint32_t passedCell = 0;
  float passedDistance = 0;
  float passedSide = 0;
};

struct Hit {
  float distance = kInfinity;
  uint32_t entry = cache::kNone;  // kNone: nothing hit
  uint32_t cell = 0;              // meshlets: triangle. Grids: row * cellsU + column at the traced stride
  float u = 0, v = 0;             // of the root patch; meshlets: barycentric
  Vec3 normal{0};                 // unit, of the facet, oriented as the surface is

  bool any() const { return entry != cache::kNone; }
};

enum class Obstacle { kNone, kFiltered, kOpaque };

struct RaySceneStatistics {
  uint64_t grids = 0, meshlets = 0, quads = 0, triangles = 0, geometries = 0;
  uint64_t solids = 0;
  uint64_t prototypes = 0, instances = 0;     // grids of prototypes count once
  uint64_t stitchQuads = 0;                   // of grids whose borders no neighbour shows
  uint64_t embreeBytes = 0, recordBytes = 0;  // embreeBytes: now; peakBytes: while building
  uint64_t peakBytes = 0;
  // Of clusters, a part of the above: how many there are, and how many rays have come near; trees made and
  // given back.
  uint64_t clusters = 0, clustersDiced = 0, treesBuilt = 0, treesFreed = 0;
  double resolveSeconds = 0, buildSeconds = 0;
};

class Clusters;

class RayScene {
 public:
  /// Resolves the patches that rays may see and builds; what stands outside of the picture, and everything in
  /// a large scene, waits in clusters until a ray comes near. `opaqueCaster` says whether an object stops
  /// shadow rays without being asked. Grids that fail validation are reported and left out.
  static Result<std::unique_ptr<RayScene>> build(cache::SceneCache& cache,
                                                 const std::function<bool(cache::ObjectId)>& opaqueCaster,
                                                 const RaySceneOptions& options);
  ~RayScene();
  RayScene(const RayScene&) = delete;
  RayScene& operator=(const RayScene&) = delete;

  /// Nearest hit that is not the departing surface, not behind a passed hit, not the back of a one-sided
  /// surface. Equal distances: the lowest (object, patch, cell).
  Hit closest(const Ray& ray) const;
  /// Whether the ray hits anything. Of rays that are aimed exactly at a vertex, one or two in a hundred may
  /// get through: they should go a little beside it. `fill` is called with `who` before anything is asked of
  /// the ray but its origin, direction, distances, time and mask.
  bool anyHit(Ray& ray, void* who, void (*fill)(void* who, Ray& ray)) const;
  /// What startRays() must know of the surface of a node. Nothing: its rays need a second look.
  std::optional<LeavingRays> leavingRays(cache::NodeId node) const;
  /// What lies between the near and far distances of a shadow ray, in one traversal: something opaque, or
  /// only what must be asked for its opacity, or nothing.
  Obstacle obstacle(const Ray& ray) const;
  /// Describes the start of a ray in direction `direction` (unit) on `node` with oriented normal `normal`.
  /// Any node is allowed; one out of range, or a zero or non-finite normal, is no surface.
  Departure departure(cache::NodeId node, const Vec3& direction, const Vec3& normal) const;
  /// Lets a ray that has an origin, a direction, a time and a mask start on a surface: sets its departure and
  /// near distance, and moves its origin, by no more than facets are off the surface.
  void leave(Ray& ray, cache::NodeId node, const Vec3& normal) const;
  /// Makes `ray` go on behind `hit`.
  void stepBehind(Ray& ray, const Hit& hit) const;

  const SurfaceEntry& entry(uint32_t index) const { return entries_[index]; }
  /// Some surfaces are in transition: rays need a Ray::chance.
  bool isThinned() const { return thinned_; }
  /// Grows as rays come near clusters.
  size_t entryCount() const { return entries_.size(); }
  /// Entry of a node, or kNone. Dices the cluster that it is in, if nobody has.
  uint32_t entryOf(cache::NodeId node) const;
  RaySceneStatistics statistics() const;
  /// Trees of clusters have been given back for want of memory: whoever meets them again builds them again.
  bool treesComeAndGo() const;
  /// Holds all that rays may meet.
  const Box3f& bound() const { return bound_; }
  /// Gives about so many bytes back, if rays can do without them for now; returns how many. Thread-safe.
  uint64_t giveBack(uint64_t bytes) const;

 private:
  friend struct HitFilter;
  friend class RaySceneBuilder;
  friend struct SolidRays;
  RayScene();
  Hit intersect(const Ray& ray) const;

  struct Embree;
  /// A tree of solids: an Embree scene of its own, all of whose crossings a ray asks for.
  struct SolidTree {
    uint32_t mask = 0;  // RayMask: what can hit some part of it
  };
  struct Instance {
    uint32_t prototype;
    uint32_t shift;  // from an entry of the prototype to that of the instance
    Mat3 normals;    // takes products of two edges to cache space
  };

  /// True when cell `a` of entry `entryA` comes before the other in the order of (object, patch, place in
  /// it): among hits at equal distance the first counts. Numbers of entries say nothing about it.
  bool isBefore(uint32_t entryA, uint32_t a, uint32_t entryB, uint32_t b) const;

  std::unique_ptr<Embree> embree_;
  /// The node of what an instance lacks is kNone.
  EntryStore<SurfaceEntry> entries_;
  cache::SolidForest solids_;
  std::vector<SolidTree> solidTrees_;  // of solids_
  std::vector<Instance> instances_;    // by Embree geometry id, from firstInstance_ on
  uint32_t firstInstance_ = 0;
  std::vector<uint32_t> entryOfNode_;  // kNone: in no flat tree
  cache::SceneCache* cache_ = nullptr;
  bool thinned_ = false;  // some surfaces are in transition
  Box3f bound_;
  RaySceneStatistics statistics_;
  std::unique_ptr<Clusters> clusters_;  // nullptr: there are none. Before embree_ is gone
};

}  // namespace fr::tracer
