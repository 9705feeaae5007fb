#include "reyes/frame_scene.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "imaging/frame_request.h"

namespace fr::reyes {
namespace {

/// Tiles that the bounds may touch, as columns and rows; empty when x0 > x1 or y0 > y1.
struct TileRange {
  int x0, y0, x1, y1;
  long long count() const {
    return x1 < x0 || y1 < y0 ? 0 : static_cast<long long>(x1 - x0 + 1) * (y1 - y0 + 1);
  }
};

TileRange tilesOf(const RasterBounds& b, const Film& film) {
  const PixelRect& s = film.sampledRect();
  const auto at = [&](float v, int origin, int count) {
    return int(std::clamp(std::floor((v - float(origin)) / float(film.tileSize())), -1.0f, float(count)));
  };
  return {std::max(0, at(b.x0, s.x0, film.tilesX())), std::max(0, at(b.y0, s.y0, film.tilesY())),
          std::min(film.tilesX() - 1, at(b.x1, s.x0, film.tilesX())),
          std::min(film.tilesY() - 1, at(b.y1, s.y0, film.tilesY()))};
}

}  // namespace

RootBins::RootBins(const cache::SceneCache& cache, const ShutterSpace& space,
                   const std::vector<SurfaceTraits>& traits, const cache::SolidForest& solids,
                   const Film& film) {
  const auto objects = cache.skeleton().objects();
  const auto patches = cache.skeleton().rootPatches();
  const long long manyTiles = std::max(64, film.tileCount() / 4);
  std::vector<TileRange> ranges;
  std::vector<uint32_t> counts(size_t(film.tileCount()) + 1, 0);
  // Of a solid whose surface is nowhere seen nothing is needed.
  std::vector<uint8_t> treeSeen(solids.treeCount(), 0);
  if (!solids.empty())
    for (const cache::ObjectRecord& object : objects)
      if (const cache::SolidId leaf = cache::solidOf(object); leaf != cache::kNone)
        treeSeen[solids.treeOf(leaf)] |= traits[object.attributes].visible;
  for (uint32_t tree = 0; tree < treeSeen.size(); ++tree)
    if (space.bounds(solids.bound(tree)).outside) treeSeen[tree] = 0;
  for (const cache::ObjectRecord& object : objects) {
    const cache::SolidId leaf = cache::solidOf(object);
    const uint32_t tree = leaf == cache::kNone ? cache::kNone : solids.treeOf(leaf);
    const bool visible = tree == cache::kNone ? traits[object.attributes].visible : treeSeen[tree] != 0;
    if (!(object.sides & cache::kForReyes) || !visible) continue;
    // One test for a whole object that is out of sight. Solids count what lies behind the far plane.
    const auto outside = [&](const RasterBounds& b) { return tree == cache::kNone ? b.outside : b.before; };
    const RasterBounds all = space.bounds(object.bound);
    if (outside(all) || tilesOf(all, film).count() == 0) {
      culled_ += object.patchCount;
      continue;
    }
    for (uint32_t i = 0; i < object.patchCount; ++i) {
      const cache::NodeId node = object.firstPatch + i;
      const RasterBounds b = space.bounds(patches[node].bound);
      const TileRange range = tilesOf(b, film);
      if (outside(b) || range.count() == 0) {
        ++culled_;
        continue;
      }
      const auto index = uint32_t(roots_.size());
      roots_.push_back({node, tree, b});
      ranges.push_back(range);
      if (range.count() > manyTiles) {
        large_.push_back(index);
        ranges.back() = {0, 0, -1, -1};
        continue;
      }
      for (int y = range.y0; y <= range.y1; ++y)
        for (int x = range.x0; x <= range.x1; ++x) ++counts[size_t(y * film.tilesX() + x)];
    }
  }
  starts_.assign(size_t(film.tileCount()) + 1, 0);
  for (size_t t = 0; t < size_t(film.tileCount()); ++t) starts_[t + 1] = starts_[t] + counts[t];
  entries_.resize(starts_.back());
  std::vector<uint32_t> at(starts_.begin(), starts_.end() - 1);
  for (size_t i = 0; i < roots_.size(); ++i)
    for (int y = ranges[i].y0; y <= ranges[i].y1; ++y)
      for (int x = ranges[i].x0; x <= ranges[i].x1; ++x)
        entries_[at[size_t(y * film.tilesX() + x)]++] = uint32_t(i);
}

std::vector<SurfaceTraits> surfaceTraits(const cache::SceneCache& cache, const ShadingSystem& shading) {
  std::vector<SurfaceTraits> all;
  const auto attributes = cache.skeleton().attributes();
  for (size_t i = 0; i < attributes.size(); ++i) {
    const cache::AttributeRecord& a = attributes[i];
    SurfaceTraits t;
    t.opaque = shading.isOpaque(cache::AttributeId(i));
    t.matte = a.flags & cache::kMatte;
    t.smooth = a.flags & cache::kSmoothShading;
    t.visible = a.visibility & cache::kVisibleCamera;
    // Seen from its front (N towards the eye) a micropolygon's raster area is positive, y down, when N is
    // dPdu x dPdv.
    std::copy_n(a.thinning, 2, t.thinning);
    if (a.sides == 1) t.cullSign = a.flags & cache::kReverseOrientation ? 1 : -1;
    if (frameFloatOption(cache.skeleton(), a.attributes, "dice:rasterorient", 1) != 0)
      t.shadingArea = a.shadingRate > 0 && std::isfinite(a.shadingRate) ? a.shadingRate : 1.0f;
    all.push_back(t);
  }
  return all;
}

uint64_t patchRank(const cache::PatchNode& node) {
  const uint64_t path = hashStep(hashStep(uint64_t(node.du) << 8 | node.dv, node.iu), node.iv);
  return uint64_t(node.root) << 32 | (path & 0xffffffffu);
}

}  // namespace fr::reyes
