#include "base/sobol.h"

#include <array>

#include "base/random.h"
#include "base/sobol_pair.h"

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

uint32_t owenScramble(uint32_t x, uint32_t seed) { return reversedBits(laineKarras(reversedBits(x), seed)); }
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
  uint32_t x, y;
  sobolOwenPair(index, seed, mix32, x, y);
  return {toUnitFloat(x), toUnitFloat(y)};
}

}  // namespace fr
