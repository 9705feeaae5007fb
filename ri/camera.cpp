#include "ri/camera.h"

#include <algorithm>
#include <cmath>

namespace fr::ri {
namespace {

constexpr int kMostPixels = 1 << 18;  // along one side

int cropEdge(double position, double offset, int res) {
  const double p = std::ceil(double(res) * position + offset);
  return int(std::clamp(p, 0.0, double(res - 1)));
}

}  // namespace

PixelRect cropPixels(const std::array<double, 4>& w, int xres, int yres) {
  PixelRect r;
  r.x0 = cropEdge(w[0], 0, xres);
  r.x1 = cropEdge(w[1], -1, xres) + 1;
  r.y0 = cropEdge(w[2], 0, yres);
  r.y1 = cropEdge(w[3], -1, yres) + 1;
  r.x1 = std::max(r.x1, r.x0);
  r.y1 = std::max(r.y1, r.y0);
  return r;
}

Camera makeCamera(const Options& o, TransformPtr worldToCamera, int defaultX, int defaultY) {
  Camera c;
  c.xres = o.resolution && (*o.resolution)[0] > 0 ? (*o.resolution)[0] : defaultX;
  c.yres = o.resolution && (*o.resolution)[1] > 0 ? (*o.resolution)[1] : defaultY;
  c.pixelAspect = o.pixelAspect > 0 ? o.pixelAspect : 1;
  const double formatAspect = c.xres * c.pixelAspect / c.yres;
  c.frameAspect = o.frameAspect.value_or(formatAspect);
  // The image keeps to the format and shrinks to the frame's shape (RISpec 3.2, "FrameAspectRatio").
  if (c.frameAspect > formatAspect) {
    c.yres = int(std::lround(c.xres * c.pixelAspect / c.frameAspect));
  } else if (c.frameAspect < formatAspect) {
    c.xres = int(std::lround(c.yres * c.frameAspect / c.pixelAspect));
  }
  c.xres = std::clamp(c.xres, 1, kMostPixels);
  c.yres = std::clamp(c.yres, 1, kMostPixels);
  const double a = c.frameAspect;
  c.screenWindow = o.screenWindow.value_or(a >= 1 ? std::array<double, 4>{-a, a, -1, 1}
                                                  : std::array<double, 4>{-1, 1, -1 / a, 1 / a});
  c.crop = cropPixels(o.cropWindow, c.xres, c.yres);
  c.near = o.near;
  c.far = o.far;

  const double depth = c.far - c.near;
  DMat4 projection(1);
  bool perspective = o.projection == "perspective";
  const bool known =
      perspective || o.projection == "orthographic" || o.projection.empty() || o.projection == "null";
  if (!known) {
    perspective = o.projectionParams.find("fov") != nullptr;
    reportWarning(RiError::kUnimplemented, "Projection \"{}\" is not known; {} is used", o.projection,
                  perspective ? "perspective" : "orthographic");
  }
  if (perspective) {
    c.perspective = true;
    c.fov = o.projectionParams.getFloat("fov", 90);
    if (!(c.fov > 0 && c.fov < 180)) {
      reportWarning(RiError::kRange, "Projection: fov {} is replaced by 90", c.fov);
      c.fov = 90;
    }
    const double scale = 1 / std::tan(c.fov * 3.14159265358979323846 / 360);
    projection = DMat4(0);
    projection[0][0] = projection[1][1] = scale;
    projection[2][2] = c.far / depth;
    projection[2][3] = 1;
    projection[3][2] = -c.far * c.near / depth;
  } else {
    projection[2][2] = 1 / depth;
    projection[3][2] = -c.near / depth;
  }
  c.cameraToScreen = (o.screenTransform ? o.screenTransform->matrices.front() : DMat4(1)) * projection;

  const auto [left, right, bottom, top] = c.screenWindow;
  DMat4 raster(1);
  raster[0][0] = c.xres / (right - left);
  raster[1][1] = c.yres / (bottom - top);
  raster[3][0] = -left * raster[0][0];
  raster[3][1] = -top * raster[1][1];
  c.screenToRaster = raster;
  c.cameraToRaster = raster * c.cameraToScreen;

  c.worldToCamera = std::move(worldToCamera);
  c.fstop = o.fstop;
  c.focalLength = o.focalLength;
  c.focalDistance = o.focalDistance;
  c.depthOfField = c.perspective && o.fstop < 1e37 && o.focalLength > 0;
  c.shutterOpen = o.shutterOpen;
  c.shutterClose = o.shutterClose;
  return c;
}

}  // namespace fr::ri
