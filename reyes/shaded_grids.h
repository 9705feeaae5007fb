// The grids that are shaded, or being shaded, in a frame: each once, however many tiles see it.
//
// Thread safety: all members may be called by all workers.
// Lifetime: a grid is registered with every unfinished tile that its bounds touch, and freed when the last of
// them is finished. A tile that sees a grid is one of them, so a pointer got by a tile is good until that
// tile is finished.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "imaging/film.h"
#include "reyes/raster_space.h"
#include "reyes/visible_points.h"
#include "scene_cache/cache.h"

namespace fr::reyes {

struct ShadedGrid {
  enum class State : int { kEmpty, kShading, kDone };

  cache::NodeId node = cache::kNone;
  const cache::GridRecord* record = nullptr;
  /// kEmpty -> kShading: compare-and-swap by the worker that shades it. kShading -> kDone: release store by
  /// that worker; pairs with the acquire loads of the tiles that read the values.
  std::atomic<State> state{State::kEmpty};
  std::atomic<int> tilesLeft{0};
  /// TriangleSet of all tiles so far.
  std::array<std::atomic<uint64_t>, TriangleSet::kWords> seen{};
  const uint8_t* indices = nullptr;  // of a meshlet
  /// Colour (3), opacity (3; empty when opaque), output channels: planes of `points` values, one a vertex.
  size_t points = 0;
  ShadingStride stride;
  std::vector<float> color, opacity, outputs;
  /// "constant" shading of a grid with rows and columns: what each micropolygon shows, the mean of its
  /// corners; side by side, since a sample with many layers wants all of it at once. Empty otherwise.
  struct alignas(32) Cell {
    float color[4], opacity[4];  // the fourth are 0: room for vector instructions
  };
  std::vector<Cell> cells;
  /// Fills `cells` from the planes above; opacity is 1 where there is none.
  void makeCells();

  /// Of those that were shaded.
  size_t visiblePoints() const;

  bool claim() {
    State expected = State::kEmpty;
    return state.compare_exchange_strong(expected, State::kShading, std::memory_order_acq_rel);
  }
  bool done() const { return state.load(std::memory_order_acquire) == State::kDone; }
  void addSeen(const TriangleSet& triangles) {
    for (size_t i = 0; i < seen.size(); ++i) seen[i].fetch_or(triangles.word(i), std::memory_order_relaxed);
  }
  void publish() { state.store(State::kDone, std::memory_order_release); }
};

class ShadedGrids {
 public:
  explicit ShadedGrids(const Film& film);
  ~ShadedGrids();

  /// The entry of a grid that tile `tile` (unfinished) sees; made when there is none. `bounds`: of the whole
  /// grid.
  ShadedGrid* acquire(int tile, cache::NodeId node, const cache::GridView& grid, const RasterBounds& bounds);
  /// The tile will not look at its grids again. Returns how many points showed of those that are thereby
  /// freed.
  size_t finishTile(int tile);
  size_t peak() const { return peak_.load(std::memory_order_relaxed); }

 private:
  struct Tile {
    std::mutex mutex;
    bool finished = false;
    std::vector<ShadedGrid*> grids;
  };
  struct Shard {
    std::mutex mutex;
    std::unordered_map<cache::NodeId, std::unique_ptr<ShadedGrid>> grids;
  };
  Shard& shardOf(cache::NodeId node) { return shards_[node % shards_.size()]; }

  const Film& film_;
  std::vector<Tile> tiles_;
  std::array<Shard, 64> shards_;
  std::atomic<size_t> count_{0}, peak_{0};
};

}  // namespace fr::reyes
