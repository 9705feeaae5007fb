#include "base/isa.h"
#include "reyes/blur_kernel.h"
#include "reyes/raster_kernel.h"

namespace fr::reyes {

RasterFunction rasterFunction() { return forIsa(sse4::rasterise, avx2::rasterise, avx512::rasterise); }
int rasterWidth() { return forIsa(4, 8, 16); }
BlurFunction blurFunction() { return forIsa(sse4::drawBlurred, avx2::drawBlurred, avx512::drawBlurred); }

}  // namespace fr::reyes
