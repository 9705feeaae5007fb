// Nodes of instances: the splits and grids of their prototype, transformed.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene_cache/attribute_records.h"
#include "scene_cache/cache_impl.h"

namespace fr::cache {

bool SceneCache::Impl::prototypeReady(NodeId prototype) const {
  const PatchNode* n = prototype < nodeCount() ? node(prototype) : nullptr;
  if (!n) return false;
  const NodeState s = stateOf(n->state.load(std::memory_order_acquire));
  return s == NodeState::kGrid || s == NodeState::kSplit;
}

Box3f placedBound(const DMat4& placement, const Box3f& box) {
  Box3f r;
  for (int i = 0; i < 8; ++i) {
    const DVec3 corner(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y,
                       i & 4 ? box.max.z : box.min.z);
    r.extend(Vec3(transformPoint(placement, corner)));
  }
  // The vertices are transformed in floats, by a matrix of floats.
  const Vec3 size = glm::max(glm::abs(r.min), glm::abs(r.max));
  r.grow(8e-7f * std::max({size.x, size.y, size.z}));
  return r;
}

DMat4 Skeleton::placement(const ObjectRecord& object) const {
  const float open = camera().shutter[0];
  const ObjectRecord& prototype = objects()[object.prototype];
  return toCache(object.transform, open) * glm::inverse(toCache(prototype.transform, open));
}

uint64_t SceneCache::Impl::makePlaced(const Skeleton& skeleton, NodeId nodeId, const ObjectRecord& object) {
  const PatchNode& n = *node(nodeId);
  const NodeId from = n.prototype - 1;
  const PatchNode* shared = from < nodeCount() ? node(from) : nullptr;
  if (object.prototype == kNone || !shared) return 0;
  const uint64_t word = shared->state.load(std::memory_order_acquire);
  const DMat4 placement = skeleton.placement(object);

  if (stateOf(word) == NodeState::kSplit) {
    const NodeId first = splitFirst(word);
    if (uint64_t(first) + 2 > nodeCount()) return 0;
    const uint64_t offset = allocateChildren();
    if (!offset) return 0;
    auto* made = reinterpret_cast<PatchNode*>(nodes.base() + offset);
    for (uint32_t c = 0; c < 2; ++c) {
      const PatchNode& child = *node(first + c);
      made[c].root = n.root;
      made[c].iu = child.iu, made[c].iv = child.iv;
      made[c].du = child.du, made[c].dv = child.dv;
      std::copy_n(child.edgeRootDepth, 4, made[c].edgeRootDepth);
      made[c].bound = placedBound(placement, child.bound);
      made[c].prototype = 1 + first + c;
    }
    nodesSplit.fetch_add(1, std::memory_order_relaxed);
    return splitWord(NodeId((offset - kStoreHeaderBytes) / sizeof(PatchNode)), splitInV(word));
  }

  const GridRecord* source = stateOf(word) == NodeState::kGrid ? grid(gridOffset(word), from) : nullptr;
  if (!source || source->normals != 0) return 0;
  const uint64_t offset = allocateGrid(1, 12 * sizeof(float));
  if (!offset) return 0;
  auto* g = new (arena.base() + offset) GridRecord(*source);
  g->node = nodeId;
  g->placement = offset + sizeof(GridRecord);
  float* m = reinterpret_cast<float*>(arena.base() + g->placement);
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column) m[row * 4 + column] = float(placement[column][row]);
  const float stretch = float(largestStretch(placement));
  for (float& d : g->deviation) d *= stretch;
  g->cellSize *= stretch;
  GridView view;
  view.placement = m;
  g->bound = {};
  const uint32_t rows = g->kind == GridKind::kGrid ? g->nv + 1u : 1u;
  const uint32_t columns = g->kind == GridKind::kGrid ? g->nu + 1u : g->nu;
  for (uint32_t k = 0; k < g->keyCount; ++k) {
    const float* xyz = reinterpret_cast<const float*>(arena.base() + g->positions + k * g->keyBytes);
    for (uint32_t j = 0; j < rows; ++j)
      for (uint32_t i = 0; i < columns; ++i)
        g->bound.extend(view.placed(xyz + 3 * (size_t(j) * g->rowStride + i)));
  }
  gridsShared.fetch_add(1, std::memory_order_relaxed);
  return gridWord(offset);
}

}  // namespace fr::cache
