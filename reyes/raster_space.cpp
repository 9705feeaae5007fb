#include "reyes/raster_space.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::reyes {

RasterSpace::RasterSpace(const cache::CameraRecord& camera, const DMat4& cacheToCamera, const FrameLens& lens)
    : cacheToCamera_(cacheToCamera), perspective_(camera.projection == cache::ProjectionType::kPerspective) {
  const double fov = std::clamp(double(camera.fov), 1e-6, 179.999999);
  const double scale = perspective_ ? 1 / std::tan(fov * std::numbers::pi / 360) : 1.0;
  const double left = camera.screenWindow[0], right = camera.screenWindow[1];
  const double bottom = camera.screenWindow[2], top = camera.screenWindow[3];
  const double sx = camera.resolution[0] / (right - left), sy = camera.resolution[1] / (bottom - top);
  // Rows of the matrix: x w, y w, w, z.
  DMat4 m(0.0);
  m[0][0] = scale * sx;
  m[1][1] = scale * sy;
  const int offsetColumn = perspective_ ? 2 : 3;  // multiplied by w
  m[offsetColumn][0] = -left * sx;
  m[offsetColumn][1] = -top * sy;
  m[offsetColumn][2] = 1;
  m[2][3] = 1;
  rasterFromCache_ = Mat4(m * cacheToCamera);
  near_ = std::max(camera.clipping[0], perspective_ ? 1e-10f : -kRiInfinity);
  far_ = camera.clipping[1];
  farKey_ = far_ >= 1e30f ? kInfinity : key(far_);
  if (lens.radius > 0) {
    // The ray through lens position l meets the plane of focus where the ray through the lens' middle does.
    // What lies at depth z in camera space is seen from the middle at p, and from l at p + l (1 / focus - 1 /
    // z) (perspective), p + l (z / focus - 1) (orthographic).
    const double offset = perspective_ ? 1 / lens.focalDistance : -1;
    const double slope = perspective_ ? 1 : 1 / lens.focalDistance;
    lens_.x0 = float(lens.radius * scale * sx * offset), lens_.x1 = float(lens.radius * scale * sx * slope);
    lens_.y0 = float(lens.radius * scale * sy * offset), lens_.y1 = float(lens.radius * scale * sy * slope);
  }
}

RasterBounds RasterSpace::bounds(const Box3f& box) const {
  RasterBounds r{-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity, false};
  if (box.empty()) {
    r.outside = r.before = true;
    return r;
  }
  float zMin = kInfinity, zMax = -kInfinity;
  float x0 = kInfinity, y0 = kInfinity, x1 = -kInfinity, y1 = -kInfinity;
  for (int i = 0; i < 8; ++i) {
    const Vec4 h = homogeneous(box.corner(i));
    zMin = std::min(zMin, h.w), zMax = std::max(zMax, h.w);
    const float w = h.z;
    x0 = std::min(x0, h.x / w), x1 = std::max(x1, h.x / w);
    y0 = std::min(y0, h.y / w), y1 = std::max(y1, h.y / w);
  }
  // Rounding of a coordinate of the largest size that occurs, a few times over.
  const float slack = 4e-6f * std::max(std::abs(zMin), std::abs(zMax));
  zMin -= slack, zMax += slack;
  r.before = zMax < near_;
  r.outside = r.before || zMin > far_;
  // Written so that NaN counts as "through the near plane".
  if (!(zMin > near_) || !(x0 <= x1) || !(y0 <= y1)) {
    r.key = perspective_ ? -kInfinity : zMin;
    return r;
  }
  if (lens_.any()) {
    const float shiftX = std::max(std::abs(lens_.x(1, key(zMin))), std::abs(lens_.x(1, key(zMax))));
    const float shiftY = std::max(std::abs(lens_.y(1, key(zMin))), std::abs(lens_.y(1, key(zMax))));
    x0 -= shiftX, x1 += shiftX, y0 -= shiftY, y1 += shiftY;
  }
  const float margin = 1.0f + 1e-5f * std::max({std::abs(x0), std::abs(x1), std::abs(y0), std::abs(y1)});
  return {x0 - margin, y0 - margin, x1 + margin, y1 + margin, key(zMin), r.outside, r.before};
}

ShutterSpace::ShutterSpace(const cache::CameraRecord& camera, const std::vector<DMat4>& cacheToCamera,
                           const FrameLens& lens) {
  keys_.clear();
  for (const DMat4& m : cacheToCamera) keys_.emplace_back(camera, m, lens);
}

Vec4 ShutterSpace::homogeneous(const Vec3& p, float time) const {
  if (keys_.size() == 1) return keys_.front().homogeneous(p);
  const float at = time * float(keys_.size() - 1);
  const size_t k = std::min(size_t(at), keys_.size() - 2);
  const float weight = at - float(k);
  const Vec4 a = keys_[k].homogeneous(p), b = keys_[k + 1].homogeneous(p);
  return a + weight * (b - a);
}

RasterBounds ShutterSpace::bounds(const Box3f& box) const {
  RasterBounds all = keys_.front().bounds(box);
  for (size_t k = 1; k < keys_.size(); ++k) {
    // What moves straight in camera space moves straight on the raster, while it is before the eye.
    const RasterBounds b = keys_[k].bounds(box);
    all.x0 = std::min(all.x0, b.x0), all.x1 = std::max(all.x1, b.x1);
    all.y0 = std::min(all.y0, b.y0), all.y1 = std::max(all.y1, b.y1);
    all.key = std::min(all.key, b.key);
    // Before the near plane at one time and behind the far one at another: between them it is neither.
    all.outside = all.outside && b.outside, all.before = all.before && b.before;
  }
  return all;
}

}  // namespace fr::reyes
