#include "base/isa.h"

#include <cstdlib>
#include <cstring>
#include <initializer_list>

namespace fr {

Isa currentIsa() {
  static const Isa isa = [] {
    Isa best = Isa::kSse4;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) best = Isa::kAvx2;
    if (best == Isa::kAvx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
      best = Isa::kAvx512;
    if (const char* e = std::getenv("FRANKENRENDER_ISA")) {
      for (Isa i : {Isa::kSse4, Isa::kAvx2, Isa::kAvx512})
        if (std::strcmp(e, isaName(i)) == 0 && i < best) best = i;
    }
    return best;
  }();
  return isa;
}

namespace {
constexpr const char* kDeterministic = "FRANKENRENDER_DETERMINISTIC";
}

Isa portableIsa() {
  const char* e = std::getenv(kDeterministic);
  return e && *e && std::strcmp(e, "0") != 0 ? Isa::kSse4 : currentIsa();
}

void beDeterministic() { setenv(kDeterministic, "1", 1); }

const char* isaName(Isa isa) {
  switch (isa) {
    case Isa::kSse4:
      return "sse4";
    case Isa::kAvx2:
      return "avx2";
    case Isa::kAvx512:
      return "avx512";
  }
  return "?";
}

}  // namespace fr
