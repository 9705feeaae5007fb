#include "scene_cache/frame_records.h"

#include <algorithm>
#include <cmath>

#include "ri/camera.h"
#include "scene_cache/skeleton_check.h"

namespace fr::cache {
namespace {

/// A number of the RI as a float inside a range; not finite: `otherwise`.
float clampedFloat(double x, double low, double high, double otherwise) {
  return float(std::isfinite(x) ? std::clamp(x, low, high) : otherwise);
}
constexpr double kLargest = kRiInfinity;

CameraRecord cameraRecord(const ri::Camera& c, const ri::Options& o, TransformId worldToCamera) {
  CameraRecord r{};
  r.worldToCamera = worldToCamera;
  r.projection = c.perspective ? ProjectionType::kPerspective : ProjectionType::kOrthographic;
  r.fov = clampedFloat(c.fov, 1e-3, 179.999, 90);
  for (size_t i = 0; i < 4; ++i) {
    r.screenWindow[i] = clampedFloat(c.screenWindow[i], -kLargest, kLargest, i % 2 ? 1 : -1);
    r.cropWindow[i] = clampedFloat(o.cropWindow[i], 0, 1, double(i % 2));
  }
  if (c.xres > kMaxResolution || c.yres > kMaxResolution)
    report(makeError(RiError::kLimit, "an image of {} x {} pixels; sides are limited to {}", c.xres, c.yres,
                     kMaxResolution));
  r.resolution[0] = std::clamp(c.xres, 1, kMaxResolution);
  r.resolution[1] = std::clamp(c.yres, 1, kMaxResolution);
  r.pixelAspect = clampedFloat(c.pixelAspect, 1e-6, 1e6, 1);
  r.frameAspect = clampedFloat(c.frameAspect, 1e-6, 1e6, 1);
  r.cropPixels[0] = std::clamp(c.crop.x0, 0, r.resolution[0] - 1);
  r.cropPixels[1] = std::clamp(c.crop.x1 - 1, -1, r.resolution[0] - 1);
  r.cropPixels[2] = std::clamp(c.crop.y0, 0, r.resolution[1] - 1);
  r.cropPixels[3] = std::clamp(c.crop.y1 - 1, -1, r.resolution[1] - 1);
  r.clipping[0] = clampedFloat(c.near, 0, kLargest, 1e-10);
  r.clipping[1] = clampedFloat(c.far, 0, kLargest, kLargest);
  r.shutter[0] = clampedFloat(c.shutterOpen, -kLargest, kLargest, 0);
  r.shutter[1] = clampedFloat(c.shutterClose, -kLargest, kLargest, 0);
  r.dof[0] = c.depthOfField ? clampedFloat(c.fstop, 0, kLargest, kLargest) : kRiInfinity;
  r.dof[1] = clampedFloat(c.focalLength, 0, kLargest, 0);
  r.dof[2] = clampedFloat(c.focalDistance, 0, kLargest, 1);
  return r;
}

/// The planes as the camera sees them at shutter open.
void addClippingPlanes(const ri::Options& o, const ri::TransformPtr& worldToCamera,
                       const AttributeRecords& records, CameraRecord* r) {
  for (const ri::ClippingPlane& plane : o.clippingPlanes) {
    if (r->clippingPlaneCount == kMaxClippingPlanes)
      return report(makeError(RiError::kLimit, "{} clipping planes; no more than {} cut anything away",
                              o.clippingPlanes.size(), kMaxClippingPlanes));
    auto toWorld = records.toWorld(plane.space);
    if (!toWorld) {
      report(std::move(toWorld).error().context("ClippingPlane"));
      continue;
    }
    DMat4 toCamera = (**toWorld).matrices.front();
    if (worldToCamera) toCamera = worldToCamera->matrices.front() * toCamera;
    const DVec3 normal = glm::transpose(glm::inverse(DMat3(toCamera))) * plane.normal;
    const double length = glm::length(normal);
    const double distance = glm::dot(normal, DVec3(toCamera * DVec4(plane.point, 1))) / length;
    if (!(length > 0) || !std::isfinite(length) || !(std::abs(distance) < kLargest)) {
      report(makeError(RiError::kMath, "ClippingPlane: no plane in camera space; ignored"));
      continue;
    }
    float* out = r->clippingPlanes[r->clippingPlaneCount++];
    for (int k = 0; k < 3; ++k) out[k] = float(normal[k] / length);
    out[3] = float(distance);
  }
}

void setQuantize(const ri::QuantizeState& q, float out[4]) {
  out[0] = float(q.one), out[1] = float(q.min), out[2] = float(q.max), out[3] = q.dither;
}

/// "varying color foo" of DisplayChannel, by the name of the channel.
const ri::DisplayRequest* findChannel(const ri::Options& o, std::string_view name) {
  for (const ri::DisplayRequest& c : o.channels)
    if (const auto t = ri::parseToken(c.name); t && t->name == name) return &c;
  return nullptr;
}

/// The mode with the declarations of its channels put in; what channels say about quantisation, exposure and
/// filter holds for the display unless it says so itself (the first channel that does, where they differ).
void applyChannels(const ri::Options& o, ri::DisplayRequest* d) {
  std::string mode;
  for (size_t begin = 0; begin <= d->mode.size();) {
    const size_t end = std::min(d->mode.find_first_of(",+", begin), d->mode.size());
    std::string item = d->mode.substr(begin, end - begin);
    const size_t first = item.find_first_not_of(" \t"), last = item.find_last_not_of(" \t");
    item = first == std::string::npos ? "" : item.substr(first, last - first + 1);
    begin = end + 1;
    if (item.empty()) continue;
    if (const ri::DisplayRequest* c = findChannel(o, item)) {
      for (const char* name : {"quantize", "dither", "exposure", "filter"})
        if (const ri::Param* p = c->params.find(name); p && !d->params.has(name)) d->params.set(*p);
      if (const auto t = ri::parseToken(c->name); t && t->declaration) {
        ri::Declaration plain = *t->declaration;
        item = fmt::format("{}{} {}", ri::valueTypeName(plain.type),
                           plain.isArray ? fmt::format("[{}]", plain.arrayLength) : "", t->name);
      }
    }
    if (!mode.empty()) mode += ',';
    mode += item;
  }
  d->mode = std::move(mode);
}

const ri::QuantizeState& quantizeOf(const ri::DisplayRequest& d, const ri::Options& o) {
  if (d.mode == "z") return o.quantizeDepth;
  const auto named = o.quantizeOther.find(std::string_view(d.mode).substr(d.mode.rfind(' ') + 1));
  return named == o.quantizeOther.end() ? o.quantizeColor : named->second;
}

DisplayRecord displayRecord(ri::DisplayRequest d, const ri::Options& o, SkeletonWriter& w) {
  applyChannels(o, &d);
  DisplayRecord r{};
  r.name = w.intern(d.name);
  r.type = w.intern(d.type);
  r.mode = w.intern(d.mode);
  r.params = w.addParams(d.params);
  setQuantize(quantizeOf(d, o), r.quantize);
  // PRMan's per-display parameters: "quantize" is zero one min max.
  if (const ri::Param* q = d.params.find("quantize"); q && q->elementCount() >= 4)
    for (size_t i = 0; i < 3; ++i) r.quantize[i] = ri::toFloat(*q, r.quantize[i], i + 1);
  r.quantize[3] = d.params.getFloat("dither", r.quantize[3]);
  r.exposure[0] = float(o.gain), r.exposure[1] = float(o.gamma);
  if (const ri::Param* e = d.params.find("exposure"); e && e->elementCount() >= 2)
    for (size_t i = 0; i < 2; ++i) r.exposure[i] = ri::toFloat(*e, r.exposure[i], i);
  return r;
}

int rayLevels(const ri::Options& o, int otherwise) {
  return std::clamp(o.values.getInt("trace:maxdepth", o.values.getInt("render:max_raylevel", otherwise)), 0,
                    1000);
}

constexpr const char* kPathCategories[] = {"shader", "texture", "archive", "procedural", "display"};

StringId joinedPath(const ri::Options& o, const char* category, SkeletonWriter& w) {
  const auto it = o.searchPaths.find(category);
  if (it == o.searchPaths.end()) return 0;
  std::string all;
  for (const std::string& folder : it->second) {
    if (!all.empty()) all += ':';
    all += folder;
  }
  return w.intern(all);
}

}  // namespace

ri::Options overridden(ri::Options o, const FrameOverrides& with, const FrameDefaults& otherwise) {
  if (otherwise.resolution && !o.resolution) o.resolution = otherwise.resolution;
  if (otherwise.pixelSamples && !o.pixelSamplesGiven) {
    o.pixelSamples = *otherwise.pixelSamples;
    o.pixelSamplesGiven = true;
  }
  for (const std::string& folder : with.shaderFolders) o.searchPaths["shader"].push_back(folder);
  for (const std::string& folder : with.textureFolders) o.searchPaths["texture"].push_back(folder);
  if (with.resolution) {
    // A new resolution with the RIB's shape of the frame would shrink the image the user asked for.
    o.resolution = with.resolution;
    o.frameAspect.reset();
  }
  if (with.crop) o.cropWindow = *with.crop;
  if (with.pixelSamples) {
    o.pixelSamples = *with.pixelSamples;
    o.pixelSamplesGiven = true;
  }
  if (!with.displays.empty()) {
    std::erase_if(o.displays, [](const ri::DisplayRequest& d) {
      return d.type != "zfile" && d.type != "shadow" && d.type != "deepshad" && d.type != "z";
    });
    for (const DisplayOverride& d : with.displays) o.displays.push_back({d.name, d.type, d.mode, {}});
  }
  if (o.displays.empty() && otherwise.display) {
    const DisplayOverride& d = *otherwise.display;
    o.displays.push_back({d.name, d.type, d.mode, {}});
    reportOnce("no display", {RiError::kNone,
                              Severity::kInfo,
                              {},
                              fmt::format("the scene has no Display: the picture goes to {}", d.name)});
  }
  return o;
}

void writeFrameRecords(const ri::Options& o, const ri::TransformPtr& worldToCamera, int frameNumber,
                       AttributeRecords& records, SkeletonWriter* writer) {
  SkeletonWriter& w = *writer;
  if (o.screenTransform && *o.screenTransform != ri::Transform())
    reportOnce("screen transform", {RiError::kUnimplemented,
                                    Severity::kWarning,
                                    {},
                                    "transformations before Projection are not implemented; ignored"});
  const ri::Param* const given = o.values.find("trace:levels");
  if (const std::string levels = given ? given->strings.empty() ? "a number" : given->strings[0] : "auto";
      levels != "auto" && levels != "on" && levels != "off")
    reportOnce(
        "trace levels",
        {RiError::kRange,
         Severity::kWarning,
         {},
         fmt::format(
             "Option \"trace\" \"levels\" is \"auto\", \"on\" or \"off\", not \"{}\"; taken as \"auto\"",
             levels)});
  const ri::Camera c = ri::makeCamera(o, worldToCamera);
  CameraRecord camera = cameraRecord(c, o, records.transform(worldToCamera));
  addClippingPlanes(o, worldToCamera, records, &camera);
  w.setCamera(camera);
  const DVec3 origin = chooseCacheOrigin(worldToCamera ? worldToCamera->matrices.front() : DMat4(1), c.near);
  w.setCacheOrigin(origin);

  OptionsRecord r{};
  for (size_t i = 0; i < 2; ++i) {
    if (o.pixelSamples[i] > kMaxPixelSamples || o.filterWidth[i] > kMaxFilterWidth)
      reportOnce("too many samples",
                 makeError(RiError::kLimit,
                           "PixelSamples are limited to {} a side of a pixel, PixelFilter to {} pixels",
                           kMaxPixelSamples, kMaxFilterWidth));
    r.pixelSamples[i] = clampedFloat(o.pixelSamples[i], 1, kMaxPixelSamples, 2);
    r.filterWidth[i] = clampedFloat(o.filterWidth[i], 1e-3, kMaxFilterWidth, 2);
  }
  r.filter = w.intern(ri::filterName(o.filter));
  r.exposure[0] = clampedFloat(o.gain, -kLargest, kLargest, 1);
  r.exposure[1] = clampedFloat(o.gamma, -kLargest, kLargest, 1);
  setQuantize(o.quantizeColor, r.quantizeRgba);
  setQuantize(o.quantizeDepth, r.quantizeZ);
  r.pixelVariance = clampedFloat(o.pixelVariance.value_or(0), 0, kLargest, 0);
  r.hider = w.intern(o.hider);
  r.hiderParams = w.addParams(o.hiderParams);
  r.imager = records.shader(o.imager);
  std::vector<DisplayRecord> displays;
  displays.reserve(o.displays.size());
  for (const ri::DisplayRequest& d : o.displays) displays.push_back(displayRecord(d, o, w));
  r.displays = w.addDisplays(displays);
  std::vector<ParamRecord> params;
  params.reserve(o.values.all().size());
  for (const auto& [name, p] : o.values.all()) params.push_back(w.makeParam(p, name));
  r.options = w.addParams(params);
  r.maxRayLevel = rayLevels(o, 4);
  r.frameNumber = frameNumber;
  w.setOptions(r);

  std::vector<StringId> paths;
  for (const char* category : kPathCategories) paths.push_back(joinedPath(o, category, w));
  w.setSearchPaths(paths);
}

void mergeTracerOptions(const ri::Options& tracer, SkeletonWriter* writer) {
  SkeletonWriter& w = *writer;
  OptionsRecord r = w.options();
  r.maxRayLevel = rayLevels(tracer, r.maxRayLevel);
  const auto known = w.params(r.options);
  std::vector<ParamRecord> params(known.begin(), known.end());
  const size_t own = params.size();
  for (const auto& [name, p] : tracer.values.all()) {
    const StringId id = w.intern(name);
    if (std::none_of(params.begin(), params.begin() + ptrdiff_t(own),
                     [&](const ParamRecord& k) { return k.name == id; }))
      params.push_back(w.makeParam(p, name));
  }
  r.options = w.addParams(params);
  w.setOptions(r);

  const auto given = w.searchPaths();
  std::vector<StringId> paths(given.begin(), given.end());
  for (size_t i = 0; i < paths.size() && i < std::size(kPathCategories); ++i) {
    const auto it = tracer.searchPaths.find(kPathCategories[i]);
    if (it == tracer.searchPaths.end()) continue;
    std::string all(w.string(paths[i]));
    for (const std::string& folder : it->second)
      if ((':' + all + ':').find(':' + folder + ':') == std::string::npos)
        all += (all.empty() ? "" : ":") + folder;
    paths[i] = w.intern(all);
  }
  w.setSearchPaths(paths);
}

DVec3 chooseCacheOrigin(const DMat4& worldToCamera, double nearClip) {
  const double det = glm::determinant(worldToCamera);
  if (!(std::abs(det) > 0) || !std::isfinite(det)) return DVec3(0);
  const DVec3 eye = transformPoint(glm::inverse(worldToCamera), DVec3(0));
  if (!std::isfinite(eye.x) || !std::isfinite(eye.y) || !std::isfinite(eye.z)) return DVec3(0);
  // An unset near plane (RI_EPSILON) says nothing about the scene's scale.
  double step = 64;
  if (nearClip > 1e-6 && nearClip < 1e6)
    step = std::exp2(std::clamp(std::ceil(std::log2(64 * nearClip)), -10.0, 20.0));
  // + 0.0: no negative zeros, which would differ in content from positive ones.
  const auto snapped = [&](double x) { return std::nearbyint(x / step) * step + 0.0; };
  return {snapped(eye.x), snapped(eye.y), snapped(eye.z)};
}

}  // namespace fr::cache
