#include "reyes/raster_space.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::reyes {

RasterSpace::RasterSpace(const cache::CameraRecord& camera, const DMat4& cacheToCamera)
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
  const float margin = 1.0f + 1e-5f * std::max({std::abs(x0), std::abs(x1), std::abs(y0), std::abs(y1)});
  return {x0 - margin, y0 - margin, x1 + margin, y1 + margin, key(zMin), r.outside, r.before};
}

}  // namespace fr::reyes
