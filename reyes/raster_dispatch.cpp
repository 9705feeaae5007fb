#include "base/isa.h"
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

}  // namespace fr::reyes
