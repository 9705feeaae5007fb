#include "tracer/camera_rays.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::tracer {

CameraRays::CameraRays(const cache::CameraRecord& camera, const std::vector<DMat4>& cacheToCamera,
                       const FrameLens& lens)
    : perspective_(camera.projection == cache::ProjectionType::kPerspective),
      cacheToCamera_(cacheToCamera),
      cameraToCache_(glm::inverse(cacheToCamera.front())),
      lensRadius_(lens.radius),
      focalDistance_(lens.focalDistance) {
  const double fov = std::clamp(double(camera.fov), 1e-6, 179.999999);
  const double tangent = perspective_ ? std::tan(fov * std::numbers::pi / 360) : 1.0;
  const double left = camera.screenWindow[0], right = camera.screenWindow[1];
  const double bottom = camera.screenWindow[2], top = camera.screenWindow[3];
  scaleX_ = tangent * (right - left) / camera.resolution[0];
  scaleY_ = tangent * (bottom - top) / camera.resolution[1];
  offsetX_ = tangent * left, offsetY_ = tangent * top;
  near_ = perspective_ ? std::max(double(camera.clipping[0]), 1e-10) : double(camera.clipping[0]);
  far_ = camera.clipping[1];
  start_ = perspective_ ? 0.0 : std::min(0.0, near_);
  originDepth_ = float(start_);
  const double scale = std::cbrt(std::abs(glm::determinant(DMat3(cameraToCache_))));  // cameras may scale
  halfPixel_ = float(0.5 * scale * std::sqrt(std::abs(scaleX_ * scaleY_)));
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
  const double cx = x * scaleX_ + offsetX_, cy = y * scaleY_ + offsetY_;
  // From the lens position through what the middle of the lens sees in focus.
  const DVec3 lens(lensRadius_ * double(blur.lensX), lensRadius_ * double(blur.lensY), 0);
  DVec3 start, axis;  // camera space; axis: one unit of z
  if (perspective_) {
    start = lens, axis = DVec3(cx, cy, 1) - lens / focalDistance_;
  } else {
    axis = DVec3(0, 0, 1) - lens / focalDistance_;
    start = DVec3(cx, cy, 0) + lens + start_ * axis;
  }
  const DMat4 toCache = cacheToCamera_.size() == 1 ? cameraToCache_ : glm::inverse(cacheToCamera(blur.time));
  const DVec3 origin(toCache * DVec4(start, 1)), direction = DMat3(toCache) * axis;
  const double length = glm::length(direction);
  Ray r;
  r.origin = Vec3(origin);
  r.direction = Vec3(direction / length);
  r.time = blur.time;
  r.nearDistance = float((near_ - start_) * length);
  const double farDistance = (far_ - start_) * length;
  r.farDistance = far_ >= 1e30 || !(farDistance < 1e37) ? kInfinity : float(farDistance);
  r.mask = kCameraRay;
  return r;
}

}  // namespace fr::tracer
