// Filters as functions (RISpec 3.2, appendix E), by the renderer's own formulas.
#include "imaging/pixel_filter.h"
#include "libri/context.h"

namespace {

RtFloat weight(fr::FilterKind kind, RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth) {
  return fr::PixelFilter(kind, xwidth, ywidth).evaluate(x, y);
}

struct Named {
  RtFilterFunc function;
  const char* name;
};
constexpr Named kFilters[] = {{RiBoxFilter, "box"},
                              {RiTriangleFilter, "triangle"},
                              {RiCatmullRomFilter, "catmull-rom"},
                              {RiGaussianFilter, "gaussian"},
                              {RiSincFilter, "sinc"},
                              {RiMitchellFilter, "mitchell"},
                              {RiDiskFilter, "disk"},
                              {RiBesselFilter, "bessel"},
                              {RiLanczosFilter, "lanczos"},
                              {RiBlackmanHarrisFilter, "blackman-harris"},
                              {RiSeparableCatmullRomFilter, "separable-catmull-rom"}};

}  // namespace

std::string fr::libri::filterNameOf(const char* request, RtFilterFunc f) {
  for (const Named& n : kFilters)
    if (n.function == f) return n.name;
  complain(RiError::kUnimplemented, Severity::kWarning, request,
           "a filter function of the program's own cannot be used; \"gaussian\" takes its place");
  return "gaussian";
}

extern "C" {

#define FR_RI_FILTER(name, kind)                                       \
  RtFloat name(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth) { \
    return weight(fr::FilterKind::kind, x, y, xwidth, ywidth);         \
  }
FR_RI_FILTER(RiBoxFilter, kBox)
FR_RI_FILTER(RiTriangleFilter, kTriangle)
FR_RI_FILTER(RiCatmullRomFilter, kCatmullRom)
FR_RI_FILTER(RiGaussianFilter, kGaussian)
FR_RI_FILTER(RiSincFilter, kSinc)
FR_RI_FILTER(RiMitchellFilter, kMitchell)
FR_RI_FILTER(RiDiskFilter, kDisk)
FR_RI_FILTER(RiBesselFilter, kBessel)
FR_RI_FILTER(RiLanczosFilter, kLanczos)
FR_RI_FILTER(RiBlackmanHarrisFilter, kBlackmanHarris)
FR_RI_FILTER(RiSeparableCatmullRomFilter, kSeparableCatmullRom)

}  // extern "C"
