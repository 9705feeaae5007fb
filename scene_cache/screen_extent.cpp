#include "scene_cache/screen_extent.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace fr::cache {
namespace {

constexpr double kFar = 1e29;  // beyond it a bound means "everywhere"

/// A side of the picture, as the camera space half-space beyond it: axis coordinate * sign > limit(z).
struct Side {
  int axis;
  double sign, slope, offset;  // limit = slope * z + offset
};

}  // namespace

ScreenExtent screenExtent(const ScreenCamera& camera, std::span<const DMat4> objectToWorld,
                          const ri::Bound& bound) {
  ScreenExtent e;
  for (size_t i = 0; i < 6; ++i)
    if (!(std::abs(bound[i]) < kFar)) return e;
  for (size_t i = 0; i < 6; i += 2)
    if (bound[i] > bound[i + 1]) return e;
  const CameraRecord& c = camera.record;
  const bool perspective = c.projection == ProjectionType::kPerspective;
  const double tangent = perspective ? std::tan(double(c.fov) * (3.14159265358979323846 / 360)) : 1;

  // Corners at every key; between two keys the box is inside their hull.
  std::vector<DVec3> corners;
  corners.reserve(8 * objectToWorld.size());
  for (const DMat4& m : objectToWorld) {
    const DMat4 toCamera = camera.worldToCamera[0] * m;
    for (size_t i = 0; i < 8; ++i) {
      const DVec4 p = toCamera * DVec4(bound[i & 1], bound[2 + (i >> 1 & 1)], bound[4 + (i >> 2)], 1);
      const DVec3 q = DVec3(p) / p.w;
      if (!(p.w > 0) || !std::isfinite(q.x + q.y + q.z)) return e;
      corners.push_back(q);
    }
  }
  double nearest = kRiInfinity, farthest = -kRiInfinity;
  for (const DVec3& p : corners) nearest = std::min(nearest, p.z), farthest = std::max(farthest, p.z);

  // ---- area, of what is beyond the near plane
  const double width = double(c.screenWindow[1]) - c.screenWindow[0];
  const double height = double(c.screenWindow[3]) - c.screenWindow[2];
  const double pixelsX = width != 0 ? c.resolution[0] / std::abs(width) : 0;
  const double pixelsY = height != 0 ? c.resolution[1] / std::abs(height) : 0;
  double x[2] = {kRiInfinity, -kRiInfinity}, y[2] = {kRiInfinity, -kRiInfinity};
  const auto extend = [&](const DVec3& p) {
    const double depth = perspective ? std::abs(p.z) * tangent : 1;
    x[0] = std::min(x[0], p.x / depth), x[1] = std::max(x[1], p.x / depth);
    y[0] = std::min(y[0], p.y / depth), y[1] = std::max(y[1], p.y / depth);
  };
  const double near = c.clipping[0];
  const bool cut = perspective && nearest < near && farthest > near;
  for (size_t i = 0; i < corners.size(); ++i) {
    const DVec3& p = corners[i];
    if (!cut || p.z >= near) extend(p);
    for (size_t bit = 1; cut && bit < 8; bit *= 2) {
      if (i & bit) continue;
      const DVec3& q = corners[i | bit];
      if ((p.z < near) != (q.z < near)) extend(p + (q - p) * ((near - p.z) / (q.z - p.z)));
    }
  }
  const double area = (x[1] - x[0]) * pixelsX * ((y[1] - y[0]) * pixelsY);
  e.pixels = std::isfinite(area) ? std::min(area, double(kRiInfinity)) : kRiInfinity;

  // ---- view
  if (camera.worldToCamera.size() > 1) return e;
  if (farthest < c.clipping[0] || nearest > c.clipping[1]) return e.inView = false, e;
  // The crop window on the screen, wider by what the filter reaches.
  const double x0 = c.cropPixels[0] - camera.filterRadius[0],
               x1 = c.cropPixels[1] + 1 + camera.filterRadius[0];
  const double y0 = c.cropPixels[2] - camera.filterRadius[1],
               y1 = c.cropPixels[3] + 1 + camera.filterRadius[1];
  const auto screenX = [&](double px) { return c.screenWindow[0] + width * px / c.resolution[0]; };
  const auto screenY = [&](double py) { return c.screenWindow[3] - height * py / c.resolution[1]; };
  const auto [left, right] = std::minmax({screenX(x0), screenX(x1)});
  const auto [bottom, top] = std::minmax({screenY(y0), screenY(y1)});
  // Rays leave a lens of this radius and meet at the plane in focus: at depth z they lie within
  // radius * |1 - z / focus| of the one through its centre.
  const bool lens = perspective && c.dof[0] < kRiInfinity && c.dof[0] > 0 && c.dof[2] > 0;
  const double radius = lens ? double(c.dof[1]) / (2 * double(c.dof[0])) : 0;
  const double slope = perspective ? 1 : 0, offset = perspective ? 0 : 1;
  const std::array<Side, 4> sides{{{0, 1, right * tangent * slope, right * offset},
                                   {0, -1, -left * tangent * slope, -left * offset},
                                   {1, 1, top * tangent * slope, top * offset},
                                   {1, -1, -bottom * tangent * slope, -bottom * offset}}};
  for (const Side& s : sides) {
    // The part of space beyond a side is convex, the lens included: a box whose corners are there is there.
    const bool beyond = std::all_of(corners.begin(), corners.end(), [&](const DVec3& p) {
      const double blur = radius > 0 ? radius * std::abs(1 - p.z / double(c.dof[2])) : 0;
      return p[s.axis] * s.sign > s.slope * p.z + s.offset + blur;
    });
    if (beyond) e.inView = false;
  }
  return e;
}

}  // namespace fr::cache
