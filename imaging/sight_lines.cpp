#include "imaging/sight_lines.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

namespace fr {

SightLines::SightLines(const cache::CameraRecord& camera, const FrameLens& lens)
    : perspective_(camera.projection == cache::ProjectionType::kPerspective),
      lensRadius_(lens.radius),
      focalDistance_(lens.focalDistance),
      planeCount_(camera.clippingPlaneCount) {
  const double fov = std::clamp(double(camera.fov), 1e-6, 179.999999);
  const double tangent = perspective_ ? std::tan(fov * std::numbers::pi / 360) : 1.0;
  const double left = camera.screenWindow[0], right = camera.screenWindow[1];
  const double bottom = camera.screenWindow[2], top = camera.screenWindow[3];
  scaleX_ = tangent * (right - left) / camera.resolution[0];
  scaleY_ = tangent * (bottom - top) / camera.resolution[1];
  offsetX_ = tangent * left, offsetY_ = tangent * top;
  static_assert(sizeof planes_ == sizeof camera.clippingPlanes);
  std::memcpy(planes_, camera.clippingPlanes, sizeof planes_);
}

SightLines::Line SightLines::line(double x, double y, const SamplePattern::Blur& blur) const {
  const double cx = x * scaleX_ + offsetX_, cy = y * scaleY_ + offsetY_;
  const DVec3 lens(lensRadius_ * double(blur.lensX), lensRadius_ * double(blur.lensY), 0);
  if (perspective_) return {lens, DVec3(cx, cy, 1) - lens / focalDistance_};
  return {DVec3(cx, cy, 0) + lens, DVec3(0, 0, 1) - lens / focalDistance_};
}

SightLines::Depths SightLines::seen(const Line& line, double near, double far) const {
  for (uint32_t i = 0; i < planeCount_; ++i) {
    const DVec3 normal(planes_[i][0], planes_[i][1], planes_[i][2]);
    const double height = glm::dot(normal, line.start) - double(planes_[i][3]);
    const double slope = glm::dot(normal, line.axis);  // cut away where height + z * slope > 0
    if (slope > 0)
      far = std::min(far, -height / slope);
    else if (slope < 0)
      near = std::max(near, -height / slope);
    else if (height > 0)
      return {1, 0};
  }
  return {near, far};
}

}  // namespace fr
