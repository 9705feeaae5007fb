// Counter-based random numbers: every number is a hash of what it is for, never of when or by whom it
// was asked for. So threads, transports, batches and restarts cannot change an image.
#pragma once

#include <cstdint>

namespace fr {

/// Finalizer of MurmurHash3 (64 bit): a bijection with full avalanche.
constexpr uint64_t mix64(uint64_t x) {
  x ^= x >> 33, x *= 0xff51afd7ed558ccdull;
  x ^= x >> 33, x *= 0xc4ceb9fe1a85ec53ull;
  return x ^ (x >> 33);
}
/// Extends a key: one step down a path (frame -> pixel -> sample -> ray -> dimension).
constexpr uint64_t hashStep(uint64_t key, uint64_t next) {
  return mix64(key * 0x9e3779b97f4a7c15ull + next + 0x632be59bd9b4e019ull);
}
/// 32-bit finalizer with low bias (C. Wellons' "lowbias32" search).
constexpr uint32_t mix32(uint32_t x) {
  x ^= x >> 16, x *= 0x7feb352du;
  x ^= x >> 15, x *= 0x846ca68bu;
  return x ^ (x >> 16);
}
/// Uniform in [0,1): the top 24 bits, so it never rounds up to 1.
constexpr float toUnitFloat(uint32_t x) { return float(x >> 8) * 0x1p-24f; }
constexpr float toUnitFloat64(uint64_t x) { return toUnitFloat(uint32_t(x >> 32)); }

}  // namespace fr
