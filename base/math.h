// Vectors, matrices, boxes. GLM underneath.
//
// RISpec writes points as row vectors, p' = p M, with 16 numbers row by row. GLM writes columns,
// p' = M p, stored column by column. The 16 numbers are the same bytes in both, so a RIB matrix is
// copied as it stands, and "concatenate M before the CTM" (CTM := M CTM) is `ctm * m` here.
#pragma once

#define GLM_FORCE_SILENT_WARNINGS 1
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/matrix.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <limits>

namespace fr {

using Vec2 = glm::vec2;
using Vec3 = glm::vec3;
using Vec4 = glm::vec4;
using Mat3 = glm::mat3;
using Mat4 = glm::mat4;
using DVec3 = glm::dvec3;
using DVec4 = glm::dvec4;
using DMat3 = glm::dmat3;
using DMat4 = glm::dmat4;
using Color = glm::vec3;

inline constexpr float kRiInfinity = 1.0e38f;
inline constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// Transforms a point (w divided out only when the matrix is a projection).
template <class T>
inline glm::tvec3<T> transformPoint(const glm::tmat4x4<T>& m, const glm::tvec3<T>& p) {
  const glm::tvec4<T> h = m * glm::tvec4<T>(p, T(1));
  const glm::tvec3<T> r(h);
  return h.w == T(1) ? r : r / h.w;
}
/// Transforms a direction: upper 3x3, no translation.
template <class T>
inline glm::tvec3<T> transformVector(const glm::tmat4x4<T>& m, const glm::tvec3<T>& v) {
  return glm::tmat3x3<T>(m) * v;
}
/// The matrix that carries normals when `m` carries points: inverse transpose of the upper 3x3.
/// A singular `m` gives its cofactor matrix, which still has the right direction.
template <class T>
inline glm::tmat3x3<T> normalMatrix(const glm::tmat4x4<T>& m) {
  const glm::tmat3x3<T> a(m);
  const glm::tmat3x3<T> cof(glm::cross(a[1], a[2]), glm::cross(a[2], a[0]), glm::cross(a[0], a[1]));
  const T det = glm::dot(a[0], cof[0]);
  return det != T(0) ? cof / det : cof;
}
/// True when `m` swaps handedness (negative determinant).
template <class T>
inline bool isMirrored(const glm::tmat4x4<T>& m) {
  return glm::determinant(glm::tmat3x3<T>(m)) < T(0);
}

/// Axis-aligned box. An empty box has min > max.
template <class T>
struct Box3 {
  glm::tvec3<T> min{std::numeric_limits<T>::infinity()};
  glm::tvec3<T> max{-std::numeric_limits<T>::infinity()};

  bool empty() const { return !(min.x <= max.x && min.y <= max.y && min.z <= max.z); }
  void extend(const glm::tvec3<T>& p) { min = glm::min(min, p), max = glm::max(max, p); }
  void extend(const Box3& b) { min = glm::min(min, b.min), max = glm::max(max, b.max); }
  void grow(T r) { min -= glm::tvec3<T>(r), max += glm::tvec3<T>(r); }
  glm::tvec3<T> corner(int i) const {
    return {i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z};
  }
  glm::tvec3<T> center() const { return (min + max) * T(0.5); }
  T diagonal() const { return empty() ? T(0) : glm::length(max - min); }
  bool overlaps(const Box3& b) const {
    return min.x <= b.max.x && b.min.x <= max.x && min.y <= b.max.y && b.min.y <= max.y &&
           min.z <= b.max.z && b.min.z <= max.z;
  }
};
using Box3f = Box3<float>;
using Box3d = Box3<double>;

/// Box around the eight transformed corners.
template <class T>
inline Box3<T> transformBox(const glm::tmat4x4<T>& m, const Box3<T>& b) {
  Box3<T> r;
  if (b.empty()) return r;
  for (int i = 0; i < 8; ++i) r.extend(transformPoint(m, b.corner(i)));
  return r;
}

/// Smallest power of two >= x, as an exponent; 0 for x <= 1 and for NaN.
inline int log2Ceil(double x) {
  int e = 0;
  while (e < 62 && double(1ull << e) < x) ++e;
  return e;
}

inline bool isFinite(const Vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

}  // namespace fr
