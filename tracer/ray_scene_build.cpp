// Building RayScene: what is traced as one flat tree, as prototypes and their instances, as solids, and in
// clusters.
#include <malloc.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <map>

#include "base/cores.h"
#include "base/isa.h"
#include "scene_cache/dice_estimate.h"
#include "scene_cache/view_volume.h"
#include "tracer/clusters.h"
#include "tracer/ray_scene_embree.h"
#include "tracer/ray_solids.h"

namespace fr::tracer {

using namespace cache;

namespace {

/// Mask of the geometries of solids: all is asked for, what is seen is decided afterwards.
constexpr uint32_t kSolidMask = 0x80;
/// Pieces of large patches go into clusters by themselves from this part of a cluster on.
constexpr double kLargeItem = 0.25;

/// Objects that one ObjectInstance made of prototypes.
struct InstanceGroup {
  std::vector<ObjectId> objects;
  uint32_t prototype = 0;
};

}  // namespace

class RaySceneBuilder {
 public:
  RaySceneBuilder(SceneCache& cache, const std::function<bool(ObjectId)>& opaqueCaster,
                  const RaySceneOptions& options)
      : cache_(cache), opaqueCaster_(opaqueCaster), options_(options), scene_(new RayScene) {}

  Result<std::unique_ptr<RayScene>> build() {
    const auto t0 = std::chrono::steady_clock::now();
    scene_->cache_ = &cache_;
    for (const AttributeRecord& a : cache_.skeleton().attributes())
      scene_->thinned_ |= a.thinning[0] > 0 || a.thinning[1] > 0;
    scene_->solids_ = SolidForest(cache_.skeleton());
    scene_->solidTrees_.resize(scene_->solids_.treeCount());
    const int cores = availableCores();  // oneTBB has no more workers
    threads_ = options_.threads > 0 ? std::min(options_.threads, cores) : cores;
    if (Result<void> r = openDevice(); !r) return std::move(r).error();
    if (Result<void> r = scene_->entries_.open(cache_.scratch()); !r)
      return std::move(r).error().context("records of traced grids");
    tbb::task_arena arena(threads_);
    arena.execute([&] { gatherAll(); });
    const auto t1 = std::chrono::steady_clock::now();
    arena.execute([&] { makeScenes(); });
    ::malloc_trim(0);  // building takes several times what remains, and the allocator would keep it
    const RayScene::Embree& em = *scene_->embree_;
    if (em.error != RTC_ERROR_NONE)
      return makeError(em.error == RTC_ERROR_OUT_OF_MEMORY ? RiError::kNoMem : RiError::kSystem,
                       "the acceleration structure for rays cannot be built: Embree says \"{}\"", em.message);
    const auto t2 = std::chrono::steady_clock::now();
    scene_->statistics_.resolveSeconds = std::chrono::duration<double>(t1 - t0).count();
    scene_->statistics_.buildSeconds = std::chrono::duration<double>(t2 - t1).count();
    return std::move(scene_);
  }

 private:
  struct Part {
    std::vector<GatheredGrid> grids;
    uint32_t firstEntry = 0;
  };
  struct Prototype {
    std::vector<ObjectId> objects;
    int level = 0;
    Part part;
    std::map<NodeId, uint32_t> gridOfNode;
  };

  // ---- what there is

  void gatherAll() {
    const auto objects = cache_.skeleton().objects();
    facts_.resize(objects.size());
    solidTreeOf_.assign(objects.size(), kNone);
    for (ObjectId i = 0; i < objects.size(); ++i) {
      facts_[i] = factsOf(cache_.skeleton(), i, opaqueCaster_, options_);
      const SolidId leaf = solidOf(objects[i]);
      if (leaf == kNone) continue;
      solidTreeOf_[i] = scene_->solids_.treeOf(leaf);
      scene_->solidTrees_[solidTreeOf_[i]].mask |= facts_[i].mask;
    }
    solids_.resize(scene_->solidTrees_.size());
    std::vector<ObjectId> plain;
    std::vector<std::vector<ObjectId>> ofSolids(solids_.size());
    for (ObjectId i = 0; i < objects.size(); ++i) {
      if (const uint32_t tree = solidTreeOf_[i]; tree != kNone) {
        // What cannot be seen shapes the solid that it is a part of.
        if ((objects[i].sides & kForTracer) && scene_->solidTrees_[tree].mask != 0)
          ofSolids[tree].push_back(i);
      } else if (facts_[i].mask == 0) {
      } else if (objects[i].prototype == kNone) {
        plain.push_back(i);
      } else {
        i = addGroup(i);
      }
    }
    const std::vector<ObjectId> flat = chooseFlat(plain);
    gatherObjects(flat, nullptr, main_.grids);
    orientGrids(cache_, main_.grids, nullptr);
    for (size_t t = 0; t < solids_.size(); ++t) {
      gatherObjects(ofSolids[t], nullptr, solids_[t].grids);
      orientGrids(cache_, solids_[t].grids, nullptr);
      for (GatheredGrid& g : solids_[t].grids) g.key.mask = kSolidMask;
    }
    for (Prototype& p : prototypes_) {
      ObjectFacts all;
      all.mask = ~0u, all.level = p.level;
      gatherObjects(p.objects, &all, p.part.grids);
      for (size_t k = 0; k < p.part.grids.size(); ++k) p.gridOfNode[p.part.grids[k].entry.node] = uint32_t(k);
    }
    placed_.resize(groups_.size());
    scene_->instances_.resize(groups_.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, groups_.size(), 16),
                      [&](const tbb::blocked_range<size_t>& r) {
                        for (size_t i = r.begin(); i != r.end(); ++i) placeInstance(i);
                      });
  }

  /// The objects of an instance stand one after the other; returns the last one.
  ObjectId addGroup(ObjectId first) {
    const auto objects = cache_.skeleton().objects();
    std::pair<std::vector<ObjectId>, int> key{{}, facts_[first].level};
    InstanceGroup group;
    ObjectId i = first;
    for (; i < objects.size() && objects[i].prototype != kNone &&
           objects[i].instance == objects[first].instance &&
           objects[i].attributes == objects[first].attributes && objects[i].sides == objects[first].sides;
         ++i) {
      facts_[i] = facts_[first];
      group.objects.push_back(i);
      key.first.push_back(objects[i].prototype);
    }
    const auto [at, fresh] = prototypeOf_.try_emplace(key, uint32_t(prototypes_.size()));
    if (fresh) {
      prototypes_.emplace_back();
      prototypes_.back().objects = key.first, prototypes_.back().level = key.second;
    }
    group.prototype = at->second;
    groups_.push_back(std::move(group));
    return i - 1;
  }

  LevelChoice levelChoice() const {
    const Skeleton& s = cache_.skeleton();
    const ParamRecord* p = s.find(s.options().options, "trace:levels");
    if (!p || s.strings(*p).empty()) return options_.levels;
    const std::string_view word = s.string(s.strings(*p)[0]);
    return word == "on" ? LevelChoice::kOn : word == "off" ? LevelChoice::kOff : LevelChoice::kAuto;
  }

  /// Puts into clusters what need not be diced before a ray comes near, and returns the other objects.
  /// Surfaces that may be in several pieces are never torn apart between the two.
  std::vector<ObjectId> chooseFlat(const std::vector<ObjectId>& plain) {
    const Skeleton& skeleton = cache_.skeleton();
    const auto objects = skeleton.objects();
    const auto roots = skeleton.rootPatches();
    const DiceEye eye = diceEye(skeleton.camera(), skeleton.cacheToCamera(skeleton.camera().shutter[0]));
    const auto rateOf = [&](const ObjectRecord& o) {
      return diceRate(eye, skeleton.attributes()[o.attributes], o.type, o.fixedRate);
    };
    const auto displacementOf = [&](const ObjectRecord& o) {
      return skeleton.attributes()[o.attributes].displacementBound;
    };
    const auto isBounded = [](const Box3f& b) { return !b.empty() && isFinite(b.min) && isFinite(b.max); };
    double total = 0;
    for (const ObjectId i : plain) {
      const DiceRate rate = rateOf(objects[i]);
      for (uint32_t p = 0; p < objects[i].patchCount && total <= options_.flatMicropolygons; ++p)
        total +=
            estimateMicropolygons(rate, roots[objects[i].firstPatch + p].bound, displacementOf(objects[i]));
    }
    const LevelChoice levels = levelChoice();
    const bool large = total > options_.flatMicropolygons || levels == LevelChoice::kOn;
    const ViewVolume view(skeleton);
    std::map<uint32_t, bool> flatGroup;  // by surface group
    for (const ObjectId i : plain) {
      const ObjectRecord& o = objects[i];
      const AttributeRecord& a = skeleton.attributes()[o.attributes];
      // What may be displaced out of its box cannot wait behind it.
      const bool unbounded = !isBounded(o.bound) || (a.displacement != kNone && !(a.displacementBound > 0));
      flatGroup[o.surfaceGroup] =
          flatGroup[o.surfaceGroup] || unbounded || !(large || view.isOutside(o.bound));
    }
    std::vector<ObjectId> flat;
    std::vector<ClusterItem> items;
    for (const ObjectId i : plain) {
      if (flatGroup[objects[i].surfaceGroup]) {
        flat.push_back(i);
        continue;
      }
      const DiceRate rate = rateOf(objects[i]);
      for (uint32_t p = 0; p < objects[i].patchCount; ++p)
        addItems(objects[i].firstPatch + p, i, rate, displacementOf(objects[i]),
                 roots[objects[i].firstPatch + p].bound, items, 0);
    }
    if (items.empty()) return flat;
    scene_->clusters_ = std::make_unique<Clusters>(scene_->embree_->device, cache_, facts_, scene_->entries_,
                                                   scene_->embree_->bytes, options_.leastTreeBytes,
                                                   levels != LevelChoice::kOff);
    scene_->clusters_->add(std::move(items), options_.clusterMicropolygons);
    return flat;
  }

  void addItems(NodeId node, ObjectId object, const DiceRate& rate, float displacement, const Box3f& bound,
                std::vector<ClusterItem>& items, int depth) {
    const double size = estimateMicropolygons(rate, bound, displacement);
    if (depth < 64 && size > kLargeItem * options_.clusterMicropolygons) {
      const ResolvedNode r = cache_.resolve(node);
      if (r.state == NodeState::kSplit) {
        for (const NodeId child : r.children)
          if (child < cache_.nodeCount())
            addItems(child, object, rate, displacement, cache_.node(child).bound, items, depth + 1);
        return;
      }
    }
    items.push_back({node, object, bound, std::max(size, 1.0)});
  }

  /// Appends the grids of these objects, root after root in the order given, whoever resolves them. `facts`
  /// nullptr: each object's own.
  void gatherObjects(const std::vector<ObjectId>& objects, const ObjectFacts* facts,
                     std::vector<GatheredGrid>& to) {
    const auto records = cache_.skeleton().objects();
    std::vector<std::pair<ObjectId, NodeId>> roots;
    for (const ObjectId o : objects)
      for (uint32_t p = 0; p < records[o].patchCount; ++p) roots.emplace_back(o, records[o].firstPatch + p);
    std::vector<std::vector<GatheredGrid>> parts(roots.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, roots.size(), 16),
                      [&](const tbb::blocked_range<size_t>& r) {
                        for (size_t i = r.begin(); i != r.end(); ++i)
                          gatherNode(cache_, roots[i].second, roots[i].first,
                                     facts ? *facts : facts_[roots[i].first], parts[i]);
                      });
    size_t total = to.size();
    for (const auto& p : parts) total += p.size();
    to.reserve(total);
    for (auto& p : parts) {
      to.insert(to.end(), p.begin(), p.end());
      p = {};
    }
  }

  /// Entries of an instance, in the order of its prototype's; what is missing has no node.
  void placeInstance(size_t index) {
    const InstanceGroup& group = groups_[index];
    const Prototype& prototype = prototypes_[group.prototype];
    const auto objects = cache_.skeleton().objects();
    const DMat3 m(cache_.skeleton().placement(objects[group.objects[0]]));
    RayScene::Instance& instance = scene_->instances_[index];
    instance.prototype = group.prototype;
    instance.normals = Mat3(DMat3(glm::cross(m[1], m[2]), glm::cross(m[2], m[0]), glm::cross(m[0], m[1])));
    std::vector<GatheredGrid> own;
    for (const ObjectId o : group.objects)
      for (uint32_t p = 0; p < objects[o].patchCount; ++p)
        gatherNode(cache_, objects[o].firstPatch + p, o, facts_[o], own);
    orientGrids(cache_, own, &instance.normals);
    std::vector<SurfaceEntry>& entries = placed_[index];
    entries.resize(prototype.part.grids.size());
    for (SurfaceEntry& e : entries) e = {}, e.node = kNone;
    for (const GatheredGrid& p : own) {
      const uint32_t shared = cache_.node(p.entry.node).prototype;
      const auto at = prototype.gridOfNode.find(shared - 1);
      if (shared == 0 || at == prototype.gridOfNode.end()) continue;
      const SurfaceEntry& like = prototype.part.grids[at->second].entry;
      if (p.entry.cellsU == like.cellsU && p.entry.cellsV == like.cellsV && p.entry.level == like.level)
        entries[at->second] = p.entry;
    }
  }

  // ---- Embree

  Result<void> openDevice() {
    RayScene::Embree& em = *scene_->embree_;
    const char* isa = portableIsa() == Isa::kSse4   ? "isa=sse4.2"
                      : portableIsa() == Isa::kAvx2 ? "isa=avx2"
                                                    : "isa=avx512";
    const std::string config = fmt::format("threads={},{},start_threads=0,set_affinity=0", threads_, isa);
    em.device = rtcNewDevice(config.c_str());
    if (!em.device) {
      const RTCError code = rtcGetDeviceError(nullptr);
      if (code == RTC_ERROR_OUT_OF_MEMORY)
        return makeError(RiError::kNoMem, "Embree cannot be started: out of memory");
      return makeError(RiError::kSystem, "Embree cannot be started (error {})", int(code));
    }
    rtcSetDeviceErrorFunction(
        em.device,
        [](void* p, RTCError code, const char* text) {
          auto* e = static_cast<RayScene::Embree*>(p);
          e->error = code;
          e->message = text ? text : "";
        },
        &em);
    rtcSetDeviceMemoryMonitorFunction(
        em.device,
        [](void* p, ssize_t bytes, bool) {
          auto* e = static_cast<RayScene::Embree*>(p);
          const int64_t now = e->bytes.fetch_add(bytes) + bytes;
          int64_t peak = e->peak.load();
          while (now > peak && !e->peak.compare_exchange_weak(peak, now)) {
          }
          return true;
        },
        &em);
    for (RTCDeviceProperty needed :
         {RTC_DEVICE_PROPERTY_RAY_MASK_SUPPORTED, RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED})
      if (!rtcGetDeviceProperty(em.device, needed))
        return makeError(RiError::kIncapable, "this Embree was built without ray masks or filter functions");
    return {};
  }

  void makeScenes() {
    RayScene& s = *scene_;
    RayScene::Embree& em = *s.embree_;
    makePart(main_, em.main);
    em.solids.resize(solids_.size());
    for (size_t t = 0; t < solids_.size(); ++t) {
      if (solids_[t].grids.empty()) continue;
      makePart(solids_[t], em.solids[t]);
      rtcJoinCommitScene(em.solids[t].scene);
      ++s.statistics_.solids;
    }
    em.prototypes.resize(prototypes_.size());
    for (size_t i = 0; i < prototypes_.size(); ++i) {
      makePart(prototypes_[i].part, em.prototypes[i]);
      rtcJoinCommitScene(em.prototypes[i].scene);
    }
    if (s.statistics_.solids > 0) SolidRays::attach(s);
    if (s.clusters_) s.clusters_->attach(em.main.scene, em.main.entryOfPrimitive);
    s.firstInstance_ = uint32_t(em.main.entryOfPrimitive.size());
    for (size_t i = 0; i < groups_.size(); ++i) attachInstance(i);
    s.statistics_.prototypes = prototypes_.size(), s.statistics_.instances = groups_.size();
    listNodes();
    main_ = {}, solids_ = {}, prototypes_ = {}, groups_ = {}, placed_ = {};
    rtcJoinCommitScene(em.main.scene);
    RTCBounds b;
    rtcGetSceneBounds(em.main.scene, &b);
    s.bound_ = {Vec3(b.lower_x, b.lower_y, b.lower_z), Vec3(b.upper_x, b.upper_y, b.upper_z)};
  }

  void makePart(Part& part, TracedPart& traced) {
    part.firstEntry = scene_->entries_.append(part.grids.size());
    double cells = 0;
    for (const GatheredGrid& g : part.grids)
      if (!g.key.meshlet && g.key.keys == 1) cells += double(g.entry.cellsU) * g.entry.cellsV;
    const bool quads = quadCells_ + cells <= options_.quadCells;
    if (quads) quadCells_ += cells;
    buildPart(scene_->embree_->device, cache_, part.grids, part.firstEntry, traced, scene_->statistics_,
              quads ? CellType::kQuads : CellType::kGrids);
    for (size_t i = 0; i < part.grids.size(); ++i)
      scene_->entries_[part.firstEntry + uint32_t(i)] = part.grids[i].entry;
  }

  void attachInstance(size_t index) {
    RayScene::Embree& em = *scene_->embree_;
    const InstanceGroup& group = groups_[index];
    const Part& prototype = prototypes_[group.prototype].part;
    const uint32_t first = scene_->entries_.append(placed_[index].size());
    scene_->instances_[index].shift = first - prototype.firstEntry;
    for (size_t k = 0; k < placed_[index].size(); ++k) {
      // Where its primitives are was found out for the prototype.
      const SurfaceEntry& like = prototype.grids[k].entry;
      SurfaceEntry& e = placed_[index][k];
      e.stitched = like.stitched, e.firstTriangle = like.firstTriangle;
      scene_->entries_[first + uint32_t(k)] = e;
    }
    const DMat4 m = cache_.skeleton().placement(cache_.skeleton().objects()[group.objects[0]]);
    float columns[12];
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 3; ++r) columns[c * 3 + r] = float(m[c][r]);
    RTCGeometry g = rtcNewGeometry(em.device, RTC_GEOMETRY_TYPE_INSTANCE);
    rtcSetGeometryInstancedScene(g, em.prototypes[group.prototype].scene);
    rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, columns);
    rtcSetGeometryMask(g, facts_[group.objects[0]].mask);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(em.main.scene, g);
    FR_CHECK(id == scene_->firstInstance_ + index);
    rtcReleaseGeometry(g);
  }

  void listNodes() {
    RayScene& s = *scene_;
    NodeId lastNode = 0;
    for (uint32_t i = 0; i < s.entries_.size(); ++i)
      if (s.entries_[i].node != kNone) lastNode = std::max(lastNode, s.entries_[i].node);
    s.entryOfNode_.assign(s.entries_.size() == 0 ? 0 : size_t(lastNode) + 1, kNone);
    for (uint32_t i = 0; i < s.entries_.size(); ++i)
      if (s.entries_[i].node != kNone) s.entryOfNode_[s.entries_[i].node] = i;
  }

  SceneCache& cache_;
  const std::function<bool(ObjectId)>& opaqueCaster_;
  RaySceneOptions options_;
  std::unique_ptr<RayScene> scene_;
  int threads_ = 1;
  std::vector<ObjectFacts> facts_;     // by object
  std::vector<uint32_t> solidTreeOf_;  // by object
  double quadCells_ = 0;               // of the parts that are quadrilaterals
  Part main_;
  std::vector<Part> solids_;                                               // by tree
  std::map<std::pair<std::vector<ObjectId>, int>, uint32_t> prototypeOf_;  // by objects and level
  std::vector<Prototype> prototypes_;
  std::vector<InstanceGroup> groups_;
  std::vector<std::vector<SurfaceEntry>> placed_;  // by group, in the order of the prototype's entries
};

Result<std::unique_ptr<RayScene>> RayScene::build(SceneCache& cache,
                                                  const std::function<bool(ObjectId)>& opaqueCaster,
                                                  const RaySceneOptions& options) {
  return RaySceneBuilder(cache, opaqueCaster, options).build();
}

}  // namespace fr::tracer
