// The numbers of one frame and their text (--stats).
#pragma once

#include <optional>
#include <string>

#include "reyes/renderer.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_loader.h"
#include "shading/shading_system.h"
#include "shm/memory_info.h"
#include "shm/pager.h"
#include "tracer/ray_tracer.h"

namespace fr::tools {

struct FrameReport {
  std::optional<cache::FrameCounts> load;
  FrameStatistics frame;
  ShadingStatistics shading;
  cache::CacheStatistics cache;
  std::optional<tracer::TracerStatistics> tracer;
  bool oracleAsked = false;
  int tracerProcess = 0;
  uint64_t tracerRestarts = 0;
  std::optional<shm::ProcessMemory> rendererMemory, tracerMemory;
  std::optional<shm::PagerStatistics> pager;

  /// Reads the memory of both processes, while they still run.
  void takeMemory();
  std::string text(int frameNumber) const;
};

}  // namespace fr::tools
