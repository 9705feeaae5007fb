// Visibility of one tile: which micropolygon each sample sees. Nothing is shaded here.
#pragma once

#include <vector>

#include "reyes/blurred_grid.h"
#include "reyes/frame_scene.h"
#include "reyes/grid_projection.h"
#include "reyes/shaded_grids.h"
#include "reyes/tile_solids.h"

namespace fr::reyes {

struct HiderStatistics {
  uint64_t nodesCulledTile = 0, nodesCulledHidden = 0, nodesCulledOutside = 0, nodesSplit = 0, nodesLost = 0;
  uint64_t gridsDrawn = 0, gridsCulledHidden = 0, gridsCulledTile = 0, micropolygonsTested = 0, fragments = 0;
  double resolveSeconds = 0, drawSeconds = 0;
};

/// A grid that was drawn onto the tile.
struct TileGrid {
  cache::NodeId node = cache::kNone;
  const cache::GridRecord* record = nullptr;
  const uint8_t* indices = nullptr;  // of a meshlet
  SurfaceTraits traits;
  ProjectedGrid projected;
  BlurredGrid blurred;                  // in place of `projected` when it moves or is seen through a lens
  cache::SolidId solid = cache::kNone;  // leaf that it bounds
  bool shows = true;  // false: of a solid, a side or an object that is not seen but shapes what is
  bool seen = false;  // by a sample, so that its colours are needed
  TriangleSet seenTriangles;
  ShadedGrid* shaded = nullptr;
};

/// What a sample sees of a surface that is not known to be opaque.
struct Layer {
  float depth;
  uint32_t hit;
};

/// A hidden tile on its way to colours.
struct TileView {
  int tile = -1;
  SampleBuffer samples;
  std::vector<TileGrid> grids;      // by slot
  std::vector<uint64_t> ranks;      // by slot
  std::vector<Fragment> fragments;  // of surfaces not known to be opaque, as they were drawn
  /// The same by sample, front to back, without what lies behind something opaque: sample s has the layers
  /// [firstLayer[s], firstLayer[s + 1]). Both are empty when there are no fragments.
  std::vector<Layer> layers;
  std::vector<uint32_t> firstLayer;
};

/// One per thread.
class TileHider {
 public:
  explicit TileHider(const FrameScene& scene)
      : scene_(scene), rasterise_(rasterFunction()), drawBlurred_(blurFunction()), solids_(*scene.solids) {}
  /// Fills `view` for the samples of pixels `rect`, and marks the grids whose colours are needed.
  void hide(int tile, const PixelRect& rect, TileView& view, const SampleRound& round = {});
  const HiderStatistics& statistics() const { return statistics_; }

 private:
  struct Candidate {
    float key;
    cache::NodeId node;   // or, of solids, the tree
    uint32_t bounds = 0;  // index into bounds_; kSolid: a tree
    bool operator<(const Candidate& o) const { return key != o.key ? key > o.key : node > o.node; }
  };
  void addCandidate(cache::NodeId node, const RasterBounds& b) {
    heap_.push_back({b.key, node, uint32_t(bounds_.size())});
    bounds_.push_back(b);
  }
  void consider(cache::NodeId node, TileView& view);
  void drawGrid(cache::NodeId node, const cache::GridRecord& grid, TileView& view);
  void drawSolid(uint32_t tree, TileView& view);
  cache::ResolvedNode resolve(cache::NodeId node);
  void markSeen(TileView& view);
  static void sortLayers(TileView& view);

  const FrameScene& scene_;
  RasterFunction rasterise_;
  BlurFunction drawBlurred_;
  static constexpr uint32_t kSolid = 0xffffffffu;
  std::vector<Candidate> heap_;
  std::vector<RasterBounds> bounds_;
  std::vector<cache::NodeId> stack_;
  std::vector<Fragment> room_;
  TileSolids solids_;
  double resolving_ = 0;
  std::vector<Vec3> placed_;  // vertices of a grid that is not in cache space
  HiderStatistics statistics_;
};

}  // namespace fr::reyes
