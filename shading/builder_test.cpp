#include "shading/builder.h"

#include <gtest/gtest.h>

#include <limits>

namespace fr {
namespace {

TEST(ProgramBuilder, ConstantsAreToldApartByTheirBits) {
  ProgramBuilder b;
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float zero[3] = {0, 0, 0}, minus[3] = {-0.0f, -0.0f, -0.0f}, mixed[3] = {0, -0.0f, 0},
              none[3] = {nan, 1, nan};
  const auto add = [&](const float(&v)[3]) { return b.constantFloats(SlType::kColor, v); };
  const uint32_t first[] = {add(zero), add(minus), add(mixed), add(none)};
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < i; ++j) EXPECT_NE(first[i], first[j]) << i << " " << j;
  EXPECT_EQ(add(zero), first[0]);
  EXPECT_EQ(add(minus), first[1]);
  EXPECT_EQ(add(mixed), first[2]);
  EXPECT_EQ(add(none), first[3]);
  EXPECT_NE(b.constantFloats(SlType::kPoint, zero), first[0]);
}

}  // namespace
}  // namespace fr
