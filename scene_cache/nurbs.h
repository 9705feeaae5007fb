// B-splines with any knots as Bezier pieces.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "scene_cache/primitive_source.h"

namespace fr::cache {

/// Non-empty knot intervals of a B-spline inside [min, max]. `knots` ascend; order >= 2; there are
/// knots.size() - order control values. Empty when nothing of [min, max] lies inside a knot interval.
std::vector<NurbsSpan> nurbsSpans(std::span<const float> knots, int order, float min, float max);

/// Control values of a B-spline (knots.size() - order values of `width` numbers, `stride` numbers apart) to
/// Bezier points of its spans: max(order, 4) points each, the lower orders raised to cubics. By blossoming
/// (Ramshaw, "Blossoms are polar forms", 1989). Neighbouring spans share their common point bit by bit,
/// unless a knot of multiplicity `order` separates them.
std::vector<double> bezierPieces(std::span<const float> knots, int order, std::span<const NurbsSpan> spans,
                                 const double* values, size_t width, size_t stride);

/// Point of one Bezier piece (order points of `width` numbers, at most 4 of them used) by de Casteljau's
/// algorithm.
void bezierPiecePoint(const double* points, int order, size_t width, double t, double* out);

}  // namespace fr::cache
