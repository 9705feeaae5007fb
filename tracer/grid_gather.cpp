#include "tracer/grid_gather.h"

#include <algorithm>
#include <cmath>

#include "scene_cache/primitive_source.h"

namespace fr::tracer {

using namespace cache;

namespace {

/// Embree loads 16 bytes for a vertex of 12.
constexpr uint64_t kVertexOverread = 4;
constexpr unsigned kMaxKeys = 129;  // RTC_MAX_TIME_STEP_COUNT

float sane(float x, float otherwise) { return std::isfinite(x) && x >= 0 ? x : otherwise; }

/// Largest power of two of vertices to skip, as an exponent: multiplier 1 -> 0, 0.5 -> 1, 0.3 -> 2 (rounded
/// down to 0.25).
int wantedLevel(float multiplier) {
  if (!(multiplier > 0)) return kLevels - 1;
  int level = 0;
  for (float m = 1; m > multiplier && level < kLevels - 1; m *= 0.5f) ++level;
  return level;
}

/// The ribbons of a cluster of curves as grids: an eighth of the memory of their triangles.
void addStrips(const SceneCache& cache, const GatheredGrid& meshlet, std::vector<GatheredGrid>& out) {
  const Skeleton& s = cache.skeleton();
  const auto* source = sourceRecord<CurvesSource>(s, s.objects()[meshlet.entry.object]);
  if (!source) return;
  const auto clusters = sourceArray<CurveCluster>(s, source->clusters);
  const auto all = sourceArray<CurvePiece>(s, source->pieces);
  const uint32_t face = cache.rootOf(meshlet.entry.node).face;
  if (face >= clusters.size()) return;
  const CurveCluster& cluster = clusters[face];
  if (cluster.firstPiece > all.size() || cluster.pieceCount > all.size() - cluster.firstPiece) return;
  const uint32_t vertices = meshlet.entry.cellsU, triangles = meshlet.entry.cellsV;
  for (const CurvePiece& piece : all.subspan(cluster.firstPiece, cluster.pieceCount)) {
    if (piece.columns == 0 || piece.rows == 0 ||
        piece.firstVertex + (piece.columns + 1u) * (piece.rows + 1u) > vertices ||
        piece.firstTriangle + 2u * piece.columns * piece.rows > triangles)
      continue;
    GatheredGrid p = meshlet;
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
bool checkGrid(const SceneCache& cache, NodeId id, ObjectId object, const ObjectFacts& facts,
               const GridRecord& shared, GatheredGrid& p) {
  const GridRecord g = shared;
  if (g.flags & kGridAbsent) return false;
  const bool meshlet = g.kind == GridKind::kMeshlet;
  // Faces that name one or two vertices three times have no area.
  if (meshlet && g.nu > 0 && g.nu < 3) return false;
  const uint64_t arenaBytes = cache.arena().size();
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
  const bool placeOk = g.positions % positionAlign(std::clamp<uint32_t>(g.levels, 1, kLevels)) == 0 &&
                       bytes <= arenaBytes && g.positions <= arenaBytes - bytes;
  const bool indicesOk =
      !meshlet || (g.indices != 0 && g.indices <= arenaBytes && g.nv * uint64_t(3) <= arenaBytes - g.indices);
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
    // Closed round surfaces of fewer than four segments a turn are flat: nothing would be left of a small
    // sphere.
    const PatchNode& node = cache.node(id);
    const auto segments = [&](uint32_t n, uint8_t depth) {
      return uint64_t(n >> level) << std::min<int>(depth, 32);
    };
    if (cache.skeleton().objects()[object].type <= PrimitiveType::kTorus)
      while (level > 0 && (segments(g.nu, node.du) < 4 || segments(g.nv, node.dv) < 4)) --level;
  }
  const uint64_t window = g.positions / kWindow;
  const uint64_t step = uint64_t(12) << level;
  p.key = {meshlet, facts.mask, uint32_t(level), g.keyCount, keyBytes, window};
  p.startVertex = uint32_t((g.positions - window * kWindow) / step);
  p.rowStride = g.rowStride;
  p.indices = meshlet ? g.indices : 0;

  const PatchNode& node = cache.node(id);
  SurfaceEntry& e = p.entry;
  e = {};
  e.node = id;
  e.object = object;
  const ObjectRecord& o = cache.skeleton().objects()[object];
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

void gather(SceneCache& cache, NodeId id, ObjectId object, const ObjectFacts& facts,
            std::vector<GatheredGrid>& out, int depth) {
  if (depth > 64) return;  // dyadic rectangles have at most 32 + 32 halvings
  const ResolvedNode r = cache.resolve(id);
  if (r.state == NodeState::kSplit) {
    for (NodeId child : r.children)
      if (child < cache.nodeCount()) gather(cache, child, object, facts, out, depth + 1);
  } else if (r.state == NodeState::kGrid && r.grid) {
    GatheredGrid p;
    if (!checkGrid(cache, id, object, facts, *r.grid, p)) return;
    if (p.entry.meshlet && cache.skeleton().objects()[object].type == PrimitiveType::kCurves) {
      addStrips(cache, p, out);
    } else {
      out.push_back(p);
    }
  }
}

double orientationVote(const SceneCache& cache, const GatheredGrid& p, const Mat3* normals) {
  const SurfaceEntry& e = p.entry;
  Vec3 raw;
  uint32_t cell = 0;
  float u, v;
  const auto at = [&](uint64_t i) {
    const float* f = vertexOf(cache, p, i);
    return Vec3(f[0], f[1], f[2]);
  };
  if (e.meshlet) {
    const auto* index = reinterpret_cast<const uint8_t*>(cache.arena().data() + p.indices);
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
  cache.evaluateSurface(e.node, 1, &cell, &u, &v, out);
  const float d = glm::dot(raw / length, ng);
  return std::isfinite(d) ? d : 0;
}

}  // namespace

ObjectFacts factsOf(const Skeleton& skeleton, ObjectId id, const std::function<bool(ObjectId)>& opaqueCaster,
                    const RaySceneOptions& options) {
  const ObjectRecord& o = skeleton.objects()[id];
  ObjectFacts f;
  if (!(o.sides & kForTracer)) return f;
  const auto attributes = skeleton.attributes();
  if (o.attributes >= attributes.size()) return f;
  const AttributeRecord& a = attributes[o.attributes];
  if (options.cameraRays && (a.visibility & kVisibleCamera)) f.mask |= kCameraRay;
  if (a.visibility & kVisibleReflection)
    f.mask |=
        (a.flags & kNoSpecularRays ? 0u : kReflectionRay) | (a.flags & kNoDiffuseRays ? 0u : kDiffuseRay);
  if ((a.visibility & kVisibleShadow) && a.castsShadows != CastsShadows::kNever) {
    f.opaqueCaster = opaqueCaster(id);
    f.mask |= f.opaqueCaster ? kOpaqueShadowRay : kFilteredShadowRay;
  }
  f.level = wantedLevel(a.patchMultiplier >= 0 ? a.patchMultiplier : options.patchMultiplier);
  f.oneSided = a.sides == 1;
  f.castsShadows = a.castsShadows;
  return f;
}

void gatherNode(SceneCache& cache, NodeId node, ObjectId object, const ObjectFacts& facts,
                std::vector<GatheredGrid>& to) {
  gather(cache, node, object, facts, to, 0);
}

void orientGrids(const SceneCache& cache, std::span<GatheredGrid> grids, const Mat3* normals) {
  size_t i = 0;
  while (i < grids.size()) {
    size_t end = i;
    while (end < grids.size() && grids[end].entry.object == grids[i].entry.object) ++end;
    double votes = 0;
    const size_t step = std::max<size_t>(1, (end - i) / 5);
    for (size_t j = i; j < end; j += step) votes += orientationVote(cache, grids[j], normals);
    if (votes < 0)
      for (size_t j = i; j < end; ++j) grids[j].entry.orientation = -1;
    i = end;
  }
}

}  // namespace fr::tracer
