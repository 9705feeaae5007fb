// Where a box of object space lies in the picture.
#pragma once

#include <span>

#include "ri/primitives.h"
#include "ri/transform.h"
#include "scene_cache/format.h"

namespace fr::cache {

struct ScreenExtent {
  /// False when no camera ray can meet it: certain, filters, lens and motion included.
  bool inView = true;
  /// Pixels of the rectangle on the raster around what is beyond the near plane, whether inside the picture
  /// or not (RISpec 3.2, "Detail"); a box before that plane counts as if it were as far behind the eye's.
  double pixels = kRiInfinity;
};

/// The camera as ScreenExtent needs it.
struct ScreenCamera {
  CameraRecord record{};
  std::span<const DMat4> worldToCamera;  ///< keys; at least one
  double filterRadius[2] = {1, 1};       ///< pixels
};

/// `bound`: xmin xmax ymin ymax zmin zmax; an infinite one is everywhere. Linear between the keys of
/// `objectToWorld`. A camera that moves sees everything.
ScreenExtent screenExtent(const ScreenCamera& camera, std::span<const DMat4> objectToWorld,
                          const ri::Bound& bound);

}  // namespace fr::cache
