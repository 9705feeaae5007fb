// Single polygons and patches that follow each other under one state, taken together.
//
// Many scenes are written one face a request. A request becomes an object with tables, patches and a place
// in every list; what a face itself needs is a tenth of that. So consecutive Polygon requests become one
// PointsPolygons, and consecutive Patch requests one PatchMesh of separate patches (ri::PatchMesh::separate).
// The picture is the same: faces keep their parameters, and neighbours meet as they did.
#pragma once

#include <optional>

#include "ri/state_renderer.h"

namespace fr::cache {

/// Not thread-safe.
class PrimitiveRun {
 public:
  /// Takes `p`, which `sides` see, if it can start the run or continue it.
  bool take(const ri::PlacedPrimitive& p, uint8_t sides);
  bool empty() const { return requests_ == 0; }
  uint8_t sides() const { return sides_; }
  /// Requests taken so far.
  uint32_t requests() const { return requests_; }
  /// All that was taken, as one primitive; a single request as it was. The run is empty afterwards.
  ri::PlacedPrimitive end();

 private:
  bool continues(const ri::PlacedPrimitive& p, uint8_t sides) const;

  ri::PlacedPrimitive first_;
  uint8_t sides_ = 0;
  uint32_t requests_ = 0;
  std::vector<int> sizes_;            // of polygons
  std::vector<ri::Param> variables_;  // of all requests, request after request
};

}  // namespace fr::cache
