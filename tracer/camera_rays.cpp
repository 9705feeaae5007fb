#include "tracer/camera_rays.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::tracer {

CameraRays::CameraRays(const cache::CameraRecord& camera, const DMat4& cacheToCamera)
    : perspective_(camera.projection == cache::ProjectionType::kPerspective),
      cameraToCache_(glm::inverse(cacheToCamera)) {
  const double fov = std::clamp(double(camera.fov), 1e-6, 179.999999);
  const double tangent = perspective_ ? std::tan(fov * std::numbers::pi / 360) : 1.0;
  const double left = camera.screenWindow[0], right = camera.screenWindow[1];
  const double bottom = camera.screenWindow[2], top = camera.screenWindow[3];
  scaleX_ = tangent * (right - left) / camera.resolution[0];
  scaleY_ = tangent * (bottom - top) / camera.resolution[1];
  offsetX_ = tangent * left, offsetY_ = tangent * top;
  depthAxis_ = Vec3(float(cacheToCamera[0][2]), float(cacheToCamera[1][2]), float(cacheToCamera[2][2]));
  near_ = perspective_ ? std::max(double(camera.clipping[0]), 1e-10) : double(camera.clipping[0]);
  far_ = camera.clipping[1];
  start_ = perspective_ ? 0.0 : std::min(0.0, near_);
  originDepth_ = float(start_);
  const double scale = std::cbrt(std::abs(glm::determinant(DMat3(cameraToCache_))));  // cameras may scale
  halfPixel_ = float(0.5 * scale * std::sqrt(std::abs(scaleX_ * scaleY_)));
}

Ray CameraRays::ray(double x, double y) const {
  const double cx = x * scaleX_ + offsetX_, cy = y * scaleY_ + offsetY_;
  const DVec3 origin =
      perspective_ ? DVec3(cameraToCache_[3]) : DVec3(cameraToCache_ * DVec4(cx, cy, start_, 1));
  const DVec3 direction =
      DMat3(cameraToCache_) * (perspective_ ? DVec3(cx, cy, 1) : DVec3(0, 0, 1));  // one unit of camera z
  const double length = glm::length(direction);
  Ray r;
  r.origin = Vec3(origin);
  r.direction = Vec3(direction / length);
  r.nearDistance = float((near_ - start_) * length);
  const double farDistance = (far_ - start_) * length;
  r.farDistance = far_ >= 1e30 || !(farDistance < 1e37) ? kInfinity : float(farDistance);
  r.mask = kCameraRay;
  return r;
}

}  // namespace fr::tracer
