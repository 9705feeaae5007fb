// Which vertices are shaded, and what the others get.
#include "reyes/shading_stride.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

namespace fr::reyes {
namespace {

/// Orthographic, a pixel a unit, y down.
RasterSpace flatSpace() {
  cache::CameraRecord c{};
  c.projection = cache::ProjectionType::kOrthographic;
  c.resolution[0] = c.resolution[1] = 100;
  c.screenWindow[1] = 100, c.screenWindow[2] = -100;
  c.clipping[0] = -1000, c.clipping[1] = 1e30f;
  return {c, DMat4(1.0)};
}

struct TestGrid {
  cache::GridRecord record{};
  std::vector<float> xyz;
  cache::GridView view;
  template <class F>
  TestGrid(uint32_t nu, uint32_t nv, F&& position) {
    record.kind = cache::GridKind::kGrid;
    record.nu = uint16_t(nu), record.nv = uint16_t(nv), record.rowStride = uint16_t(nu + 3);
    xyz.resize(size_t(record.rowStride) * (nv + 1) * 3);
    for (uint32_t j = 0; j <= nv; ++j)
      for (uint32_t i = 0; i <= nu; ++i) {
        const Vec3 p = position(float(i), float(j));
        for (int c = 0; c < 3; ++c) xyz[(size_t(j) * record.rowStride + i) * 3 + size_t(c)] = p[c];
      }
    view.record = &record, view.positions = xyz.data();
  }
};

TEST(ShadingStride, FollowsTheRaster) {
  const RasterSpace space = flatSpace();
  const auto strideOf = [&](const Vec3& u, const Vec3& v, float area) {
    const TestGrid g(16, 16, [&](float i, float j) { return i * u + j * v; });
    const ShadingStride s = shadingStride(space, g.view, area);
    return std::pair(s.u, s.v);
  };
  using P = std::pair<uint32_t, uint32_t>;
  // Facing the camera, one pixel each.
  EXPECT_EQ(strideOf({1, 0, 0}, {0, -1, 0}, 1), P(1, 1));
  EXPECT_EQ(strideOf({1, 0, 0}, {0, -1, 0}, 4), P(2, 2));
  EXPECT_EQ(strideOf({0.5f, 0, 0}, {0, -0.5f, 0}, 1), P(2, 2));
  // A floor: rows are an eighth of a pixel apart, whatever their distance in space.
  EXPECT_EQ(strideOf({1, 0, 0}, {0, -0.125f, 1}, 1), P(1, 8));
  EXPECT_EQ(strideOf({0, -0.125f, 1}, {1, 0, 0}, 1), P(8, 1));
  // Two short sides: the cell may be as long as a pixel's diagonal, but not larger than a pixel.
  EXPECT_EQ(strideOf({0.7f, 0, 0}, {0, -0.7f, 0}, 1), P(2, 1));
  EXPECT_EQ(strideOf({0.8f, 0, 0}, {0, -0.8f, 0}, 1), P(1, 1));
  // Everything on one line.
  EXPECT_EQ(strideOf({0.01f, 0, 1}, {0.01f, 0, -1}, 1), P(16, 16));
  EXPECT_EQ(strideOf({1, 0, 0}, {0, -0.125f, 1}, 0), P(1, 1));
}

TEST(ShadingStride, NoShadedCellIsTooLargeAndRimsStayFine) {
  const RasterSpace space = flatSpace();
  // A strip of a cylinder that the camera sees from the front up to its rim, or past it.
  for (const float end : {0.45f, 0.55f}) {
    const TestGrid g(16, 16, [&](float i, float j) {
      const float a = float(std::numbers::pi) * (end - 0.1f + 0.1f * i / 16);
      return Vec3(40 * std::sin(a), -0.5f * j, 40 - 40 * std::cos(a));
    });
    const ShadingStride s = shadingStride(space, g.view, 1);
    float longest = 0;
    for (uint32_t i = 0; i + s.u <= 16; i += s.u)
      longest = std::max(longest, std::abs(g.view.vertex(i + s.u).x - g.view.vertex(i).x));
    EXPECT_LE(longest, std::sqrt(2.0f) * 1.001f);
    if (end > 0.5f) {
      EXPECT_LE(std::max(s.u, s.v), 2u);
    }
    EXPECT_GT(s.u * s.v, 1u);
  }
}

TEST(ShadingStride, MeshletsAndWhatReachesThroughTheNearPlaneAreShadedWhole) {
  const RasterSpace space = flatSpace();
  TestGrid g(16, 16, [](float i, float j) { return Vec3(0.1f * i, -0.1f * j, i - 1008); });
  EXPECT_TRUE(shadingStride(space, g.view, 1).all());
  TestGrid m(16, 16, [](float i, float j) { return Vec3(0.1f * i, -0.1f * j, 0); });
  EXPECT_FALSE(shadingStride(space, m.view, 1).all());
  m.record.kind = cache::GridKind::kMeshlet;
  EXPECT_TRUE(shadingStride(space, m.view, 1).all());
}

TEST(ShadingStride, SpreadsLinearFunctionsExactly) {
  const auto f = [](uint32_t i, uint32_t j) { return 3.0f + 0.25f * float(i) - 0.5f * float(j); };
  for (const uint32_t su : {1u, 2u, 8u, 16u})
    for (const uint32_t sv : {1u, 4u, 8u}) {
      TestGrid g(16, 8, [](float i, float j) { return Vec3(i, j, 0); });
      std::vector<float> from, to(17 * 9);
      for (uint32_t j = 0; j <= 8; j += sv)
        for (uint32_t i = 0; i <= 16; i += su) from.push_back(f(i, j));
      spreadShading(g.record, {su, sv}, from.data(), to.data());
      for (uint32_t j = 0; j <= 8; ++j)
        for (uint32_t i = 0; i <= 16; ++i) EXPECT_EQ(to[j * 17 + i], f(i, j));
    }
}

/// Along v = 0 only every fourth vertex is kept: the others stand on it.
TEST(ShadingStride, CollapsedVerticesGetTheValueOfTheirPlace) {
  TestGrid g(16, 4, [](float i, float j) { return Vec3(i, j, 0); });
  g.record.edgeShift[0] = 2;
  std::vector<float> from, to(17 * 5);
  for (uint32_t j = 0; j <= 4; j += 2)
    for (uint32_t i = 0; i <= 16; i += 8) from.push_back(float(i));
  spreadShading(g.record, {8, 2}, from.data(), to.data());
  for (uint32_t i = 0; i <= 16; ++i) {
    EXPECT_EQ(to[i], float(i / 4 * 4));
    EXPECT_EQ(to[2 * 17 + i], float(i));
  }
}

}  // namespace
}  // namespace fr::reyes
