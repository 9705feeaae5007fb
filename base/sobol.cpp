#include "base/sobol.h"

#include <array>

#include "base/random.h"

namespace fr {
namespace {

// Direction numbers of the first four Sobol dimensions (Joe & Kuo), as 32 columns each.
using Columns = std::array<uint32_t, 32>;

constexpr Columns columns(int degree, uint32_t polynomial, std::array<uint32_t, 4> m) {
  Columns v{};
  for (int i = 0; i < 32; ++i) {
    if (i < degree) {
      v[size_t(i)] = m[size_t(i)] << (31 - i);
      continue;
    }
    uint32_t x = v[size_t(i - degree)] ^ (v[size_t(i - degree)] >> degree);
    for (int k = 1; k < degree; ++k)
      if ((polynomial >> (degree - 1 - k)) & 1u) x ^= v[size_t(i - k)];
    v[size_t(i)] = x;
  }
  return v;
}
constexpr Columns vanDerCorput() {
  Columns v{};
  for (int i = 0; i < 32; ++i) v[size_t(i)] = 1u << (31 - i);
  return v;
}
constexpr std::array<Columns, 4> kColumns = {vanDerCorput(), columns(1, 0, {1}), columns(2, 1, {1, 3}),
                                             columns(3, 1, {1, 3, 1})};

uint32_t reverseBits(uint32_t x) {
  x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
  x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
  x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
  return __builtin_bswap32(x);
}
// Laine-Karras permutation: each bit is flipped by a hash of the bits below it.
uint32_t laineKarras(uint32_t x, uint32_t seed) {
  x += seed;
  x ^= x * 0x6c50b47cu;
  x ^= x * 0xb82f1e52u;
  x ^= x * 0xc7afe638u;
  x ^= x * 0x8d22f6e6u;
  return x;
}
uint32_t owenScramble(uint32_t x, uint32_t seed) { return reverseBits(laineKarras(reverseBits(x), seed)); }
uint32_t seedOf(int dimension, uint32_t seed) {
  return mix32(seed ^ (0x9e3779b9u * uint32_t(dimension + 1)));
}

uint32_t sobol(uint32_t index, int dimension) {
  uint32_t x = 0;
  for (const Columns& v = kColumns[size_t(dimension)]; index != 0; index &= index - 1)
    x ^= v[size_t(__builtin_ctz(index))];
  return x;
}

}  // namespace

float sobolOwen(uint32_t index, int dimension, uint32_t seed) {
  const uint32_t shuffled = owenScramble(index, mix32(seed));
  const uint32_t x = sobol(shuffled, dimension & 3);
  return toUnitFloat(owenScramble(x, seedOf(dimension, seed)));
}

Vec2 sobolOwen2(uint32_t index, uint32_t seed) {
  // The index is shuffled once, and bits are reversed where the definition above would reverse them twice.
  const uint32_t reversed = laineKarras(reverseBits(index), mix32(seed));
  // Dimension 0 reverses its index. Dimension 1 is Pascal's triangle modulo 2 times it, which takes sums over
  // all numbers of bits that contain a number of a bit, one binary digit of that number after the other.
  uint32_t sum = reversed;
  sum ^= (sum & 0x55555555u) << 1;
  sum ^= (sum & 0x33333333u) << 2;
  sum ^= (sum & 0x0f0f0f0fu) << 4;
  sum ^= (sum & 0x00ff00ffu) << 8;
  sum ^= sum << 16;
  return {toUnitFloat(reverseBits(laineKarras(reverseBits(reversed), seedOf(0, seed)))),
          toUnitFloat(reverseBits(laineKarras(reverseBits(sum), seedOf(1, seed))))};
}

}  // namespace fr
