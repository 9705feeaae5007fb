// Memory that machine code can be run from.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <string_view>

#include "base/isa.h"
#include "shading/native_run.h"

namespace fr {

bool nativeCodeAvailable() {
#if defined(__x86_64__)
  static const bool available = [] {
    const char* const wish = std::getenv("FRANKENRENDER_NATIVE");
    return int(currentIsa()) >= int(Isa::kAvx2) && !(wish && std::string_view(wish) == "0");
  }();
  return available;
#else
  return false;
#endif
}

std::unique_ptr<NativeMemory> NativeMemory::of(const std::vector<uint8_t>& code) {
  const auto page = size_t(::sysconf(_SC_PAGESIZE));
  const size_t size = (code.size() + page - 1) / page * page;
  if (size == 0) return nullptr;
  void* const memory = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) return nullptr;
  std::memcpy(memory, code.data(), code.size());
  if (::mprotect(memory, size, PROT_READ | PROT_EXEC) != 0) {
    ::munmap(memory, size);
    return nullptr;
  }
  return std::unique_ptr<NativeMemory>(new NativeMemory(memory, size));
}

NativeMemory::~NativeMemory() { ::munmap(memory_, size_); }

}  // namespace fr
