// Making nodes of what another cache has.
#include <algorithm>
#include <cstring>
#include <map>

#include "scene_cache/cache_impl.h"
#include "scene_cache/grid_source.h"
#include "scene_cache/object_content.h"
#include "scene_cache/thin.h"

namespace fr::cache {
namespace {

bool sameEyes(const DiceEye& a, const DiceEye& b) {
  return a.position == b.position && a.perspective == b.perspective && a.pixel == b.pixel &&
         a.nearDistance == b.nearDistance && a.axis == b.axis && a.cone == b.cone && a.radius == b.radius;
}

DiceEye eyeOf(const Skeleton& s) { return diceEye(s.camera(), s.cacheToCamera(s.camera().shutter[0])); }

}  // namespace

GridSource::GridSource(std::shared_ptr<const SceneCache> old, const SceneCache& now,
                       const SceneCache::Reuse& reuse)
    : old_(std::move(old)), reuse_(reuse) {
  const Skeleton &then = old_->skeleton(), &here = now.skeleton();
  roots_.assign(here.rootPatches().size(), kNone);
  const float *a = then.camera().shutter, *b = here.camera().shutter;
  if (then.header().cacheOrigin != here.header().cacheOrigin || a[0] != b[0] || a[1] != b[1]) return;
  sameEye_ = sameEyes(eyeOf(then), eyeOf(here));
  sameCamera_ = sameEye_ && transformContent(then, then.camera().worldToCamera) ==
                                transformContent(here, here.camera().worldToCamera);
  // Equal objects are taken in order.
  std::map<ContentKey, std::vector<ObjectId>> objects;
  for (ObjectId i = ObjectId(then.objects().size()); i-- > 0;)
    objects[diceContent(then, i, true)].push_back(i);
  for (ObjectId i = 0; i < here.objects().size(); ++i) {
    const auto found = objects.find(diceContent(here, i, true));
    if (found == objects.end() || found->second.empty()) continue;
    const ObjectRecord &from = then.objects()[found->second.back()], &to = here.objects()[i];
    found->second.pop_back();
    if (from.patchCount != to.patchCount) continue;
    for (uint32_t k = 0; k < to.patchCount; ++k) roots_[to.firstPatch + k] = from.firstPatch + k;
  }
}

NodeId GridSource::nodeFor(const PatchNode& n) const {
  NodeId at = n.root < roots_.size() ? roots_[n.root] : kNone;
  for (int steps = 0; at != kNone && steps <= 2 * kMaxSplitDepth; ++steps) {
    const PatchNode& o = old_->node(at);
    if (o.du == n.du && o.dv == n.dv) return o.iu == n.iu && o.iv == n.iv ? at : kNone;
    const ResolvedNode r = old_->peek(at);
    if (r.state != NodeState::kSplit || o.du > n.du || o.dv > n.dv) return kNone;
    const bool inV = old_->node(r.children[0]).dv != o.dv;
    const int depth = inV ? o.dv : o.du, target = inV ? n.dv : n.du;
    if (depth >= target) return kNone;
    at = r.children[((inV ? n.iv : n.iu) >> (target - depth - 1)) & 1];
  }
  return kNone;
}

void SceneCache::takeGridsFrom(std::shared_ptr<const SceneCache> old, const Reuse& reuse) {
  impl_->gridSource = std::make_unique<GridSource>(std::move(old), *this, reuse);
}

uint64_t SceneCache::displacement() const { return impl_->displacement; }

uint64_t SceneCache::Impl::copyGrid(const SceneCache& from, const GridRecord& o, NodeId id_) {
  const GridView v = from.view(o);
  const bool isGrid = o.kind == GridKind::kGrid;
  const uint64_t points = isGrid ? uint64_t(o.rowStride) * o.nv + o.nu + 1u : o.nu;
  const uint64_t vertices = isGrid ? uint64_t(o.nu + 1u) * (o.nv + 1u) : o.nu;
  const uint64_t keyBytes = (points * 12 + 15) / 16 * 16;
  const uint64_t normalBytes = v.normals ? vertices * sizeof(uint32_t) : 0,
                 indexBytes = isGrid ? 0 : o.nv * 3ull;
  const uint64_t offset = allocateGrid(o.levels, o.keyCount * keyBytes + normalBytes + indexBytes);
  if (!offset) return 0;
  auto* g = new (arena.base() + offset) GridRecord(o);
  g->node = id_;
  g->keyBytes = keyBytes;
  g->positions = offset + sizeof(GridRecord);
  for (uint32_t k = 0; k < o.keyCount; ++k)
    std::memcpy(arena.base() + g->positions + k * keyBytes,
                reinterpret_cast<const std::byte*>(v.positions) + k * o.keyBytes, points * 12);
  uint64_t at = g->positions + o.keyCount * keyBytes;
  if (v.normals) {
    g->normals = at, at += normalBytes;
    std::memcpy(arena.base() + g->normals, v.normals, normalBytes);
  }
  if (indexBytes) {
    g->indices = at;
    std::memcpy(arena.base() + g->indices, v.indices, indexBytes);
  }
  return offset;
}

uint64_t SceneCache::Impl::makeReused(const Skeleton& skeleton, NodeId id_, const ObjectRecord& object,
                                      Displacer* displacer) {
  const PatchNode& n = *node(id_);
  const NodeId from = gridSource->nodeFor(n);
  if (from == kNone) return 0;
  const ResolvedNode o = gridSource->old().peek(from);
  // Meshlets hold the mesh's own points, prototypes are diced at a fixed rate; all others depend on the eye.
  const bool fixed = object.type == PrimitiveType::kMeshlets ||
                     (object.fixedRate > 0 && !(skeleton.attributes()[object.attributes].flatness > 0));
  if (!gridSource->sameEye() && !fixed) return 0;

  if (o.state == NodeState::kSplit) {
    const PatchNode& first = gridSource->old().node(o.children[0]);
    const bool inV = first.dv != n.dv;
    const uint64_t offset = allocateChildren();
    if (!offset) return 0;
    auto* made = reinterpret_cast<PatchNode*>(nodes.base() + offset);
    NodeRect children[2];
    splitRect(rectOf(n), inV, children);
    for (int c = 0; c < 2; ++c) {
      made[c].root = n.root;
      made[c].iu = children[c].iu, made[c].iv = children[c].iv;
      made[c].du = children[c].du, made[c].dv = children[c].dv;
      std::copy_n(children[c].edgeRootDepth, 4, made[c].edgeRootDepth);
      made[c].bound = gridSource->old().node(o.children[c]).bound;
    }
    nodesSplit.fetch_add(1, std::memory_order_relaxed);
    return splitWord(NodeId((offset - kStoreHeaderBytes) / sizeof(PatchNode)), inV);
  }
  if (o.state != NodeState::kGrid || o.grid->placement != 0) return 0;
  const bool displaced = (o.grid->flags & kGridHasNormals) != 0;
  if (!gridSource->reuse().only) {
    const bool wanted = displacer && displacer->displaces(skeleton.rootPatches()[n.root].object);
    if (wanted != displaced ||
        (displaced && !(gridSource->reuse().displacements && gridSource->sameCamera())))
      return 0;
  }
  const uint64_t offset = copyGrid(gridSource->old(), *o.grid, id_);
  if (!offset) return 0;
  gridsReused.fetch_add(1, std::memory_order_relaxed);
  return gridWord(offset);
}

uint64_t SceneCache::Impl::reusePlanned(NodeId id_, const DicePlan& plan, int keys,
                                        const std::function<void(int, float*)>& borders) {
  const NodeId from = gridSource->nodeFor(*node(id_));
  if (from == kNone) return 0;
  const ResolvedNode o = gridSource->old().peek(from);
  if (o.state != NodeState::kGrid || o.grid->kind != GridKind::kGrid || o.grid->flags != 0 ||
      o.grid->placement != 0)
    return 0;
  const GridRecord& old = *o.grid;
  if (old.nu != 1 << plan.log2Nu || old.nv != 1 << plan.log2Nv || old.keyCount != keys ||
      old.rowStride != old.nu + 1u || !std::equal(plan.edgeShift, plan.edgeShift + 4, old.edgeShift))
    return 0;
  const uint64_t offset = copyGrid(gridSource->old(), old, id_);
  if (!offset) return 0;
  auto* g = reinterpret_cast<GridRecord*>(arena.base() + offset);
  // The plan says which vertices are kept. Where the kept ones lie may still differ: lines end on older ones,
  // whose rates are not this grid's.
  bool same = true;
  const size_t bytes = (size_t(old.rowStride) * old.nv + old.nu + 1) * 12;
  const auto* before = reinterpret_cast<const std::byte*>(gridSource->old().view(old).positions);
  for (int k = 0; k < keys && same; ++k) {
    auto* xyz = reinterpret_cast<float*>(arena.base() + g->positions + unsigned(k) * g->keyBytes);
    borders(k, xyz);
    same = std::memcmp(xyz, before + unsigned(k) * old.keyBytes, bytes) == 0;
  }
  if (!same) return 0;  // the copy stays behind, unreferenced: rare
  gridsReused.fetch_add(1, std::memory_order_relaxed);
  return gridWord(offset);
}

}  // namespace fr::cache
