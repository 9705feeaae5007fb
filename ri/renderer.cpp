#include "ri/renderer.h"

#include <cmath>
#include <cstdint>

namespace fr::ri {
namespace {

constexpr std::array<const char*, 11> kFilterNames = {"box",
                                                      "triangle",
                                                      "catmull-rom",
                                                      "sinc",
                                                      "gaussian",
                                                      "mitchell",
                                                      "disk",
                                                      "bessel",
                                                      "separable-catmull-rom",
                                                      "blackman-harris",
                                                      "lanczos"};

}  // namespace

const char* shaderKindName(ShaderKind k) {
  switch (k) {
    case ShaderKind::kSurface:
      return "Surface";
    case ShaderKind::kDisplacement:
      return "Displacement";
    case ShaderKind::kAtmosphere:
      return "Atmosphere";
    case ShaderKind::kInterior:
      return "Interior";
    case ShaderKind::kExterior:
      return "Exterior";
    case ShaderKind::kDeformation:
      return "Deformation";
    case ShaderKind::kLight:
      return "LightSource";
    case ShaderKind::kAreaLight:
      return "AreaLightSource";
    case ShaderKind::kImager:
      return "Imager";
  }
  return "Shader";
}

const char* filterName(FilterKind f) { return kFilterNames[size_t(f)]; }

std::optional<FilterKind> filterFromName(std::string_view name) {
  for (size_t i = 0; i < kFilterNames.size(); ++i) {
    if (name == kFilterNames[i]) return FilterKind(i);
  }
  return std::nullopt;
}

Result<void> checkTrimCurve(const TrimCurve& t) {
  uint64_t curves = 0;
  for (int n : t.ncurves) {
    if (n < 1) return makeError(RiError::kRange, "TrimCurve: a loop of {} curves", n);
    curves += uint64_t(n);
  }
  const auto expect = [](const char* what, uint64_t actual, uint64_t expected) -> Result<void> {
    if (actual == expected) return {};
    return makeError(RiError::kConsistency, "TrimCurve: {} has {} values, expected {}", what, actual,
                     expected);
  };
  if (auto r = expect("order", t.order.size(), curves); !r) return r;
  if (auto r = expect("min", t.min.size(), curves); !r) return r;
  if (auto r = expect("max", t.max.size(), curves); !r) return r;
  if (auto r = expect("n", t.n.size(), curves); !r) return r;
  uint64_t points = 0, knots = 0;
  for (size_t i = 0; i < t.n.size(); ++i) {
    if (t.order[i] < 2) return makeError(RiError::kRange, "TrimCurve: order {} of curve {}", t.order[i], i);
    if (t.n[i] < t.order[i]) {
      return makeError(RiError::kConsistency, "TrimCurve: curve {} has {} points but order {}", i, t.n[i],
                       t.order[i]);
    }
    if (!(t.min[i] < t.max[i])) {
      return makeError(RiError::kRange, "TrimCurve: curve {} runs from {} to {}", i, t.min[i], t.max[i]);
    }
    points += uint64_t(t.n[i]);
    knots += uint64_t(t.n[i]) + uint64_t(t.order[i]);
  }
  if (auto r = expect("knot", t.knot.size(), knots); !r) return r;
  if (auto r = expect("u", t.u.size(), points); !r) return r;
  if (auto r = expect("v", t.v.size(), points); !r) return r;
  return expect("w", t.w.size(), points);
}

std::vector<std::string> Renderer::searchPath(std::string_view) const { return {}; }
const Param* Renderer::variable(std::string_view) const { return nullptr; }

void Renderer::reportHere(RiError code, Severity severity, std::string message) const {
  report(Error{code, severity, location(), std::move(message)});
}

}  // namespace fr::ri
