// libFuzzer: any bytes through the loader of compiled shaders. What it accepts must be writable, readable and
// printable.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>

#include "shading/slx.h"
#include "shading/source.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  constexpr size_t kHeader = 32;
  if (size >= kHeader) {
    const uint64_t numbers[2] = {size - kHeader, fr::hashBytes(bytes.data() + kHeader, size - kHeader)};
    std::memcpy(bytes.data() + 16, numbers, sizeof(numbers));
  }
  const auto program = fr::readSlx(bytes);
  if (!program) return 0;
  (void)fr::disassemble(*program);
  if (!fr::readSlx(fr::writeSlx(*program)).ok()) std::abort();
  return 0;
}
