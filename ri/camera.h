// From options to the numbers of a camera (RISpec 3.2, sections 4.1 and 4.2).
#pragma once

#include <array>

#include "base/error.h"
#include "base/math.h"
#include "ri/graphics_state.h"

namespace fr::ri {

/// Pixels x0 <= x < x1, y0 <= y < y1; y downwards.
struct PixelRect {
  int x0 = 0, x1 = 0, y0 = 0, y1 = 0;
  int width() const { return x1 - x0; }
  int height() const { return y1 - y0; }
};

struct Camera {
  int xres = 640, yres = 480;  ///< after FrameAspectRatio has shrunk the image
  double pixelAspect = 1, frameAspect = 4.0 / 3.0;
  std::array<double, 4> screenWindow{};  ///< left right bottom top
  PixelRect crop;                        ///< pixels to be rendered
  bool perspective = false;
  double fov = 90;  ///< degrees, between screen -1 and 1
  double near = 1e-10, far = 1e38;
  /// Still part of the projection: camera to screen, the near plane at depth 0 and the far plane at 1.
  DMat4 cameraToScreen{1}, screenToRaster{1}, cameraToRaster{1};
  TransformPtr worldToCamera;  ///< with the keys of a moving camera
  bool depthOfField = false;
  double fstop = 1e38, focalLength = 0, focalDistance = 1;
  double shutterOpen = 0, shutterClose = 0;
};

/// CropWindow's rule: pixels from clamp(ceil(res*min)) to clamp(ceil(res*max - 1)), so that crops that share
/// a side share no pixel and leave none out.
PixelRect cropPixels(const std::array<double, 4>& window, int xres, int yres);

/// Values that make no sense are replaced by the defaults and reported. `defaultX`, `defaultY` hold when
/// Format left the resolution to the device.
Camera makeCamera(const Options& o, TransformPtr worldToCamera, int defaultX = 640, int defaultY = 480);

}  // namespace fr::ri
