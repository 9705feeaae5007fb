#include "reyes/tile_hider.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "scene_cache/trim.h"

namespace fr::reyes {
namespace {

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// (u, v) of the root patch where a sample sees a grid's triangle, in perspective.
Vec2 patchParameters(const TileGrid& g, const cache::PatchNode& node, uint32_t triangle, double px, double py,
                     bool perspective) {
  const cache::GridRecord& r = *g.record;
  uint32_t v[3];
  gridTriangle(r.nu, triangle, v);
  const ProjectedGrid& p = g.projected;
  double e[3], sum = 0;
  const bool drawn = !(p.state[v[0]] | p.state[v[1]] | p.state[v[2]]);
  for (int i = 0; i < 3; ++i) {
    const uint32_t a = v[(i + 1) % 3], b = v[(i + 2) % 3];
    e[i] = drawn ? double(p.x[b] - p.x[a]) * (py - p.y[a]) - double(p.y[b] - p.y[a]) * (px - p.x[a]) : 1.0;
    if (perspective && drawn) e[i] *= double(p.key[v[i]]);
    sum += e[i];
  }
  double column = 0, row = 0;
  for (int i = 0; i < 3; ++i) {
    const double w = sum != 0 ? e[i] / sum : 1.0 / 3;
    column += w * double(v[i] % (r.nu + 1u)), row += w * double(v[i] / (r.nu + 1u));
  }
  return {float((node.iu + column / r.nu) * std::ldexp(1.0, -node.du)),
          float((node.iv + row / r.nv) * std::ldexp(1.0, -node.dv))};
}

/// Room for fragments is made for this many at a time.
constexpr size_t kFragmentRoom = 4096;

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
    heap_.push_back({b.key, node}), std::push_heap(heap_.begin(), heap_.end());
}

void TileHider::hide(int tile, const PixelRect& rect, TileView& view) {
  const auto start = Clock::now();
  double resolving = 0;
  view.tile = tile;
  view.samples.reset(rect, scene_.pattern, scene_.space.farKey());
  view.grids.clear(), view.ranks.clear(), view.fragments.clear(), view.firstFragment.clear();
  heap_.clear();
  scene_.roots->forTile(tile, rect, [&](cache::NodeId node, const RasterBounds& b) {
    if (b.overlaps(rect))
      heap_.push_back({b.key, node});
    else
      ++statistics_.nodesCulledTile;
  });
  std::make_heap(heap_.begin(), heap_.end());
  while (!heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const cache::NodeId node = heap_.back().node;
    heap_.pop_back();
    // What was drawn since the node was found may hide it.
    const RasterBounds b = scene_.space.bounds(scene_.cache->node(node).bound);
    if (view.samples.hides(b)) {
      ++statistics_.nodesCulledHidden;
      continue;
    }
    const auto before = Clock::now();
    const cache::ResolvedNode resolved = scene_.cache->resolve(node);
    resolving += secondsSince(before);
    switch (resolved.state) {
      case cache::NodeState::kSplit:
        ++statistics_.nodesSplit;
        for (cache::NodeId child : resolved.children) consider(child, view);
        break;
      case cache::NodeState::kGrid:
        drawGrid(node, *resolved.grid, view);
        break;
      case cache::NodeState::kEmpty:
      case cache::NodeState::kBuilding:
        ++statistics_.nodesLost;
        break;
    }
  }
  markSeen(view);
  statistics_.fragments += view.fragments.size();
  statistics_.resolveSeconds += resolving;
  statistics_.drawSeconds += secondsSince(start) - resolving;
}

void TileHider::drawGrid(cache::NodeId node, const cache::GridRecord& grid, TileView& view) {
  const PixelRect& rect = view.samples.rect();
  if (grid.flags & cache::kGridAbsent) return;
  const RasterBounds boxBounds = scene_.space.bounds(grid.bound);
  if (boxBounds.outside || !boxBounds.overlaps(rect)) {
    ++statistics_.gridsCulledTile;
    return;
  }
  if (view.samples.hides(boxBounds)) {
    ++statistics_.gridsCulledHidden;
    return;
  }
  if (view.grids.size() >= kMaxSlots) {
    reportOnce("grids of a bucket",
               makeError(RiError::kLimit, "more than {} grids in one bucket", kMaxSlots));
    return;
  }
  const cache::GridView v = scene_.cache->view(grid);
  const bool meshlet = grid.kind == cache::GridKind::kMeshlet;
  const int columns = meshlet ? grid.nu : grid.nu + 1, rows = meshlet ? 1 : grid.nv + 1;
  const size_t rowStride = meshlet ? grid.nu : grid.rowStride;
  if (grid.keyCount > 1)
    reportOnce("motion blur", Error{RiError::kUnimplemented,
                                    Severity::kWarning,
                                    {},
                                    "moving geometry is rendered as it is at shutter open"});

  TileGrid entry;
  entry.node = node, entry.record = &grid, entry.indices = v.indices;
  entry.traits = scene_.traits[scene_.cache->objectOf(node).attributes];
  projectGrid(scene_.space, v.positions, columns, rows, rowStride, rect, entry.projected);
  const RasterBounds& b = entry.projected.bounds;
  if (b.outside || !b.overlaps(rect)) {
    ++statistics_.gridsCulledTile;
    return;
  }
  if (view.samples.hides(b)) {
    ++statistics_.gridsCulledHidden;
    return;
  }
  ++statistics_.gridsDrawn;
  const auto slot = uint32_t(view.grids.size());
  view.grids.push_back(std::move(entry));
  view.ranks.push_back(patchRank(scene_.cache->node(node)));
  const TileGrid& g = view.grids.back();

  RasterTriangles triangles;
  triangles.x = g.projected.x.data(), triangles.y = g.projected.y.data(),
  triangles.key = g.projected.key.data();
  triangles.skip = g.projected.state.data();
  triangles.nu = grid.nu, triangles.nv = grid.nv;
  triangles.indices = v.indices;
  triangles.triangleCount = meshlet ? grid.nv : 2u * grid.nu * grid.nv;
  triangles.slot = slot, triangles.cullSign = g.traits.cullSign;

  SampleBuffer& samples = view.samples;
  RasterTarget target;
  target.columns = rect.width(), target.rows = rect.height();
  target.perPixel = samples.perPixel(), target.rowStride = samples.rowStride();
  target.x = samples.x.data(), target.y = samples.y.data();
  target.depth = samples.depth.data(), target.hit = samples.hit.data();
  target.slotRank = view.ranks.data();
  const bool trimmed = grid.flags & cache::kGridTrimmed;
  const size_t firstFragment = view.fragments.size();
  const auto draw = [&](const RasterTriangles& t) {
    if (g.traits.opaque && !trimmed) {
      rasterise_(t, 0, target);
      return;
    }
    size_t room = kFragmentRoom;
    for (uint32_t next = 0; next < t.triangleCount;) {
      const size_t have = view.fragments.size();
      view.fragments.resize(have + room);
      target.fragments = view.fragments.data() + have;
      target.fragmentCapacity = room, target.fragmentCount = 0;
      const uint32_t stopped = rasterise_(t, next, target);
      view.fragments.resize(have + target.fragmentCount);
      if (stopped == next) room *= 2;  // one triangle covers more samples than there was room for
      next = stopped;
    }
  };
  draw(triangles);
  if (g.projected.anyClipped)
    drawClipped(scene_.space, v.positions, columns, rowStride, rect, g.projected, triangles, draw);
  if (trimmed) {
    const cache::PatchTrim trim = scene_.cache->trimOf(node);
    const cache::PatchNode& place = scene_.cache->node(node);
    const auto cut = [&](const Fragment& f) {
      const Vec2 uv = patchParameters(g, place, f.hit & kTriangleMask, samples.x[f.sample],
                                      samples.y[f.sample], scene_.space.perspective());
      return trim.removed(uv.x, uv.y);
    };
    view.fragments.erase(
        std::remove_if(view.fragments.begin() + ptrdiff_t(firstFragment), view.fragments.end(), cut),
        view.fragments.end());
  }
  if (g.traits.opaque && !trimmed && target.column1 >= 0)
    samples.touched(target.column0, target.row0, target.column1, target.row1);
  statistics_.micropolygonsTested += target.trianglesTested / (meshlet ? 1 : 2);
}

void TileHider::markSeen(TileView& view) {
  for (uint32_t h : view.samples.hit)
    if (h != kNothing) view.grids[h >> kTriangleBits].seen = true;
  if (view.fragments.empty()) return;
  view.firstFragment.assign(view.samples.size(), kNothing);
  // Backwards, so that each sample's list comes out in the order of drawing.
  for (size_t i = view.fragments.size(); i-- > 0;) {
    Fragment& f = view.fragments[i];
    if (f.depth > view.samples.depth[f.sample]) continue;  // something opaque came before it later on
    f.next = view.firstFragment[f.sample];
    view.firstFragment[f.sample] = uint32_t(i);
    view.grids[f.hit >> kTriangleBits].seen = true;
  }
}

}  // namespace fr::reyes
