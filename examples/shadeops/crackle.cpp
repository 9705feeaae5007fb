// A shadeop of frankenrender's own kind: called once for a whole batch of points, with a column for each
// component of each argument.
//
//   float crackle(point P, float jitter, output color cell)     distance to the edge between Worley cells,
//   and a colour
//                                                               for the cell
//
// Builds with any C++17 compiler:  c++ -shared -fPIC -O3 -I<include/frankenrender/shading> crackle.cpp -o
// crackle.so
#include "shadeop.h"

#include <cmath>
#include <cstdint>

FR_SHADEOP_TABLE(crackle) = {{"float crackle_batch(point, float, output color)", "", ""}, {"", "", ""}};

namespace {

/// A number in [0,1) for a cell and a channel.
float hashOf(int x, int y, int z, int channel) {
  uint32_t h = uint32_t(x) * 0x8da6b343u ^ uint32_t(y) * 0xd8163841u ^ uint32_t(z) * 0xcb1ab31fu ^
               uint32_t(channel) * 0x9e3779b9u;
  h = (h ^ h >> 15) * 0x2c1b3c6du;
  h = (h ^ h >> 12) * 0x297a2d39u;
  return float((h ^ h >> 15) >> 8) / 16777216.0f;
}

}  // namespace

FR_SHADEOP(crackle_batch) {
  (void)initdata;
  const FrShadeopArg &result = batch->arg[0], &P = batch->arg[1], &jitter = batch->arg[2],
                     &cell = batch->arg[3];
  for (int i = 0; i < batch->lanes; ++i) {
    if (!batch->mask[i]) continue;  // others wait outside of an if: their values must stay
    float p[3];
    int base[3];
    for (int c = 0; c < 3; ++c) {
      p[c] = *fr_shadeop_at(&P, c, i);
      base[c] = int(std::floor(std::fmax(-1e9f, std::fmin(1e9f, p[c]))));
    }
    const float spread = *fr_shadeop_at(&jitter, 0, i);
    float nearest = 1e9f, second = 1e9f;
    int best[3] = {0, 0, 0};
    for (int k = 0; k < 27; ++k) {
      const int q[3] = {base[0] + k % 3 - 1, base[1] + k / 3 % 3 - 1, base[2] + k / 9 - 1};
      float d = 0;
      for (int c = 0; c < 3; ++c) {
        const float x = float(q[c]) + 0.5f + spread * (hashOf(q[0], q[1], q[2], c) - 0.5f) - p[c];
        d += x * x;
      }
      if (d < nearest) {
        second = nearest, nearest = d;
        for (int c = 0; c < 3; ++c) best[c] = q[c];
      } else if (d < second) {
        second = d;
      }
    }
    *fr_shadeop_at(&result, 0, i) = std::sqrt(second) - std::sqrt(nearest);
    for (int c = 0; c < 3; ++c) *fr_shadeop_at(&cell, c, i) = hashOf(best[0], best[1], best[2], 3 + c);
  }
  return 0;
}
