// An Embree scene with what is needed to say what its hits mean. Internal to tracer/.
#pragma once

#include <embree3/rtcore.h>

#include <memory>
#include <utility>
#include <vector>

#include "tracer/border_stitch.h"
#include "tracer/meshlet_leaves.h"

namespace fr::tracer {

struct TracedPart {
  /// In entryOfPrimitive: the rest is an index into stitches.
  static constexpr uint32_t kStitch = 0x80000000u;

  RTCScene scene = nullptr;                             // owned; nullptr: no geometry
  std::vector<std::vector<uint32_t>> entryOfPrimitive;  // by Embree's geometry id, then primitive id
  std::vector<std::unique_ptr<MeshletLeaves>> leaves;   // by geometry id, nullptr or beyond: no meshlets.
                                                        // Know the entries of their triangles themselves
  std::vector<StitchQuad> stitches;                     // StitchQuad::grid is the entry
  std::vector<std::vector<float>> stitchVertices;       // four corners each, key after key
  std::vector<std::vector<uint32_t>> descriptors;       // of grids, one a geometry; Embree reads them here
  /// By geometry id: cells of grids that are Embree's quadrilaterals, by primitive id; empty or beyond: none
  /// are.
  struct Cell {
    uint32_t grid;  // as in entryOfPrimitive
    uint16_t i, j;  // of the cells that Embree sees as this grid
    uint16_t cellsU, cellsV;
  };
  std::vector<std::vector<Cell>> cells;
  TracedPart() = default;
  TracedPart(TracedPart&& o) noexcept { *this = std::move(o); }
  TracedPart& operator=(TracedPart&& o) noexcept {
    std::swap(scene, o.scene);
    entryOfPrimitive.swap(o.entryOfPrimitive), stitches.swap(o.stitches);
    stitchVertices.swap(o.stitchVertices), descriptors.swap(o.descriptors), leaves.swap(o.leaves),
        cells.swap(o.cells);
    return *this;
  }
  ~TracedPart() {
    if (scene) rtcReleaseScene(scene);
  }

  /// The entry that a primitive belongs to, or a number of a stitch and kStitch; u and v, of the hit on it,
  /// become places in what Embree sees of the grid.
  uint32_t entryOf(uint32_t geometry, uint32_t primitive, float& u, float& v) const {
    if (geometry < cells.size() && !cells[geometry].empty()) {
      const Cell& c = cells[geometry][primitive];
      u = (float(c.i) + u) / float(c.cellsU), v = (float(c.j) + v) / float(c.cellsV);
      return c.grid;
    }
    if (geometry < leaves.size() && leaves[geometry]) return leaves[geometry]->entryOf(primitive);
    return entryOfPrimitive[geometry][primitive];
  }

  uint64_t recordBytes() const {
    uint64_t n = stitches.size() * sizeof(StitchQuad);
    for (const auto& table : entryOfPrimitive) n += table.size() * sizeof(uint32_t);
    for (const auto& corners : stitchVertices) n += corners.size() * sizeof(float);
    for (const auto& l : leaves) n += l ? l->bytes() : 0;
    for (const auto& table : cells) n += table.size() * sizeof(Cell);
    for (const auto& buffer : descriptors) n += buffer.size() * sizeof(uint32_t);
    return n;
  }
};

}  // namespace fr::tracer
