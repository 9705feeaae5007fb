// One thread of the frame: hides tiles, keeps several grids shading, resolves tiles whose grids are done.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "imaging/frame_journal.h"
#include "imaging/frame_output.h"
#include "reyes/adaptive_tile.h"
#include "reyes/renderer.h"
#include "reyes/shaded_grids.h"
#include "reyes/tile_hider.h"
#include "reyes/tile_resolve.h"

namespace fr::reyes {

/// What the workers of a frame share. Everything is immutable, thread-safe, or guarded as noted.
struct FrameWork {
  const FrameScene* scene = nullptr;
  Film* film = nullptr;
  FrameOutput* output = nullptr;    // nullptr: no displays
  FrameJournal* journal = nullptr;  // nullptr: none is kept
  ShadedGrids* shaded = nullptr;
  ShadingSystem* shading = nullptr;
  RayOracleService* oracle = nullptr;
  const RenderOptions* options = nullptr;
  std::optional<AdaptiveSampling> adaptive;
  std::vector<OutputChannel> outputs;
  float opacityThreshold = 0.996f;
  bool midpointDepth = false;  // DepthFilter::midpoint; no surface counts as opaque then
  std::vector<int> order;      // tiles, in the order in which they are handed out
  std::atomic<size_t> next{0};
  int threads = 1;
  std::atomic<bool> stop{false};  // hand out no more tiles
  /// A worker died with grids that others may wait for: all give up.
  std::atomic<bool> broken{false};
  std::atomic<bool> oracleFailed{false};
  /// Grows whenever a grid is done or the frame stops: workers that can do nothing wait for it.
  std::atomic<uint32_t> events{0};
  void signal() {
    events.fetch_add(1, std::memory_order_seq_cst);
    events.notify_all();
  }
  std::mutex mutex;  // guards statistics, tilesDone and the callbacks
  FrameStatistics statistics;
  size_t tilesDone = 0;
};

/// Runs on one thread. A worker never waits for another worker's grid while it holds a claim that it could
/// advance: claimed grids are always in flight, so some worker can always go on.
class BucketWorker {
 public:
  explicit BucketWorker(FrameWork& work);
  ~BucketWorker();
  void run();

 private:
  /// A hidden tile, waiting for colours.
  struct Pending {
    TileView view;
    AdaptiveTile adaptive;
    std::vector<ShadedGrid*> needed;
    size_t nextToClaim = 0, nextToFinish = 0;
  };
  /// A claimed grid in flight.
  struct GridTask {
    explicit GridTask(ShadingSystem& s) : task(s) {}
    ShadeTask task;
    ShadedGrid* grid = nullptr;
    size_t points = 0;          // of the grid that are shaded
    RayQuery* query = nullptr;  // nullptr while it waits for a free block
  };

  bool pollTasks();
  bool finishTiles();
  bool startGrid();
  bool takeTile();
  bool takeRun();
  void hideTile(Pending& tile, int index);
  void advance(std::unique_ptr<GridTask> task);
  bool submit(GridTask& task);
  void finishGrid(GridTask& task);
  bool finishRound(Pending& tile);
  void finishTile(Pending& tile);
  bool connectOracle();
  void oracleGone(Error error);
  void waitForOracle();

  FrameWork& work_;
  TileHider hider_;
  TileColors colors_;
  std::vector<std::unique_ptr<Pending>> pending_, idlePending_;
  std::vector<std::unique_ptr<GridTask>> flying_, idleTasks_;
  std::unique_ptr<RayOracle> oracle_;
  size_t mostTasks_, mostPending_;
  bool tilesLeft_ = true;
  size_t nextOfRun_ = 0, runEnd_ = 0;  // in FrameWork::order
  FrameStatistics statistics_;
};

}  // namespace fr::reyes
