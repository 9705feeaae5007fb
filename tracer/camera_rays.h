// From raster positions to camera rays: the inverse of the projection that a hider of micropolygons uses.
#pragma once

#include <vector>

#include "base/math.h"
#include "imaging/frame_request.h"
#include "imaging/sight_lines.h"
#include "scene_cache/cache.h"
#include "tracer/ray_scene.h"

namespace fr::tracer {

/// Immutable; thread-safe.
class CameraRays {
 public:
  CameraRays() = default;
  /// The camera whose space `cacheToCamera` leads to, at equally spaced times over the shutter
  /// (frameCameraKeys()).
  CameraRays(const cache::CameraRecord& camera, const std::vector<DMat4>& cacheToCamera,
             const FrameLens& lens);

  bool perspective() const { return lines_.perspective(); }
  /// The ray through raster position (x, y), in pixels, y down; between the clipping planes. Sees what
  /// cameras see, at the sample's time, from its place on the lens.
  Ray ray(double x, double y, const SamplePattern::Blur& blur = {}) const;
  /// Camera space z at `distance` along such a ray.
  float depth(const Ray& ray, float distance) const {
    return originDepth_ + distance * glm::dot(depthAxis(ray.time), ray.direction);
  }
  /// Half a pixel, as rays carry their footprints: its radius at the origin, and its growth per unit of
  /// distance.
  float footprintRadius() const { return perspective() ? 0.0f : halfPixel_; }
  float footprintSpread(const Ray& ray) const {
    return perspective() ? halfPixel_ * glm::dot(depthAxis(ray.time), ray.direction) : 0.0f;
  }

 private:
  /// Camera z per unit of cache space.
  Vec3 depthAxis(float time) const;
  DMat4 cacheToCamera(float time) const;

  SightLines lines_;
  std::vector<DMat4> cacheToCamera_{DMat4(1.0)};  // by key
  DMat4 cameraToCache_{1.0};                      // of the first key
  double near_ = 0, far_ = 0, start_ = 0;
  float originDepth_ = 0;
  float halfPixel_ = 0;  // perspective: per unit of camera z, in cache space
};

}  // namespace fr::tracer
