#include "imaging/pixel_filter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

namespace fr {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

constexpr std::array<std::pair<std::string_view, FilterKind>, 11> kNames = {{
    {"box", FilterKind::kBox},
    {"triangle", FilterKind::kTriangle},
    {"catmull-rom", FilterKind::kCatmullRom},
    {"sinc", FilterKind::kSinc},
    {"gaussian", FilterKind::kGaussian},
    {"mitchell", FilterKind::kMitchell},
    {"disk", FilterKind::kDisk},
    {"bessel", FilterKind::kBessel},
    {"lanczos", FilterKind::kLanczos},
    {"blackman-harris", FilterKind::kBlackmanHarris},
    {"separable-catmull-rom", FilterKind::kSeparableCatmullRom},
}};

float sinc(float x) { return x == 0 ? 1.0f : std::sin(kPi * x) / (kPi * x); }

/// The interpolating cubic with slope -1/2, times 2.
float catmullRom(float r) {
  if (r < 1) return (3 * r - 5) * r * r + 2;
  if (r < 2) return ((-r + 5) * r - 8) * r + 4;
  return 0;
}

/// Mitchell & Netravali 1988, B = C = 1/3, on |x| < 2.
float mitchell(float x) {
  constexpr float kB = 1.0f / 3, kC = 1.0f / 3;
  x = std::abs(x);
  if (x < 1) return ((12 - 9 * kB - 6 * kC) * x + (-18 + 12 * kB + 6 * kC)) * x * x + (6 - 2 * kB);
  if (x < 2)
    return (((-kB - 6 * kC) * x + (6 * kB + 30 * kC)) * x + (-12 * kB - 48 * kC)) * x + (8 * kB + 24 * kC);
  return 0;
}

float blackmanHarris(float phase) {  // phase in [-pi, pi], 0 at the centre
  return 0.35875f + 0.48829f * std::cos(phase) + 0.14128f * std::cos(2 * phase) +
         0.01168f * std::cos(3 * phase);
}

float cutWidth(float w, float lowest, float highest) {
  return w == w ? std::clamp(w, lowest, highest) : 2.0f;
}

bool insideSupport(float x, float width) { return x >= -0.5f * width && x < 0.5f * width; }

}  // namespace

PixelFilter::PixelFilter(FilterKind kind, float xWidth, float yWidth)
    : kind_(kind),
      xWidth_(cutWidth(xWidth, kMinWidth, kMaxWidth)),
      yWidth_(cutWidth(yWidth, kMinWidth, kMaxWidth)) {
  if (xWidth_ != xWidth || yWidth_ != yWidth)
    reportOnce("pixel filter width", Error{RiError::kRange,
                                           Severity::kWarning,
                                           {},
                                           fmt::format("pixel filter widths {} {} are cut to {} {}", xWidth,
                                                       yWidth, xWidth_, yWidth_)});
}

Result<PixelFilter> PixelFilter::byName(std::string_view name, float xWidth, float yWidth) {
  for (const auto& [known, kind] : kNames)
    if (known == name) return PixelFilter(kind, xWidth, yWidth);
  return makeError(RiError::kRange, "unknown pixel filter \"{}\"", name);
}

int PixelFilter::xReach() const { return int(std::ceil(std::max(0.0f, xWidth_ * 0.5f - 0.5f))); }
int PixelFilter::yReach() const { return int(std::ceil(std::max(0.0f, yWidth_ * 0.5f - 0.5f))); }

bool PixelFilter::separable() const {
  return kind_ != FilterKind::kCatmullRom && kind_ != FilterKind::kDisk && kind_ != FilterKind::kBessel;
}

float PixelFilter::evaluate1D(float x, float width) const {
  if (!insideSupport(x, width)) return 0;
  switch (kind_) {
    case FilterKind::kTriangle:
      return 1 - std::abs(x) / (0.5f * width);
    case FilterKind::kSinc:
      return sinc(x) * std::cos(0.5f * kPi * x / width);
    case FilterKind::kGaussian: {
      const float s = 2 * x / width;
      return std::exp(-2 * s * s);
    }
    case FilterKind::kMitchell:
      return mitchell(4 * x / width);
    case FilterKind::kLanczos:
      return sinc(x) * sinc(2 * x / width);
    case FilterKind::kBlackmanHarris:
      return blackmanHarris(2 * kPi * x / width);
    case FilterKind::kSeparableCatmullRom:
      return catmullRom(std::abs(x));
    case FilterKind::kBox:
    case FilterKind::kCatmullRom:
    case FilterKind::kDisk:
    case FilterKind::kBessel:
      break;
  }
  return 1;
}

float PixelFilter::evaluate(float x, float y) const {
  if (separable()) return evaluateX(x) * evaluateY(y);
  if (!insideSupport(x, xWidth_) || !insideSupport(y, yWidth_)) return 0;
  const float r = std::sqrt(x * x + y * y);
  if (kind_ == FilterKind::kCatmullRom) return catmullRom(r);
  const float ex = 2 * x / xWidth_, ey = 2 * y / yWidth_;
  const float ellipse = ex * ex + ey * ey;
  if (ellipse > 1) return 0;
  if (kind_ == FilterKind::kDisk) return 1;
  const float window = std::cos(0.5f * kPi * std::sqrt(ellipse));
  return window * (r == 0 ? kPi : 2 * float(::j1(double(kPi * r))) / r);
}

}  // namespace fr
