// StateRenderer: options.
#include <algorithm>
#include <cmath>

#include "ri/search_path.h"
#include "ri/state_renderer.h"

namespace fr::ri {

std::vector<std::string> StateRenderer::searchPath(std::string_view category) const {
  const auto& paths = state_.options().searchPaths;
  const auto it = paths.find(category);
  return it == paths.end() ? std::vector<std::string>{} : it->second;
}

const Param* StateRenderer::variable(std::string_view name) const {
  if (name == "Frame") {
    frameVariable_ =
        Param{"Frame", {StorageClass::kUniform, ValueType::kInteger, 1, false}, {}, {state_.frame()}, {}};
    return &frameVariable_;
  }
  for (std::string_view prefix : {"Attribute:", "Option:"}) {
    if (name.starts_with(prefix)) {
      name.remove_prefix(prefix.size());
      return prefix[0] == 'A' ? state_.attributes().values.find(name) : state_.options().values.find(name);
    }
  }
  if (const Param* p = state_.attributes().values.find(name)) return p;
  if (const Param* p = state_.options().values.find(name)) return p;
  // Mosaic and others leave the category out.
  if (name.find(':') != std::string_view::npos) return nullptr;
  if (const Param* p = state_.attributes().values.find("user", name)) return p;
  return state_.options().values.find("user", name);
}

// Options are frozen while a world is read (RISpec 3.2, section 4).
bool StateRenderer::optionAllowed(const char* request) {
  if (!state_.inWorld()) return true;
  reportHere(RiError::kNotOptions, Severity::kError,
             fmt::format("{} inside a World block; ignored", request));
  return false;
}

void StateRenderer::format(int xres, int yres, double pixelAspect) {
  if (!optionAllowed("Format")) return;
  Options& o = state_.editOptions();
  o.resolution = {xres, yres};
  o.pixelAspect = pixelAspect > 0 && std::isfinite(pixelAspect) ? pixelAspect : 1;
}

void StateRenderer::frameAspectRatio(double aspect) {
  if (!optionAllowed("FrameAspectRatio")) return;
  if (!(aspect > 0) || !std::isfinite(aspect)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("FrameAspectRatio {}; ignored", aspect));
  }
  state_.editOptions().frameAspect = aspect;
}

void StateRenderer::screenWindow(double left, double right, double bottom, double top) {
  if (!optionAllowed("ScreenWindow")) return;
  const double w = right - left, h = top - bottom;
  if (!std::isfinite(w) || !std::isfinite(h) || w == 0 || h == 0) {
    return reportHere(RiError::kRange, Severity::kError, "ScreenWindow without an area; ignored");
  }
  state_.editOptions().screenWindow = {left, right, bottom, top};
}

void StateRenderer::cropWindow(double xmin, double xmax, double ymin, double ymax) {
  if (!optionAllowed("CropWindow")) return;
  const auto inside = [](double a, double b) { return a >= 0 && a < b && b <= 1; };
  if (!inside(xmin, xmax) || !inside(ymin, ymax)) {
    reportHere(RiError::kRange, Severity::kWarning,
               fmt::format("CropWindow {} {} {} {} does not lie in 0..1", xmin, xmax, ymin, ymax));
    const auto fix = [](double& a, double& b) {
      a = a > 0 ? std::min(a, 1.0) : 0;
      b = b < 1 ? std::max(b, 0.0) : 1;
      if (!(a < b)) a = 0, b = 1;
    };
    fix(xmin, xmax);
    fix(ymin, ymax);
  }
  state_.editOptions().cropWindow = {xmin, xmax, ymin, ymax};
}

void StateRenderer::projection(std::string name, ParamList params) {
  if (!optionAllowed("Projection")) return;
  const bool first = motionSample("Projection");
  if (motion_ && motion_->request == "Projection" && name == "perspective") {
    double fov = double(params.getFloat("fov", 90));
    if (!(fov > 0 && fov < 180)) {
      if (!first)  // of the first one makeCamera() says so
        reportHere(RiError::kRange, Severity::kWarning,
                   fmt::format("Projection: fov {} is replaced by 90", fov));
      fov = 90;
    }
    motion_->zooms.push_back(std::tan(fov * 3.14159265358979323846 / 360));
  }
  if (first) state_.setProjection(std::move(name), std::move(params));
}

void StateRenderer::clipping(double near, double far) {
  if (!optionAllowed("Clipping")) return;
  if (!(near < far) || !std::isfinite(near)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("Clipping {} {}; ignored", near, far));
  }
  Options& o = state_.editOptions();
  o.near = std::max(near, 1e-10);
  o.far = std::min(far, 1e38);
}

void StateRenderer::clippingPlane(DVec3 point, DVec3 normal) {
  if (!optionAllowed("ClippingPlane")) return;
  if (!(glm::length(normal) > 0)) {
    return reportHere(RiError::kRange, Severity::kError, "ClippingPlane without a normal; ignored");
  }
  state_.editOptions().clippingPlanes.push_back({point, normal, state_.place()});
}

void StateRenderer::depthOfField(double fstop, double focalLength, double focalDistance) {
  if (!optionAllowed("DepthOfField")) return;
  if (!(fstop > 0) || !(focalLength > 0) || !(focalDistance > 0)) {
    return reportHere(RiError::kRange, Severity::kError,
                      fmt::format("DepthOfField {} {} {}; ignored", fstop, focalLength, focalDistance));
  }
  Options& o = state_.editOptions();
  o.fstop = fstop;
  o.focalLength = focalLength;
  o.focalDistance = focalDistance;
}

void StateRenderer::depthOfField() {
  if (optionAllowed("DepthOfField")) state_.editOptions().fstop = 1e38;
}

void StateRenderer::shutter(double open, double close) {
  if (!optionAllowed("Shutter")) return;
  if (!(open <= close)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("Shutter {} {}; ignored", open, close));
  }
  state_.editOptions().shutterOpen = open;
  state_.editOptions().shutterClose = close;
}

void StateRenderer::camera(std::string name, ParamList /*params*/) {
  reportOnceHere(RiError::kUnimplemented, Severity::kWarning, "Camera only names the current space");
  state_.nameSpace(std::move(name), false);
}

void StateRenderer::pixelVariance(double variance) {
  if (optionAllowed("PixelVariance")) state_.editOptions().pixelVariance = std::max(variance, 0.0);
}

void StateRenderer::pixelSamples(double x, double y) {
  if (!optionAllowed("PixelSamples")) return;
  const auto clean = [](double v) { return v > 1 ? std::min(v, 1024.0) : 1.0; };
  state_.editOptions().pixelSamples = {clean(x), clean(y)};
  state_.editOptions().pixelSamplesGiven = true;
}

void StateRenderer::pixelFilter(std::string name, double xwidth, double ywidth) {
  if (!optionAllowed("PixelFilter")) return;
  const std::optional<FilterKind> f = filterFromName(name);
  if (!f)
    reportHere(RiError::kBadToken, Severity::kError, fmt::format("PixelFilter \"{}\" is not known", name));
  const auto good = [](double w) { return w > 0 && w <= 64; };
  if (!good(xwidth) || !good(ywidth)) {
    return reportHere(RiError::kRange, Severity::kError,
                      fmt::format("PixelFilter widths {} {}; ignored", xwidth, ywidth));
  }
  if (f) state_.editOptions().filter = *f;
  state_.editOptions().filterWidth = {xwidth, ywidth};
}

void StateRenderer::exposure(double gain, double gamma) {
  if (!optionAllowed("Exposure")) return;
  if (!(gamma > 0) || !std::isfinite(gain)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("Exposure {} {}; ignored", gain, gamma));
  }
  state_.editOptions().gain = gain;
  state_.editOptions().gamma = gamma;
}

void StateRenderer::quantize(std::string type, int one, int min, int max, double dither) {
  if (!optionAllowed("Quantize")) return;
  const QuantizeState q{one, min, max, float(dither)};
  if (type == "rgba") {
    state_.editOptions().quantizeColor = q;
  } else if (type == "z") {
    state_.editOptions().quantizeDepth = q;
  } else {
    state_.editOptions().quantizeOther[type] = q;  // a variable that displays show
  }
}

void StateRenderer::display(std::string name, std::string type, std::string mode, ParamList params) {
  if (!optionAllowed("Display")) return;
  std::vector<DisplayRequest>& all = state_.editOptions().displays;
  if (name.starts_with('+')) {
    name.erase(0, 1);
  } else {
    all.clear();
  }
  all.push_back({std::move(name), std::move(type), std::move(mode), std::move(params)});
}

void StateRenderer::displayChannel(std::string declaration, ParamList params) {
  if (!optionAllowed("DisplayChannel")) return;
  const Result<ParsedToken> t = parseToken(declaration);
  if (!t) return void(check(t.error()));
  std::vector<DisplayRequest>& all = state_.editOptions().channels;
  std::erase_if(all, [&](const DisplayRequest& c) {
    const Result<ParsedToken> other = parseToken(c.name);
    return other && other->name == t->name;
  });
  all.push_back({declaration, {}, {}, std::move(params)});
}

void StateRenderer::hider(std::string type, ParamList params) {
  if (!optionAllowed("Hider")) return;
  if (type != "hidden" && type != "stochastic" && type != "raytrace") {
    reportHere(RiError::kUnimplemented, Severity::kWarning,
               fmt::format("Hider \"{}\" is not there; the picture is rendered as by \"hidden\"", type));
  }
  state_.editOptions().hider = std::move(type);
  state_.editOptions().hiderParams = std::move(params);
}

void StateRenderer::colorSamples(std::vector<float> nRgb, std::vector<float> rgbN) {
  if (!optionAllowed("ColorSamples")) return;
  if (nRgb.empty() || nRgb.size() % 3 != 0 || rgbN.size() != nRgb.size()) {
    return reportHere(RiError::kConsistency, Severity::kError,
                      fmt::format("ColorSamples: {} and {} numbers are no pair of n by 3 matrices",
                                  nRgb.size(), rgbN.size()));
  }
  state_.editOptions().nRgb = std::move(nRgb);
  state_.editOptions().rgbN = std::move(rgbN);
}

void StateRenderer::relativeDetail(double detail) {
  if (!optionAllowed("RelativeDetail")) return;
  if (!(detail >= 0)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("RelativeDetail {}; ignored", detail));
  }
  state_.editOptions().relativeDetail = detail;
}

// Unlike the others allowed everywhere: exporters set search paths and user values inside the world.
void StateRenderer::option(std::string category, ParamList params) {
  Options& o = state_.editOptions();
  for (Param& p : params.params()) {
    if (category == "searchpath" && !p.strings.empty()) {
      const auto standard = standardPaths_.find(p.name);
      o.searchPaths[p.name] =
          parseSearchPath(p.strings[0], o.searchPaths[p.name],
                          standard == standardPaths_.end() ? std::vector<std::string>{} : standard->second);
    }
    o.values.set(category, std::move(p));
  }
}

}  // namespace fr::ri
