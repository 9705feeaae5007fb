#include "imaging/frame_request.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>

#include "scene_cache/primitive_source.h"
#include "scene_cache/surface.h"

namespace fr {
namespace {

constexpr int kDefaultBucketSize = 32;
/// Buckets are made smaller when they would hold more samples than this: the buffers of a bucket should stay
/// in the cache.
constexpr long long kMostSamplesPerBucket = 1 << 16;
constexpr int kSmallestBucket = 8;
constexpr float kMostSamples = 128;  // per axis

Quantizer quantizerOf(const float q[4]) { return {q[0], q[1], q[2], q[3]}; }

/// "filter" of a display: those that choose among a pixel's own samples hold for its shader variables.
ChannelRule ruleOf(std::string_view filter) {
  if (filter == "min" || filter == "zmin") return ChannelRule::kMinimum;
  if (filter == "max" || filter == "zmax") return ChannelRule::kMaximum;
  if (filter == "average") return ChannelRule::kAverage;
  reportOnce(
      "display filter",
      Error{RiError::kUnimplemented,
            Severity::kWarning,
            {},
            fmt::format("filter \"{}\" of a display alone: all are filtered by PixelFilter; only \"min\", "
                        "\"max\" and \"average\" can be chosen for variables",
                        filter)});
  return ChannelRule::kFiltered;
}

DisplayParameter matrixParameter(const char* name, const DMat4& m) {
  std::vector<float> values;
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) values.push_back(float(m[i][j]));
  return {name, std::move(values)};
}

/// Camera space to the unit screen: x and y in [-1, 1] over the screen window, z from 0 (near) to 1 (far).
DMat4 cameraToScreen(const cache::CameraRecord& c) {
  const bool perspective = c.projection == cache::ProjectionType::kPerspective;
  const double scale = perspective ? 1 / std::tan(double(c.fov) * std::numbers::pi / 360) : 1.0;
  const double l = c.screenWindow[0], r = c.screenWindow[1], b = c.screenWindow[2], t = c.screenWindow[3];
  const double n = c.clipping[0], f = c.clipping[1];
  DMat4 m(0.0);
  m[0][0] = 2 * scale / (r - l);
  m[1][1] = 2 * scale / (t - b);
  const int w = perspective ? 2 : 3;
  m[w][0] = -(r + l) / (r - l);
  m[w][1] = -(t + b) / (t - b);
  m[w][3] = 1;
  m[2][2] = perspective ? f / (f - n) : 1 / (f - n);
  m[3][2] = perspective ? -f * n / (f - n) : -n / (f - n);
  return m;
}

int cameraKeyCount(const cache::Skeleton& skeleton) {
  const auto transforms = skeleton.transforms();
  const cache::TransformId id = skeleton.camera().worldToCamera;
  if (id >= transforms.size()) return 1;
  return cache::gridKeyCount({}, cache::sourceArray<DMat4>(skeleton, transforms[id].matrices),
                             cache::sourceArray<float>(skeleton, transforms[id].times),
                             skeleton.camera().shutter);
}

}  // namespace

FrameGeometry frameGeometry(const cache::Skeleton& skeleton) {
  const cache::CameraRecord& c = skeleton.camera();
  FrameGeometry g;
  g.fullWidth = c.resolution[0], g.fullHeight = c.resolution[1];
  g.crop = {c.cropPixels[0], c.cropPixels[2], c.cropPixels[1] + 1, c.cropPixels[3] + 1};
  g.pixelAspect = c.pixelAspect;
  const DMat4 worldToCamera = skeleton.worldToCamera(c.shutter[0]);
  g.metadata.push_back(matrixParameter("worldtocamera", worldToCamera));
  g.metadata.push_back(matrixParameter("worldtoscreen", cameraToScreen(c) * worldToCamera));
  g.metadata.push_back({"software", std::vector<std::string>{"frankenrender"}});
  return g;
}

PixelFilter framePixelFilter(const cache::Skeleton& skeleton) {
  const cache::OptionsRecord& o = skeleton.options();
  const std::string_view name = skeleton.string(o.filter);
  if (name.empty()) return PixelFilter(FilterKind::kGaussian, o.filterWidth[0], o.filterWidth[1]);
  auto filter = PixelFilter::byName(name, o.filterWidth[0], o.filterWidth[1]);
  if (filter) return *filter;
  report(filter.error());
  return PixelFilter(FilterKind::kGaussian, 2, 2);
}

int frameBucketSize(const cache::Skeleton& skeleton, int asked, int samplesPerPixel) {
  int size = asked;
  if (size <= 0) {
    const cache::ParamRecord* p = skeleton.find(skeleton.options().options, "limits:bucketsize");
    size = kDefaultBucketSize;
    if (p)
      if (const auto values = skeleton.integers(*p); !values.empty() && values[0] > 0) size = values[0];
  }
  size = std::clamp(size, 1, 512);
  while (size > kSmallestBucket &&
         static_cast<long long>(size) * size * samplesPerPixel > kMostSamplesPerBucket)
    size /= 2;
  return size;
}

float frameFloatOption(const cache::Skeleton& skeleton, cache::Slice list, const char* name,
                       float otherwise) {
  const cache::ParamRecord* p = skeleton.find(list, name);
  if (!p) return otherwise;
  if (const auto f = skeleton.floats(*p); !f.empty()) return f[0];
  if (const auto i = skeleton.integers(*p); !i.empty()) return float(i[0]);
  return otherwise;
}

SamplePattern frameSamplePattern(const cache::Skeleton& skeleton, uint32_t seed) {
  const cache::OptionsRecord& o = skeleton.options();
  const auto axis = [](float n) {
    return std::isfinite(n) ? int(std::lround(std::clamp(n, 1.0f, kMostSamples))) : 2;
  };
  float jitter = 1;
  for (const char* name : {"jitter", "hider:jitter"})
    jitter = frameFloatOption(skeleton, o.hiderParams, name, jitter);
  const SampleDimensions dimensions{frameMoves(skeleton), frameLens(skeleton).radius > 0};
  return SamplePattern(axis(o.pixelSamples[0]), axis(o.pixelSamples[1]), jitter != 0, seed, dimensions);
}

bool frameMoves(const cache::Skeleton& skeleton) {
  if (cameraKeyCount(skeleton) > 1) return true;
  const auto objects = skeleton.objects();
  return std::any_of(objects.begin(), objects.end(),
                     [](const cache::ObjectRecord& o) { return o.keyCount > 1; });
}

std::vector<DMat4> frameCameraKeys(const cache::Skeleton& skeleton) {
  const float* shutter = skeleton.camera().shutter;
  const int count = cameraKeyCount(skeleton);
  std::vector<DMat4> keys;
  for (int k = 0; k < count; ++k)
    keys.push_back(skeleton.cacheToCamera(cache::gridKeyTime(k, count, shutter)));
  return keys;
}

FrameLens frameLens(const cache::Skeleton& skeleton) {
  const float* dof = skeleton.camera().dof;
  FrameLens lens;
  if (!(dof[0] < 1e30f) || !(dof[1] > 0)) return lens;
  if (!(dof[0] > 0) || !(dof[2] > 0)) {
    reportOnce("lens", makeError(RiError::kRange,
                                 "DepthOfField {} {} {}: f-stop and focal distance have to be positive; "
                                 "everything is sharp",
                                 dof[0], dof[1], dof[2]));
    return lens;
  }
  lens.radius = 0.5 * double(dof[1]) / double(dof[0]);
  lens.focalDistance = dof[2];
  return lens;
}

std::vector<DisplayRequest> frameDisplays(const cache::Skeleton& skeleton, const std::string& picture) {
  const cache::OptionsRecord& o = skeleton.options();
  std::vector<DisplayRequest> all;
  for (const cache::DisplayRecord& d : skeleton.displays(o.displays)) {
    DisplayRequest r;
    r.name = skeleton.string(d.name), r.type = skeleton.string(d.type), r.mode = skeleton.string(d.mode);
    r.quantizer = quantizerOf(d.quantize);
    r.depthQuantizer = quantizerOf(o.quantizeZ);
    r.exposure = {d.exposure[0], d.exposure[1]};
    for (const cache::ParamRecord& p : skeleton.params(d.params)) {
      DisplayParameter q{std::string(skeleton.string(p.name)), {}};
      if (p.type == cache::ParamType::kString) {
        std::vector<std::string> values;
        for (cache::StringId s : skeleton.strings(p)) values.emplace_back(skeleton.string(s));
        q.values = std::move(values);
      } else if (p.type == cache::ParamType::kInteger) {
        const auto v = skeleton.integers(p);
        q.values = std::vector<int32_t>(v.begin(), v.end());
      } else {
        const auto v = skeleton.floats(p);
        q.values = std::vector<float>(v.begin(), v.end());
      }
      if (const auto* s = std::get_if<std::vector<std::string>>(&q.values);
          s && q.name == "filter" && !s->empty())
        r.rule = ruleOf(s->front());
      r.parameters.push_back(std::move(q));
    }
    all.push_back(std::move(r));
  }
  if (picture.empty()) return all;
  std::erase_if(all, [](const DisplayRequest& d) { return !isDepthDisplay(d.type); });
  DisplayRequest r;
  r.name = picture, r.type = "file", r.mode = "rgba";
  r.quantizer = quantizerOf(o.quantizeRgba);
  r.depthQuantizer = quantizerOf(o.quantizeZ);
  r.exposure = {o.exposure[0], o.exposure[1]};
  all.push_back(std::move(r));
  return all;
}

DepthFilter frameDepthFilter(const cache::Skeleton& skeleton) {
  DepthFilter f;
  for (const char* name : {"depthfilter", "hider:depthfilter"}) {
    const cache::ParamRecord* p = skeleton.find(skeleton.options().hiderParams, name);
    if (!p || p->type != cache::ParamType::kString || skeleton.strings(*p).empty()) continue;
    const std::string_view filter = skeleton.string(skeleton.strings(*p)[0]);
    f.midpoint = filter == "midpoint";
    f.rule = filter == "max"       ? ChannelRule::kMaximum
             : filter == "average" ? ChannelRule::kAverage
                                   : ChannelRule::kMinimum;
    if (filter != "min" && filter != "max" && filter != "average" && filter != "midpoint")
      reportOnce("depthfilter",
                 Error{RiError::kBadToken,
                       Severity::kWarning,
                       {},
                       fmt::format("depth filter \"{}\" is unknown; \"min\" is used", filter)});
  }
  return f;
}

void dropExistingDisplays(std::vector<DisplayRequest>& displays, const std::vector<std::string>& searchPath) {
  std::erase_if(displays, [&](const DisplayRequest& d) {
    const std::string path = resolveDisplayType(d.type, d.name, searchPath).path;
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(path, ignored)) return false;
    report(Error{RiError::kNone, Severity::kInfo, {}, fmt::format("{} exists and is kept", path)});
    return true;
  });
}

std::vector<std::string> frameDisplaySearchPath(const cache::Skeleton& skeleton) {
  constexpr size_t kDisplayPath = 4;
  const auto lists = skeleton.searchPaths();
  std::vector<std::string> paths;
  if (lists.size() > kDisplayPath) paths.emplace_back(skeleton.string(lists[kDisplayPath]));
  return displaySearchPath(paths);
}

}  // namespace fr
