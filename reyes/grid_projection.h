// A grid's vertices on a tile's raster, and the drawing of its micropolygons.
#pragma once

#include <vector>

#include "reyes/raster_kernel.h"
#include "reyes/raster_space.h"

namespace fr::reyes {

/// Why a vertex cannot be drawn as it is.
enum VertexState : uint8_t {
  kVertexDrawn = 0,
  kVertexClipped = 1,  // behind the near plane or outside the guard band: its triangles are clipped
  kVertexInvalid = 2,  // not a number: its triangles are left out
};

struct ProjectedGrid {
  std::vector<int32_t> x, y;  // subpixel steps from the tile's corner
  std::vector<float> key;
  std::vector<uint8_t> state;
  bool anyClipped = false;
  /// Raster bounds of the drawn vertices, in pixels; unbounded when some are clipped.
  RasterBounds bounds{};
};

/// Projects positions (rows of nu + 1 of them `rowStride` apart, nv + 1 rows; or count in one row).
/// The same position gives the same bits on every tile.
void projectGrid(const RasterSpace& space, const float* positions, int columns, int rows, size_t rowStride,
                 const PixelRect& tile, ProjectedGrid& out);

/// Draws the triangles that use clipped vertices, cut at the near plane and the guard band; `triangles` as
/// for the raster function. `draw(const RasterTriangles&)` is called with pieces. Cold path: allocates.
template <class Draw>
void drawClipped(const RasterSpace& space, const float* positions, int columns, size_t rowStride,
                 const PixelRect& tile, const ProjectedGrid& grid, const RasterTriangles& triangles,
                 Draw&& draw);

// ---- implementation
// -------------------------------------------------------------------------------------------

/// A polygon of at most 9 vertices, ready to draw as a fan.
struct ClippedPolygon {
  int count = 0;
  int32_t x[12], y[12];
  float key[12];
};
/// One triangle (vertex indices `v`), clipped. count < 3: nothing is left.
ClippedPolygon clipTriangle(const RasterSpace& space, const float* positions, int columns, size_t rowStride,
                            const PixelRect& tile, const ProjectedGrid& grid, const uint32_t v[3]);

template <class Draw>
void drawClipped(const RasterSpace& space, const float* positions, int columns, size_t rowStride,
                 const PixelRect& tile, const ProjectedGrid& grid, const RasterTriangles& triangles,
                 Draw&& draw) {
  static constexpr uint8_t kFan[] = {0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5,
                                     6, 0, 6, 7, 0, 7, 8, 0, 8, 9, 0, 9, 10};
  for (uint32_t t = 0; t < triangles.triangleCount; ++t) {
    uint32_t v[3];
    if (triangles.indices)
      for (int i = 0; i < 3; ++i) v[i] = triangles.indices[3 * t + uint32_t(i)];
    else
      gridTriangle(triangles.nu, t, v);
    const int states = grid.state[v[0]] | grid.state[v[1]] | grid.state[v[2]];
    if (states != kVertexClipped) continue;
    const ClippedPolygon p = clipTriangle(space, positions, columns, rowStride, tile, grid, v);
    if (p.count < 3) continue;
    uint32_t ids[12];
    for (uint32_t& id : ids) id = t;
    RasterTriangles piece = triangles;
    piece.x = p.x, piece.y = p.y, piece.key = p.key, piece.skip = nullptr;
    piece.indices = kFan, piece.ids = ids, piece.triangleCount = uint32_t(p.count - 2);
    draw(piece);
  }
}

}  // namespace fr::reyes
