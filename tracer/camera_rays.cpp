#include "tracer/camera_rays.h"

#include <algorithm>
#include <cmath>

namespace fr::tracer {

CameraRays::CameraRays(const cache::CameraRecord& camera, const std::vector<DMat4>& cacheToCamera,
                       const FrameLens& lens)
    : lines_(camera, lens),
      cacheToCamera_(cacheToCamera),
      cameraToCache_(glm::inverse(cacheToCamera.front())) {
  near_ = perspective() ? std::max(double(camera.clipping[0]), 1e-10) : double(camera.clipping[0]);
  far_ = camera.clipping[1];
  start_ = perspective() ? 0.0 : std::min(0.0, near_);
  originDepth_ = float(start_);
  const double scale = std::cbrt(std::abs(glm::determinant(DMat3(cameraToCache_))));  // cameras may scale
  halfPixel_ = float(0.5 * scale * std::sqrt(std::abs(lines_.pixelWidth() * lines_.pixelHeight())));
}

DMat4 CameraRays::cacheToCamera(float time) const {
  if (cacheToCamera_.size() == 1) return cacheToCamera_.front();
  const double at = double(time) * double(cacheToCamera_.size() - 1);
  const size_t k = std::min(size_t(at), cacheToCamera_.size() - 2);
  const double weight = at - double(k);
  return cacheToCamera_[k] * (1 - weight) + cacheToCamera_[k + 1] * weight;
}

Vec3 CameraRays::depthAxis(float time) const {
  const DMat4 m = cacheToCamera(time);
  return Vec3(float(m[0][2]), float(m[1][2]), float(m[2][2]));
}

Ray CameraRays::ray(double x, double y, const SamplePattern::Blur& blur) const {
  const SightLines::Line line = lines_.line(x, y, blur);
  const DVec3 start = line.start + start_ * line.axis;
  const DMat4 toCache = cacheToCamera_.size() == 1 ? cameraToCache_ : glm::inverse(cacheToCamera(blur.time));
  const DVec3 origin(toCache * DVec4(start, 1)), direction = DMat3(toCache) * line.axis;
  const double length = glm::length(direction);
  Ray r;
  r.origin = Vec3(origin);
  r.direction = Vec3(direction / length);
  r.time = blur.time;
  const SightLines::Depths seen = lines_.seen(line, near_, far_);
  r.nearDistance = float(std::max(seen.near - start_, 0.0) * length);
  const double farDistance = (seen.far - start_) * length;
  r.farDistance = seen.far >= 1e30 || !(farDistance < 1e37) ? kInfinity : float(farDistance);
  if (!(seen.near < seen.far)) r.nearDistance = 1, r.farDistance = 0;
  r.mask = kCameraRay;
  return r;
}

}  // namespace fr::tracer
