// Geometry whose trees are built when a ray first comes near it, and given back when memory is short.
// Internal to tracer/.
//
// What rays may or may not reach is cut into *clusters*: patches that stand together and that the same rays
// see. In the ray scene a cluster is a box. A ray that enters the box dices the cluster's patches, if nobody
// has, and walks through the cluster's own tree. There is one tree for each *level*: level k shows every
// 2^k-th vertex of what level 0 shows, and a ray takes the coarsest whose recorded deviation its footprint
// hides (Christensen et al., "Ray differentials and multiresolution geometry caching", 2003). A ray takes one
// level for all of a cluster. Neighbours need not take the same one: where a cluster ends, its borders have
// the vertices of stride 1 at every level, so nothing cracks.
//
// Which clusters there are, and what they show, depends on the scene alone: never on memory or timing.
//
// Trees are freed while other threads trace. Whoever walks through one says so in a slot of its own first (a
// hazard pointer); what has been taken out of use is freed when no slot names it any more.
#pragma once

#include <embree3/rtcore.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "tracer/part_builder.h"

namespace fr::tracer {

/// A patch, or a piece of a large one, that goes into a cluster as a whole.
struct ClusterItem {
  cache::NodeId node = cache::kNone;
  cache::ObjectId object = cache::kNone;
  Box3f bound;
  double micropolygons = 0;  // estimate
};

class Clusters {
 public:
  /// How much of a footprint's radius the traced surface may be off.
  static constexpr float kHiddenDeviation = 0.25f;

  Clusters(RTCDevice device, cache::SceneCache& cache, std::vector<ObjectFacts> facts,
           EntryStore<SurfaceEntry>& entries, const std::atomic<int64_t>& embreeBytes, int64_t leastBytes,
           bool byFootprint);
  ~Clusters();

  /// Cuts items into clusters of about `size` micropolygons.
  void add(std::vector<ClusterItem> items, double size);
  /// Attaches the boxes to the ray scene. Hits in them come with HitFilter::within set.
  void attach(RTCScene scene, std::vector<std::vector<uint32_t>>& entryOfPrimitive);

  bool empty() const { return clusters_.empty(); }
  /// Entry of a diced node at level 0, kNone when it is in no cluster. Dices its cluster if nobody has.
  uint32_t entryOf(cache::NodeId node);
  /// Frees trees, the least recently used first, until about so many bytes are free; returns how many.
  uint64_t giveBack(uint64_t bytes);
  bool hasGivenBack() const { return evicted_.load(std::memory_order_relaxed) > 0; }
  /// Adds what has been built to the counts of a ray scene.
  void count(RaySceneStatistics& s) const;

 private:
  struct Tree;
  struct Cluster;
  struct BoxGeometry;
  template <class Walk>
  static void enter(void* geometry, uint32_t box, RTCIntersectContext* context, Walk&& walk);
  static void bounds(const RTCBoundsFunctionArguments* a);
  static void intersect(const RTCIntersectFunctionNArguments* a);
  static void occluded(const RTCOccludedFunctionNArguments* a);

  struct Cut {
    double size;   // micropolygons of a cluster, about
    double least;  // what has fewer stays together
    uint32_t mask;
  };
  void split(std::vector<ClusterItem>& items, size_t first, size_t end, const Cut& cut);
  std::vector<std::pair<uint32_t, Box3f>> foreignTo(const Cluster& c) const;
  std::vector<GatheredGrid> gather(Cluster& c, int level);
  void dice(Cluster& c);
  int levelFor(const Cluster& c, const struct Ray& ray) const;
  const Tree* use(Cluster& c, int level);
  const Tree* build(Cluster& c, int level);
  void freeRetired();

  RTCDevice device_;
  cache::SceneCache& cache_;
  std::vector<ObjectFacts> facts_;
  EntryStore<SurfaceEntry>& entries_;
  const std::atomic<int64_t>& embreeBytes_;
  const int64_t leastBytes_;  // RaySceneOptions::leastTreeBytes
  const bool byFootprint_;    // else level 0 for all rays
  std::vector<std::unique_ptr<Cluster>> clusters_;
  std::vector<Box3f> boxes_;                              // of clusters_, close together
  std::vector<std::unique_ptr<BoxGeometry>> geometries_;  // one a mask
  /// Which cluster an item is in.
  struct Place {
    uint32_t root;
    cache::NodeId node;
    uint32_t cluster;
  };
  std::vector<Place> places_;  // sorted
  std::atomic<uint32_t> clock_{1};
  mutable std::mutex mutex_;  // retired_ and counts_
  std::vector<std::unique_ptr<const Tree>> retired_;
  RaySceneStatistics counts_;
  std::atomic<uint64_t> diced_{0}, built_{0}, evicted_{0};
  std::atomic<uint64_t> recordBytes_{0};  // beside Embree's: of trees, and of what outlives them
};

}  // namespace fr::tracer
