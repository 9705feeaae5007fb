#include "shading/textures/picture.h"

#include <OpenImageIO/filter.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>

namespace fr::textures {
namespace {

constexpr int64_t kMostPixels = int64_t(1) << 28;
constexpr int kMostChannels = 64;

struct FilterName {
  const char *ri, *oiio;
  float least;  // full support below which it is no such filter: negative lobes need their room
};
constexpr std::array<FilterName, 15> kFilters = {{{"", "box", 0},
                                                  {"box", "box", 0},
                                                  {"triangle", "triangle", 0},
                                                  {"bilinear", "triangle", 0},
                                                  {"gaussian", "gaussian", 0},
                                                  {"catmull-rom", "catmull-rom", 4},
                                                  {"separable-catmull-rom", "catmull-rom", 4},
                                                  {"sinc", "sinc", 4},
                                                  {"bessel", "sinc", 4},
                                                  {"mitchell", "mitchell", 4},
                                                  {"lanczos", "lanczos3", 6},
                                                  {"blackman-harris", "blackman-harris", 3},
                                                  {"bspline", "bspline", 4},
                                                  {"radial-bspline", "bspline", 4},
                                                  {"disk", "box", 0}}};

const FilterName* filterNamed(const std::string& name) {
  for (const FilterName& f : kFilters)
    if (name == f.ri) return &f;
  return nullptr;
}

struct DestroyFilter {
  void operator()(OIIO::Filter1D* f) const { OIIO::Filter1D::destroy(f); }
};

/// Where a line of `to` pixels gets its values from in a line of `from` pixels.
struct Weights {
  std::vector<int> first;   // of each target pixel: index into source, weight
  std::vector<int> source;  // -1: outside, black
  std::vector<float> weight;
};

Weights lineWeights(int from, int to, const std::string& name, float width, Wrap wrap) {
  const FilterName* const known = filterNamed(name);
  const char* const type = known ? known->oiio : "box";
  width = std::isfinite(width) ? std::clamp(width, 0.01f, 64.0f) : 1.0f;
  if (known) width = std::max(width, known->least);
  const std::unique_ptr<OIIO::Filter1D, DestroyFilter> filter(OIIO::Filter1D::create(type, width));
  const bool box = !filter || std::strcmp(type, "box") == 0;
  Weights w;
  const double scale = double(from) / double(to), unit = std::max(scale, 1.0), reach = 0.5 * width * unit;
  for (int i = 0; i < to; ++i) {
    w.first.push_back(int(w.source.size()));
    const double center = (double(i) + 0.5) * scale;
    const int lo = int(std::floor(center - reach)), hi = int(std::ceil(center + reach));
    double sum = 0;
    const size_t begin = w.weight.size();
    for (int k = lo; k < hi; ++k) {
      // A box counts what it covers of a pixel, so that halves of odd sizes are true means.
      const double value =
          box ? std::max(0.0, std::min(center + reach, double(k + 1)) - std::max(center - reach, double(k)))
              : double((*filter)(float((double(k) + 0.5 - center) / unit)));
      if (value == 0) continue;
      sum += value;
      int x = k;
      if (x < 0 || x >= from) {
        if (wrap == Wrap::kPeriodic)
          x = ((x % from) + from) % from;
        else
          x = std::clamp(x, 0, from - 1);
      }
      w.source.push_back(x);
      w.weight.push_back(float(value));
    }
    if (w.weight.size() == begin || std::fabs(sum) < 1e-12) {
      w.source.resize(begin), w.weight.resize(begin);
      w.source.push_back(std::clamp(int(center), 0, from - 1));
      w.weight.push_back(1);
      sum = 1;
    }
    for (size_t k = begin; k < w.weight.size(); ++k) w.weight[k] = float(double(w.weight[k]) / sum);
  }
  w.first.push_back(int(w.source.size()));
  return w;
}

bool takeMatrix(const OIIO::ImageSpec& spec, const char* name, float out[16]) {
  const OIIO::ParamValue* p = spec.find_attribute(name);
  if (!p || p->type().basetype != OIIO::TypeDesc::FLOAT ||
      p->type().numelements() * p->type().aggregate != 16)
    return false;
  std::memcpy(out, p->data(), 16 * sizeof(float));
  return std::all_of(out, out + 16, [](float x) { return std::isfinite(x); });
}

}  // namespace

bool takeCamera(const OIIO::ImageSpec& spec, float toCamera[16], float toScreen[16]) {
  // OpenEXR has a name of its own for the second one; the letters' case does not count.
  return takeMatrix(spec, "worldtocamera", toCamera) &&
         (takeMatrix(spec, "worldtoscreen", toScreen) || takeMatrix(spec, "worldtondc", toScreen));
}

bool wrapNamed(const std::string& name, Wrap* wrap) {
  if (name.empty() || name == "black")
    *wrap = Wrap::kBlack;
  else if (name == "clamp")
    *wrap = Wrap::kClamp;
  else if (name == "periodic")
    *wrap = Wrap::kPeriodic;
  else
    return false;
  return true;
}
const char* wrapName(Wrap wrap) {
  return wrap == Wrap::kPeriodic ? "periodic" : wrap == Wrap::kClamp ? "clamp" : "black";
}

bool filterKnown(const std::string& name) { return filterNamed(name) != nullptr; }

std::string readPicture(const std::string& path, float outside, Picture* out) {
  const auto in = OIIO::ImageInput::open(path);
  if (!in) {
    const std::string why = OIIO::geterror();
    return path + ": " + (why.empty() ? "cannot be read as an image" : why);
  }
  const OIIO::ImageSpec& spec = in->spec();
  const int64_t pixels = int64_t(spec.width) * spec.height, all = int64_t(spec.full_width) * spec.full_height;
  if (spec.width <= 0 || spec.height <= 0 || spec.nchannels <= 0 || spec.full_width <= 0 ||
      spec.full_height <= 0)
    return path + ": it holds no pixels";
  if (pixels > kMostPixels || all > kMostPixels || spec.nchannels > kMostChannels || spec.depth > 1 ||
      spec.deep)
    return path + ": it is too large, or no flat picture";
  Picture& p = *out;
  p = {};
  p.channels = spec.nchannels;
  p.width = spec.full_width, p.height = spec.full_height;
  p.type = spec.format;
  p.channelNames = spec.channelnames;
  p.hasCamera = takeCamera(spec, p.worldToCamera, p.worldToScreen);
  std::vector<float> data(size_t(pixels) * size_t(p.channels));
  if (!in->read_image(0, 0, 0, p.channels, OIIO::TypeDesc::FLOAT, data.data()))
    return path + ": " + in->geterror();
  const int dx = spec.x - spec.full_x, dy = spec.y - spec.full_y;
  if (dx == 0 && dy == 0 && spec.width == p.width && spec.height == p.height) {
    p.texels = std::move(data);
    return "";
  }
  p.texels.assign(size_t(all) * size_t(p.channels), outside);
  for (int y = 0; y < p.height; ++y)
    for (int x = std::max(0, dx); x < std::min(p.width, dx + spec.width); ++x) {
      if (y < dy || y >= dy + spec.height) continue;
      const float* const from =
          data.data() + (size_t(y - dy) * size_t(spec.width) + size_t(x - dx)) * size_t(p.channels);
      std::copy(from, from + p.channels, p.at(x, y));
    }
  return "";
}

void keepChannel(int channel, Picture* picture) {
  Picture& p = *picture;
  if (p.channels == 1) return;
  const size_t n = size_t(p.width) * size_t(p.height);
  for (size_t i = 0; i < n; ++i) p.texels[i] = p.texels[i * size_t(p.channels) + size_t(channel)];
  p.texels.resize(n);
  p.channels = 1;
  p.channelNames = {p.channelNames.size() > size_t(channel) ? p.channelNames[size_t(channel)] : "Y"};
}

Picture resampled(const Picture& from, int width, int height, const ReduceFilter& filter) {
  Picture to = from;
  if (width == from.width && height == from.height) return to;
  const size_t channels = size_t(from.channels);
  const Weights columns = lineWeights(from.width, width, filter.name, filter.sWidth, filter.sWrap);
  const Weights rows = lineWeights(from.height, height, filter.name, filter.tWidth, filter.tWrap);
  std::vector<float> middle(size_t(from.height) * size_t(width) * channels, 0.0f);
  for (int y = 0; y < from.height; ++y)
    for (int x = 0; x < width; ++x) {
      float* const t = middle.data() + (size_t(y) * size_t(width) + size_t(x)) * channels;
      for (int k = columns.first[size_t(x)]; k < columns.first[size_t(x) + 1]; ++k) {
        const float* const f = from.at(columns.source[size_t(k)], y);
        for (size_t c = 0; c < channels; ++c) t[c] += columns.weight[size_t(k)] * f[c];
      }
    }
  to.width = width, to.height = height;
  to.texels.assign(size_t(height) * size_t(width) * channels, 0.0f);
  const size_t line = size_t(width) * channels;
  for (int y = 0; y < height; ++y)
    for (int k = rows.first[size_t(y)]; k < rows.first[size_t(y) + 1]; ++k) {
      const float* const f = middle.data() + size_t(rows.source[size_t(k)]) * line;
      float* const t = to.texels.data() + size_t(y) * line;
      for (size_t c = 0; c < line; ++c) t[c] += rows.weight[size_t(k)] * f[c];
    }
  return to;
}

}  // namespace fr::textures
