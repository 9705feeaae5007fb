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
/// Thread safety: connect(), statistics() and processId() from any thread; a line belongs to one thread at a
/// time and must end before the service. When the tracer dies, every line gets an error that says how it
/// ended; nobody waits for ever. The tracer ends when this process does, however that happens; nothing
/// outlives the two. Seam for recovery: a line keeps what it needs to submit its blocks in flight again to
/// another process.
class ShmOracleService : public RayOracleService {
 public:
  struct Options {
    /// Path of rendrib; empty: beside the running program.
    std::string program;
    std::vector<std::string> arguments{"--oracle"};
    int threads = 0;  // of the tracer; 0: one per core
    float patchMultiplier = 0.5f;
    int maxRayLevel = -1;  // negative: the scene's
    std::vector<std::string> shaderPath;
    std::string standardShaders;
  };
  /// The cache must outlive the service. Nothing is started yet.
  ShmOracleService(cache::SceneCache& cache, Options options);
  ~ShmOracleService() override;

  Result<std::unique_ptr<RayOracle>> connect() override;

  /// Numbers of the tracer process so far. Empty when it never started or is gone.
  std::optional<TracerStatistics> statistics();
  /// Process id of the tracer, 0 while none runs.
  int processId() const;

 private:
  friend class ShmOracle;
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace fr::tracer
