#include "base/isa.h"
#include "imaging/film_kernel.h"

namespace fr {

FilmFunction filmFunction() {
  switch (currentIsa()) {
    case Isa::kAvx512:
      return avx512::addSamples;
    case Isa::kAvx2:
      return avx2::addSamples;
    case Isa::kSse4:
      break;
  }
  return sse4::addSamples;
}

}  // namespace fr
