#include "scene_cache/view_volume.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {
namespace {

/// For pixel filters: of the view's width.
constexpr double kMargin = 0.05;
/// RISpec's infinity: a pinhole's f-stop.
constexpr float kPinhole = 1e37f;

}  // namespace

ViewVolume::ViewVolume(const Skeleton& skeleton) {
  const CameraRecord& camera = skeleton.camera();
  const auto transforms = skeleton.transforms();
  if (camera.worldToCamera >= transforms.size() || transforms[camera.worldToCamera].times.count > 1) return;
  if (camera.dof[0] > 0 && camera.dof[0] < kPinhole) return;
  cacheToCamera_ = skeleton.cacheToCamera(camera.shutter[0]);
  perspective_ = camera.projection == ProjectionType::kPerspective;
  const double scale = perspective_ ? std::tan(double(camera.fov) * (3.14159265358979323846 / 360)) : 1.0;
  const float* w = camera.screenWindow;
  const double margin = kMargin * std::max(std::abs(double(w[1]) - w[0]), std::abs(double(w[3]) - w[2]));
  left_ = (double(std::min(w[0], w[1])) - margin) * scale,
  right_ = (double(std::max(w[0], w[1])) + margin) * scale;
  bottom_ = (double(std::min(w[2], w[3])) - margin) * scale,
  top_ = (double(std::max(w[2], w[3])) + margin) * scale;
  near_ = std::max(0.0, double(camera.clipping[0]));
  everything_ = !(std::isfinite(left_) && std::isfinite(right_) && std::isfinite(bottom_) &&
                  std::isfinite(top_) && std::isfinite(near_) && scale > 0);
}

bool ViewVolume::isOutside(const Box3f& box) const {
  if (everything_ || box.empty()) return false;
  bool outside[5] = {true, true, true, true, true};
  for (int i = 0; i < 8; ++i) {
    const DVec4 p = cacheToCamera_ * DVec4(DVec3(box.corner(i)), 1.0);
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) return false;
    const double z = perspective_ ? p.z : 1.0;
    outside[0] = outside[0] && p.x < left_ * z;
    outside[1] = outside[1] && p.x > right_ * z;
    outside[2] = outside[2] && p.y < bottom_ * z;
    outside[3] = outside[3] && p.y > top_ * z;
    outside[4] = outside[4] && p.z < near_;
  }
  // The half spaces of the sides hold what is in front of the eye; that of a box partly behind it is judged
  // by all its corners, which errs towards inside.
  return outside[0] || outside[1] || outside[2] || outside[3] || outside[4];
}

}  // namespace fr::cache
