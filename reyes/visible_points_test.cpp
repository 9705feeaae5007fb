#include "reyes/visible_points.h"

#include <gtest/gtest.h>

namespace fr::reyes {
namespace {

cache::GridRecord gridOf(uint16_t nu, uint16_t nv) {
  cache::GridRecord g{};
  g.kind = cache::GridKind::kGrid, g.nu = nu, g.nv = nv;
  return g;
}

TriangleSet triangles(std::initializer_list<uint32_t> list) {
  TriangleSet s;
  for (const uint32_t t : list) s.insert(t);
  return s;
}

TEST(VisiblePoints, AreTheCornersOfSeenCells) {
  const cache::GridRecord g = gridOf(4, 4);
  EXPECT_EQ(visiblePoints(g, {}, triangles({}), nullptr), 0u);
  EXPECT_EQ(visiblePoints(g, {}, triangles({0}), nullptr), 4u);
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 1}), nullptr), 4u) << "one cell";
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 3}), nullptr), 6u) << "cells that share a side";
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 10}), nullptr), 7u) << "cells that share a corner";
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 31}), nullptr), 8u) << "opposite cells";
}

TEST(VisiblePoints, CountWhatWasShaded) {
  const cache::GridRecord g = gridOf(4, 4);
  EXPECT_EQ(visiblePoints(g, {2, 2}, triangles({0, 10}), nullptr), 4u) << "cells of one shaded cell";
  EXPECT_EQ(visiblePoints(g, {4, 2}, triangles({0, 31}), nullptr), 6u);
}

TEST(VisiblePoints, OfTheLargestGrid) {
  const cache::GridRecord g = gridOf(cache::kMaxGridSide, cache::kMaxGridSide);
  TriangleSet all;
  for (uint32_t t = 0; t < 2u * cache::kMaxGridSide * cache::kMaxGridSide; ++t) all.insert(t);
  EXPECT_EQ(visiblePoints(g, {}, all, nullptr), size_t(17 * 17));
  EXPECT_EQ(visiblePoints(g, {16, 16}, all, nullptr), 4u);
}

TEST(VisiblePoints, OfMeshlets) {
  cache::GridRecord g{};
  g.kind = cache::GridKind::kMeshlet, g.nu = 5, g.nv = 3;
  const uint8_t indices[] = {0, 1, 2, 2, 1, 3, 3, 4, 0};
  EXPECT_EQ(visiblePoints(g, {}, triangles({0}), indices), 3u);
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 1}), indices), 4u);
  EXPECT_EQ(visiblePoints(g, {}, triangles({0, 1, 2}), indices), 5u);
}

}  // namespace
}  // namespace fr::reyes
