#include "imaging/frame_request.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr {
namespace {

Quantizer quantizerOf(const float q[4]) { return {q[0], q[1], q[2], q[3]}; }

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

std::vector<DisplayRequest> frameDisplays(const cache::Skeleton& skeleton) {
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
      r.parameters.push_back(std::move(q));
    }
    all.push_back(std::move(r));
  }
  return all;
}

std::vector<std::string> frameDisplaySearchPath(const cache::Skeleton& skeleton) {
  constexpr size_t kDisplayPath = 4;
  const auto lists = skeleton.searchPaths();
  std::vector<std::string> paths;
  if (lists.size() > kDisplayPath) paths.emplace_back(skeleton.string(lists[kDisplayPath]));
  return displaySearchPath(paths);
}

}  // namespace fr
