#include "imaging/tile_order.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "base/math.h"

namespace fr {

std::vector<int> hilbertOrder(int width, int height) {
  std::vector<int> order;
  order.reserve(size_t(width) * size_t(height));
  const int bits = log2Ceil(std::max(width, height));
  for (uint64_t d = 0; d < uint64_t(1) << (2 * bits); ++d) {
    uint32_t x = 0, y = 0;
    uint64_t t = d;
    for (uint32_t s = 1; s < 1u << bits; s *= 2) {
      const uint32_t rx = 1u & uint32_t(t / 2), ry = 1u & uint32_t(t ^ rx);
      if (ry == 0) {
        if (rx == 1) x = s - 1 - x, y = s - 1 - y;
        std::swap(x, y);
      }
      x += s * rx, y += s * ry;
      t /= 4;
    }
    if (int(x) < width && int(y) < height) order.push_back(int(y) * width + int(x));
  }
  return order;
}

}  // namespace fr
