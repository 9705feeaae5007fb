#include "ri/transform.h"

#include <algorithm>
#include <cmath>

namespace fr::ri {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;
constexpr double kLargestTurn =
    10.0;  // degrees between two keys: a point leaves its circle by 0.4 % of the radius
constexpr int kMostSteps = 128;

Result<DMat4> rotation(double angle, const DVec3& axis) {
  const double length = glm::length(axis);
  if (!(length > 0)) return makeError(RiError::kRange, "the axis of Rotate has no length");
  const DVec3 a = axis / length;
  const double c = std::cos(angle * kDegree), s = std::sin(angle * kDegree), k = 1 - c;
  DMat4 m(1);
  m[0] = {k * a.x * a.x + c, k * a.x * a.y + s * a.z, k * a.x * a.z - s * a.y, 0};
  m[1] = {k * a.x * a.y - s * a.z, k * a.y * a.y + c, k * a.y * a.z + s * a.x, 0};
  m[2] = {k * a.x * a.z + s * a.y, k * a.y * a.z - s * a.x, k * a.z * a.z + c, 0};
  return m;
}

// Shears along d2 in proportion to the part of a point that is square to d2, so that d1 turns towards d2 by
// `angle` (RISpec 3.2, "Skew").
Result<DMat4> shear(double angle, const DVec3& axis1, const DVec3& axis2) {
  const double l1 = glm::length(axis1), l2 = glm::length(axis2);
  if (!(l1 > 0) || !(l2 > 0)) return makeError(RiError::kRange, "an axis of Skew has no length");
  const DVec3 d1 = axis1 / l1, d2 = axis2 / l2;
  const double along = glm::dot(d1, d2);
  const DVec3 square = d1 - along * d2;
  const double across = glm::length(square);
  const double between = std::atan2(across, along);
  const double turned = between - angle * kDegree;
  constexpr double kPi = 180 * kDegree;
  if (across < 1e-12 || turned <= 1e-12 || turned >= kPi - 1e-12) {
    return makeError(RiError::kRange, "Skew by {} degrees reaches its second axis", angle);
  }
  const double k = std::cos(turned) / std::sin(turned) - along / across;
  const DVec3 n = square / across;
  DMat4 m(1);
  for (int i = 0; i < 3; ++i) m[i] += DVec4(d2 * (k * n[i]), 0);
  return m;
}

Result<DMat4> perspective(double fov) {
  if (!(fov > 0 && fov < 180))
    return makeError(RiError::kRange, "Perspective with a field of view of {}", fov);
  const double d = std::tan(fov * 0.5 * kDegree);
  DMat4 m(0);
  m[0][0] = m[1][1] = 1;
  m[2][2] = m[2][3] = d;
  m[3][2] = -d;
  return m;
}

bool isFiniteMatrix(const DMat4& m) {
  for (int i = 0; i < 16; ++i) {
    if (!std::isfinite(m[i / 4][i % 4])) return false;
  }
  return true;
}

TransformRequest between(const TransformRequest& a, const TransformRequest& b, double t) {
  TransformRequest r = a;
  for (size_t i = 0; i < r.args.size(); ++i) r.args[i] = a.args[i] * (1 - t) + b.args[i] * t;
  return r;
}

}  // namespace

const char* transformRequestName(TransformRequest::Kind k) {
  static constexpr const char* kNames[] = {"Identity",  "Transform", "ConcatTransform", "Perspective",
                                           "Translate", "Rotate",    "Scale",           "Skew"};
  return kNames[size_t(k)];
}

DMat4 Transform::at(float time) const {
  if (!(time > times.front())) return matrices.front();
  if (time >= times.back()) return matrices.back();
  const size_t i = size_t(std::upper_bound(times.begin(), times.end(), time) - times.begin());
  const double t = (double(time) - times[i - 1]) / (double(times[i]) - times[i - 1]);
  return matrices[i - 1] * (1 - t) + matrices[i] * t;
}

Transform concat(const Transform& outer, const Transform& inner) {
  Transform r;
  if (!inner.isMoving() || !outer.isMoving()) {
    const Transform& moving = inner.isMoving() ? inner : outer;
    r.times = moving.times;
    r.matrices.resize(moving.matrices.size());
    for (size_t i = 0; i < r.matrices.size(); ++i) {
      r.matrices[i] = outer.matrices[outer.isMoving() ? i : 0] * inner.matrices[inner.isMoving() ? i : 0];
    }
    return r;
  }
  r.times.clear();
  std::set_union(outer.times.begin(), outer.times.end(), inner.times.begin(), inner.times.end(),
                 std::back_inserter(r.times));
  r.matrices.clear();
  for (float t : r.times) r.matrices.push_back(outer.at(t) * inner.at(t));
  return r;
}

Result<Transform> inverse(const Transform& t) {
  Transform r = t;
  for (DMat4& m : r.matrices) {
    m = glm::inverse(m);
    if (!isFiniteMatrix(m)) return makeError(RiError::kMath, "a transformation cannot be inverted");
  }
  return r;
}

Result<DMat4> TransformRequest::matrix() const {
  const auto& a = args;
  const auto v = [&](size_t i) { return DVec3(a[i], a[i + 1], a[i + 2]); };
  Result<DMat4> r = DMat4(1);
  switch (kind) {
    case Kind::kIdentity:
      break;
    case Kind::kTransform:
    case Kind::kConcat:
      for (int i = 0; i < 16; ++i) (*r)[i / 4][i % 4] = a[size_t(i)];
      break;
    case Kind::kPerspective:
      r = perspective(a[0]);
      break;
    case Kind::kTranslate:
      (*r)[3] = DVec4(v(0), 1);
      break;
    case Kind::kRotate:
      r = rotation(a[0], v(1));
      break;
    case Kind::kScale:
      for (int i = 0; i < 3; ++i) (*r)[i][i] = a[size_t(i)];
      break;
    case Kind::kSkew:
      r = shear(a[0], v(1), v(4));
      break;
  }
  if (r && !isFiniteMatrix(*r)) {
    return makeError(RiError::kMath, "{}: a number is not finite", transformRequestName(kind));
  }
  return r;
}

Result<Transform> movingTransform(const std::vector<float>& times,
                                  const std::vector<TransformRequest>& requests) {
  if (times.size() != requests.size() || times.empty()) {
    return makeError(RiError::kBadMotion, "{} requests for {} times", requests.size(), times.size());
  }
  Transform r;
  r.times.clear();
  r.matrices.clear();
  for (size_t i = 0; i < requests.size(); ++i) {
    if (i > 0) {
      int steps = 1;
      if (requests[i].kind == TransformRequest::Kind::kRotate) {
        const double turn = std::abs(requests[i].args[0] - requests[i - 1].args[0]);
        if (turn > kLargestTurn) steps = int(std::min(std::ceil(turn / kLargestTurn), double(kMostSteps)));
      }
      for (int k = 1; k < steps; ++k) {
        const double t = double(k) / steps;
        Result<DMat4> m = between(requests[i - 1], requests[i], t).matrix();
        if (!m) return m.error();
        const float time = float(times[i - 1] * (1 - t) + times[i] * t);
        if (!(time > r.times.back()) || !(time < times[i])) continue;  // keys too close for a float
        r.times.push_back(time);
        r.matrices.push_back(*m);
      }
    }
    Result<DMat4> m = requests[i].matrix();
    if (!m) return m.error();
    r.times.push_back(times[i]);
    r.matrices.push_back(*m);
  }
  return r;
}

}  // namespace fr::ri
