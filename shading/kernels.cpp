#include "shading/kernels.h"

#include "base/isa.h"

namespace fr {

#define FR_DECLARE(isa)                    \
  namespace isa {                          \
  void addArithmeticKernels(KernelTable&); \
  void addGeometryKernels(KernelTable&);   \
  void addNoiseKernels(KernelTable&);      \
  void addDifferenceKernel(KernelTable&);  \
  void addRayKernels(KernelTable&);        \
  }
FR_DECLARE(sse4)
FR_DECLARE(avx2)
FR_DECLARE(avx512)
#undef FR_DECLARE

const KernelTable& kernelsOf(int isa) {
#define FR_TABLE(name)                  \
  static const KernelTable table = [] { \
    KernelTable t;                      \
    name::addArithmeticKernels(t);      \
    name::addGeometryKernels(t);        \
    name::addNoiseKernels(t);           \
    name::addDifferenceKernel(t);       \
    name::addRayKernels(t);             \
    return t;                           \
  }();                                  \
  return table
  if (isa == int(Isa::kAvx512)) {
    FR_TABLE(avx512);
  }
  if (isa == int(Isa::kAvx2)) {
    FR_TABLE(avx2);
  }
  FR_TABLE(sse4);
#undef FR_TABLE
}

const KernelTable& kernels() {
  static const KernelTable& table = kernelsOf(int(currentIsa()));
  return table;
}

}  // namespace fr
