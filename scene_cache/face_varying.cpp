#include "scene_cache/face_varying.h"

#include <algorithm>
#include <bit>
#include <compare>
#include <numeric>

namespace fr::cache {

WeldedFaceVarying weldFaceVarying(std::span<const float> values, uint32_t width,
                                  std::span<const uint32_t> vertices) {
  // By vertex, then by the bits of the row (-0 and 0 being one number): an order even for NaNs.
  const auto compare = [&](uint32_t a, uint32_t b) {
    if (const auto o = vertices[a] <=> vertices[b]; o != 0) return o;
    for (uint32_t c = 0; c < width; ++c) {
      const auto x = std::bit_cast<uint32_t>(values[size_t(a) * width + c] + 0.0f);
      const auto y = std::bit_cast<uint32_t>(values[size_t(b) * width + c] + 0.0f);
      if (const auto o = x <=> y; o != 0) return o;
    }
    return std::strong_ordering::equal;
  };
  std::vector<uint32_t> order(vertices.size());
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return compare(a, b) < 0; });
  WeldedFaceVarying w;
  w.valueOfCorner.resize(vertices.size());
  for (size_t i = 0; i < order.size(); ++i) {
    if (i == 0 || compare(order[i - 1], order[i]) != 0) w.cornerOfValue.push_back(order[i]);
    w.valueOfCorner[order[i]] = uint32_t(w.cornerOfValue.size() - 1);
  }
  return w;
}

}  // namespace fr::cache
