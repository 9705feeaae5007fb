// Bounds of boxes on the raster: nothing that can be seen lies outside of them, and of a box that reaches
// through the near plane they tell on which side it is.
#include "reyes/raster_space.h"

#include <gtest/gtest.h>

#include <glm/gtc/matrix_transform.hpp>
#include <random>

namespace fr::reyes {
namespace {

cache::CameraRecord camera(float fov, float near) {
  cache::CameraRecord c{};
  c.projection = cache::ProjectionType::kPerspective;
  c.fov = fov;
  c.resolution[0] = 640, c.resolution[1] = 480;
  c.screenWindow[0] = -4 / 3.0f, c.screenWindow[1] = 4 / 3.0f;
  c.screenWindow[2] = -1, c.screenWindow[3] = 1;
  c.clipping[0] = near, c.clipping[1] = 1e30f;
  return c;
}

struct Random {
  std::mt19937 g{7};
  float operator()(float a, float b) { return std::uniform_real_distribution<float>(a, b)(g); }
  Vec3 in(const Box3f& b) {
    return {(*this)(b.min.x, b.max.x), (*this)(b.min.y, b.max.y), (*this)(b.min.z, b.max.z)};
  }
};

DMat4 turned(Random& random, const DVec3& at) {
  const DVec3 axis = glm::normalize(DVec3(random(-1, 1), random(-1, 1), random(-1, 1) + 1e-3));
  DMat4 m = glm::rotate(DMat4(1), double(random(-0.6f, 0.6f)), axis);
  m[3] = DVec4(at, 1);
  return m;
}

/// Whether a place that the camera sees at z >= near lies within the bounds; `checked` counts those.
void expectInside(const RasterBounds& b, const Vec4& h, const RasterSpace& space, size_t& checked) {
  if (!(h.w >= space.near())) return;
  ++checked;
  const float x = h.x / h.z, y = h.y / h.z;
  ASSERT_FALSE(b.outside);
  ASSERT_TRUE(x >= b.x0 && x <= b.x1 && y >= b.y0 && y <= b.y1)
      << x << " " << y << " in " << b.x0 << " " << b.y0 << " " << b.x1 << " " << b.y1;
  ASSERT_LE(b.key, space.key(h.w));
}

TEST(RasterBounds, HoldWhateverTheCameraSeesOfABox) {
  Random random;
  size_t checked = 0;
  for (int i = 0; i < 3000; ++i) {
    const float near = i % 3 == 0 ? 1e-10f : i % 3 == 1 ? 0.01f : 1.0f;
    const RasterSpace space(camera(random(1, 120), near), turned(random, {0, 0, 0}));
    const Vec3 middle(random(-3, 3), random(-3, 3), random(-3, 3)),
        half(random(0, 4), random(0, 4), random(0, 4));
    const Box3f box{middle - half, middle + half};
    const RasterBounds b = space.bounds(box);
    for (int k = 0; k < 30; ++k) expectInside(b, space.homogeneous(random.in(box)), space, checked);
    for (int k = 0; k < 8; ++k) expectInside(b, space.homogeneous(box.corner(k)), space, checked);
  }
  EXPECT_GT(checked, 20000u);
}

TEST(RasterBounds, HoldWhatAMovingCameraSeesOfABox) {
  Random random;
  size_t checked = 0;
  for (int i = 0; i < 2000; ++i) {
    const cache::CameraRecord record = camera(random(10, 90), 0.05f);
    const std::vector<DMat4> keys{turned(random, {random(-1, 1), 0, random(-2, 2)}),
                                  turned(random, {random(-1, 1), 0, random(-2, 2)}),
                                  turned(random, {random(-1, 1), 0, random(-2, 2)})};
    const ShutterSpace space(record, keys, {});
    const Vec3 middle(random(-3, 3), random(-3, 3), random(-3, 3)),
        half(random(0, 3), random(0, 3), random(0, 3));
    const Box3f box{middle - half, middle + half};
    const RasterBounds b = space.bounds(box);
    for (int k = 0; k < 40; ++k) {
      expectInside(b, space.homogeneous(random.in(box), random(0, 1)), space.open(), checked);
    }
  }
  EXPECT_GT(checked, 10000u);
}

TEST(RasterBounds, AFloorUnderTheEyeStaysBelowTheHorizon) {
  // Camera space has y up: the floor is in the lower half of the picture, however far it reaches behind the
  // eye.
  const Box3f floor{{-100, -1.01f, -50}, {100, -1, 80}};
  for (const float near : {1e-10f, 0.1f, 2.0f}) {
    const RasterBounds b = RasterSpace(camera(60, near), DMat4(1)).bounds(floor);
    EXPECT_FALSE(b.outside || b.before);
    // The farthest edge of the floor: 1 / 80 below the horizon, at 480 / (2 tan 30) pixels to the unit.
    EXPECT_NEAR(b.y0, 240 + 415.7f / 80, 2.5f);
    EXPECT_LT(b.x0, 0);
    EXPECT_GT(b.x1, 640);
    EXPECT_GT(b.y1, 480 - (near > 1 ? 40 : 0));
  }
  // To the left of the eye, and not in the picture.
  const RasterBounds b = RasterSpace(camera(60, 0.1f), DMat4(1)).bounds({{-20, -1, -5}, {-10, 1, 5}});
  EXPECT_LT(b.x1, 0);
}

TEST(RasterBounds, ALensWidensThem) {
  FrameLens lens;
  lens.radius = 0.05, lens.focalDistance = 4;
  const Box3f floor{{-100, -1.01f, -50}, {100, -1, 80}};
  const RasterSpace sharp(camera(60, 0.1f), DMat4(1)), blurred(camera(60, 0.1f), DMat4(1), lens);
  const RasterBounds a = sharp.bounds(floor), b = blurred.bounds(floor);
  // The nearest places move most: radius (1 / near - 1 / focus) in units of the screen at distance 1.
  EXPECT_NEAR(a.y0 - b.y0, 415.7f * 0.05f * (1 / 0.1f - 1 / 4.0f), 3);
}

}  // namespace
}  // namespace fr::reyes
