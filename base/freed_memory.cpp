#include "base/freed_memory.h"

#include <malloc.h>

namespace fr {

void returnFreedMemory() {
  // Setting either switches off what glibc would learn (mallopt(3), M_MMAP_THRESHOLD).
  constexpr int kLargeBlock = 256 << 10;
  ::mallopt(M_MMAP_THRESHOLD, kLargeBlock);
  ::mallopt(M_TRIM_THRESHOLD, kLargeBlock);
}

}  // namespace fr
