// Polygons with holes to triangles.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/math.h"

namespace fr::cache {

/// Sum of cross products around a loop: twice the area times the normal (Newell's method).
DVec3 newellNormal(std::span<const DVec3> loop);

/// Triangles of a polygon given as loops, the first outside and the others holes (RISpec 3.2, "General
/// polygons"), in either direction. `points` holds the loops one after the other, loopSizes their sizes; the
/// result indexes points, three a triangle, wound as the first loop is. Ear clipping after D. Eberly,
/// "Triangulation by Ear Clipping" (holes are joined to the outside by bridges). Crossing or degenerate loops
/// give some triangulation that uses every vertex; never hangs (quadratic time at worst). Empty when fewer
/// than three points are left.
std::vector<uint32_t> triangulate(std::span<const DVec3> points, std::span<const uint32_t> loopSizes);

}  // namespace fr::cache
