// The first two dimensions of scrambled Sobol points, for numbers and for vectors of them.
#pragma once

#include <cstdint>

namespace fr {

// Always inline: kernels are compiled for instruction sets that not every machine has.
#define FR_SOBOL_INLINE __attribute__((always_inline)) inline

template <class U>
FR_SOBOL_INLINE U reversedBits(U x) {
  x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
  return (x >> 16) | (x << 16);
}
/// Laine-Karras permutation: each bit is flipped by a hash of the bits below it.
template <class U>
FR_SOBOL_INLINE U laineKarras(U x, U seed) {
  x += seed;
  x ^= x * 0x6c50b47cu;
  x ^= x * 0xb82f1e52u;
  x ^= x * 0xc7afe638u;
  x ^= x * 0x8d22f6e6u;
  return x;
}
/// Point `index`, shuffled and scrambled by `seed`, as fractions of 2^32. `mix`: mix32() for U.
template <class U, class Mix>
FR_SOBOL_INLINE void sobolOwenPair(U index, U seed, const Mix& mix, U& x, U& y) {
  // Bits are not turned around where they would be turned back: dimension 0 is the index with its bits turned
  // around.
  const U shuffled = reversedBits(laineKarras(reversedBits(index), mix(seed)));
  x = reversedBits(laineKarras(shuffled, mix(seed ^ 0x9e3779b9u)));
  // Dimension 1, turned around, is Pascal's triangle modulo 2 times the index, which takes sums over all
  // numbers of bits that contain a number of a bit, one binary digit of that number after the other.
  U sum = shuffled;
  sum ^= (sum >> 1) & 0x55555555u;
  sum ^= (sum >> 2) & 0x33333333u;
  sum ^= (sum >> 4) & 0x0f0f0f0fu;
  sum ^= (sum >> 8) & 0x00ff00ffu;
  sum ^= sum >> 16;
  y = reversedBits(laineKarras(sum, mix(seed ^ 0x3c6ef372u)));
}

#undef FR_SOBOL_INLINE

}  // namespace fr
