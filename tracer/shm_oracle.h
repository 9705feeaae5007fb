// Rays answered by another process through rings in shared memory.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "oracle/ray_oracle.h"
#include "scene_cache/cache.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

/// Starts the tracer process when a line first acquires a block, and sends it the scene cache. Every line has
/// a channel of its own with kBlocksPerLine blocks. Waiting threads sleep.
///
/// Thread safety: connect(), statistics(), processId() and restarts() from any thread; a line belongs to one
/// thread at a time and must end before the service. When the tracer dies, another one is started, and what
/// was in flight is asked again: lines notice nothing but the time, and the answers are the same, since an
/// answer depends on its ray alone. One warning a death says how it ended. A tracer that dies again and again
/// without answering anything in between, or that says that it cannot do its work, is an error for every
/// line; nobody waits for ever. The tracer ends when this process does, however that happens; nothing
/// outlives the two.
class ShmOracleService : public RayOracleService {
 public:
  struct Options {
    /// Path of rendrib; empty: beside the running program.
    std::string program;
    std::vector<std::string> arguments{"--oracle"};
    int threads = 0;  // of the tracer; 0: one per core
    float patchMultiplier = 0.5f;
    int maxRayLevel = -1;       // negative: the scene's
    uint64_t memoryBudget = 0;  // bytes for this process and the tracer together; 0: none
    std::vector<std::string> shaderPath;
    std::string standardShaders;
  };
  /// The cache must outlive the service. Nothing is started yet.
  ShmOracleService(cache::SceneCache& cache, Options options);
  ~ShmOracleService() override;

  Result<std::unique_ptr<RayOracle>> connect() override;

  /// Numbers of the tracer process so far. Empty when it never started or is gone.
  std::optional<TracerStatistics> statistics();
  /// Process id of the tracer, also while it starts; 0 when there is none. Never waits.
  int processId() const;
  /// Tracers that were started because the one before died. Never waits.
  uint64_t restarts() const;

 private:
  friend class ShmOracle;
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace fr::tracer
