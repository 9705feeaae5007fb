#include "reyes/tile_hider.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "reyes/hit_position.h"
#include "scene_cache/trim.h"

namespace fr::reyes {
namespace {

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// (u, v) of the root patch where a sample sees a grid's triangle, in perspective.
Vec2 patchParameters(const TileGrid& g, const TileView& view, const ShutterSpace& space,
                     const cache::PatchNode& node, uint32_t triangle, size_t sample) {
  const cache::GridRecord& r = *g.record;
  uint32_t v[3];
  gridTriangle(r.nu, triangle, v);
  BlurPoint corner[3];
  double weight[3] = {1.0 / 3, 1.0 / 3, 1.0 / 3};
  if (seenCorners(g, view, space, sample, v, corner))
    cornerWeights(corner, space.open().perspective(), view.samples.x[sample], view.samples.y[sample], weight);
  double column = 0, row = 0;
  for (int i = 0; i < 3; ++i)
    column += weight[i] * double(v[i] % (r.nu + 1u)), row += weight[i] * double(v[i] / (r.nu + 1u));
  return {float((node.iu + column / r.nu) * std::ldexp(1.0, -node.du)),
          float((node.iv + row / r.nv) * std::ldexp(1.0, -node.dv))};
}

/// Fragments that are gathered before they go to their list.
constexpr size_t kFragmentRoom = 4096;

/// Kernels have room for no more than dicers make; grids also come from files.
bool hasKernelSize(const cache::GridRecord& g) {
  const bool meshlet = g.kind == cache::GridKind::kMeshlet;
  const uint32_t vertices = meshlet ? g.nu : (g.nu + 1u) * (g.nv + 1u);
  const uint32_t triangles = meshlet ? g.nv : 2u * g.nu * g.nv;
  return vertices <= kMostBlurVertices && triangles <= kTriangleMask + 1;
}

/// RasterTarget::drain.
void drainFragments(RasterTarget& target) {
  auto& to = *static_cast<std::vector<Fragment>*>(target.drainTo);
  to.insert(to.end(), target.fragments, target.fragments + target.fragmentCount);
  target.fragmentCount = 0;
}

template <class IsUnseen>
void eraseFragments(std::vector<Fragment>& fragments, size_t first, IsUnseen&& isUnseen) {
  fragments.erase(std::remove_if(fragments.begin() + ptrdiff_t(first), fragments.end(), isUnseen),
                  fragments.end());
}

/// A hit that no kernel drew.
void addHit(uint32_t sample, uint32_t hit, float key, std::vector<Fragment>* fragments,
            RasterTarget& target) {
  float& depth = target.depth[sample];
  if (fragments) {
    if (key <= depth) fragments->push_back({sample, hit, key, 0});
    return;
  }
  uint32_t& other = target.hit[sample];
  const auto isBefore = [&] {
    const uint64_t mine = target.slotRank[hit >> kTriangleBits],
                   its = target.slotRank[other >> kTriangleBits];
    return mine < its || (mine == its && (hit & kTriangleMask) < (other & kTriangleMask));
  };
  if (key < depth || (key == depth && other != kNothing && isBefore())) depth = key, other = hit;
}

}  // namespace

void TileHider::consider(cache::NodeId node, TileView& view) {
  const RasterBounds b = scene_.space.bounds(scene_.cache->node(node).bound);
  if (b.outside)
    ++statistics_.nodesCulledOutside;
  else if (!b.overlaps(view.samples.rect()))
    ++statistics_.nodesCulledTile;
  else if (view.samples.hides(b))
    ++statistics_.nodesCulledHidden;
  else
    addCandidate(node, b), std::push_heap(heap_.begin(), heap_.end());
}

void TileHider::hide(int tile, const PixelRect& rect, TileView& view, const SampleRound& round) {
  const auto start = Clock::now();
  resolving_ = 0;
  view.tile = tile;
  view.samples.reset(rect, scene_.pattern, scene_.space.open().farKey(), round);
  if (scene_.lines.hasPlanes()) view.samples.limit(scene_.pattern, scene_.lines, scene_.space.open());
  view.grids.clear(), view.ranks.clear(), view.fragments.clear();
  view.layers.clear(), view.firstLayer.clear();
  heap_.clear(), bounds_.clear();
  solids_.begin();
  scene_.roots->forTile(tile, rect, [&](cache::NodeId node, const RasterBounds& b, uint32_t tree) {
    if (!b.overlaps(rect))
      ++statistics_.nodesCulledTile;
    else if (tree == cache::kNone)
      addCandidate(node, b);
    else
      solids_.addRoot(tree, node);
  });
  solids_.forTrees([&](uint32_t tree) {
    const RasterBounds b = scene_.space.bounds(scene_.solids->bound(tree));
    if (!b.outside && b.overlaps(rect)) heap_.push_back({b.key, tree, kSolid});
  });
  std::make_heap(heap_.begin(), heap_.end());
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const Candidate next = heap_.back();
    const cache::NodeId node = next.node;
    heap_.pop_back();
    if (next.bounds == kSolid) {
      drawSolid(node, view);
      continue;
    }
    // What was drawn since the node was found may hide it.
    if (view.samples.hides(bounds_[next.bounds])) {
      ++statistics_.nodesCulledHidden;
      continue;
    }
    const cache::ResolvedNode resolved = resolve(node);
    if (resolved.state == cache::NodeState::kSplit)
      for (cache::NodeId child : resolved.children) consider(child, view);
    else if (resolved.state == cache::NodeState::kGrid)
      drawGrid(node, *resolved.grid, view);
  }
  markSeen(view);
  statistics_.fragments += view.fragments.size();
  statistics_.resolveSeconds += resolving_;
  statistics_.drawSeconds += secondsSince(start) - resolving_;
}

cache::ResolvedNode TileHider::resolve(cache::NodeId node) {
  const auto start = Clock::now();
  const cache::ResolvedNode resolved = scene_.cache->resolve(node);
  resolving_ += secondsSince(start);
  statistics_.nodesSplit += resolved.state == cache::NodeState::kSplit;
  statistics_.nodesLost +=
      resolved.state == cache::NodeState::kEmpty || resolved.state == cache::NodeState::kBuilding;
  return resolved;
}

/// All of a tree at once: whether one part shows depends on the others. Only as a whole is it hidden.
void TileHider::drawSolid(uint32_t tree, TileView& view) {
  const PixelRect& rect = view.samples.rect();
  if (view.samples.hides(scene_.space.bounds(scene_.solids->bound(tree)))) {
    ++statistics_.nodesCulledHidden;
    return;
  }
  stack_.clear();
  solids_.forRoots(tree, [&](cache::NodeId root) { stack_.push_back(root); });
  while (!stack_.empty()) {
    const cache::NodeId node = stack_.back();
    stack_.pop_back();
    const RasterBounds b = scene_.space.bounds(scene_.cache->node(node).bound);
    if (b.before || !b.overlaps(rect)) {
      ++statistics_.nodesCulledTile;
      continue;
    }
    const cache::ResolvedNode resolved = resolve(node);
    if (resolved.state == cache::NodeState::kSplit)
      stack_.insert(stack_.end(), resolved.children, resolved.children + 2);
    else if (resolved.state == cache::NodeState::kGrid)
      drawGrid(node, *resolved.grid, view);
  }
  if (solids_.resolve(view)) view.samples.touched(0, 0, rect.width() - 1, rect.height() - 1);
}

void TileHider::drawGrid(cache::NodeId node, const cache::GridRecord& grid, TileView& view) {
  const PixelRect& rect = view.samples.rect();
  if (grid.flags & cache::kGridAbsent) return;
  if (!hasKernelSize(grid)) {
    ++statistics_.nodesLost;
    return;
  }
  const cache::ObjectRecord& object = scene_.cache->objectOf(node);
  const cache::SolidId solid = cache::solidOf(object);
  const bool isSolid = solid != cache::kNone;
  const RasterBounds boxBounds = scene_.space.bounds(grid.bound);
  if ((isSolid ? boxBounds.before : boxBounds.outside) || !boxBounds.overlaps(rect)) {
    ++statistics_.gridsCulledTile;
    return;
  }
  if (!isSolid && view.samples.hides(boxBounds)) {
    ++statistics_.gridsCulledHidden;
    return;
  }
  if (view.grids.size() + 2 > kMaxSlots) {
    reportOnce("grids of a bucket",
               makeError(RiError::kLimit, "more than {} grids in one bucket", kMaxSlots));
    return;
  }
  const cache::GridView v = scene_.cache->view(grid);
  const bool meshlet = grid.kind == cache::GridKind::kMeshlet;
  const int columns = meshlet ? grid.nu : grid.nu + 1, rows = meshlet ? 1 : grid.nv + 1;
  const size_t rowStride = meshlet ? grid.nu : grid.rowStride;
  TileGrid entry;
  entry.node = node, entry.record = &grid, entry.indices = v.indices;
  entry.traits = scene_.traits[object.attributes];
  entry.solid = solid, entry.shows = !isSolid || entry.traits.visible;
  // Vertices of a prototype, brought to cache space; key after key where they move.
  const float* positions = v.positions;
  size_t keyStride = grid.keyBytes / sizeof(float);
  if (v.placement) {
    const size_t count = size_t(rows - 1) * rowStride + size_t(columns);
    placed_.resize(count * grid.keyCount);
    for (size_t k = 0; k < grid.keyCount; ++k)
      for (size_t i = 0; i < count; ++i)
        placed_[k * count + i] = v.placed(v.positions + k * keyStride + 3 * i);
    positions = &placed_[0].x, keyStride = 3 * count;
  }
  const bool blurred = view.samples.blurred() && (grid.keyCount > 1 || scene_.space.blursAll());
  if (blurred)
    projectBlurred(scene_.space, positions, grid.keyCount, keyStride, columns, rows, rowStride,
                   entry.blurred);
  else
    projectGrid(scene_.space.open(), positions, columns, rows, rowStride, rect, entry.projected);
  const RasterBounds& b = blurred ? entry.blurred.bounds : entry.projected.bounds;
  if (b.outside || !b.overlaps(rect)) {
    ++statistics_.gridsCulledTile;
    return;
  }
  if (!isSolid && view.samples.hides(b)) {
    ++statistics_.gridsCulledHidden;
    return;
  }
  ++statistics_.gridsDrawn;
  const auto slot = uint32_t(view.grids.size());
  view.grids.push_back(std::move(entry));
  view.ranks.push_back(patchRank(scene_.cache->node(node)));
  // The side of a one-sided solid that is not seen is crossed all the same: it gets a slot of its own.
  const bool hasUnseenSide = isSolid && view.grids.back().traits.cullSign != 0;
  if (hasUnseenSide) {
    TileGrid unseen;
    unseen.node = node, unseen.record = &grid, unseen.solid = solid, unseen.shows = false;
    view.grids.push_back(std::move(unseen));
    view.ranks.push_back(view.ranks.back());
  }
  const TileGrid& g = view.grids[slot];

  SampleBuffer& samples = view.samples;
  RasterTarget target;
  target.columns = rect.width(), target.rows = rect.height();
  target.perPixel = samples.perPixel(), target.rowStride = samples.rowStride();
  target.x = samples.x.data(), target.y = samples.y.data(), target.xy = samples.xy.data();
  target.groups = samples.groups().data();
  target.groupSize = samples.groups().empty() ? 0 : rasterWidth();
  target.depth = isSolid ? solids_.unlimited(samples.size()) : samples.depth.data();
  target.hit = samples.hit.data();
  target.slotRank = view.ranks.data();
  // What samples do not see of the grid is taken out of the list of fragments, so they make one first.
  const bool trimmed = grid.flags & cache::kGridTrimmed;
  const bool thinned = g.traits.thinning[0] > 0 || g.traits.thinning[1] > 0;
  const bool cut = trimmed || (!isSolid && (thinned || samples.startsLate()));
  const bool hides = g.traits.opaque && !cut && !isSolid;
  std::vector<Fragment>& fragments = isSolid ? solids_.crossings() : view.fragments;
  std::vector<Fragment>* to = hides ? nullptr : &fragments;
  const size_t firstFragment = fragments.size();
  if (to) {
    if (room_.empty()) room_.resize(kFragmentRoom);
    target.fragments = room_.data(), target.fragmentCapacity = room_.size();
    target.drain = drainFragments, target.drainTo = to;
  }
  const auto draw = [&](uint32_t drawnSlot, int cullSign) {
    if (blurred) {
      BlurFaces faces = g.blurred.faces(scene_.space, rect);
      faces.nu = grid.nu, faces.nv = grid.nv, faces.indices = v.indices;
      faces.faceCount = meshlet ? grid.nv : uint32_t(grid.nu) * grid.nv;
      faces.slot = drawnSlot, faces.cullSign = cullSign;
      const BlurSamples times = samples.blurSamples();
      drawBlurred_(faces, times, target);
      if (to) drainFragments(target);
      if (g.blurred.anyClipped)
        drawBlurredClipped(g.blurred, scene_.space, faces, times, target,
                           [&](uint32_t sample, uint32_t triangle, float key) {
                             addHit(sample, drawnSlot << kTriangleBits | triangle, key, to, target);
                           });
      // Where it may have been seen at some time.
      target.column0 = target.row0 = 0, target.column1 = rect.width() - 1, target.row1 = rect.height() - 1;
      return;
    }
    RasterTriangles triangles;
    triangles.x = g.projected.x.data(), triangles.y = g.projected.y.data();
    triangles.key = g.projected.key.data(), triangles.skip = g.projected.state.data();
    triangles.nu = grid.nu, triangles.nv = grid.nv, triangles.indices = v.indices;
    triangles.triangleCount = meshlet ? grid.nv : 2u * grid.nu * grid.nv;
    triangles.slot = drawnSlot, triangles.cullSign = cullSign;
    const auto drawTriangles = [&](const RasterTriangles& t) {
      rasterise_(t, target);
      if (to) drainFragments(target);
    };
    drawTriangles(triangles);
    if (g.projected.anyClipped)
      drawClipped(scene_.space.open(), positions, columns, rowStride, rect, g.projected, triangles,
                  drawTriangles);
  };
  draw(slot, g.traits.cullSign);
  if (hasUnseenSide) draw(slot + 1, -g.traits.cullSign);
  if (trimmed) {
    const cache::PatchTrim trim = scene_.cache->trimOf(node);
    const cache::PatchNode& place = scene_.cache->node(node);
    eraseFragments(fragments, firstFragment, [&](const Fragment& f) {
      const Vec2 uv = patchParameters(g, view, scene_.space, place, f.hit & kTriangleMask, f.sample);
      return trim.removed(uv.x, uv.y);
    });
  }
  if (cut && !isSolid) {
    if (thinned)
      eraseFragments(fragments, firstFragment, [&](const Fragment& f) {
        const float chance = samples.chance(f.sample, scene_.pattern);
        return chance < g.traits.thinning[0] || chance >= 1 - g.traits.thinning[1];
      });
    if (samples.startsLate())
      eraseFragments(fragments, firstFragment,
                     [&](const Fragment& f) { return f.depth < samples.start(f.sample); });
    if (g.traits.opaque) {
      for (size_t i = firstFragment; i < fragments.size(); ++i)
        addHit(fragments[i].sample, fragments[i].hit, fragments[i].depth, nullptr, target);
      fragments.resize(firstFragment);
      samples.touched(0, 0, rect.width() - 1, rect.height() - 1);
    }
  }
  if (hides && target.column1 >= 0) samples.touched(target.column0, target.row0, target.column1, target.row1);
  statistics_.micropolygonsTested += target.trianglesTested / (meshlet || blurred ? 1 : 2);
}

void TileHider::markSeen(TileView& view) {
  const auto mark = [&view](uint32_t hit) {
    TileGrid& g = view.grids[hit >> kTriangleBits];
    g.seen = true;
    g.seenTriangles.insert(hit & kTriangleMask);
  };
  for (const uint32_t h : view.samples.hit)
    if (h != kNothing) mark(h);
  if (!view.fragments.empty()) sortLayers(view);
  for (const Layer& l : view.layers) mark(l.hit);
}

void TileHider::sortLayers(TileView& view) {
  const std::vector<float>& opaque = view.samples.depth;
  // Counted one place further on: when all are in place, first[s + 1] is where sample s begins, and the first
  // of the next one where it ends.
  std::vector<uint32_t>& first = view.firstLayer;
  first.assign(view.samples.size() + 2, 0);
  const auto shows = [&](const Fragment& f) { return f.depth <= opaque[f.sample]; };
  for (const Fragment& f : view.fragments)
    if (shows(f)) ++first[f.sample + 2];
  for (size_t s = 2; s < first.size(); ++s) first[s] += first[s - 1];
  view.layers.resize(first.back());
  for (const Fragment& f : view.fragments)
    if (shows(f)) view.layers[first[f.sample + 1]++] = {f.depth, f.hit};
  first.pop_back();
  const auto isBefore = [&](const Layer& a, const Layer& b) {
    if (a.depth != b.depth) return a.depth < b.depth;
    const uint64_t ra = view.ranks[a.hit >> kTriangleBits], rb = view.ranks[b.hit >> kTriangleBits];
    return ra != rb ? ra < rb : (a.hit & kTriangleMask) < (b.hit & kTriangleMask);
  };
  // Grids are drawn front to back, so the layers of a sample are nearly in order already.
  constexpr uint32_t kManyLayers = 48;
  for (size_t s = 0; s + 1 < first.size(); ++s) {
    const auto begin = view.layers.begin() + ptrdiff_t(first[s]),
               end = view.layers.begin() + ptrdiff_t(first[s + 1]);
    if (first[s + 1] - first[s] > kManyLayers) {
      std::sort(begin, end, isBefore);
      continue;
    }
    for (auto at = begin; at != end; ++at) {
      const Layer layer = *at;
      auto to = at;
      for (; to != begin && isBefore(layer, *(to - 1)); --to) *to = *(to - 1);
      *to = layer;
    }
  }
}

}  // namespace fr::reyes
