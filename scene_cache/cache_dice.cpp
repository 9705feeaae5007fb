// Making nodes: splitting and dicing, by whoever holds the claim.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene_cache/cache_impl.h"
#include "scene_cache/grid_measure.h"
#include "scene_cache/grid_source.h"
#include "scene_cache/packed_normal.h"
#include "scene_cache/primvar.h"
#include "scene_cache/thin.h"
#include "scene_cache/trim.h"

namespace fr::cache {
namespace {

/// No scene needs more; a runaway split ends here with a message.
constexpr uint64_t kMostNodes = uint64_t(1) << 30;

std::string objectName(const Skeleton& s, const ObjectRecord& o) {
  return fmt::format("{}:{}", s.string(o.locationFile), o.locationLine);
}

SourceLocation locationOf(const Skeleton& s, const ObjectRecord& o) {
  return {std::string(s.string(o.locationFile)), int(o.locationLine), 0};
}

}  // namespace

std::vector<NodeRect> SceneCache::Impl::pathTo(const PatchNode& n) const {
  std::vector<NodeRect> path;
  path.reserve(size_t(n.du) + n.dv + 1);
  const PatchNode* at = node(n.root);
  if (n.du > kMaxSplitDepth || n.dv > kMaxSplitDepth) return path;
  while (at && path.size() <= 2 * kMaxSplitDepth) {
    path.push_back(rectOf(*at));
    if (at->du == n.du && at->dv == n.dv) {
      if (at->iu != n.iu || at->iv != n.iv) break;
      return path;
    }
    const uint64_t word = at->state.load(std::memory_order_acquire);
    if (stateOf(word) != NodeState::kSplit) break;
    const bool inV = splitInV(word);
    const int depth = inV ? at->dv : at->du, target = inV ? n.dv : n.du;
    if (depth >= target) break;
    const uint32_t bit = ((inV ? n.iv : n.iu) >> (target - depth - 1)) & 1;
    const NodeId next = splitFirst(word) + bit;
    at = next < nodeCount() ? node(next) : nullptr;
  }
  path.clear();
  return path;
}

bool SceneCache::Impl::prepare(const Skeleton& skeleton, uint32_t root, float time, bool borders,
                               DiceSurfaces* out) {
  if (!out->own.prepare(skeleton, root, time, subdivisions.get())) return false;
  out->borders = {};
  out->owners.clear();
  const RootPatchRecord& r = skeleton.rootPatches()[root];
  if (!borders || r.firstEdge == kNone) return true;
  const auto edges = skeleton.edges();
  if (uint64_t(r.firstEdge) + 8 > edges.size()) return true;
  out->owners.resize(8);  // never grows afterwards: pieces point into it
  for (unsigned i = 0; i < 8; ++i) {
    const EdgeRecord& e = edges[r.firstEdge + i];
    if (e.owner == root && e.ownerEdge == i % 4 && !e.reversed) continue;
    if (e.ownerEdge > 3 || !out->owners[i].prepare(skeleton, e.owner, time, subdivisions.get())) continue;
    RootBorders::Piece& p = i < 4 ? out->borders.edge[i] : out->borders.corner[i - 4];
    p.surface = &out->owners[i];
    p.edge = e.ownerEdge;
    p.reversed = e.reversed != 0;
  }
  return true;
}

uint64_t SceneCache::Impl::make(const Skeleton& skeleton, NodeId nodeId, Displacer* displacer) {
  const PatchNode* n = node(nodeId);
  const auto roots = skeleton.rootPatches();
  if (!n || n->root >= roots.size()) return 0;
  const ObjectRecord& object = skeleton.objects()[roots[n->root].object];
  if (n->prototype != 0) return makePlaced(skeleton, nodeId, object);
  if (gridSource) {
    const uint64_t word = makeReused(skeleton, nodeId, object, displacer);
    if (word || gridSource->reuse().only) return word;
  }
  if (isThin(object)) return makeThin(skeleton, nodeId, object, displacer);
  return object.type == PrimitiveType::kMeshlets ? makeMeshlet(skeleton, nodeId, object, displacer)
                                                 : makeGrid(skeleton, nodeId, object, displacer);
}

void SceneCache::Impl::reportNoRoom(const Skeleton& s, const ObjectRecord& o) {
  noRoom = true;
  if (build) return;  // whoever builds the file stops and says why: SceneCache::room()
  Error e = makeError(
      RiError::kNoMem,
      "no memory for more grids; parts of the scene stay empty (with --memory the scene goes to files)");
  e.where = locationOf(s, o);
  reportOnce("grid arena full", e);
}

namespace {

/// Box of the node's part of the surface: samples, widened by what second differences say may lie between
/// them.
Box3f sampledBound(const Surface& s, const NodeRect& n) {
  constexpr int kSide = 9;
  float u[kSide], v[kSide], xyz[kSide * kSide * 3];
  for (int i = 0; i < kSide; ++i) {
    u[i] = float((double(n.iu) + i / 8.0) * std::ldexp(1.0, -n.du));
    v[i] = float((double(n.iv) + i / 8.0) * std::ldexp(1.0, -n.dv));
  }
  Box3f box;
  s.grid(kSide - 1, u, kSide - 1, v, xyz, kSide);
  Vec3 bend[2] = {Vec3(0), Vec3(0)};
  const auto at = [&](int i, int j) {
    const float* p = xyz + 3 * (j * kSide + i);
    return Vec3(p[0], p[1], p[2]);
  };
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const Vec3 p = at(i, j);
      box.extend(p);
      if (i > 0 && i < kSide - 1)
        bend[0] = glm::max(bend[0], glm::abs((at(i - 1, j) + at(i + 1, j)) - 2.0f * p));
      if (j > 0 && j < kSide - 1)
        bend[1] = glm::max(bend[1], glm::abs((at(i, j - 1) + at(i, j + 1)) - 2.0f * p));
    }
  }
  // Linear interpolation errs by at most 1/8 of the second difference; twice that, for differences that were
  // missed.
  const Vec3 size = glm::max(glm::abs(box.min), glm::abs(box.max));
  const Vec3 more = 0.25f * (bend[0] + bend[1]) + Vec3(4e-7f * std::max({size.x, size.y, size.z}));
  box.min -= more, box.max += more;
  return box;
}

/// Collapsed border vertices may lie a micropolygon or two outside the node's own rectangle.
Vec3 collapseMargin(const DiceRate& rate, const Box3f& box) {
  float distance = 1;
  if (rate.perspective) {
    const Vec3 far = glm::max(glm::abs(box.min - rate.eye), glm::abs(box.max - rate.eye));
    distance = std::max(std::sqrt(glm::dot(far, far)), std::sqrt(rate.nearSquared));
  } else {
    for (int i = 0; i < 8; ++i) {
      const Vec3 p = box.corner(i) - rate.eye;
      distance = std::max(distance, 1 / rate.cylinderWeight(p, p));
    }
  }
  if (rate.focus > 0) {
    float least = kInfinity, most = -kInfinity;
    for (int i = 0; i < 8; ++i) {
      const float depth = glm::dot(box.corner(i) - rate.eye, rate.axis);
      least = std::min(least, depth), most = std::max(most, depth);
    }
    distance *= std::max({rate.motionSide, rate.focusSide(least, least), rate.focusSide(most, most)});
  } else {
    distance *= rate.motionSide;
  }
  // Along the axis of an orthographic camera micropolygons are longer.
  return (Vec3(1) + (1 / rate.alongAxis - 1) * glm::abs(rate.axis)) *
         (3.0f * kLongestSegment * distance / rate.scale);
}

/// A place of every vertex of a meshlet: a corner of the first triangle that has it.
void meshletVertexParameters(const uint8_t* indices, uint32_t count, uint32_t triangles, uint32_t* cell,
                             float* u, float* v) {
  for (uint32_t i = 0; i < count; ++i) cell[i] = 0, u[i] = v[i] = 0;
  for (uint32_t t = triangles; t-- > 0;) {
    for (uint32_t c = 0; c < 3; ++c) {
      const uint8_t i = indices[t * 3 + c];
      cell[i] = t, u[i] = c == 1 ? 1.0f : 0.0f, v[i] = c == 2 ? 1.0f : 0.0f;
    }
  }
}

/// Bound and cell size of a meshlet, over all keys.
void measureMeshlet(GridRecord& g, const std::byte* arena, const uint8_t* indices) {
  float longest = 0;
  for (unsigned k = 0; k < g.keyCount; ++k) {
    const float* xyz = reinterpret_cast<const float*>(arena + g.positions + k * g.keyBytes);
    const auto point = [&](uint32_t i) { return Vec3(xyz[i * 3], xyz[i * 3 + 1], xyz[i * 3 + 2]); };
    for (uint32_t i = 0; i < g.nu; ++i) g.bound.extend(point(i));
    for (uint32_t t = 0; t < g.nv; ++t) {
      for (uint32_t c = 0; c < 3; ++c) {
        const Vec3 d = point(indices[t * 3 + c]) - point(indices[t * 3 + (c + 1) % 3]);
        longest = std::max(longest, glm::dot(d, d));
      }
    }
  }
  g.cellSize = std::sqrt(longest);
}

uint32_t rowStrideFor(int nu) { return uint32_t(nu) + 1; }

}  // namespace

float SceneCache::Impl::motionSideOf(const Skeleton& skeleton, const ObjectRecord& object) const {
  const float factor = skeleton.attributes()[object.attributes].motionFactor;
  const float* shutter = skeleton.camera().shutter;
  if (!(factor > 0) || object.fixedRate > 0 || !(shutter[1] > shutter[0])) return 1;
  const DMat4 cameraOpen = skeleton.cacheToCamera(shutter[0]),
              cameraClose = skeleton.cacheToCamera(shutter[1]);
  const DMat4 open = skeleton.toCache(object.transform, shutter[0]),
              close = skeleton.toCache(object.transform, shutter[1]);
  if (open == close && cameraOpen == cameraClose) return 1;
  const DMat4 moved = cameraClose * close * glm::inverse(open);
  const double unit = eye.perspective ? 1.0 : std::cbrt(std::abs(glm::determinant(DMat3(cameraOpen))));
  glm::dvec2 seen[2][8];
  for (int i = 0; i < 8; ++i) {
    const DVec4 corner(DVec3(object.bound.corner(i)), 1.0);
    const DVec4 at[2] = {cameraOpen * corner, moved * corner};
    for (int k = 0; k < 2; ++k) {
      if (eye.perspective && !(at[k].z > eye.nearDistance)) return 1;
      seen[k][i] = glm::dvec2(at[k]) / (eye.pixel * (eye.perspective ? at[k].z : unit));
    }
  }
  return motionSide(seen[0], seen[1], factor);
}

uint64_t SceneCache::Impl::makeGrid(const Skeleton& skeleton, NodeId nodeId, const ObjectRecord& object,
                                    Displacer* displacer) {
  PatchNode& n = *node(nodeId);
  const AttributeRecord& attributes = skeleton.attributes()[object.attributes];
  const std::vector<NodeRect> path = pathTo(n);
  if (path.empty()) {
    reportOnce("damaged node tree", makeError(RiError::kBadFile, "the scene cache's patch tree is damaged"));
    return 0;
  }
  const NodeRect& rect = path.back();
  const float* shutter = skeleton.camera().shutter;
  const int keys = std::min<int>(object.keyCount, kMaxGridKeys);
  DiceRate rate = diceRate(eye, attributes, object.type, object.fixedRate);
  rate.motionSide = motionSideOf(skeleton, object);
  if (isPolygon(object)) {
    const auto* source = sourceRecord<PolygonSource>(skeleton, object);
    if (source && source->undicedEdge >= 1 && source->undicedEdge <= kMostUndicedEdge)
      rate.undicedEdge = source->undicedEdge;
  }
  DiceSurfaces first;
  if (!prepare(skeleton, n.root, gridKeyTime(0, keys, shutter), true, &first)) {
    Error e = makeError(RiError::kBadFile, "the data of this primitive are damaged; it stays empty");
    e.where = locationOf(skeleton, object);
    reportOnce(fmt::format("source {}", objectName(skeleton, object)), e);
    return 0;
  }
  const DicePlan plan = planNode(first.own, first.borders, rate, rect);

  if (plan.kind != DicePlan::Kind::kGrid) {
    const bool inV = plan.kind == DicePlan::Kind::kSplitV;
    NodeRect children[2];
    splitRect(rect, inV, children);
    Box3f bounds[2];
    for (int k = 0; k < keys; ++k) {
      DiceSurfaces at;
      const bool still = k == 0;
      if (!still && !prepare(skeleton, n.root, gridKeyTime(k, keys, shutter), false, &at)) return 0;
      for (int c = 0; c < 2; ++c) bounds[c].extend(sampledBound(still ? first.own : at.own, children[c]));
    }
    uint64_t offset = 0;
    if (nodeCount() < kMostNodes) offset = allocateChildren();
    if (!offset) {
      reportNoRoom(skeleton, object);
      return 0;
    }
    auto* made = reinterpret_cast<PatchNode*>(nodes.base() + offset);
    for (int c = 0; c < 2; ++c) {
      made[c].root = n.root;
      made[c].iu = children[c].iu, made[c].iv = children[c].iv;
      made[c].du = children[c].du, made[c].dv = children[c].dv;
      std::copy_n(children[c].edgeRootDepth, 4, made[c].edgeRootDepth);
      const Vec3 margin =
          collapseMargin(rate, bounds[c]) + Vec3(std::max(0.0f, attributes.displacementBound));
      bounds[c].min -= margin, bounds[c].max += margin;
      // Never larger than the parent, which holds all of it.
      made[c].bound = {glm::max(bounds[c].min, n.bound.min), glm::min(bounds[c].max, n.bound.max)};
    }
    nodesSplit.fetch_add(1, std::memory_order_relaxed);
    return splitWord(NodeId((offset - kStoreHeaderBytes) / sizeof(PatchNode)), inV);
  }

  const int nu = 1 << plan.log2Nu, nv = 1 << plan.log2Nv;
  const ObjectId objectId = skeleton.rootPatches()[n.root].object;
  const bool displaced = displacer && displacer->displaces(objectId);
  const uint32_t rowStride = rowStrideFor(nu);
  if (gridSource && !displaced) {
    const auto borders = [&](int k, float* xyz) {
      DiceSurfaces at;
      const bool still = k == 0 || !prepare(skeleton, n.root, gridKeyTime(k, keys, shutter), true, &at);
      const DiceSurfaces& now = still ? first : at;
      diceBorders(now.own, now.borders, first.own, first.borders, rate, path, plan, xyz, rowStride);
    };
    if (const uint64_t word = reusePlanned(nodeId, plan, keys, borders)) return word;
  }
  const uint64_t points = uint64_t(rowStride) * unsigned(nv) + unsigned(nu) + 1;
  const uint64_t keyBytes = (points * 12 + 15) / 16 * 16;
  const uint64_t normalBytes = displaced ? uint64_t(nu + 1) * unsigned(nv + 1) * sizeof(uint32_t) : 0;
  const int levels = std::min(plan.log2Nu, plan.log2Nv) + 1;
  const uint64_t offset = allocateGrid(unsigned(levels), unsigned(keys) * keyBytes + normalBytes);
  if (!offset) {
    reportNoRoom(skeleton, object);
    return 0;
  }
  auto* g = new (arena.base() + offset) GridRecord{};
  g->node = nodeId;
  g->kind = GridKind::kGrid;
  g->keyCount = uint8_t(keys);
  g->levels = uint8_t(levels);
  g->nu = uint16_t(nu), g->nv = uint16_t(nv);
  g->rowStride = rowStride;
  g->positions = offset + sizeof(GridRecord);
  g->keyBytes = keyBytes;
  std::copy_n(plan.edgeShift, 4, g->edgeShift);
  if (displaced) {
    g->normals = g->positions + unsigned(keys) * keyBytes;
    g->flags |= kGridHasNormals;
  }
  const GridParameters parameters = gridParameters(rect, plan.log2Nu, plan.log2Nv);
  if (const PatchTrim trim = patchTrim(skeleton, n.root); trim.any()) {
    const auto removed = trim.removed(parameters.u[0], parameters.u[nu], parameters.v[0], parameters.v[nv]);
    if (!removed.has_value()) g->flags |= kGridTrimmed;
    if (removed.value_or(false)) g->flags |= kGridAbsent;
  }
  for (int k = 0; k < keys; ++k) {
    float* xyz = reinterpret_cast<float*>(arena.base() + g->positions + unsigned(k) * keyBytes);
    DiceSurfaces at;
    const bool still = k == 0;
    if (!still && !prepare(skeleton, n.root, gridKeyTime(k, keys, shutter), true, &at)) at = first;
    const DiceSurfaces& now = still ? first : at;
    dicePositions(now.own, now.borders, first.own, first.borders, rate, path, plan, xyz, rowStride);
    if (!displaced && meetsRays) {
      const float deviation = estimateTrueDeviation(now.own, parameters, xyz, nu, nv, rowStride);
      g->deviation[0] = std::max(g->deviation[0], deviation);
    }
  }
  if (displaced) {
    float u[(kMaxGridSide + 1) * (kMaxGridSide + 1)], v[(kMaxGridSide + 1) * (kMaxGridSide + 1)];
    for (int j = 0; j <= nv; ++j) {
      for (int i = 0; i <= nu; ++i) {
        const int k = j * (nu + 1) + i;
        collapsedParameters(rect, plan.log2Nu, plan.log2Nv, plan.edgeShift, i, j, u + k, v + k);
      }
    }
    displace(skeleton, nodeId, object, *displacer, *g, nullptr, u, v);
  }
  for (int k = 0; k < keys; ++k) {
    const float* xyz = reinterpret_cast<const float*>(arena.base() + g->positions + unsigned(k) * keyBytes);
    measureGrid(xyz, nu, nv, rowStride, meetsRays ? g->levels : 1, g->deviation, &g->cellSize, &g->bound);
  }
  // A displaced surface is known at its vertices alone: halving a cell divides its error by about four.
  if (displaced && meetsRays) g->deviation[0] = g->levels > 1 ? g->deviation[1] * 0.25f : g->cellSize * 0.25f;
  gridsDiced.fetch_add(1, std::memory_order_relaxed);
  micropolygonsDiced.fetch_add(uint64_t(nu) * unsigned(nv), std::memory_order_relaxed);
  return gridWord(offset);
}

uint64_t SceneCache::Impl::makeThin(const Skeleton& skeleton, NodeId nodeId, const ObjectRecord& object,
                                    Displacer* displacer) {
  const PatchNode& n = *node(nodeId);
  const RootPatchRecord& root = skeleton.rootPatches()[n.root];
  const float* shutter = skeleton.camera().shutter;
  const int keys = std::min<int>(object.keyCount, kMaxGridKeys);
  const bool isPoints = object.type == PrimitiveType::kPoints;
  PointsView points;
  CurvesView curves;
  const auto prepareAt = [&](float time) {
    return isPoints ? points.prepare(skeleton, object, root.face, time, eye)
                    : curves.prepare(skeleton, object, root.face, time, eye);
  };
  if (!prepareAt(gridKeyTime(0, keys, shutter))) {
    Error e = makeError(RiError::kBadFile, "the data of this primitive are damaged; it stays empty");
    e.where = locationOf(skeleton, object);
    reportOnce(fmt::format("source {}", objectName(skeleton, object)), e);
    return 0;
  }
  const uint32_t count = isPoints ? points.vertexCount() : curves.cluster.vertexCount;
  const uint32_t triangles = isPoints ? points.triangleCount() : curves.cluster.triangleCount;
  const bool displaced = displacer && displacer->displaces(root.object);
  const uint64_t keyBytes = (uint64_t(count) * 12 + 15) / 16 * 16;
  const uint64_t offset = allocateGrid(
      1, unsigned(keys) * keyBytes + (displaced ? uint64_t(count) * sizeof(uint32_t) : 0) + triangles * 3ull);
  if (!offset) {
    reportNoRoom(skeleton, object);
    return 0;
  }
  auto* g = new (arena.base() + offset) GridRecord{};
  g->node = nodeId;
  g->kind = GridKind::kMeshlet;
  g->keyCount = uint8_t(keys);
  g->levels = 1;
  g->nu = uint16_t(count), g->nv = uint16_t(triangles);
  g->positions = offset + sizeof(GridRecord);
  g->keyBytes = keyBytes;
  uint64_t at = g->positions + unsigned(keys) * keyBytes;
  if (displaced) {
    g->normals = at, at += uint64_t(count) * sizeof(uint32_t);
    g->flags = kGridHasNormals;
  } else if (isPoints) {
    g->flags = kGridSprites, g->rowStride = points.cluster.sides;
  }
  g->indices = at;
  auto* indices = reinterpret_cast<uint8_t*>(arena.base() + at);
  isPoints ? points.triangles(indices) : curves.triangles(indices);
  for (int k = 0; k < keys; ++k) {
    if (k > 0 && !prepareAt(gridKeyTime(k, keys, shutter))) return 0;
    float* xyz = reinterpret_cast<float*>(arena.base() + g->positions + unsigned(k) * keyBytes);
    isPoints ? points.vertices(xyz) : curves.vertices(xyz);
  }
  if (displaced) {
    uint32_t cell[kMaxMeshletVertices];
    float u[kMaxMeshletVertices], v[kMaxMeshletVertices];
    meshletVertexParameters(indices, count, triangles, cell, u, v);
    displace(skeleton, nodeId, object, *displacer, *g, cell, u, v);
  }
  measureMeshlet(*g, reinterpret_cast<const std::byte*>(arena.base()), indices);
  // Thin as it is: a ray that leaves a ribbon or a disk is behind it at once.
  g->deviation[0] = displaced ? g->cellSize * 0.25f : 0.0f;
  gridsDiced.fetch_add(1, std::memory_order_relaxed);
  micropolygonsDiced.fetch_add(triangles, std::memory_order_relaxed);
  return gridWord(offset);
}

uint64_t SceneCache::Impl::makeMeshlet(const Skeleton& skeleton, NodeId nodeId, const ObjectRecord& object,
                                       Displacer* displacer) {
  const PatchNode& n = *node(nodeId);
  const RootPatchRecord& root = skeleton.rootPatches()[n.root];
  const MeshletView m = meshletView(skeleton, object, root.face);
  if (!m.valid) {
    Error e = makeError(RiError::kBadFile, "the data of this mesh are damaged; it stays empty");
    e.where = locationOf(skeleton, object);
    reportOnce(fmt::format("source {}", objectName(skeleton, object)), e);
    return 0;
  }
  const float* shutter = skeleton.camera().shutter;
  const int keys = std::min<int>(object.keyCount, kMaxGridKeys);
  const uint32_t count = m.record.vertexCount, triangles = m.record.triangleCount;
  const bool displaced = displacer && displacer->displaces(root.object);
  const uint64_t keyBytes = (uint64_t(count) * 12 + 15) / 16 * 16;
  const uint64_t offset = allocateGrid(
      1, unsigned(keys) * keyBytes + (displaced ? uint64_t(count) * sizeof(uint32_t) : 0) + triangles * 3ull);
  if (!offset) {
    reportNoRoom(skeleton, object);
    return 0;
  }
  auto* g = new (arena.base() + offset) GridRecord{};
  g->node = nodeId;
  g->kind = GridKind::kMeshlet;
  g->keyCount = uint8_t(keys);
  g->levels = 1;
  g->nu = uint16_t(count), g->nv = uint16_t(triangles);
  g->rowStride = 0;
  g->positions = offset + sizeof(GridRecord);
  g->keyBytes = keyBytes;
  uint64_t at = g->positions + unsigned(keys) * keyBytes;
  if (displaced) {
    g->normals = at, at += uint64_t(count) * sizeof(uint32_t);
    g->flags = kGridHasNormals;
  }
  g->indices = at;
  auto* indices = reinterpret_cast<uint8_t*>(arena.base() + at);
  for (size_t i = 0; i < m.triangles.size(); ++i)
    indices[i] = uint8_t(std::min<uint32_t>(m.triangles[i], count - 1));
  for (int k = 0; k < keys; ++k) {
    const float time = gridKeyTime(k, keys, shutter);
    const PositionKeys p = positionsAt(skeleton, m.source->positions, time);
    const DMat4 toCache = skeleton.toCache(object.transform, time);
    float* xyz = reinterpret_cast<float*>(arena.base() + g->positions + unsigned(k) * keyBytes);
    for (uint32_t i = 0; i < count; ++i) {
      const DVec3 q =
          p.count ? transformPoint(toCache, p.at(std::min<uint64_t>(m.vertices[i], p.count - 1))) : DVec3(0);
      for (int c = 0; c < 3; ++c) xyz[i * 3 + unsigned(c)] = float(q[c]);
    }
  }
  if (displaced) {
    uint32_t cell[kMaxMeshletVertices];
    float u[kMaxMeshletVertices], v[kMaxMeshletVertices];
    meshletVertexParameters(indices, count, triangles, cell, u, v);
    displace(skeleton, nodeId, object, *displacer, *g, cell, u, v);
  }
  measureMeshlet(*g, reinterpret_cast<const std::byte*>(arena.base()), indices);
  if (displaced) g->deviation[0] = g->cellSize * 0.25f;
  gridsDiced.fetch_add(1, std::memory_order_relaxed);
  micropolygonsDiced.fetch_add(triangles, std::memory_order_relaxed);
  return gridWord(offset);
}

void SceneCache::Impl::displace(const Skeleton& skeleton, NodeId nodeId, const ObjectRecord& object,
                                Displacer& displacer, GridRecord& g, const uint32_t* cell, const float* u,
                                const float* v) {
  const bool isGrid = g.kind == GridKind::kGrid;
  const size_t width = isGrid ? size_t(g.nu) + 1 : g.nu, rows = isGrid ? size_t(g.nv) + 1 : 1;
  const size_t n = width * rows, stride = isGrid ? g.rowStride : width;
  const AttributeRecord& attributes = skeleton.attributes()[object.attributes];
  const NodeId root = node(nodeId)->root;
  std::vector<float> store(n * 6);
  float* P[3] = {store.data(), store.data() + n, store.data() + 2 * n};
  float* N[3] = {store.data() + 3 * n, store.data() + 4 * n, store.data() + 5 * n};
  float furthest = 0;
  for (int k = 0; k < g.keyCount; ++k) {
    const float time = gridKeyTime(k, g.keyCount, skeleton.camera().shutter);
    float* xyz = reinterpret_cast<float*>(arena.base() + g.positions + unsigned(k) * g.keyBytes);
    for (size_t i = 0; i < n; ++i) {
      const float* p = xyz + (i / width * stride + i % width) * 3;
      for (int c = 0; c < 3; ++c) P[c][i] = p[c];
    }
    surfaceNormals(skeleton, root, time, n, cell, u, v, N, nullptr);
    displacer.displace(nodeId, n, cell, u, v, isGrid ? g.nu : 0, isGrid ? g.nv : 0, P, N);
    for (size_t i = 0; i < n; ++i) {
      float* p = xyz + (i / width * stride + i % width) * 3;
      const Vec3 to(P[0][i], P[1][i], P[2][i]);
      if (!isFinite(to)) {
        Error e = makeError(RiError::kMath,
                            "a displacement shader made points that are not numbers; they stay in place");
        e.where = locationOf(skeleton, object);
        reportOnce(fmt::format("displaced nan {}", objectName(skeleton, object)), e);
        continue;
      }
      const Vec3 by = to - Vec3(p[0], p[1], p[2]);
      furthest = std::max(furthest, glm::dot(by, by));
      p[0] = to.x, p[1] = to.y, p[2] = to.z;
    }
    if (k > 0) continue;
    auto* normals = reinterpret_cast<uint32_t*>(arena.base() + g.normals);
    for (size_t i = 0; i < n; ++i) {
      Vec3 normal(N[0][i], N[1][i], N[2][i]);
      const float length = std::sqrt(glm::dot(normal, normal));
      if (length > 0 && std::isfinite(length)) normal /= length;
      normals[i] = packNormal(normal);
    }
  }
  furthest = std::sqrt(furthest);
  if (furthest > std::max(0.0f, attributes.displacementBound) * 1.0001f + 1e-12f) {
    Error e = makeError(
        RiError::kRange,
        "displaced by {:.4g} world units, but the displacement bound is {:.4g}: parts may be missing. Set "
        "Attribute \"displacementbound\" \"sphere\" to at least {:.4g} (world units)",
        furthest, attributes.displacementBound, furthest);
    e.severity = Severity::kWarning;
    e.where = locationOf(skeleton, object);
    reportOnce(fmt::format("displacement bound {}", objectName(skeleton, object)), e);
  }
}

}  // namespace fr::cache
