// libFuzzer: any bytes through the loader of compiled shaders. What it accepts must be writable, readable and
// printable.
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "shading/slx.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const auto program = fr::readSlx({reinterpret_cast<const char*>(data), size});
  if (!program) return 0;
  (void)fr::disassemble(*program);
  if (!fr::readSlx(fr::writeSlx(*program)).ok()) std::abort();
  return 0;
}
