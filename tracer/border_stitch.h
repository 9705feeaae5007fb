// Closing the surface between grids whose coarse borders differ.
//
// At stride 1 neighbours show the same vertices along their common border (scene_cache/dicer.h). At a coarser
// stride they need not: a border of 8 segments shows 4 in a grid of 8 cells, but 8 in a grid of 16 whose
// surplus vertices were collapsed. A ray may pass between the two lines.
//
// So a segment of a coarse border that another grid shows in pieces is cut where that one has its vertices,
// and both sides end on the same line, bit by bit. Segments are found by their end points alone, so pieces of
// separate primitives close too. The row of cells along such a border becomes quadrilaterals of their own;
// what lies inside of these rows stays a strided grid. Most segments have their equal on the other side, or
// nothing, and cost nothing.
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
  /// Its neighbours may not be among the grids: segments that nobody else shows, in whatever way, get all
  /// their vertices of stride 1.
  bool open = false;
  uint8_t inner[4] = {};  // out: the cells [0], [1] in u, and [2], [3] in v, first and end, that stay a grid;
                          // may be none
};

/// Two triangles over vertices of stride 1, wound as the grid's cells are: corners 0 1 3 and 2 3 1, as Embree
/// cuts quadrilaterals. One of them may have no area.
struct StitchQuad {
  uint32_t grid;       // index into the grids
  uint8_t i[4], j[4];  // column and row of the corners
};

/// Fills BorderedGrid::inner and returns the quadrilaterals around it, in the order of the grids. Runs on the
/// calling TBB arena.
std::vector<StitchQuad> stitchBorders(std::span<BorderedGrid> grids);

}  // namespace fr::tracer
