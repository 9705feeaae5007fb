// Closing the surface between grids whose coarse borders differ.
//
// At stride 1 neighbours show the same vertices along their common border (scene_cache/dicer.h). At a coarser
// stride they need not: a border of 8 segments shows 4 in a grid of 8 cells, but 8 in a grid of 16 whose
// surplus vertices were collapsed. A ray may pass between the two lines.
//
// So a segment of a coarse border that another grid shows in pieces is given its vertices of stride 1 back,
// and so are the pieces where they are coarse themselves. Both sides then end on the same line, bit by bit.
// Segments are found by their end points alone, so pieces of separate primitives close too. The row of cells
// along such a border becomes triangles; what lies inside of these rows stays a strided grid. Most segments
// have their equal on the other side, or nothing, and cost nothing.
//
// (Triangles between the two lines alone would be fewer, but they stand on edge, and rays along them slip
// through.)
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace fr::tracer {

/// What stitching must know of a grid, and the outcome.
struct BorderedGrid {
  const float* vertices = nullptr;  // stride 1, xyz; nullptr: not a grid
  uint32_t rowStride = 0;           // in vertices of stride 1
  uint8_t cellsU = 0, cellsV = 0;   // at the coarse stride
  uint8_t level = 0;                // the coarse stride is 2^level
  uint32_t kind = 0;                // only grids of one kind meet
  uint8_t inner[4] = {};  // out: the cells [0], [1] in u, and [2], [3] in v, first and end, that stay a grid;
                          // may be none
};

/// A triangle over vertices of stride 1, wound as the grid's cells are.
struct StitchTriangle {
  uint32_t grid;       // index into the grids
  uint8_t i[3], j[3];  // column and row of the corners
};

/// Fills BorderedGrid::inner and returns the triangles around it, in the order of the grids. Runs on the
/// calling TBB arena.
std::vector<StitchTriangle> stitchBorders(std::span<BorderedGrid> grids);

}  // namespace fr::tracer
