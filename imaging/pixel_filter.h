// The pixel filters of RISpec 3.2 (appendix E) and those that later renderers added.
#pragma once

#include <string_view>

#include "base/error.h"

namespace fr {

enum class FilterKind {
  kBox,
  kTriangle,
  kCatmullRom,
  kSinc,
  kGaussian,
  kMitchell,
  kDisk,
  kBessel,
  kLanczos,
  kBlackmanHarris,
  kSeparableCatmullRom,
};

/// A reconstruction filter with its widths: full supports in pixels. Not normalised: whoever filters divides
/// by the sum of the weights that were used. A value type; thread-safe.
class PixelFilter {
 public:
  /// The widest support there is: wider filters are cut to it, with a warning.
  static constexpr float kMaxWidth = 33.0f;

  PixelFilter() = default;
  /// Widths are cut to [kMinWidth, kMaxWidth]; NaN becomes 2.
  PixelFilter(FilterKind kind, float xWidth, float yWidth);
  /// Errors: kRange for an unknown name.
  static Result<PixelFilter> byName(std::string_view name, float xWidth, float yWidth);

  FilterKind kind() const { return kind_; }
  float xWidth() const { return xWidth_; }
  float yWidth() const { return yWidth_; }
  /// How many pixels beyond its own a sample can reach: target pixels are [pixel - reach, pixel + reach].
  int xReach() const;
  int yReach() const;
  /// True when evaluate(x, y) is evaluateX(x) * evaluateY(y).
  bool separable() const;
  /// Weight of a sample (x, y) pixels away from the pixel's centre; 0 outside [-width/2, width/2). That
  /// interval is half open, so that box filters of whole widths count every sample equally often.
  float evaluate(float x, float y) const;
  float evaluateX(float x) const { return evaluate1D(x, xWidth_); }
  float evaluateY(float y) const { return evaluate1D(y, yWidth_); }

 private:
  static constexpr float kMinWidth = 1e-3f;
  float evaluate1D(float x, float width) const;

  FilterKind kind_ = FilterKind::kGaussian;
  float xWidth_ = 2, yWidth_ = 2;
};

}  // namespace fr
