// Which vertices of a grid are shaded.
//
// Grids are diced by distance alone, since rays look at them from everywhere: a floor that the camera sees at
// a glancing angle, the rim of a sphere, and whatever a power of two rounded up, have many times more
// micropolygons than ShadingRate asks for on the raster. All of them are drawn; shaded are only as many rows
// and columns as the raster needs, and the vertices between get interpolated values.
#pragma once

#include <cstdint>

#include "reyes/raster_space.h"
#include "scene_cache/cache.h"

namespace fr::reyes {

/// Every u-th column and every v-th row; powers of two that divide the grid's sides.
struct ShadingStride {
  uint32_t u = 1, v = 1;
  bool all() const { return u == 1 && v == 1; }
};

/// The widest stride at which no shaded cell covers more than `area` pixels and none of its sides is longer
/// than the diagonal of a square of that size, as the camera `space` sees key 0. Where a surface turns away
/// from the camera within the grid, a stride of 2 at most: colours there often jump from one side to the
/// other. Depends on grid and camera alone. Anything but grids with rows and columns: 1.
ShadingStride shadingStride(const RasterSpace& space, const cache::GridView& grid, float area);

/// Values at all (nu + 1) (nv + 1) vertices from those that were shaded, bilinear in between: `from` and `to`
/// row by row. Border vertices that were collapsed onto another one get the value there.
void spreadShading(const cache::GridRecord& grid, ShadingStride stride, const float* from, float* to);

}  // namespace fr::reyes
