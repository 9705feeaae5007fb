// How many of the points that were shaded show: what shading of hidden points costs, for the statistics.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "reyes/shading_stride.h"
#include "scene_cache/cache.h"

namespace fr::reyes {

/// Triangles of a grid or meshlet, numbered as samples know them, a bit each.
class TriangleSet {
 public:
  void insert(uint32_t triangle) { words_[triangle / 64] |= uint64_t(1) << triangle % 64; }
  bool contains(uint32_t triangle) const { return words_[triangle / 64] >> triangle % 64 & 1; }
  uint64_t word(size_t i) const { return words_[i]; }
  void setWord(size_t i, uint64_t word) { words_[i] = word; }
  static constexpr size_t kWords = 8;
  static_assert(kWords * 64 >= 2 * cache::kMaxGridSide * cache::kMaxGridSide &&
                kWords * 64 >= cache::kMaxMeshletTriangles);

 private:
  std::array<uint64_t, kWords> words_{};
};

/// Points that were shaded at `stride` and are corners of what was seen: of shaded cells with a seen triangle
/// in a grid, of seen triangles in a meshlet, whose triples of vertices are `indices`.
size_t visiblePoints(const cache::GridRecord& grid, ShadingStride stride, const TriangleSet& seen,
                     const uint8_t* indices);

}  // namespace fr::reyes
