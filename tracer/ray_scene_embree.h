// Embree's handles behind RayScene. Internal to tracer/.
#pragma once

#include <embree3/rtcore.h>

#include <atomic>
#include <string>
#include <vector>

#include "tracer/ray_scene.h"
#include "tracer/traced_part.h"

namespace fr::tracer {

struct RayScene::Embree {
  RTCDevice device = nullptr;
  TracedPart main;                 // has boxes of solids and clusters, and instances, too
  std::vector<TracedPart> solids;  // by tree; without a scene: no ray can hit it
  /// Grids that many instances show, in object space.
  std::vector<TracedPart> prototypes;
  std::atomic<int64_t> bytes{0}, peak{0};
  RTCError error = RTC_ERROR_NONE;
  std::string message;

  ~Embree() {
    main = TracedPart(), solids.clear(), prototypes.clear();
    if (device) rtcReleaseDevice(device);
  }
};

}  // namespace fr::tracer
