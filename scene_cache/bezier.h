// Symmetric curve formulas.
//
// Every function gives the same bits when the control points are given in reverse order and t is replaced by
// 1 - t, provided that 1 - t is exact (t = k / 2^n). So two separate primitives with the same edge control
// points, in either direction, show the same polyline. This needs -ffp-contract=off (set for all of our
// targets).
#pragma once

namespace fr::cache {

/// s * a + t * b, with s = 1 - t.
template <class T>
inline T lerpSymmetric(T a, T b, T s, T t) {
  return s * a + t * b;
}

/// The four cubic Bernstein polynomials at t.
template <class T>
inline void bernstein(T t, T b[4]) {
  const T s = T(1) - t;
  b[0] = (s * s) * s;
  b[1] = T(3) * ((s * s) * t);
  b[2] = T(3) * ((t * t) * s);
  b[3] = (t * t) * t;
}
/// Weights of the derivative's differences: d/dt = d[0] (p1-p0) + d[1] (p2-p1) + d[2] (p3-p2).
template <class T>
inline void bernsteinDerivative(T t, T d[3]) {
  const T s = T(1) - t;
  d[0] = T(3) * (s * s);
  d[1] = T(6) * (s * t);
  d[2] = T(3) * (t * t);
}
/// Point of a cubic from its Bernstein weights.
template <class T>
inline T cubicPoint(T p0, T p1, T p2, T p3, const T b[4]) {
  return (p0 * b[0] + p3 * b[3]) + (p1 * b[1] + p2 * b[2]);
}
template <class T>
inline T cubicDerivative(T p0, T p1, T p2, T p3, const T d[3]) {
  return ((p1 - p0) * d[0] + (p3 - p2) * d[2]) + (p2 - p1) * d[1];
}

}  // namespace fr::cache
