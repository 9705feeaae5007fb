// The constants that two processes must agree on, and the pause instruction.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fr::shm {

/// Distance in bytes that keeps two writers off each other's cache lines: two 64-byte lines, because the
/// adjacent-line prefetcher fetches pairs. A constant of ours, not
/// std::hardware_destructive_interference_size, which changes with compiler and flags; it is part of every
/// layout fingerprint.
inline constexpr size_t kCacheLine = 128;

/// Bytes that may be read beyond the used end of a segment (Embree reads 16 at the last vertex).
inline constexpr uint64_t kEndPadding = 64;

constexpr uint64_t roundUp(uint64_t value, uint64_t multiple) {
  return (value + multiple - 1) / multiple * multiple;
}

/// Tells the core that this is a spin loop.
inline void cpuRelax() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

/// FNV-1a over 64-bit words: the fingerprint of a layout is this over its sizes, offsets and alignments.
template <class... Words>
constexpr uint64_t layoutHash(Words... words) {
  uint64_t h = 0xcbf29ce484222325ull;
  auto mix = [&h](uint64_t w) {
    for (int i = 0; i < 8; ++i, w >>= 8) h = (h ^ (w & 0xff)) * 0x100000001b3ull;
  };
  (mix(uint64_t(words)), ...);
  return h;
}

}  // namespace fr::shm
