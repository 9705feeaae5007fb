// Building RayScene: resolve, validate, sort into classes, hand to Embree.
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <map>
#include <thread>
#include <tuple>

#include "base/cores.h"
#include "base/isa.h"
#include "scene_cache/primitive_source.h"
#include "tracer/border_stitch.h"
#include "tracer/ray_scene_embree.h"
#include "tracer/ray_solids.h"

namespace fr::tracer {

using namespace cache;

namespace {

/// Vertex buffers are addressed by 32-bit indices and end 16 GB after their start (Embree); windows of half
/// of that always hold a grid that starts in them.
constexpr uint64_t kWindow = (uint64_t(8) << 30) / kPositionAlign * kPositionAlign;
/// Embree loads 16 bytes for a vertex of 12.
constexpr uint64_t kVertexOverread = 4;
constexpr unsigned kMaxKeys = 129;  // RTC_MAX_TIME_STEP_COUNT
/// Mask of the geometries of solids: all is asked for, what is seen is decided afterwards.
constexpr uint32_t kSolidMask = 0x80;

/// Grids of one class share an Embree geometry.
struct ClassKey {
  uint32_t part;  // a tree of solids, or, behind all of these, a prototype; kNone: neither
  bool meshlet;
  uint32_t mask;
  uint32_t level;
  uint32_t keys;
  uint64_t keyBytes;
  uint64_t window;
  auto operator<=>(const ClassKey&) const = default;
};

/// A checked grid before it is sorted into its class.
struct Prepared {
  SurfaceEntry entry;
  ClassKey key;
  uint32_t startVertex;  // in units of the class's byte stride, from its window's start
  uint32_t rowStride;
  uint64_t indices;  // meshlets
};

/// Objects that one ObjectInstance made of prototypes.
struct InstanceGroup {
  std::vector<ObjectId> objects;
  uint32_t prototype = 0;
};

float sane(float x, float otherwise) { return std::isfinite(x) && x >= 0 ? x : otherwise; }

/// Largest power of two of vertices to skip, as an exponent: multiplier 1 -> 0, 0.5 -> 1, 0.3 -> 2 (rounded
/// down to 0.25).
int wantedLevel(float multiplier) {
  if (!(multiplier > 0)) return kLevels - 1;
  int level = 0;
  for (float m = 1; m > multiplier && level < kLevels - 1; m *= 0.5f) ++level;
  return level;
}

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
    tbb::task_arena arena(threads_);
    arena.execute([&] { prepareAll(); });
    const auto t1 = std::chrono::steady_clock::now();
    Result<void> made = makeGeometries();
    if (!made) return std::move(made).error();
    const auto t2 = std::chrono::steady_clock::now();
    scene_->statistics_.resolveSeconds = std::chrono::duration<double>(t1 - t0).count();
    scene_->statistics_.buildSeconds = std::chrono::duration<double>(t2 - t1).count();
    return std::move(scene_);
  }

 private:
  struct ObjectFacts {
    uint32_t mask = 0;
    uint32_t part = kNone;  // as ClassKey::part
    int level = 0;
    bool visible = false;
    bool oneSided = false;
    CastsShadows castsShadows = CastsShadows::kOpaque;
    bool opaqueCaster = false;
  };

  struct PrototypeParts {
    std::vector<ObjectId> objects;
    int level = 0;
    uint32_t firstEntry = 0, endEntry = 0;
    std::map<NodeId, uint32_t> entryOfNode;
  };

  ObjectFacts factsOf(ObjectId id) const {
    const ObjectRecord& o = cache_.skeleton().objects()[id];
    ObjectFacts f;
    if (!(o.sides & kForTracer)) return f;
    const auto attributes = cache_.skeleton().attributes();
    if (o.attributes >= attributes.size()) return f;
    const AttributeRecord& a = attributes[o.attributes];
    if (options_.cameraRays && (a.visibility & kVisibleCamera)) f.mask |= kCameraRay;
    if (a.visibility & kVisibleReflection)
      f.mask |=
          (a.flags & kNoSpecularRays ? 0u : kReflectionRay) | (a.flags & kNoDiffuseRays ? 0u : kDiffuseRay);
    if ((a.visibility & kVisibleShadow) && a.castsShadows != CastsShadows::kNever) {
      f.opaqueCaster = opaqueCaster_(id);
      f.mask |= f.opaqueCaster ? kOpaqueShadowRay : kFilteredShadowRay;
    }
    f.visible = f.mask != 0;
    f.level = wantedLevel(a.patchMultiplier >= 0 ? a.patchMultiplier : options_.patchMultiplier);
    f.oneSided = a.sides == 1;
    f.castsShadows = a.castsShadows;
    return f;
  }

  void prepareAll() {
    const auto objects = cache_.skeleton().objects();
    std::vector<ObjectFacts>& facts = facts_;
    facts.resize(objects.size());
    for (ObjectId i = 0; i < objects.size(); ++i) {
      facts[i] = factsOf(i);
      const SolidId leaf = solidOf(objects[i]);
      if (leaf == kNone) continue;
      facts[i].part = scene_->solids_.treeOf(leaf);
      scene_->solidTrees_[facts[i].part].mask |= facts[i].mask;
    }
    std::vector<ObjectId> flat;
    for (ObjectId i = 0; i < objects.size(); ++i) {
      // What cannot be seen shapes the solid that it is a part of.
      if (facts[i].part != kNone)
        facts[i].visible = (objects[i].sides & kForTracer) && scene_->solidTrees_[facts[i].part].mask != 0;
      if (!facts[i].visible) continue;
      if (objects[i].prototype == kNone) {
        flat.push_back(i);
      } else {
        i = addGroup(i);
      }
    }
    prepareObjects(flat, nullptr, prepared_);
    orient(prepared_, nullptr);
    for (size_t i = 0; i < prototypes_.size(); ++i) {
      ObjectFacts all;
      all.mask = ~0u, all.level = prototypes_[i].level;
      all.part = uint32_t(scene_->solidTrees_.size() + i);
      prototypes_[i].firstEntry = uint32_t(prepared_.size());
      prepareObjects(prototypes_[i].objects, &all, prepared_);
      for (size_t k = prototypes_[i].firstEntry; k < prepared_.size(); ++k)
        prototypes_[i].entryOfNode[prepared_[k].entry.node] = uint32_t(k);
      prototypes_[i].endEntry = uint32_t(prepared_.size());
    }
    placed_.resize(groups_.size());
    scene_->prototypes_.resize(prototypes_.size());
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

  /// Appends the grids of these objects, root after root in the order given, whoever resolves them. `facts`
  /// nullptr: each object's own.
  void prepareObjects(const std::vector<ObjectId>& objects, const ObjectFacts* facts,
                      std::vector<Prepared>& to) {
    const auto records = cache_.skeleton().objects();
    std::vector<std::pair<ObjectId, NodeId>> roots;
    for (const ObjectId o : objects)
      for (uint32_t p = 0; p < records[o].patchCount; ++p) roots.emplace_back(o, records[o].firstPatch + p);
    std::vector<std::vector<Prepared>> parts(roots.size());
    tbb::parallel_for(tbb::blocked_range<size_t>(0, roots.size(), 16),
                      [&](const tbb::blocked_range<size_t>& r) {
                        for (size_t i = r.begin(); i != r.end(); ++i)
                          prepareNode(roots[i].second, roots[i].first,
                                      facts ? *facts : facts_[roots[i].first], parts[i], 0);
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
    const PrototypeParts& prototype = prototypes_[group.prototype];
    const auto objects = cache_.skeleton().objects();
    const DMat3 m(cache_.skeleton().placement(objects[group.objects[0]]));
    RayScene::Instance& instance = scene_->instances_[index];
    instance.prototype = group.prototype;
    instance.normals = Mat3(DMat3(glm::cross(m[1], m[2]), glm::cross(m[2], m[0]), glm::cross(m[0], m[1])));
    std::vector<Prepared> own;
    for (const ObjectId o : group.objects)
      for (uint32_t p = 0; p < objects[o].patchCount; ++p)
        prepareNode(objects[o].firstPatch + p, o, facts_[o], own, 0);
    orient(own, &instance.normals);
    std::vector<SurfaceEntry>& entries = placed_[index];
    entries.resize(prototype.endEntry - prototype.firstEntry);
    for (SurfaceEntry& e : entries) e = {}, e.node = kNone;
    for (const Prepared& p : own) {
      const uint32_t shared = cache_.node(p.entry.node).prototype;
      const auto at = prototype.entryOfNode.find(shared - 1);
      if (shared == 0 || at == prototype.entryOfNode.end()) continue;
      const SurfaceEntry& like = prepared_[at->second].entry;
      if (p.entry.cellsU == like.cellsU && p.entry.cellsV == like.cellsV && p.entry.level == like.level)
        entries[at->second - prototype.firstEntry] = p.entry;
    }
  }

  void prepareNode(NodeId id, ObjectId object, const ObjectFacts& facts, std::vector<Prepared>& out,
                   int depth) {
    if (depth > 64) return;  // dyadic rectangles have at most 32 + 32 halvings
    const ResolvedNode r = cache_.resolve(id);
    if (r.state == NodeState::kSplit) {
      for (NodeId child : r.children)
        if (child < cache_.nodeCount()) prepareNode(child, object, facts, out, depth + 1);
    } else if (r.state == NodeState::kGrid && r.grid) {
      Prepared p;
      if (!prepareGrid(id, object, facts, *r.grid, p)) return;
      if (p.entry.meshlet && cache_.skeleton().objects()[object].type == PrimitiveType::kCurves) {
        addStrips(p, out);
      } else {
        out.push_back(p);
      }
    }
  }

  /// The ribbons of a cluster of curves as grids: an eighth of the memory of their triangles.
  void addStrips(const Prepared& meshlet, std::vector<Prepared>& out) const {
    const Skeleton& s = cache_.skeleton();
    const auto* source = sourceRecord<CurvesSource>(s, s.objects()[meshlet.entry.object]);
    if (!source) return;
    const auto clusters = sourceArray<CurveCluster>(s, source->clusters);
    const auto all = sourceArray<CurvePiece>(s, source->pieces);
    const uint32_t face = cache_.rootOf(meshlet.entry.node).face;
    if (face >= clusters.size()) return;
    const CurveCluster& cluster = clusters[face];
    if (cluster.firstPiece > all.size() || cluster.pieceCount > all.size() - cluster.firstPiece) return;
    const uint32_t vertices = meshlet.entry.cellsU, triangles = meshlet.entry.cellsV;
    for (const CurvePiece& piece : all.subspan(cluster.firstPiece, cluster.pieceCount)) {
      if (piece.columns == 0 || piece.rows == 0 ||
          piece.firstVertex + (piece.columns + 1u) * (piece.rows + 1u) > vertices ||
          piece.firstTriangle + 2u * piece.columns * piece.rows > triangles)
        continue;
      Prepared p = meshlet;
      p.key.meshlet = false;
      p.startVertex += piece.firstVertex;
      p.rowStride = piece.columns + 1u;
      p.entry.meshlet = 0, p.entry.strip = 1;
      p.entry.cellsU = piece.columns, p.entry.cellsV = piece.rows;
      p.entry.firstTriangle = piece.firstTriangle;
      out.push_back(p);
    }
  }

  /// Copies the descriptor, then trusts only the copy.
  bool prepareGrid(NodeId id, ObjectId object, const ObjectFacts& facts, const GridRecord& shared,
                   Prepared& p) {
    const GridRecord g = shared;
    if (g.flags & kGridAbsent) return false;
    const bool meshlet = g.kind == GridKind::kMeshlet;
    // Faces that name one or two vertices three times have no area.
    if (meshlet && g.nu > 0 && g.nu < 3) return false;
    const uint64_t arenaBytes = cache_.arena().size();
    const uint64_t vertices = meshlet ? g.nu : uint64_t(g.nv) * g.rowStride + g.nu + 1;
    const bool shapeOk =
        meshlet ? g.nu >= 3 && g.nu <= kMaxMeshletVertices && g.nv >= 1 && g.nv <= kMaxMeshletTriangles
                : g.nu >= 1 && g.nv >= 1 && g.nu <= kMaxGridSide && g.nv <= kMaxGridSide &&
                      g.rowStride > g.nu && g.rowStride <= 4096;
    const uint64_t keyBytes = g.keyCount > 1 ? g.keyBytes : 0;
    const bool keysOk = g.keyCount >= 1 && g.keyCount <= kMaxKeys && keyBytes % 4 == 0 &&
                        keyBytes <= arenaBytes && (g.keyCount == 1 || keyBytes >= vertices * 12);
    const uint64_t bytes =
        keysOk && shapeOk ? keyBytes * (g.keyCount - 1u) + vertices * 12 + kVertexOverread : 0;
    const bool placeOk =
        g.positions % kPositionAlign == 0 && bytes <= arenaBytes && g.positions <= arenaBytes - bytes;
    const bool indicesOk = !meshlet || (g.indices != 0 && g.indices <= arenaBytes &&
                                        g.nv * uint64_t(3) <= arenaBytes - g.indices);
    if (!(shapeOk && keysOk && placeOk && indicesOk)) {
      reportOnce("tracer.bad-grid", makeError(RiError::kBadFile,
                                              "a grid of the scene cache (patch {}) is damaged and "
                                              "is left out of ray tracing",
                                              id));
      return false;
    }

    int level = 0;
    if (!meshlet) {
      level = std::min(facts.level, std::clamp(int(g.levels), 1, kLevels) - 1);
      while (level > 0 && (g.nu % (1 << level) || g.nv % (1 << level))) --level;
    }
    const uint64_t window = g.positions / kWindow;
    const uint64_t step = uint64_t(12) << level;
    p.key = {facts.part, meshlet, isSolid(facts.part) ? kSolidMask : facts.mask, uint32_t(level), g.keyCount,
             keyBytes,   window};
    p.startVertex = uint32_t((g.positions - window * kWindow) / step);
    p.rowStride = g.rowStride;
    p.indices = meshlet ? g.indices : 0;

    const PatchNode& node = cache_.node(id);
    SurfaceEntry& e = p.entry;
    e = {};
    e.node = id;
    e.object = object;
    const ObjectRecord& o = cache_.skeleton().objects()[object];
    e.attributes = o.attributes;
    e.surfaceGroup = o.surfaceGroup;
    e.uScale = std::ldexp(1.0f, -int(std::min<uint8_t>(node.du, 32)));
    e.vScale = std::ldexp(1.0f, -int(std::min<uint8_t>(node.dv, 32)));
    e.u0 = std::clamp(float(node.iu) * e.uScale, 0.0f, 1.0f);
    e.v0 = std::clamp(float(node.iv) * e.vScale, 0.0f, 1.0f);
    const float diagonal = sane(g.bound.diagonal(), 0);
    e.cellSize = sane(g.cellSize, diagonal) * float(1 << level);
    e.deviation = meshlet ? 0 : sane(g.deviation[0], 0) + (level ? sane(g.deviation[level], 0) : 0);
    e.shadedDeviation = meshlet ? 0 : sane(g.deviation[0], 0);
    e.cellsU = uint16_t(g.nu >> level);
    e.cellsV = uint16_t(g.nv >> level);
    e.orientation = 1;
    e.oneSided = facts.oneSided;
    e.meshlet = meshlet;
    e.level = uint8_t(level);
    e.mask = uint8_t(facts.mask);
    e.moving = g.keyCount > 1;
    e.castsShadows = facts.castsShadows;
    e.opaqueCaster = facts.opaqueCaster;
    e.trimmed = (g.flags & kGridTrimmed) != 0;
    return true;
  }

  const float* vertex(const Prepared& p, uint64_t index) const {
    const uint64_t at = p.key.window * kWindow + (uint64_t(12) << p.key.level) * p.startVertex + 12 * index;
    return reinterpret_cast<const float*>(cache_.arena().data() + at);
  }

  bool isSolid(uint32_t part) const { return part < scene_->solidTrees_.size(); }
  bool isPrototype(uint32_t part) const { return part != kNone && !isSolid(part); }

  /// Which way dPdu x dPdv points in cache space against the oriented normal: one answer per object, voted
  /// for by its first grids (a pole or a fold may be undecided or wrong).
  /// `normals`: of an instance, as RayScene::Instance.
  void orient(std::vector<Prepared>& prepared, const Mat3* normals) const {
    size_t i = 0;
    while (i < prepared.size()) {
      size_t end = i;
      while (end < prepared.size() && prepared[end].entry.object == prepared[i].entry.object) ++end;
      double votes = 0;
      const size_t step = std::max<size_t>(1, (end - i) / 5);
      for (size_t j = i; j < end; j += step) votes += orientationVote(prepared[j], normals);
      if (votes < 0)
        for (size_t j = i; j < end; ++j) prepared[j].entry.orientation = -1;
      i = end;
    }
  }

  double orientationVote(const Prepared& p, const Mat3* normals) const {
    const SurfaceEntry& e = p.entry;
    Vec3 raw;
    uint32_t cell = 0;
    float u, v;
    const auto at = [&](uint64_t i) {
      const float* f = vertex(p, i);
      return Vec3(f[0], f[1], f[2]);
    };
    if (e.meshlet) {
      const auto* index = reinterpret_cast<const uint8_t*>(cache_.arena().data() + p.indices);
      const auto corner = [&](int c) { return at(std::min<uint32_t>(index[c], e.cellsU - 1u)); };
      const Vec3 a = corner(0);
      raw = glm::cross(corner(1) - a, corner(2) - a);
      u = v = 1.0f / 3;
    } else {
      const uint64_t k = uint64_t(1) << e.level, cu = e.cellsU / 2, cv = e.cellsV / 2;
      const uint64_t base = cv * k * p.rowStride + cu * k;
      raw = glm::cross(at(base + k * p.rowStride + k) - at(base), at(base + k * p.rowStride) - at(base + k));
      u = e.u0 + e.uScale * (float(cu) + 0.5f) / float(e.cellsU);
      v = e.v0 + e.vScale * (float(cv) + 0.5f) / float(e.cellsV);
      if (e.strip) cell = e.firstTriangle + uint32_t(2 * (cv * e.cellsU + cu)), u = v = 0.5f;
    }
    if (normals) raw = *normals * raw;
    const float length = glm::length(raw);
    if (!(length > 0) || !std::isfinite(length)) return 0;
    Vec3 ng(0);
    SurfaceOut out;
    for (int c = 0; c < 3; ++c) out.Ng[c] = &ng[c];
    cache_.evaluateSurface(e.node, 1, &cell, &u, &v, out);
    const float d = glm::dot(raw / length, ng);
    return std::isfinite(d) ? d : 0;
  }

  Result<void> openDevice() {
    RayScene::Embree& em = *scene_->embree_;
    const char* isa = currentIsa() == Isa::kSse4   ? "isa=sse4.2"
                      : currentIsa() == Isa::kAvx2 ? "isa=avx2"
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

  Result<void> makeGeometries() {
    if (Result<void> r = openDevice(); !r) return r;
    RayScene& s = *scene_;
    RayScene::Embree& em = *s.embree_;
    const auto newScene = [&] {
      RTCScene scene = rtcNewScene(em.device);
      rtcSetSceneFlags(scene, RTCSceneFlags(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
      rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
      return scene;
    };
    em.scene = newScene();
    em.solids.assign(s.solidTrees_.size(), nullptr);
    for (const Prepared& p : prepared_)
      if (isSolid(p.key.part) && !em.solids[p.key.part])
        em.solids[p.key.part] = newScene(), ++s.statistics_.solids;
    for (size_t i = 0; i < prototypes_.size(); ++i) em.prototypes.push_back(newScene());

    std::map<ClassKey, std::vector<uint32_t>> classes;
    for (uint32_t i = 0; i < prepared_.size(); ++i) classes[prepared_[i].key].push_back(i);
    const auto stitches = closeBorders();
    em.descriptors.reserve(classes.size() + stitches.size());
    for (const auto& [key, members] : classes) attach(key, members);
    for (const auto& [key, triangles] : stitches) attachStitches(key, triangles);
    s.statistics_.geometries = em.descriptors.size();
    for (RTCScene solid : em.solids)
      if (solid) rtcCommitScene(solid);
    for (RTCScene prototype : em.prototypes) rtcCommitScene(prototype);
    if (s.statistics_.solids > 0) SolidRays::attach(s);
    s.firstInstance_ = uint32_t(s.entryOfPrimitive_.size());
    collectEntries();
    for (size_t i = 0; i < groups_.size(); ++i) attachInstance(i);
    s.statistics_.prototypes = prototypes_.size(), s.statistics_.instances = groups_.size();
    prepared_ = {}, prototypes_ = {}, groups_ = {}, placed_ = {};
    rtcCommitScene(em.scene);
    if (em.error != RTC_ERROR_NONE)
      return makeError(em.error == RTC_ERROR_OUT_OF_MEMORY ? RiError::kNoMem : RiError::kSystem,
                       "the acceleration structure for rays cannot be built: Embree says \"{}\"", em.message);
    return {};
  }

  RayScene::PrimitiveTable& tableOf(const ClassKey& key) {
    if (isSolid(key.part)) return scene_->solidTrees_[key.part].entryOfPrimitive;
    if (!isPrototype(key.part)) return scene_->entryOfPrimitive_;
    return scene_->prototypes_[key.part - scene_->solidTrees_.size()].entryOfPrimitive;
  }
  RTCScene sceneOf(const ClassKey& key) const {
    const RayScene::Embree& em = *scene_->embree_;
    if (isSolid(key.part)) return em.solids[key.part];
    return isPrototype(key.part) ? em.prototypes[key.part - scene_->solidTrees_.size()] : em.scene;
  }

  /// All entries in one array, those of instances last.
  void collectEntries() {
    RayScene& s = *scene_;
    size_t total = prepared_.size();
    for (const auto& p : placed_) total += p.size();
    s.entries_.reserve(total);
    for (const Prepared& p : prepared_) s.entries_.push_back(p.entry);
    for (size_t i = 0; i < groups_.size(); ++i) {
      const PrototypeParts& prototype = prototypes_[groups_[i].prototype];
      s.instances_[i].shift = uint32_t(s.entries_.size()) - prototype.firstEntry;
      for (size_t k = 0; k < placed_[i].size(); ++k) {
        // Where its primitives are was found out for the prototype.
        const SurfaceEntry& like = prepared_[prototype.firstEntry + k].entry;
        SurfaceEntry& e = placed_[i][k];
        e.stitched = like.stitched, e.firstTriangle = like.firstTriangle;
        s.entries_.push_back(e);
      }
    }
    NodeId lastNode = 0;
    for (const SurfaceEntry& e : s.entries_)
      if (e.node != kNone) lastNode = std::max(lastNode, e.node);
    s.entryOfNode_.assign(s.entries_.empty() ? 0 : size_t(lastNode) + 1, kNone);
    for (uint32_t i = 0; i < s.entries_.size(); ++i)
      if (s.entries_[i].node != kNone) s.entryOfNode_[s.entries_[i].node] = i;
  }

  void attachInstance(size_t index) {
    RayScene::Embree& em = *scene_->embree_;
    const InstanceGroup& group = groups_[index];
    const DMat4 m = cache_.skeleton().placement(cache_.skeleton().objects()[group.objects[0]]);
    float columns[12];
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 3; ++r) columns[c * 3 + r] = float(m[c][r]);
    RTCGeometry g = rtcNewGeometry(em.device, RTC_GEOMETRY_TYPE_INSTANCE);
    rtcSetGeometryInstancedScene(g, em.prototypes[group.prototype]);
    rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, columns);
    rtcSetGeometryMask(g, facts_[group.objects[0]].mask);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(em.scene, g);
    FR_CHECK(id == scene_->firstInstance_ + index);
    rtcReleaseGeometry(g);
  }

  void attach(const ClassKey& key, const std::vector<uint32_t>& members) {
    RayScene& s = *scene_;
    RayScene::Embree& em = *s.embree_;
    std::vector<uint32_t>& buffer = em.descriptors.emplace_back();
    std::vector<uint32_t>& entryOf = tableOf(key).emplace_back();
    uint64_t vertexEnd = 0;
    size_t primitives = 0;
    for (uint32_t m : members) {
      Prepared& p = prepared_[m];
      SurfaceEntry& e = p.entry;
      if (key.meshlet) {
        e.firstTriangle = uint32_t(primitives);
        const auto* index = reinterpret_cast<const uint8_t*>(cache_.arena().data() + p.indices);
        for (uint32_t t = 0; t < e.cellsV; ++t) {
          for (uint32_t c = 0; c < 3;
               ++c)  // read once; a corner outside of the meshlet becomes its first vertex
            if (const uint32_t i = index[3 * t + c]; i < e.cellsU)
              buffer.push_back(p.startVertex + i);
            else
              buffer.push_back(p.startVertex);
          entryOf.push_back(m);
        }
        primitives += e.cellsV;
        vertexEnd = std::max<uint64_t>(vertexEnd, uint64_t(p.startVertex) + e.cellsU);
        s.statistics_.meshlets += 1;
        s.statistics_.triangles += e.cellsV;
      } else {
        uint32_t first = p.startVertex, cellsU = e.cellsU, cellsV = e.cellsV;
        if (e.stitched) {
          first += e.inner[2] * p.rowStride + e.inner[0];
          cellsU = e.inner[1] - e.inner[0], cellsV = e.inner[3] - e.inner[2];
          if (cellsU == 0) continue;
        }
        const RTCGrid grid{first, p.rowStride, uint16_t(cellsU + 1), uint16_t(cellsV + 1)};
        const auto words = std::bit_cast<std::array<uint32_t, sizeof(RTCGrid) / 4>>(grid);
        buffer.insert(buffer.end(), words.begin(), words.end());
        entryOf.push_back(m);
        ++primitives;
        vertexEnd = std::max<uint64_t>(vertexEnd, first + uint64_t(cellsV) * p.rowStride + cellsU + 1u);
        s.statistics_.grids += 1;
        s.statistics_.quads += uint64_t(cellsU) * cellsV;
      }
    }
    addGeometry(key, key.meshlet ? RTC_GEOMETRY_TYPE_TRIANGLE : RTC_GEOMETRY_TYPE_GRID, vertexEnd,
                primitives);
  }

  /// Refines borders that no neighbour shows, by the class that the triangles share vertices with.
  std::map<ClassKey, std::vector<StitchTriangle>> closeBorders() {
    std::vector<BorderedGrid> grids(prepared_.size());
    for (size_t i = 0; i < grids.size(); ++i) {
      const Prepared& p = prepared_[i];
      if (p.entry.meshlet || p.entry.strip) continue;
      BorderedGrid& g = grids[i];
      g.vertices = vertex(p, 0);
      g.rowStride = p.rowStride;
      g.cellsU = uint8_t(p.entry.cellsU), g.cellsV = uint8_t(p.entry.cellsV);
      g.level = uint8_t(p.key.level);
      // Prototypes lie in spaces of their own.
      g.kind =
          isPrototype(p.key.part) ? 0x80000000u | p.key.part << 8 | p.key.keys : p.key.mask | p.key.keys << 8;
    }
    std::map<ClassKey, std::vector<StitchTriangle>> stitches;
    for (const StitchTriangle& t : stitchBorders(grids)) {
      Prepared& p = prepared_[t.grid];
      p.entry.stitched = 1;
      std::copy_n(grids[t.grid].inner, 4, p.entry.inner);
      stitches[p.key].push_back(t);
    }
    return stitches;
  }

  void attachStitches(const ClassKey& key, const std::vector<StitchTriangle>& triangles) {
    RayScene& s = *scene_;
    std::vector<uint32_t>& buffer = s.embree_->descriptors.emplace_back();
    std::vector<uint32_t>& entryOf = tableOf(key).emplace_back();
    uint32_t vertexEnd = 0;
    for (const StitchTriangle& t : triangles) {
      const Prepared& p = prepared_[t.grid];
      for (int c = 0; c < 3; ++c) {
        const uint32_t at = (p.startVertex << key.level) + t.j[c] * p.rowStride + t.i[c];
        buffer.push_back(at);
        vertexEnd = std::max(vertexEnd, at + 1);
      }
      entryOf.push_back(RayScene::kStitch | uint32_t(s.stitches_.size()));
      s.stitches_.push_back(t);
    }
    s.statistics_.stitchTriangles += triangles.size();
    ClassKey fine = key;
    fine.level = 0;
    addGeometry(fine, RTC_GEOMETRY_TYPE_TRIANGLE, vertexEnd, triangles.size());
  }

  /// Hands the newest buffer of descriptors to Embree, over the vertices of a class.
  void addGeometry(const ClassKey& key, RTCGeometryType type, uint64_t vertexEnd, size_t primitives) {
    RayScene& s = *scene_;
    RayScene::Embree& em = *s.embree_;
    std::vector<uint32_t>& buffer = em.descriptors.back();
    const uint64_t step = uint64_t(12) << key.level;
    buffer.resize(buffer.size() + 4);  // Embree may load past the last element

    RTCGeometry g = rtcNewGeometry(em.device, type);
    rtcSetGeometryTimeStepCount(g, key.keys);
    for (uint32_t k = 0; k < key.keys; ++k)
      rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, k, RTC_FORMAT_FLOAT3,
                                 cache_.arena().data() + key.window * kWindow + k * key.keyBytes, 0, step,
                                 vertexEnd);
    if (type == RTC_GEOMETRY_TYPE_TRIANGLE)
      rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, buffer.data(), 0, 12,
                                 primitives);
    else
      rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_GRID, 0, RTC_FORMAT_GRID, buffer.data(), 0,
                                 sizeof(RTCGrid), primitives);
    rtcSetGeometryMask(g, key.mask);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(sceneOf(key), g);
    FR_CHECK(id + 1 == tableOf(key).size());
    rtcReleaseGeometry(g);
  }

  SceneCache& cache_;
  const std::function<bool(ObjectId)>& opaqueCaster_;
  RaySceneOptions options_;
  std::unique_ptr<RayScene> scene_;
  int threads_ = 1;
  std::vector<Prepared> prepared_;                                         // of prototypes behind all others
  std::vector<ObjectFacts> facts_;                                         // by object
  std::map<std::pair<std::vector<ObjectId>, int>, uint32_t> prototypeOf_;  // by objects and level
  std::vector<PrototypeParts> prototypes_;
  std::vector<InstanceGroup> groups_;
  std::vector<std::vector<SurfaceEntry>> placed_;  // by group, in the order of the prototype's entries
};

Result<std::unique_ptr<RayScene>> RayScene::build(SceneCache& cache,
                                                  const std::function<bool(ObjectId)>& opaqueCaster,
                                                  const RaySceneOptions& options) {
  return RaySceneBuilder(cache, opaqueCaster, options).build();
}

}  // namespace fr::tracer
