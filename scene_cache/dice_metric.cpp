#include "scene_cache/dice_metric.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::cache {
namespace {

/// Orthographic: a piece that is seen along itself has no length on the raster. Only flat faces are rated by
/// that: long chords of a bent surface would put corners into its outline and errors into depths.
constexpr float kAlongFlat = 1.0f / 16;

/// Blurred over so many pixels, detail of a pixel still counts; and blur never makes segments longer than
/// this.
constexpr float kSharpPixels = 4, kMostBlurSide = 16;

}  // namespace

DiceEye diceEye(const CameraRecord& camera, const DMat4& cacheToCamera) {
  DiceEye e;
  const double scale =
      std::cbrt(std::abs(glm::determinant(DMat3(cacheToCamera))));  // camera units per world unit
  const double unit = scale > 0 && std::isfinite(scale) ? scale : 1.0;
  if (scale > 0 && std::isfinite(scale)) {
    const DVec4 p = glm::inverse(cacheToCamera) * DVec4(0, 0, 0, 1);
    e.position = DVec3(p) / p.w;
  }
  e.perspective = camera.projection == ProjectionType::kPerspective;
  const double tangent =
      e.perspective ? std::tan(std::clamp(double(camera.fov), 1e-3, 179.0) * (3.14159265358979323846 / 360))
                    : 1.0 / unit;
  const double px =
      std::abs(double(camera.screenWindow[1]) - camera.screenWindow[0]) / std::max(1, camera.resolution[0]);
  const double py =
      std::abs(double(camera.screenWindow[3]) - camera.screenWindow[2]) / std::max(1, camera.resolution[1]);
  e.pixel = std::sqrt(px * py) * tangent;
  if (!(e.pixel > 0) || !std::isfinite(e.pixel)) e.pixel = 1e-3;
  const auto largest = [](float a, float b) { return double(std::max(std::abs(a), std::abs(b))); };
  const double x = largest(camera.screenWindow[0], camera.screenWindow[1]) * tangent;
  const double y = largest(camera.screenWindow[2], camera.screenWindow[3]) * tangent;
  const double corner = std::sqrt(x * x + y * y);
  const DVec3 forward = glm::transpose(DMat3(cacheToCamera)) * DVec3(0, 0, 1);
  const double length = glm::length(forward);
  if (length > 0 && std::isfinite(length) && std::isfinite(corner) && corner > 0) {
    e.axis = forward / length;
    // A margin for filters and displacement.
    e.perspective ? e.cone = std::atan(corner)* 1.05 : e.radius = corner * 1.05;
  }
  const float* dof = camera.dof;
  if (e.perspective && dof[0] > 0 && dof[0] < 1e30f && dof[1] > 0 && dof[2] > 0 && std::isfinite(dof[1])) {
    e.lensRadius = 0.5 * double(dof[1]) / double(dof[0]) / unit;
    e.focalDistance = double(dof[2]) / unit;
  }
  // A near plane of almost nothing must not ask for infinitely fine grids around the eye.
  e.nearDistance = std::max(double(camera.clipping[0]), 1e-6) / unit;
  if (!std::isfinite(e.nearDistance)) e.nearDistance = 1e-6;
  return e;
}

DiceRate diceRate(const DiceEye& eye, const AttributeRecord& a, PrimitiveType type) {
  DiceRate r;
  r.eye = Vec3(eye.position);
  r.perspective = eye.perspective;
  r.axis = Vec3(eye.axis);
  r.cone = float(eye.cone);
  r.insideCone = eye.cone < std::numbers::pi ? float(std::cos(eye.cone)) + 1e-6f : -2;
  r.radius = float(eye.radius);
  const double nearest = std::max(eye.nearDistance, 1e-15);
  r.nearSquared = float(nearest * nearest);
  const double shadingRate = a.shadingRate > 0 && std::isfinite(a.shadingRate) ? a.shadingRate : 1.0;
  // Several samples a pixel need no finer micropolygons: below a hundredth of a pixel a rate is a mistake.
  const double side = eye.pixel * std::max(std::sqrt(shadingRate), 0.01);
  const double multiplier =
      std::clamp(std::isfinite(a.patchMultiplier) ? double(a.patchMultiplier) : 1.0, 1.0, 64.0);
  r.scale = float(multiplier / side);
  if (type == PrimitiveType::kBilinearPatches || type == PrimitiveType::kMeshlets)
    r.undicedEdge = kUndicedEdge;
  if (type <= PrimitiveType::kTorus) r.leastLog2 = 2;
  const bool moved = a.displacement != kNone || a.deformation != 0;
  if (!r.perspective && !moved &&
      (type == PrimitiveType::kBilinearPatches || type == PrimitiveType::kMeshlets))
    r.alongAxis = kAlongFlat;
  if (eye.lensRadius > 0 && a.focusFactor > 0) {
    r.focus = float(a.focusFactor * 2 * eye.lensRadius / eye.pixel) / kSharpPixels;
    r.sharpest = float(1 / eye.focalDistance);
  }
  if (a.flatness > 0) r.flatness = float(double(a.flatness) * eye.pixel * double(r.scale));
  return r;
}

DiceRate diceRate(const DiceEye& eye, const AttributeRecord& a, PrimitiveType type, float fixedRate) {
  DiceRate r = diceRate(eye, a, type);
  if (fixedRate > 0)
    r.focus = 0, r.perspective = false, r.radius = 1e30f, r.alongAxis = 1, r.scale = fixedRate;
  return r;
}

float DiceRate::segment(Vec3 a, Vec3 b) const {
  // In a fixed order, so that a curve and its reverse get the same bits.
  const bool swap = a.x != b.x ? b.x < a.x : a.y != b.y ? b.y < a.y : b.z < a.z;
  if (swap) std::swap(a, b);
  Vec3 d = b - a;
  if (alongAxis < 1) d -= axis * ((1 - alongAxis) * glm::dot(axis, d));
  const float square = glm::dot(d, d);
  if (!perspective) return std::sqrt(square) * scale * cylinderWeight(a - eye, b - eye) / motionSide;
  const Vec3 e = eye - a;
  const float t = square > 0 ? std::clamp(glm::dot(e, d) / square, 0.0f, 1.0f) : 0.0f;
  const Vec3 nearest = e - d * t;
  const float distance = std::max(glm::dot(nearest, nearest), nearSquared);
  const float length = std::sqrt(square / distance) * scale * viewWeight(a - eye, b - eye);
  // Blur by motion and by the lens: the stronger one hides the other's detail too.
  const float focusBlur = focus > 0 ? focusSide(glm::dot(a - eye, axis), glm::dot(b - eye, axis)) : 1.0f;
  return length / std::max(motionSide, focusBlur);
}

float DiceRate::focusSide(float depthA, float depthB) const {
  const float nearest = std::sqrt(nearSquared);
  const float a = 1 / std::max(depthA, nearest) - sharpest, b = 1 / std::max(depthB, nearest) - sharpest;
  const float blur = (a < 0) == (b < 0) ? std::min(std::abs(a), std::abs(b)) : 0.0f;
  return std::clamp(focus * blur, 1.0f, kMostBlurSide);
}

float motionSide(const glm::dvec2 (&open)[8], const glm::dvec2 (&close)[8], float factor) {
  glm::dvec2 mean(0);
  for (int i = 0; i < 8; ++i) mean += close[i] - open[i];
  const double length = glm::length(mean);
  if (!(length > 0) || !std::isfinite(length)) return 1;
  // What lies between the corners moves between them: no less far in the direction of all than any corner
  // does.
  double least = 1e30;
  for (int i = 0; i < 8; ++i) least = std::min(least, glm::dot(close[i] - open[i], mean) / length);
  if (!(least > 0)) return 1;  // some of it may stand still
  return std::clamp(std::sqrt(factor * float(least) / kSharpPixels), 1.0f, kMostBlurSide);
}

float DiceRate::viewWeight(Vec3 a, Vec3 b) const {
  constexpr float kLeast = 0.25f;
  // So many cones away from it, even that is too much for an extremely narrow view: a ball that fills it many
  // thousand times over would be endless.
  constexpr float kFar = 64;
  // The largest cosine to the axis along a + t (b - a): at an end, or where its derivative vanishes.
  const Vec3 d = b - a;
  const float a0 = glm::dot(a, axis), a1 = glm::dot(d, axis);
  const float b0 = glm::dot(a, a), b1 = glm::dot(a, d), b2 = glm::dot(d, d);
  const auto cosineAt = [&](float t) {
    const Vec3 p = a + d * t;
    const float square = glm::dot(p, p);
    return square > nearSquared ? glm::dot(p, axis) / std::sqrt(square) : 1.0f;
  };
  float cosine = std::max(cosineAt(0), cosineAt(1));
  if (cosine > insideCone) return 1.0f;
  const float denominator = a0 * b2 - a1 * b1;
  const float t = denominator != 0 ? (a1 * b0 - a0 * b1) / denominator : 0.0f;
  if (t > 0 && t < 1) cosine = std::max(cosine, cosineAt(t));
  const float outside = std::acos(std::clamp(cosine, -1.0f, 1.0f)) - cone;
  if (!(outside > 0)) return 1;
  const float weight = std::max(kLeast, 1 / (1 + 3 * outside / cone));
  return outside > kFar * cone ? weight * kFar * cone / outside : weight;
}

float DiceRate::cylinderWeight(Vec3 a, Vec3 b) const {
  a -= axis * glm::dot(a, axis), b -= axis * glm::dot(b, axis);
  const Vec3 d = b - a;
  const float square = glm::dot(d, d);
  const float t = square > 0 ? std::clamp(-glm::dot(a, d) / square, 0.0f, 1.0f) : 0.0f;
  const float distance = glm::length(a + d * t);
  return distance > radius ? radius / distance : 1.0f;
}

float DiceRate::longestSegment(const float (&x)[kMetricSteps + 1], const float (&y)[kMetricSteps + 1],
                               const float (&z)[kMetricSteps + 1]) const {
  const auto slow = [&](int i) { return segment({x[i], y[i], z[i]}, {x[i + 1], y[i + 1], z[i + 1]}); };
  float largest = 0;
  if (!perspective || alongAxis < 1 || focus > 0) {
    for (int i = 0; i < kMetricSteps; ++i) largest = std::max(largest, slow(i));
    return largest;
  }
  // segment() and the first lines of viewWeight() as loops that compilers turn into vector instructions; the
  // same operations in the same order.
  float length[kMetricSteps], cosine[kMetricSteps];
  for (int i = 0; i < kMetricSteps; ++i) {
    const float x0 = x[i], y0 = y[i], z0 = z[i], x1 = x[i + 1], y1 = y[i + 1], z1 = z[i + 1];
    const bool swap = (x1 < x0) | ((x1 == x0) & ((y1 < y0) | ((y1 == y0) & (z1 < z0))));
    const float ax = swap ? x1 : x0, ay = swap ? y1 : y0, az = swap ? z1 : z0;
    const float bx = swap ? x0 : x1, by = swap ? y0 : y1, bz = swap ? z0 : z1;
    const float dx = bx - ax, dy = by - ay, dz = bz - az;
    const float square = dx * dx + dy * dy + dz * dz;
    const float ex = eye.x - ax, ey = eye.y - ay, ez = eye.z - az;
    float t = (ex * dx + ey * dy + ez * dz) / square;
    t = t < 0 ? 0.0f : 1 < t ? 1.0f : t;
    t = square > 0 ? t : 0.0f;
    const float nx = ex - dx * t, ny = ey - dy * t, nz = ez - dz * t;
    const float n = nx * nx + ny * ny + nz * nz;
    length[i] = std::sqrt(square / (n < nearSquared ? nearSquared : n)) * scale;
    const float px = ax - eye.x, py = ay - eye.y, pz = az - eye.z;
    const float qx = px + (bx - eye.x - px), qy = py + (by - eye.y - py), qz = pz + (bz - eye.z - pz);
    const float p2 = px * px + py * py + pz * pz, q2 = qx * qx + qy * qy + qz * qz;
    const float p = (px * axis.x + py * axis.y + pz * axis.z) / std::sqrt(p2);
    const float q = (qx * axis.x + qy * axis.y + qz * axis.z) / std::sqrt(q2);
    const float cosineP = p2 > nearSquared ? p : 1.0f, cosineQ = q2 > nearSquared ? q : 1.0f;
    cosine[i] = cosineP < cosineQ ? cosineQ : cosineP;
  }
  for (int i = 0; i < kMetricSteps; ++i)
    largest = std::max(largest, cosine[i] > insideCone ? length[i] / std::max(motionSide, 1.0f) : slow(i));
  return largest;
}

float DiceRate::curve(const float* x, const float* y, const float* z, size_t stride) const {
  float px[kMetricSteps + 1], py[kMetricSteps + 1], pz[kMetricSteps + 1];
  for (size_t i = 0; i <= kMetricSteps; ++i)
    px[i] = x[i * stride], py[i] = y[i * stride], pz[i] = z[i * stride];
  const float largest = longestSegment(px, py, pz);
  const float length = largest * float(kMetricSteps);
  if (!(flatness > 0)) return length;
  // n chords of equal parameters err by |P''| / 8 n^2, and the second difference of samples at 1/8 is |P''|
  // / 64.
  float bend = 0;
  for (int i = 1; i < kMetricSteps; ++i) {
    const size_t k = size_t(i) * stride, a = k - stride, b = k + stride;
    const Vec3 p(x[k], y[k], z[k]);
    const Vec3 second = (Vec3(x[a], y[a], z[a]) + Vec3(x[b], y[b], z[b])) - 2.0f * p;
    bend = std::max(bend, segment(p, p + second));
  }
  // What flatness asks for is a bound: nothing is rounded down.
  return std::max(length, kLongestSegment * std::sqrt(8 * bend / flatness));
}

int DiceRate::log2Segments(float metric) const {
  if (!(metric > undicedEdge)) return leastLog2;
  int e = std::max(1, leastLog2);
  while (e < 30 && kLongestSegment * float(1u << e) < metric) ++e;
  return e;
}

}  // namespace fr::cache
