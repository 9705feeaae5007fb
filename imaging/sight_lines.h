// What each sample looks along, in camera space, and how much of it the clipping planes leave: the same for
// both hiders.
#pragma once

#include "base/math.h"
#include "imaging/frame_request.h"
#include "imaging/sample_pattern.h"
#include "scene_cache/cache.h"

namespace fr {

/// Immutable; thread-safe.
class SightLines {
 public:
  SightLines() = default;
  SightLines(const cache::CameraRecord& camera, const FrameLens& lens);

  bool perspective() const { return perspective_; }
  /// Camera space per pixel, at depth 1 in perspective.
  double pixelWidth() const { return scaleX_; }
  double pixelHeight() const { return scaleY_; }

  /// At depth z a line is at start + z * axis.
  struct Line {
    DVec3 start{0}, axis{0, 0, 1};
  };
  /// Through raster position (x, y), in pixels, y down: from the lens position through what the middle of the
  /// lens sees in focus.
  Line line(double x, double y, const SamplePattern::Blur& blur) const;

  struct Depths {
    double near, far;
  };
  /// The depths that are seen along a line: those between near and far (as after Clipping) that no
  /// ClippingPlane cuts away; near > far: none.
  Depths seen(const Line& line, double near, double far) const;
  bool hasPlanes() const { return planeCount_ > 0; }

 private:
  bool perspective_ = true;
  // Raster to camera space at z = 1 (perspective) or any z: position = raster * scale + offset.
  double scaleX_ = 1, scaleY_ = 1, offsetX_ = 0, offsetY_ = 0;
  double lensRadius_ = 0, focalDistance_ = 1;
  uint32_t planeCount_ = 0;
  float planes_[cache::kMaxClippingPlanes][4] = {};
};

}  // namespace fr
