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

void RasterSpace::add(const Box3f& box, Hull& hull) const {
  // A sum of four products: each rounds, and so does each partial sum.
  const Vec3 size = glm::max(glm::abs(box.min), glm::abs(box.max));
  for (int c = 0; c < 4; ++c) {
    float sum = std::abs(rasterFromCache_[3][c]);
    for (int k = 0; k < 3; ++k) sum += std::abs(rasterFromCache_[k][c]) * size[k];
    hull.slack[c] = std::max(hull.slack[c], 6e-7f * sum);
  }
  for (int i = 0; i < 8; ++i) hull.points[hull.count++] = homogeneous(box.corner(i));
}

RasterBounds RasterSpace::bounds(const Hull& hull) const {
  RasterBounds r{-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity, false};
  float zMin = kInfinity, zMax = -kInfinity;
  for (int i = 0; i < hull.count; ++i) {
    const float z = hull.points[i].w;
    // Nothing is known of places that are no numbers.
    if (!std::isfinite(hull.points[i].x) || !std::isfinite(hull.points[i].y) || !std::isfinite(z)) return r;
    zMin = std::min(zMin, z), zMax = std::max(zMax, z);
  }
  zMin -= hull.slack.w, zMax += hull.slack.w;
  r.before = zMax < near_;
  r.outside = r.before || zMin > far_;
  if (r.outside) {
    r.key = perspective_ ? zMin > 0 ? key(zMin) : -kInfinity : zMin;
    return r;
  }
  const bool through = perspective_ && zMin < near_;
  float x0 = kInfinity, y0 = kInfinity, x1 = -kInfinity, y1 = -kInfinity;
  // What rounding does to x w and y w counts as much more on the raster as w is small.
  const auto extend = [&](float xw, float yw, float w, float slackX = 0, float slackY = 0) {
    const float dx = through ? hull.slack.x + slackX : 0, dy = through ? hull.slack.y + slackY : 0;
    x0 = std::min(x0, (xw - dx) / w), x1 = std::max(x1, (xw + dx) / w);
    y0 = std::min(y0, (yw - dy) / w), y1 = std::max(y1, (yw + dy) / w);
  };
  for (int i = 0; i < hull.count; ++i) {
    const Vec4& p = hull.points[i];
    if (!through || p.w >= near_) extend(p.x, p.y, p.z);
    if (!through) continue;
    // The hull's section with the near plane is the hull of the sections of all lines through it. Corners
    // that are as near to it as rounding count as both sides.
    if (std::abs(p.w - near_) <= hull.slack.w) extend(p.x, p.y, near_);
    for (int k = i + 1; k < hull.count; ++k) {
      const Vec4& q = hull.points[k];
      if ((p.w < near_) == (q.w < near_)) continue;
      const float t = std::clamp((near_ - p.w) / (q.w - p.w), 0.0f, 1.0f);
      const float moved = 2 * hull.slack.w / std::abs(q.w - p.w);  // along the line, by rounding of w
      extend(p.x + t * (q.x - p.x), p.y + t * (q.y - p.y), near_, moved * std::abs(q.x - p.x),
             moved * std::abs(q.y - p.y));
    }
  }
  if (through && !(x0 <= x1)) {
    // Only its slack reaches through.
    return r;
  }
  const float nearest = through ? near_ : zMin;
  if (lens_.any()) {
    const float shiftX = std::max(std::abs(lens_.x(1, key(nearest))), std::abs(lens_.x(1, key(zMax))));
    const float shiftY = std::max(std::abs(lens_.y(1, key(nearest))), std::abs(lens_.y(1, key(zMax))));
    x0 -= shiftX, x1 += shiftX, y0 -= shiftY, y1 += shiftY;
  }
  const auto margin = [](float v) { return 1.0f + 1e-5f * std::abs(v); };
  const float all = margin(std::max({std::abs(x0), std::abs(x1), std::abs(y0), std::abs(y1)}));
  r.key = key(nearest);
  if (through) {
    // Each side for itself: one of them is far out.
    r.x0 = x0 - margin(x0), r.y0 = y0 - margin(y0), r.x1 = x1 + margin(x1), r.y1 = y1 + margin(y1);
  } else {
    r.x0 = x0 - all, r.y0 = y0 - all, r.x1 = x1 + all, r.y1 = y1 + all;
  }
  return r;
}

RasterBounds RasterSpace::bounds(const Box3f& box) const {
  if (box.empty()) return {-kInfinity, -kInfinity, kInfinity, kInfinity, -kInfinity, true, true};
  Hull hull;
  add(box, hull);
  return bounds(hull);
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
  if (keys_.size() == 1 || box.empty()) return keys_.front().bounds(box);
  RasterBounds all{kInfinity, kInfinity, -kInfinity, -kInfinity, kInfinity, true, true};
  for (size_t k = 0; k + 1 < keys_.size(); ++k) {
    // From one key to the next every place moves straight in homogeneous coordinates: within the hull of
    // both.
    RasterSpace::Hull hull;
    keys_[k].add(box, hull), keys_[k + 1].add(box, hull);
    const RasterBounds b = keys_[k].bounds(hull);
    all.x0 = std::min(all.x0, b.x0), all.x1 = std::max(all.x1, b.x1);
    all.y0 = std::min(all.y0, b.y0), all.y1 = std::max(all.y1, b.y1);
    all.key = std::min(all.key, b.key);
    all.outside = all.outside && b.outside, all.before = all.before && b.before;
  }
  return all;
}

}  // namespace fr::reyes
