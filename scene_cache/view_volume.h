// What the camera can see, as far as boxes of cache space go.
#pragma once

#include "scene_cache/cache.h"

namespace fr::cache {

/// Thread-safe. A camera that moves or has a lens, or whose screen window makes no sense, sees everything.
class ViewVolume {
 public:
  explicit ViewVolume(const Skeleton& skeleton);
  /// True when no camera ray meets the box: certain, pixel filters included. False for boxes that are not
  /// finite.
  bool isOutside(const Box3f& box) const;

 private:
  bool everything_ = true;
  bool perspective_ = true;
  DMat4 cacheToCamera_{1.0};
  double left_ = 0, right_ = 0, bottom_ = 0, top_ = 0;  // of the view at distance 1, a margin included
  double near_ = 0;
};

}  // namespace fr::cache
