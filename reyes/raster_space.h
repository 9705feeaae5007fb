// From cache space to raster space: the camera of a frame.
//
// Depth is carried as a key that is linear in raster space and grows with distance: -1/z in perspective (z:
// camera space), z itself in orthographic projections. So keys can be interpolated and compared without a
// division.
#pragma once

#include <cstdint>

#include <vector>
#include "base/math.h"

#include "imaging/frame_request.h"
#include "imaging/pixel_rect.h"
#include "imaging/sample_pattern.h"
#include "scene_cache/cache.h"

namespace fr::reyes {

/// Raster positions beyond this many pixels are clipped away before they are snapped.
inline constexpr float kGuardBand = 30000.0f;

/// Conservative image of a box.
struct RasterBounds {
  float x0, y0, x1, y1;
  float key;             // not greater than any depth key in the box
  bool outside = false;  // nothing of it can be seen
  bool before = false;   // all of it lies before the near plane

  bool overlaps(const PixelRect& r) const {
    return x1 >= float(r.x0) && x0 <= float(r.x1) && y1 >= float(r.y0) && y0 <= float(r.y1);
  }
};

/// How far a place on the lens moves what is seen on the raster: linear in the depth key, zero in focus.
struct LensShift {
  float x0 = 0, x1 = 0, y0 = 0, y1 = 0;
  /// Pixels, for a lens position on the unit disk.
  float x(float lensX, float key) const { return lensX * (x0 + x1 * key); }
  float y(float lensY, float key) const { return lensY * (y0 + y1 * key); }
  bool any() const { return x0 != 0 || x1 != 0; }
};

/// Immutable; thread-safe.
class RasterSpace {
 public:
  RasterSpace() = default;
  /// The camera at one time.
  RasterSpace(const cache::CameraRecord& camera, const DMat4& cacheToCamera, const FrameLens& lens = {});

  bool perspective() const { return perspective_; }
  const Mat4& cacheToCamera() const { return cacheToCamera_; }
  /// Camera depths of the clipping planes.
  float near() const { return near_; }
  float far() const { return far_; }
  /// Keys below which (nearer) and from which (farther) nothing is visible.
  float farKey() const { return farKey_; }
  float key(float z) const { return perspective_ ? -1 / z : z; }
  float depth(float k) const { return perspective_ ? -1 / k : k; }

  /// (x w, y w, w, camera z) of a cache-space point, in pixels; w = z in perspective, 1 otherwise.
  Vec4 homogeneous(const Vec3& p) const {
    const Vec4 c = rasterFromCache_ * Vec4(p, 1.0f);
    return c;
  }
  /// Bounds of a cache-space box, grown by a margin for rounding. `outside`: before the near or behind the
  /// far plane. Of a box that reaches through the near plane, the part behind it. The whole lens is looked
  /// through.
  RasterBounds bounds(const Box3f& box) const;
  const LensShift& lens() const { return lens_; }

 private:
  friend class ShutterSpace;
  /// homogeneous() of some places, and how far rounding can have moved each component.
  struct Hull {
    Vec4 points[16];
    int count = 0;
    Vec4 slack{0};
  };
  void add(const Box3f& box, Hull& hull) const;
  /// Bounds of the convex hull.
  RasterBounds bounds(const Hull& hull) const;

  Mat4 cacheToCamera_{1.0f}, rasterFromCache_{1.0f};
  LensShift lens_;
  bool perspective_ = true;
  float near_ = 0, far_ = 0, farKey_ = 0;
};

/// The camera while the shutter is open. Immutable; thread-safe.
class ShutterSpace {
 public:
  ShutterSpace() = default;
  ShutterSpace(const cache::CameraRecord& camera, const std::vector<DMat4>& cacheToCamera,
               const FrameLens& lens);
  /// At equally spaced times; one when the camera stands still.
  const std::vector<RasterSpace>& keys() const { return keys_; }
  /// At shutter open, where everything is shaded.
  const RasterSpace& open() const { return keys_.front(); }
  /// Between the keys, as positions are blended: `time` 0 open ... 1 close.
  Vec4 homogeneous(const Vec3& p, float time) const;
  bool moves() const { return keys_.size() > 1; }
  bool blursAll() const { return moves() || open().lens().any(); }
  /// Bounds at all times.
  RasterBounds bounds(const Box3f& box) const;

 private:
  std::vector<RasterSpace> keys_{RasterSpace()};
};

}  // namespace fr::reyes
