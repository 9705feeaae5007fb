// The transport that is none: the thread that asks answers. The yardstick for the others.
#pragma once

#include "oracle/ray_oracle.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

/// Blocks of each line of InprocOracleService and ShmOracleService: how many a client thread can have in
/// flight.
inline constexpr uint32_t kBlocksPerLine = 16;

/// Thread-safe. Submitting answers the block before it returns, in the calling thread.
class InprocOracleService : public RayOracleService {
 public:
  /// Both must outlive the service; `shading` is one for the tracer's side (Options::tracerSide).
  InprocOracleService(cache::SceneCache& cache, ShadingSystem& shading, RayTracerOptions options);
  ~InprocOracleService() override;
  Result<std::unique_ptr<RayOracle>> connect() override;
  TracerStatistics statistics() const { return tracer_.statistics(); }
  uint64_t giveBack(uint64_t bytes) { return tracer_.giveBack(bytes); }

 private:
  RayTracer tracer_;
};

}  // namespace fr::tracer
