// Rays answered by another process over a pipe, as in 1998: it loads the scene for itself.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "oracle/ray_oracle.h"
#include "scene_cache/cache.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

/// Starts a ray server (rendrib -rayserver, or the command in RAYSERVER) when a line first acquires a block,
/// and speaks to it over its standard input and output: one connection for all lines, frames with ids,
/// because a second connection would be a second scene in memory. The answers are those of the other
/// transports, bit for bit, if the server has loaded the same frame with the same options; if not, that is
/// said once, and rays leave surfaces without knowing them.
///
/// Thread safety: connect() and statistics() from any thread; a line belongs to one thread at a time. When
/// the server dies every line gets an error; nobody waits for ever.
class PipeOracleService : public RayOracleService {
 public:
  struct Options {
    std::vector<std::string> command;  // program and arguments of the server
    uint32_t blocksPerLine = 16;
  };
  /// The cache must outlive the service. Nothing is started yet.
  PipeOracleService(const cache::SceneCache& cache, Options options);
  ~PipeOracleService() override;

  Result<std::unique_ptr<RayOracle>> connect() override;
  /// The server's numbers, as far as it counts them. Empty when it never started, is gone, or keeps none.
  std::optional<TracerStatistics> statistics();
  /// Process id of the server, 0 while none runs.
  int processId() const;

 private:
  friend class PipeOracle;
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace fr::tracer
