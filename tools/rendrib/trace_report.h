// The numbers of one frame of rendrib and their text (-stats).
#pragma once

#include <optional>
#include <string>

#include "scene_cache/cache.h"
#include "scene_cache/scene_loader.h"
#include "shading/shading_system.h"
#include "shm/pager.h"
#include "tracer/render.h"

namespace fr::tools {

struct TraceReport {
  std::optional<cache::FrameCounts> load;
  tracer::TraceRenderStatistics frame;
  ShadingStatistics shading;
  cache::CacheStatistics cache;
  std::optional<shm::PagerStatistics> pager;

  /// Reads this process's memory too.
  std::string text(int frameNumber) const;
};

}  // namespace fr::tools
