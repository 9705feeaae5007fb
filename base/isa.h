// Which instruction set the kernels run on: chosen once, at first use.
#pragma once

namespace fr {

enum class Isa { kSse4 = 0, kAvx2 = 1, kAvx512 = 2 };

/// The best set this CPU has, unless FRANKENRENDER_ISA (sse4, avx2, avx512) asks for a lower one.
Isa currentIsa();
const char* isaName(Isa isa);
/// What is meant for currentIsa().
template <class T>
T forIsa(T sse4, T avx2, T avx512) {
  const Isa isa = currentIsa();
  return isa == Isa::kAvx512 ? avx512 : isa == Isa::kAvx2 ? avx2 : sse4;
}

/// For libraries that give other bits on other sets: currentIsa(), unless beDeterministic() was called, or
/// the environment says FRANKENRENDER_DETERMINISTIC=1; then the set that every CPU has.
Isa portableIsa();
/// In this process and those that it starts. Before any thread is started.
void beDeterministic();

}  // namespace fr
