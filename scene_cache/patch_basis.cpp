#include "scene_cache/patch_basis.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {

BezierConversion bezierConversion(const float basis[16]) {
  // Inverse of the Bezier basis matrix: coefficients of u^3 u^2 u 1 -> ordinates.
  static constexpr double kInverseBezier[4][4] = {
      {0, 0, 0, 1}, {0, 0, 1.0 / 3, 1}, {0, 1.0 / 3, 2.0 / 3, 1}, {1, 1, 1, 1}};
  BezierConversion r{};
  bool finite = true;
  for (int i = 0; i < 16; ++i) finite = finite && std::isfinite(basis[i]);
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      double sum = 0;
      for (int k = 0; k < 4; ++k) sum += kInverseBezier[i][k] * double(basis[k * 4 + j]);
      r.m[i][j] = finite ? sum : (i == j ? 1.0 : 0.0);
    }
  }
  r.denominator = 1;
  // RIB writes 1/6 with six or so digits: take such an entry for the fraction that is meant.
  for (const double d : {1.0, 2.0, 3.0, 4.0, 6.0, 12.0, 18.0, 24.0, 36.0}) {
    bool whole = true;
    for (auto& row : r.m) {
      for (const double x : row) whole = whole && std::abs(x * d - std::round(x * d)) < 1e-4;
    }
    if (!whole) continue;
    for (auto& row : r.m) {
      for (double& x : row) x = std::round(x * d);
    }
    r.denominator = d;
    break;
  }
  return r;
}

bool geometryFromBezier(const BezierConversion& c, const double b[4], double g[4]) {
  DMat4 m;
  for (int row = 0; row < 4; ++row) {
    for (int col = 0; col < 4; ++col) m[col][row] = c.m[row][col] / c.denominator;
  }
  const double det = glm::determinant(m);
  if (!(std::abs(det) > 1e-12)) return false;
  const DVec4 r = glm::inverse(m) * DVec4(b[0], b[1], b[2], b[3]);
  for (int i = 0; i < 4; ++i) g[i] = r[i];
  return true;
}

void convertToBezier(const BezierConversion& cu, const BezierConversion& cv, int components, double* points) {
  const auto pass = [components](const BezierConversion& c, double* p, int step) {
    for (int k = 0; k < components; ++k) {
      double g[4], r[4];
      for (int i = 0; i < 4; ++i) g[i] = p[i * step + k];
      for (int i = 0; i < 4; ++i) {
        r[i] = (c.m[i][0] * g[0] + c.m[i][3] * g[3]) + (c.m[i][1] * g[1] + c.m[i][2] * g[2]);
      }
      for (int i = 0; i < 4; ++i) p[i * step + k] = r[i];
    }
  };
  for (int j = 0; j < 4; ++j) pass(cu, points + j * 4 * components, components);
  for (int i = 0; i < 4; ++i) pass(cv, points + i * components, 4 * components);
  const double denominator = cu.denominator * cv.denominator;
  if (denominator != 1) std::for_each(points, points + 16 * components, [&](double& x) { x /= denominator; });
}

}  // namespace fr::cache
