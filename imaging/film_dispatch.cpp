#include "base/isa.h"
#include "imaging/film_kernel.h"

namespace fr {

FilmFunction filmFunction() { return forIsa(sse4::addSamples, avx2::addSamples, avx512::addSamples); }

}  // namespace fr
