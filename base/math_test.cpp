#include "base/math.h"

#include <gtest/gtest.h>

#include <cstring>

namespace fr {
namespace {

TEST(Math, RibMatrixBytesAreGlmBytes) {
  // Translation by (1,2,3) as RISpec writes it: the last row.
  const double rib[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1};
  DMat4 m;
  std::memcpy(&m, rib, sizeof m);
  EXPECT_EQ(transformPoint(m, DVec3(0)), DVec3(1, 2, 3));
  EXPECT_EQ(transformVector(m, DVec3(5, 0, 0)), DVec3(5, 0, 0));
}

TEST(Math, NormalMatrixKeepsNormalsPerpendicular) {
  const Mat4 m(Vec4(2, 0, 0, 0), Vec4(1, 3, 0, 0), Vec4(0, 0, 0.5f, 0), Vec4(7, 8, 9, 1));
  const Vec3 tangent(1, -1, 2), normal(1, 1, 0);
  EXPECT_NEAR(glm::dot(transformVector(m, tangent), normalMatrix(m) * normal), 0.f, 1e-5f);
}

TEST(Math, SingularMatrixStillGivesANormal) {
  Mat4 m(1);
  m[2][2] = 0;  // flattened on z
  EXPECT_EQ(glm::normalize(normalMatrix(m) * Vec3(0, 0, 1)), Vec3(0, 0, 1));
}

TEST(Math, BoxTransformContainsTransformedCorners) {
  Box3f b{{-1, -2, -3}, {1, 2, 3}};
  const Mat4 m(Vec4(0, 1, 0, 0), Vec4(-1, 0, 0, 0), Vec4(0, 0, 1, 0), Vec4(5, 0, 0, 1));
  const Box3f t = transformBox(m, b);
  EXPECT_EQ(t.min, Vec3(3, -1, -3));
  EXPECT_EQ(t.max, Vec3(7, 1, 3));
  EXPECT_TRUE(Box3f{}.empty());
}

TEST(Math, Log2CeilIsTheSmallestSufficientExponent) {
  EXPECT_EQ(log2Ceil(0.3), 0);
  EXPECT_EQ(log2Ceil(1), 0);
  EXPECT_EQ(log2Ceil(1.01), 1);
  EXPECT_EQ(log2Ceil(16), 4);
  EXPECT_EQ(log2Ceil(17), 5);
  EXPECT_EQ(log2Ceil(std::nan("")), 0);
}

}  // namespace
}  // namespace fr
