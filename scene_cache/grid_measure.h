// What is recorded of a grid once its vertices are in place.
#pragma once

#include "base/math.h"
#include "scene_cache/format.h"

namespace fr::cache {

/// Largest distance between the surface of stride 2^level and the vertices, and the longest cell diagonal.
void measureGrid(const float* xyz, int nu, int nv, size_t rowStride, int levels, float deviation[kLevels],
                 float* cellSize, Box3f* bound);

}  // namespace fr::cache
