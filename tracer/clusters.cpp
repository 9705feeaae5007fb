#include "tracer/clusters.h"

#include <malloc.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <span>
#include <tuple>

#include "tracer/hazard_slot.h"
#include "tracer/hit_filter.h"

namespace fr::tracer {

using namespace cache;

/// What a ray walks through: one level of a cluster. Never changes.
struct Clusters::Tree {
  TracedPart part;
  uint64_t recordBytes = 0;
};

struct alignas(64) Clusters::Cluster {
  Box3f box;
  uint32_t mask = 0;
  std::vector<std::pair<NodeId, ObjectId>> items;
  /// Surfaces that may go on in other clusters, as other primitives too: their boxes by attribute state.
  std::vector<std::pair<uint32_t, Box3f>> surfaces;

  std::atomic<const Tree*> tree[kLevels] = {};
  std::atomic<uint32_t> lastUse{0};

  std::mutex building;                 // all below
  std::atomic<bool> described{false};  // the next two do not change any more
  int levels = 1;
  float deviation[kLevels] = {};
  std::atomic<bool> listed{false};  // the next one does not change any more
  std::vector<uint32_t> byNode;     // entries of level 0, sorted by their nodes
  uint32_t firstEntry[kLevels] = {};
  bool hasEntries[kLevels] = {};

  ~Cluster() {
    for (auto& t : tree) delete t.load();
  }
};

/// The boxes of all clusters that the same rays see.
struct Clusters::BoxGeometry {
  Clusters* owner = nullptr;
  uint32_t mask = 0;
  std::vector<Cluster*> clusters;
};

namespace {

/// The surface of a box around things that stand close together, in those of their own boxes.
constexpr double kLoose = 2;
/// About as many clusters may be made of what stands apart.
constexpr double kMostLooseClusters = 4096;

double areaOf(const Box3f& box) {
  const DVec3 d(box.max - box.min);
  return d.x * d.y + d.y * d.z + d.z * d.x;
}

float distanceTo(const Box3f& box, const Vec3& p) {
  return glm::length(glm::max(glm::max(box.min - p, p - box.max), Vec3(0)));
}

/// Grown by what rounding may move positions.
Box3f rounded(Box3f box) {
  box.grow(8 * kRounding * std::max(largestCoordinate(box.min), largestCoordinate(box.max)));
  return box;
}

}  // namespace

Clusters::Clusters(RTCDevice device, SceneCache& cache, std::vector<ObjectFacts> facts,
                   EntryStore<SurfaceEntry>& entries, const std::atomic<int64_t>& embreeBytes,
                   int64_t leastBytes, bool byFootprint)
    : device_(device),
      cache_(cache),
      facts_(std::move(facts)),
      entries_(entries),
      embreeBytes_(embreeBytes),
      leastBytes_(leastBytes),
      byFootprint_(byFootprint) {}
Clusters::~Clusters() = default;

// ---- cutting
// ---------------------------------------------------------------------------------------------------------

void Clusters::add(std::vector<ClusterItem> items, double size) {
  // The same clusters whatever the numbers of nodes, which depend on who split first.
  const auto place = [&](const ClusterItem& i) {
    const PatchNode& n = cache_.node(i.node);
    return std::tuple(i.object, n.root, n.dv, n.iv, n.du, n.iu);
  };
  std::sort(items.begin(), items.end(),
            [&](const ClusterItem& a, const ClusterItem& b) { return place(a) < place(b); });
  std::map<uint32_t, std::vector<ClusterItem>> byMask;
  for (const ClusterItem& i : items) byMask[facts_[i.object].mask].push_back(i);
  double total = 0;
  for (const ClusterItem& i : items) total += i.micropolygons;
  for (auto& [mask, some] : byMask) split(some, 0, some.size(), {size, total / kMostLooseClusters, mask});
  std::sort(places_.begin(), places_.end(), [](const Place& a, const Place& b) {
    return std::pair(a.root, a.node) < std::pair(b.root, b.node);
  });
}

void Clusters::split(std::vector<ClusterItem>& items, size_t first, size_t end, const Cut& cut) {
  if (first == end) return;
  double total = 0, area = 0;
  Box3f centers, around;
  for (size_t i = first; i < end; ++i) {
    total += items[i].micropolygons;
    area += areaOf(items[i].bound);
    centers.extend(items[i].bound.center());
    around.extend(items[i].bound);
  }
  // Things that stand apart are apart: a ray that comes near one of them need not dice the others.
  const bool loose = areaOf(around) > kLoose * area && total > cut.least;
  const Vec3 extent = centers.max - centers.min;
  const int axis = extent.x >= extent.y && extent.x >= extent.z ? 0 : extent.y >= extent.z ? 1 : 2;
  if (end - first > 1 && (total > cut.size || loose)) {
    // Where a surface is cut, its edges must be traced at full resolution: that is done only to those that
    // are too large for one cluster.
    std::map<uint32_t, Box3f> groups;
    const auto groupOf = [&](const ClusterItem& i) {
      return cache_.skeleton().objects()[i.object].surfaceGroup;
    };
    for (size_t i = first; i < end; ++i) groups[groupOf(items[i])].extend(items[i].bound);
    const bool whole = groups.size() > 1;
    const auto key = [&](const ClusterItem& i) {
      const uint32_t group = whole ? groupOf(i) : 0;
      const Box3f& box = whole ? groups[group] : i.bound;
      return std::pair(box.min[axis] + box.max[axis], group);
    };
    std::stable_sort(items.begin() + std::ptrdiff_t(first), items.begin() + std::ptrdiff_t(end),
                     [&](const ClusterItem& a, const ClusterItem& b) { return key(a) < key(b); });
    // The border between groups, or items, that is nearest to the middle.
    size_t middle = 0;
    double sum = 0, best = kInfinity;
    for (size_t i = first + 1; i < end; ++i) {
      sum += items[i - 1].micropolygons;
      if (whole && groupOf(items[i - 1]) == groupOf(items[i])) continue;
      if (const double off = std::abs(sum - 0.5 * total); off < best) best = off, middle = i;
    }
    split(items, first, middle, cut);
    split(items, middle, end, cut);
    return;
  }
  auto c = std::make_unique<Cluster>();
  c->mask = cut.mask;
  const std::span<ClusterItem> own(items.data() + first, end - first);
  std::sort(own.begin(), own.end(), [&](const ClusterItem& a, const ClusterItem& b) {
    const PatchNode &m = cache_.node(a.node), &n = cache_.node(b.node);
    return std::tuple(a.object, m.root, m.dv, m.iv, m.du, m.iu) <
           std::tuple(b.object, n.root, n.dv, n.iv, n.du, n.iu);
  });
  c->items.reserve(own.size());
  std::map<uint32_t, Box3f> surfaces;
  for (const ClusterItem& i : own) {
    c->items.emplace_back(i.node, i.object);
    c->box.extend(i.bound);
    surfaces[cache_.skeleton().objects()[i.object].attributes].extend(i.bound);
    places_.push_back({cache_.node(i.node).root, i.node, uint32_t(clusters_.size())});
  }
  c->box = rounded(c->box);
  for (const auto& [attributes, box] : surfaces) c->surfaces.emplace_back(attributes, rounded(box));
  boxes_.push_back(c->box);
  clusters_.push_back(std::move(c));
}

void Clusters::attach(RTCScene scene, std::vector<std::vector<uint32_t>>& entryOfPrimitive) {
  std::map<uint32_t, BoxGeometry*> byMask;
  for (const auto& c : clusters_) {
    BoxGeometry*& g = byMask[c->mask];
    if (!g) {
      geometries_.push_back(std::make_unique<BoxGeometry>());
      g = geometries_.back().get();
      g->owner = this, g->mask = c->mask;
    }
    g->clusters.push_back(c.get());
  }
  for (const auto& g : geometries_) {
    RTCGeometry boxes = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(boxes, unsigned(g->clusters.size()));
    rtcSetGeometryUserData(boxes, g.get());
    rtcSetGeometryBoundsFunction(boxes, &Clusters::bounds, nullptr);
    rtcSetGeometryIntersectFunction(boxes, &Clusters::intersect);
    rtcSetGeometryOccludedFunction(boxes, &Clusters::occluded);
    rtcSetGeometryMask(boxes, g->mask);
    rtcCommitGeometry(boxes);
    rtcAttachGeometry(scene, boxes);
    rtcReleaseGeometry(boxes);
    entryOfPrimitive.emplace_back();  // its number in the scene is taken
  }
}

// ---- tracing
// ---------------------------------------------------------------------------------------------------------

void Clusters::bounds(const RTCBoundsFunctionArguments* a) {
  const Box3f& box = static_cast<const BoxGeometry*>(a->geometryUserPtr)->clusters[a->primID]->box;
  a->bounds_o->lower_x = box.min.x, a->bounds_o->lower_y = box.min.y, a->bounds_o->lower_z = box.min.z;
  a->bounds_o->upper_x = box.max.x, a->bounds_o->upper_y = box.max.y, a->bounds_o->upper_z = box.max.z;
}

// Only single-ray queries are made: N is 1, and the context is the first member of a HitFilter.

/// Walks through the tree that the context's ray sees in a box.
template <class Walk>
void Clusters::enter(void* geometry, uint32_t box, RTCIntersectContext* context, Walk&& walk) {
  const auto& g = *static_cast<const BoxGeometry*>(geometry);
  auto& filter = *reinterpret_cast<HitFilter*>(context);
  filter.wake();
  Cluster& c = *g.clusters[box];
  const Tree* tree = g.owner->use(c, g.owner->levelFor(c, *filter.ray));
  if (!tree) return;
  filter.within = &tree->part;
  walk(tree->part.scene);
  filter.within = nullptr;
  HazardSlot::mine().release();
}

void Clusters::intersect(const RTCIntersectFunctionNArguments* a) {
  if (!a->valid[0]) return;
  enter(a->geometryUserPtr, a->primID, a->context,
        [&](RTCScene scene) { rtcIntersect1(scene, a->context, reinterpret_cast<RTCRayHit*>(a->rayhit)); });
}

void Clusters::occluded(const RTCOccludedFunctionNArguments* a) {
  if (!a->valid[0]) return;
  enter(a->geometryUserPtr, a->primID, a->context,
        [&](RTCScene scene) { rtcOccluded1(scene, a->context, reinterpret_cast<RTCRay*>(a->ray)); });
}

int Clusters::levelFor(const Cluster& c, const Ray& ray) const {
  if (!byFootprint_ || (!(ray.radius > 0) && !(ray.spread > 0))) return 0;
  if (!c.described.load(std::memory_order_acquire))
    const_cast<Clusters*>(this)->dice(const_cast<Cluster&>(c));
  const float hidden =
      kHiddenDeviation * (ray.radius + std::max(0.0f, ray.spread) * distanceTo(c.box, ray.origin));
  int level = 0;
  while (level + 1 < c.levels && c.deviation[level + 1] <= hidden) ++level;
  return level;
}

const Clusters::Tree* Clusters::use(Cluster& c, int level) {
  const uint32_t now = clock_.load(std::memory_order_relaxed);
  if (c.lastUse.load(std::memory_order_relaxed) != now) c.lastUse.store(now, std::memory_order_relaxed);
  HazardSlot& slot = HazardSlot::mine();
  for (;;) {
    if (const Tree* t = slot.hold(c.tree[level])) return t->part.scene ? t : (slot.release(), nullptr);
    build(c, level);
  }
}

// ---- building
// ---------------------------------------------------------------------------------------------------------

/// What may belong to the same surfaces and stands in other clusters, by attribute state. Looked for whenever
/// a tree is built: that takes longer, and the lists of all clusters would be as large as many trees.
std::vector<std::pair<uint32_t, Box3f>> Clusters::foreignTo(const Cluster& c) const {
  std::vector<std::pair<uint32_t, Box3f>> foreign;
  for (size_t i = 0; i < boxes_.size(); ++i) {
    if (!boxes_[i].overlaps(c.box)) continue;
    const Cluster& other = *clusters_[i];
    if (&other == &c || other.mask != c.mask) continue;
    for (const auto& [attributes, box] : other.surfaces)
      if (std::any_of(c.surfaces.begin(), c.surfaces.end(),
                      [attributes = attributes](const auto& s) { return s.first == attributes; }))
        foreign.emplace_back(attributes, box);
  }
  return foreign;
}

std::vector<GatheredGrid> Clusters::gather(Cluster& c, int level) {
  std::vector<std::vector<GatheredGrid>> parts(c.items.size());
  // A thread that waits for others here must not take up other work: that may need this very cluster.
  tbb::this_task_arena::isolate([&] {
    tbb::parallel_for(tbb::blocked_range<size_t>(0, c.items.size(), 4), [&](const auto& range) {
      for (size_t i = range.begin(); i != range.end(); ++i) {
        const auto& [node, object] = c.items[i];
        ObjectFacts facts = facts_[object];
        facts.level = std::min(facts.level + level, kLevels - 1);
        gatherNode(cache_, node, object, facts, parts[i]);
      }
    });
  });
  std::vector<GatheredGrid> all;
  for (const auto& p : parts) all.insert(all.end(), p.begin(), p.end());
  orientGrids(cache_, all, nullptr);

  const auto foreign = foreignTo(c);
  if (!foreign.empty())
    for (GatheredGrid& g : all) {
      const ResolvedNode r = cache_.peek(g.entry.node);
      if (!r.grid) continue;
      const Box3f box = rounded(r.grid->bound);
      g.open = std::any_of(foreign.begin(), foreign.end(), [&](const auto& f) {
        return f.first == g.entry.attributes && f.second.overlaps(box);
      });
    }
  return all;
}

/// Finds out how far each level is from the truth. Dices everything in the cluster.
void Clusters::dice(Cluster& c) {
  const std::lock_guard lock(c.building);
  if (c.described.load(std::memory_order_relaxed)) return;
  const std::vector<GatheredGrid> grids = gather(c, 0);
  for (const GatheredGrid& g : grids) {
    if (g.entry.meshlet || g.entry.strip) continue;
    const ResolvedNode r = cache_.peek(g.entry.node);
    if (!r.grid) continue;
    const int last = std::clamp(int(r.grid->levels), 1, kLevels) - 1;
    for (int k = 0; k < kLevels; ++k) {
      const int level = std::min(int(g.entry.level) + k, last);
      const float d = r.grid->deviation[level];
      c.deviation[k] = std::max(c.deviation[k], level > 0 && std::isfinite(d) && d > 0 ? d : 0.0f);
    }
    c.levels = std::max(c.levels, last - int(g.entry.level) + 1);
  }
  for (int k = 1; k < kLevels; ++k) c.deviation[k] = std::max(c.deviation[k], c.deviation[k - 1]);
  diced_.fetch_add(1, std::memory_order_relaxed);
  c.described.store(true, std::memory_order_release);  // SYNC: pairs with levelFor()
}

const Clusters::Tree* Clusters::build(Cluster& c, int level) {
  dice(c);
  const std::lock_guard lock(c.building);
  if (const Tree* t = c.tree[level].load(std::memory_order_relaxed)) return t;
  std::vector<GatheredGrid> grids = gather(c, level);
  const bool fresh = !c.hasEntries[level];
  if (fresh) c.firstEntry[level] = entries_.append(grids.size()), c.hasEntries[level] = true;
  const uint32_t first = c.firstEntry[level];
  auto tree = std::make_unique<Tree>();
  RaySceneStatistics counts;
  tbb::this_task_arena::isolate([&] {
    buildPart(device_, cache_, grids, first, tree->part, counts);
    rtcJoinCommitScene(tree->part.scene);
  });
  if (fresh) {
    for (size_t i = 0; i < grids.size(); ++i) entries_[first + uint32_t(i)] = grids[i].entry;
    if (level == 0) {
      c.byNode.resize(grids.size());
      std::iota(c.byNode.begin(), c.byNode.end(), first);
      // The strips of a cluster of curves have one node; whoever asks for it gets the first of them.
      std::stable_sort(c.byNode.begin(), c.byNode.end(),
                       [&](uint32_t a, uint32_t b) { return entries_[a].node < entries_[b].node; });
      recordBytes_.fetch_add(c.byNode.size() * sizeof(uint32_t), std::memory_order_relaxed);
      c.listed.store(true, std::memory_order_release);  // SYNC: pairs with entryOf()
    }
    const std::lock_guard counting(mutex_);
    counts_.grids += counts.grids, counts_.meshlets += counts.meshlets;
    counts_.quads += counts.quads, counts_.triangles += counts.triangles;
    counts_.geometries += counts.geometries, counts_.stitchQuads += counts.stitchQuads;
  }
  tree->recordBytes = tree->part.recordBytes();
  recordBytes_.fetch_add(tree->recordBytes, std::memory_order_relaxed);
  built_.fetch_add(1, std::memory_order_relaxed);
  clock_.fetch_add(1, std::memory_order_relaxed);  // trees age by those that are built after them
  const Tree* t = tree.release();
  c.tree[level].store(t, std::memory_order_seq_cst);  // SYNC: HazardSlot
  return t;
}

uint32_t Clusters::entryOf(NodeId node) {
  if (node >= cache_.nodeCount()) return kNone;
  const PatchNode& n = cache_.node(node);
  auto place = std::lower_bound(places_.begin(), places_.end(), n.root,
                                [](const Place& p, uint32_t root) { return p.root < root; });
  for (; place != places_.end() && place->root == n.root; ++place) {
    const PatchNode& whole = cache_.node(place->node);
    if (n.du < whole.du || n.dv < whole.dv || n.iu >> (n.du - whole.du) != whole.iu ||
        n.iv >> (n.dv - whole.dv) != whole.iv)
      continue;
    Cluster& c = *clusters_[place->cluster];
    if (!c.listed.load(std::memory_order_acquire)) build(c, 0);
    const auto at = std::lower_bound(c.byNode.begin(), c.byNode.end(), node,
                                     [&](uint32_t e, NodeId wanted) { return entries_[e].node < wanted; });
    return at != c.byNode.end() && entries_[*at].node == node ? *at : kNone;
  }
  return kNone;
}

// ---- giving back
// ---------------------------------------------------------------------------------------------------------

uint64_t Clusters::giveBack(uint64_t bytes) {
  struct Idle {
    uint32_t lastUse;
    Cluster* cluster;
    int level;
  };
  std::vector<Idle> candidates;
  for (const auto& c : clusters_)
    for (int k = 0; k < kLevels; ++k)
      if (c->tree[k].load(std::memory_order_relaxed))
        candidates.push_back({c->lastUse.load(std::memory_order_relaxed), c.get(), k});
  std::sort(candidates.begin(), candidates.end(),
            [](const Idle& a, const Idle& b) { return a.lastUse < b.lastUse; });
  const int64_t before = embreeBytes_.load(std::memory_order_relaxed);
  const auto freed = [&] {
    return uint64_t(std::max<int64_t>(0, before - embreeBytes_.load(std::memory_order_relaxed)));
  };
  freeRetired();
  for (const Idle& k : candidates) {
    if (freed() >= bytes || embreeBytes_.load(std::memory_order_relaxed) <= leastBytes_) break;
    // SYNC: HazardSlot.
    const Tree* t = k.cluster->tree[k.level].exchange(nullptr, std::memory_order_seq_cst);
    if (!t) continue;
    evicted_.fetch_add(1, std::memory_order_relaxed);
    recordBytes_.fetch_sub(t->recordBytes, std::memory_order_relaxed);
    {
      const std::lock_guard lock(mutex_);
      retired_.emplace_back(t);
    }
    freeRetired();
  }
  // The allocator keeps freed memory for later; it is the system that needs it.
  if (freed() > 0) ::malloc_trim(0);
  return freed();
}

void Clusters::freeRetired() {
  const std::lock_guard lock(mutex_);
  std::erase_if(retired_, [](const auto& t) { return !HazardSlot::isHeld(t.get()); });
}

void Clusters::count(RaySceneStatistics& s) const {
  const std::lock_guard lock(mutex_);
  s.grids += counts_.grids, s.meshlets += counts_.meshlets;
  s.quads += counts_.quads, s.triangles += counts_.triangles;
  s.geometries += counts_.geometries, s.stitchQuads += counts_.stitchQuads;
  s.recordBytes += recordBytes_.load(std::memory_order_relaxed);
  s.clusters = clusters_.size(), s.clustersDiced = diced_.load(std::memory_order_relaxed);
  s.treesBuilt = built_.load(std::memory_order_relaxed),
  s.treesFreed = evicted_.load(std::memory_order_relaxed);
}

}  // namespace fr::tracer
