#include "base/isa.h"
#include "reyes/blur_kernel.h"
#include "reyes/raster_kernel.h"

namespace fr::reyes {

RasterFunction rasterFunction() {
  switch (currentIsa()) {
    case Isa::kAvx512:
      return avx512::rasterise;
    case Isa::kAvx2:
      return avx2::rasterise;
    case Isa::kSse4:
      break;
  }
  return sse4::rasterise;
}

int rasterWidth() {
  switch (currentIsa()) {
    case Isa::kAvx512:
      return 16;
    case Isa::kAvx2:
      return 8;
    case Isa::kSse4:
      break;
  }
  return 4;
}

BlurFunction blurFunction() {
  switch (currentIsa()) {
    case Isa::kAvx512:
      return avx512::drawBlurred;
    case Isa::kAvx2:
      return avx2::drawBlurred;
    case Isa::kSse4:
      break;
  }
  return sse4::drawBlurred;
}

}  // namespace fr::reyes
