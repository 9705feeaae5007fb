// What all tiles of a frame share: the scene seen from the camera.
#pragma once

#include <vector>

#include "imaging/film.h"
#include "reyes/raster_space.h"
#include "reyes/sample_buffer.h"
#include "scene_cache/cache.h"
#include "scene_cache/solids.h"
#include "shading/shading_system.h"

namespace fr::reyes {

/// What the hider needs to know of an attribute state.
struct SurfaceTraits {
  bool opaque = true;  // Os is 1 wherever it is hit
  bool matte = false;
  bool smooth = false;  // ShadingInterpolation "smooth"
  bool visible = true;  // to the camera
  int cullSign = 0;     // as RasterTriangles::cullSign
  /// ShadingRate: pixels that a shaded cell may cover; 0: every vertex is shaded, whatever its size on the
  /// raster (Attribute "dice" "rasterorient" 0).
  float shadingArea = 0;
  float thinning[2] = {0, 0};  // as AttributeRecord::thinning
};

/// Root patches by the tiles they may cover. Immutable once made; thread-safe.
class RootBins {
 public:
  /// Bounds every root patch that the camera can see and that is made for the REYES side. Of solids, also
  /// what cannot be seen but shapes what can.
  RootBins(const cache::SceneCache& cache, const ShutterSpace& space,
           const std::vector<SurfaceTraits>& traits, const cache::SolidForest& solids, const Film& film);
  /// Calls f(NodeId, const RasterBounds&, uint32_t tree) for the root patches that may cover the tile; tree:
  /// of solids, or kNone.
  template <class F>
  void forTile(int tile, const PixelRect& rect, F&& f) const {
    for (uint32_t i = starts_[size_t(tile)]; i < starts_[size_t(tile) + 1]; ++i)
      f(roots_[entries_[i]].node, roots_[entries_[i]].bounds, roots_[entries_[i]].tree);
    for (uint32_t i : large_)
      if (roots_[i].bounds.overlaps(rect)) f(roots_[i].node, roots_[i].bounds, roots_[i].tree);
  }
  uint64_t culled() const { return culled_; }
  size_t count() const { return roots_.size(); }

 private:
  struct Root {
    cache::NodeId node;
    uint32_t tree;
    RasterBounds bounds;
  };
  std::vector<Root> roots_;
  std::vector<uint32_t> starts_, entries_, large_;
  uint64_t culled_ = 0;
};

/// Immutable while tiles are rendered.
struct FrameScene {
  cache::SceneCache* cache = nullptr;
  ShutterSpace space;
  SamplePattern pattern;
  SightLines lines;
  std::vector<SurfaceTraits> traits;  // by AttributeId
  const RootBins* roots = nullptr;
  const cache::SolidForest* solids = nullptr;
};

std::vector<SurfaceTraits> surfaceTraits(const cache::SceneCache& cache, const ShadingSystem& shading);

/// Rank of a patch that does not depend on the order in which patches were split: root patch, then a hash of
/// the path.
uint64_t patchRank(const cache::PatchNode& node);

}  // namespace fr::reyes
