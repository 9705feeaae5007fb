// Embree's handles behind RayScene. Internal to tracer/.
#pragma once

#include <embree3/rtcore.h>

#include <atomic>
#include <string>
#include <vector>

#include "tracer/ray_scene.h"

namespace fr::tracer {

struct RayScene::Embree {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::vector<RTCScene> solids;  // by tree; nullptr: no ray can hit it
  std::vector<RTCScene> prototypes;
  std::vector<std::vector<uint32_t>>
      descriptors;  // RTCGrid records or triangle indices, one buffer per geometry
  std::atomic<int64_t> bytes{0}, peak{0};
  RTCError error = RTC_ERROR_NONE;
  std::string message;

  ~Embree() {
    if (scene) rtcReleaseScene(scene);
    for (RTCScene s : solids)
      if (s) rtcReleaseScene(s);
    for (RTCScene s : prototypes) rtcReleaseScene(s);
    if (device) rtcReleaseDevice(device);
  }
};

}  // namespace fr::tracer
