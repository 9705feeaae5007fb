// Cubic bases as Bezier control points.
#pragma once

#include <cstdint>

#include "base/math.h"

namespace fr::cache {

/// Turns four geometry values of a cubic basis into four Bezier ordinates: ordinate[r] = sum_c m[r][c] g[c] /
/// denominator. For the standard bases (and any basis whose entries are small fractions) m holds whole
/// numbers, so that the sums are exact in double and neighbouring patches of a mesh agree on their common
/// border bit by bit.
struct BezierConversion {
  double m[4][4];
  double denominator;
};

/// `basis`: the 16 numbers of RiBasis, row by row (RISpec 3.2, "Bicubic patches": P = U M G). Not finite:
/// Bezier.
BezierConversion bezierConversion(const float basis[16]);

/// The inverse, in double: geometry values that give the Bezier ordinates `b`. False when the basis is
/// singular.
bool geometryFromBezier(const BezierConversion& c, const double b[4], double g[4]);

/// Control points of one patch, 4x4 with `components` doubles each, u fastest, to Bezier control points in
/// place.
void convertToBezier(const BezierConversion& cu, const BezierConversion& cv, int components, double* points);

}  // namespace fr::cache
