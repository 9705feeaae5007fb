// Options.
#include "libri/context.h"

using namespace fr;
using namespace fr::libri;
using ri::Renderer;

namespace {

/// A request that is a name and a parameter list.
template <class F>
void named(const char* request, std::string_view category, RtToken name, RtInt n, RtToken tokens[],
           RtPointer parms[], F&& f) {
  withContext(request,
              [&](Context& c) { f(c.out(), text(name), c.params(request, category, n, tokens, parms)); });
}

}  // namespace

extern "C" {

RtVoid RiFormat(RtInt x, RtInt y, RtFloat pixelaspect) {
  sendTracked("RiFormat", [&](Renderer& r) { r.format(x, y, decimal(pixelaspect)); });
}
RtVoid RiFrameAspectRatio(RtFloat aspect) {
  sendTracked("RiFrameAspectRatio", [&](Renderer& r) { r.frameAspectRatio(decimal(aspect)); });
}
RtVoid RiScreenWindow(RtFloat left, RtFloat right, RtFloat bottom, RtFloat top) {
  sendTracked("RiScreenWindow", [&](Renderer& r) {
    r.screenWindow(decimal(left), decimal(right), decimal(bottom), decimal(top));
  });
}
RtVoid RiCropWindow(RtFloat xmin, RtFloat xmax, RtFloat ymin, RtFloat ymax) {
  sendTracked("RiCropWindow",
              [&](Renderer& r) { r.cropWindow(decimal(xmin), decimal(xmax), decimal(ymin), decimal(ymax)); });
}
RtVoid RiProjectionV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  withContext("RiProjection", [&](Context& c) {
    const ri::ParamList p = c.params("RiProjection", "Projection", n, tokens, parms);
    sendTracked("RiProjection", [&](Renderer& r) { r.projection(text(name), p); });
  });
}
RtVoid RiProjection(RtToken name, ...) { FR_RI_LIST(name, RiProjectionV(name, FR_RI_TAIL)); }
RtVoid RiClipping(RtFloat hither, RtFloat yon) {
  sendTracked("RiClipping", [&](Renderer& r) { r.clipping(decimal(hither), decimal(yon)); });
}
RtVoid RiClippingPlane(RtFloat x, RtFloat y, RtFloat z, RtFloat nx, RtFloat ny, RtFloat nz) {
  send("RiClippingPlane", [&](Renderer& r) {
    r.clippingPlane({decimal(x), decimal(y), decimal(z)}, {decimal(nx), decimal(ny), decimal(nz)});
  });
}
RtVoid RiDepthOfField(RtFloat fstop, RtFloat focallength, RtFloat focaldistance) {
  send("RiDepthOfField", [&](Renderer& r) {
    if (fstop >= RI_INFINITY)
      r.depthOfField();
    else
      r.depthOfField(decimal(fstop), decimal(focallength), decimal(focaldistance));
  });
}
RtVoid RiShutter(RtFloat opentime, RtFloat closetime) {
  sendTracked("RiShutter", [&](Renderer& r) { r.shutter(decimal(opentime), decimal(closetime)); });
}
RtVoid RiCameraV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  withContext("RiCamera", [&](Context& c) {
    const ri::ParamList p = c.params("RiCamera", "Camera", n, tokens, parms);
    sendTracked("RiCamera", [&](Renderer& r) { r.camera(text(name), p); });
  });
}
RtVoid RiCamera(RtToken name, ...) { FR_RI_LIST(name, RiCameraV(name, FR_RI_TAIL)); }
RtVoid RiPixelVariance(RtFloat variation) {
  send("RiPixelVariance", [&](Renderer& r) { r.pixelVariance(decimal(variation)); });
}
RtVoid RiPixelSamples(RtFloat xsamples, RtFloat ysamples) {
  send("RiPixelSamples", [&](Renderer& r) { r.pixelSamples(decimal(xsamples), decimal(ysamples)); });
}
RtVoid RiPixelFilter(RtFilterFunc filterfunc, RtFloat xwidth, RtFloat ywidth) {
  send("RiPixelFilter", [&](Renderer& r) {
    r.pixelFilter(filterNameOf("RiPixelFilter", filterfunc), decimal(xwidth), decimal(ywidth));
  });
}
RtVoid RiExposure(RtFloat gain, RtFloat gamma) {
  send("RiExposure", [&](Renderer& r) { r.exposure(decimal(gain), decimal(gamma)); });
}
RtVoid RiImagerV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  named("RiImager", "Imager", name, n, tokens, parms, [](Renderer& r, std::string s, ri::ParamList p) {
    r.shader(ri::ShaderKind::kImager, std::move(s), std::move(p));
  });
}
RtVoid RiImager(RtToken name, ...) { FR_RI_LIST(name, RiImagerV(name, FR_RI_TAIL)); }
RtVoid RiQuantize(RtToken type, RtInt one, RtInt min, RtInt max, RtFloat amplitude) {
  send("RiQuantize", [&](Renderer& r) { r.quantize(text(type), one, min, max, decimal(amplitude)); });
}
RtVoid RiDisplayV(RtToken name, RtToken type, RtToken mode, RtInt n, RtToken tokens[], RtPointer parms[]) {
  named("RiDisplay", "Display", name, n, tokens, parms, [&](Renderer& r, std::string s, ri::ParamList p) {
    r.display(std::move(s), text(type), text(mode), std::move(p));
  });
}
RtVoid RiDisplay(RtToken name, RtToken type, RtToken mode, ...) {
  FR_RI_LIST(mode, RiDisplayV(name, type, mode, FR_RI_TAIL));
}
RtVoid RiDisplayChannelV(RtToken channel, RtInt n, RtToken tokens[], RtPointer parms[]) {
  named("RiDisplayChannel", "Display", channel, n, tokens, parms,
        [](Renderer& r, std::string s, ri::ParamList p) { r.displayChannel(std::move(s), std::move(p)); });
}
RtVoid RiDisplayChannel(RtToken channel, ...) { FR_RI_LIST(channel, RiDisplayChannelV(channel, FR_RI_TAIL)); }
RtVoid RiHiderV(RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]) {
  named("RiHider", "Hider", type, n, tokens, parms,
        [](Renderer& r, std::string s, ri::ParamList p) { r.hider(std::move(s), std::move(p)); });
}
RtVoid RiHider(RtToken type, ...) { FR_RI_LIST(type, RiHiderV(type, FR_RI_TAIL)); }
RtVoid RiColorSamples(RtInt n, RtFloat nRGB[], RtFloat RGBn[]) {
  sendTracked("RiColorSamples", [&](Renderer& r) {
    if (n < 1 || n > 1024 || !nRGB || !RGBn)
      return complain(RiError::kRange, Severity::kError, "RiColorSamples", fmt::format("{} samples", n));
    r.colorSamples({nRGB, nRGB + 3 * n}, {RGBn, RGBn + 3 * n});
  });
}
RtVoid RiRelativeDetail(RtFloat relativedetail) {
  send("RiRelativeDetail", [&](Renderer& r) { r.relativeDetail(decimal(relativedetail)); });
}

}  // extern "C"
