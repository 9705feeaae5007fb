// environment(), shadow() and the matrices of maps, against analytic answers.
#include <cmath>

#include "shading/texture_fixture.h"

namespace fr {
namespace {

constexpr float kPi = 3.14159265358979f;

class MapTest : public TextureTest {
 protected:
  Vec3 environment(const std::string& name, const Vec3& d, const std::string& rest = "") {
    return value(fmt::format("color environment(\"{}\", vector({},{},{}){})", name, d.x, d.y, d.z, rest));
  }
};

TEST_F(MapTest, LatLongDirections) {
  // Red is s, green is t: longitude counts from -x through -y, +x, +y; the north pole is +z.
  picture("map.tif", 256, 128, 3, [](int x, int y, int c) {
    return c == 0 ? (float(x) + 0.5f) / 256 : c == 1 ? (float(y) + 0.5f) / 128 : 0.0f;
  });
  ASSERT_TRUE(make(FR_MAKE_LATLONG, {"map.tif"}, "map.env").ok());
  for (const char* name : {"map.env", "map.tif"}) {
    EXPECT_NEAR(environment(name, {1, 0, 0}).x, 0.5f, 0.01f);
    EXPECT_NEAR(environment(name, {0, 1, 0}).x, 0.75f, 0.01f);
    EXPECT_NEAR(environment(name, {0, -2, 0}).x, 0.25f, 0.01f);
    EXPECT_NEAR(environment(name, {1, 0, 0}).y, 0.5f, 0.01f);
    EXPECT_NEAR(environment(name, {1, 0, 1}).y, 0.25f, 0.01f);
    EXPECT_NEAR(environment(name, {0, 0, 3}).y, 0.0f, 0.01f);
    EXPECT_NEAR(environment(name, {0, 0, -3}).y, 1.0f, 0.01f);
  }
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

TEST_F(MapTest, LatLongHasNoSeamAndNoHoleAtThePole) {
  // A function of the direction alone: 0.5 + 0.5 x.
  picture("smooth.tif", 256, 128, 1, [](int x, int y, int) {
    const float a = ((float(x) + 0.5f) / 256 - 0.5f) * 2 * kPi, b = (0.5f - (float(y) + 0.5f) / 128) * kPi;
    return 0.5f + 0.5f * std::cos(a) * std::cos(b);
  });
  ASSERT_TRUE(make(FR_MAKE_LATLONG, {"smooth.tif"}, "smooth.env").ok());
  for (const float y : {-0.02f, -0.001f, 0.001f, 0.02f})
    EXPECT_NEAR(environment("smooth.env", {-1, y, 0}).x, 0.0f, 0.01f);
  for (const float x : {-0.05f, 0.0f, 0.05f})
    EXPECT_NEAR(environment("smooth.env", {x, 0, 1}).x, 0.5f + 0.5f * x, 0.02f);
  // A grid of directions around the pole, with its filter.
  grid(9, 9);
  run("color environment(\"smooth.env\", vector(s - .5, t - .5, 1))");
  for (uint32_t i = 0; i < f.count; ++i) {
    const float x = f.batch.globals[size_t(GlobalId::k_s)].at(i) - 0.5f,
                y = f.batch.globals[size_t(GlobalId::k_t)].at(i) - 0.5f;
    ASSERT_NEAR(f.Ci(i), 0.5f + 0.5f * x / std::sqrt(1 + x * x + y * y), 0.03f) << x << " " << y;
  }
  EXPECT_NEAR(environment("smooth.env", {1, 0, 0}, ", \"blur\", 1").x, 0.5f, 0.15f)
      << "blur 1 is the whole map";
}

/// Environment maps of ray calls: brightness 0.5 + 0.5 x of the direction.
class MissedRays : public MapTest {
 protected:
  MissedRays() {
    picture("sky.tif", 256, 128, 3, [](int x, int y, int) {
      const float a = ((float(x) + 0.5f) / 256 - 0.5f) * 2 * kPi, b = (0.5f - (float(y) + 0.5f) / 128) * kPi;
      return 0.5f + 0.5f * std::cos(a) * std::cos(b);
    });
    EXPECT_TRUE(make(FR_MAKE_LATLONG, {"sky.tif"}, "sky.env").ok());
    f.resize(3, 3);
  }
};

TEST_F(MissedRays, SeeTheMapOfTrace) {
  run("trace(P, vector(1, 0, 0), \"environmentmap\", \"sky.env\")");
  EXPECT_NEAR(f.Ci(2), 1, 0.01f);
  run("trace(P, vector(-1, 0, 0), \"environmentmap\", \"sky.env\")");
  EXPECT_NEAR(f.Ci(2), 0, 0.01f);
  // Another coordinate system: its x axis is -x of the world.
  f.host.spaces["turned"] = DMat4(1.0);
  f.host.spaces["turned"][0][0] = f.host.spaces["turned"][1][1] = -1;
  run("trace(P, vector(1, 0, 0), \"environmentmap\", \"sky.env\", \"environmentspace\", \"turned\")");
  EXPECT_NEAR(f.Ci(2), 0, 0.01f);
  // Through what lets a quarter pass, and onto what lets nothing pass.
  float passes = 0.25f;
  f.oracle = [&](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k)
      for (int c = 0; c < 3; ++c) r.hitDistance[k] = 1, r.color[c][k] = 0.5f, r.extra[c][k] = passes;
  };
  run("trace(P, vector(1, 0, 0), \"environmentmap\", \"sky.env\")");
  EXPECT_NEAR(f.Ci(2), 0.75, 0.01f);
  passes = 0;
  run("trace(P, vector(1, 0, 0), \"environmentmap\", \"sky.env\")");
  EXPECT_EQ(f.Ci(2), 0.5f);
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

TEST_F(MissedRays, SeeTheMapOfHemispheres) {
  // The cosine-weighted mean of x about x is 2/3, about -x -2/3.
  run("indirectdiffuse(P, vector(1, 0, 0), 256, \"environmentmap\", \"sky.env\")");
  EXPECT_NEAR(f.Ci(1), 0.5 + 0.5 * 2 / 3, 0.01f);
  run("indirectdiffuse(P, vector(-1, 0, 0), 256, \"environmentmap\", \"sky.env\")");
  EXPECT_NEAR(f.Ci(1), 0.5 - 0.5 * 2 / 3, 0.01f);
  // Half of it is hidden, what is clear has the mean of the map.
  f.oracle = [](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) r.hitDistance[k] = r.direction[1][k] > 0 ? 1.0f : kNoHit;
  };
  run("color(o, comp(sky, 0), comp(sky, 2))", "",
      "color sky = 0; float o = occlusion(P, vector(0, 0, 1), 256, \"environmentmap\", \"sky.env\", "
      "\"environmentcolor\", sky);");
  EXPECT_NEAR(f.Ci(3, 0), 0.5, 0.01f);
  EXPECT_NEAR(f.Ci(3, 1), 0.25, 0.01f);
  EXPECT_NEAR(f.Ci(3, 2), 0.25, 0.01f);
}

TEST_F(MissedRays, SeeTheMapOfGather) {
  f.oracle = [](PendingRays& r) {
    for (uint32_t k = 0; k < r.count; ++k) {
      r.hitDistance[k] = r.direction[1][k] > 0 ? 1.0f : kNoHit;
      for (int c = 0; c < 3; ++c) r.color[c][k] = 3;
    }
  };
  run("color(misses / 64, comp(sum, 0) / misses, comp(hit, 1))", "",
      "color sky = 7, c = 0, sum = 0, hit = 0; float misses = 0;\n"
      "gather(\"illuminance\", P, vector(0, 0, 1), PI/2, 64, \"surface:Ci\", c, \"environment:color\", sky,"
      " \"environmentmap\", \"sky.env\") { hit = c; } else { sum += sky; misses += 1; }");
  EXPECT_NEAR(f.Ci(0, 0), 0.5, 0.02f);
  EXPECT_NEAR(f.Ci(0, 1), 0.5, 0.02f);
  EXPECT_EQ(f.Ci(0, 2), 3);
}

TEST_F(MapTest, FourDirectionsAreAFilterQuad) {
  picture("steps.tif", 256, 128, 1, [](int x, int, int) { return (x / 8) & 1 ? 1.0f : 0.0f; });
  const float wide =
      value(
          "float environment(\"steps.tif\", vector(1,-.4,-.1), vector(1,.4,-.1), vector(1,-.4,.1), "
          "vector(1,.4,.1))")
          .x;
  EXPECT_NEAR(wide, 0.5f, 0.1f);
}

TEST_F(MapTest, CubeFacesAsCamerasSeeThem) {
  // Each face: its number in red, s in green, t in blue.
  std::vector<std::string> faces;
  for (int k = 0; k < 6; ++k) {
    faces.push_back("face" + std::to_string(k) + ".tif");
    picture(faces.back(), 64, 64, 3, [k](int x, int y, int c) {
      return c == 0 ? 0.1f * float(k + 1) : ((c == 1 ? float(x) : float(y)) + 0.5f) / 64;
    });
  }
  ASSERT_TRUE(make(FR_MAKE_CUBE, faces, "cube.env").ok());
  const Vec3 axes[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  const Vec3 right[6] = {{0, 0, -1}, {0, 0, 1}, {1, 0, 0}, {1, 0, 0}, {1, 0, 0}, {-1, 0, 0}};
  const Vec3 up[6] = {{0, 1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}, {0, 1, 0}, {0, 1, 0}};
  for (int k = 0; k < 6; ++k) {
    const Vec3 middle = environment("cube.env", axes[k]);
    EXPECT_NEAR(middle.x, 0.1f * float(k + 1), 1e-5f) << k;
    EXPECT_NEAR(middle.y, 0.5f, 0.01f);
    EXPECT_NEAR(middle.z, 0.5f, 0.01f);
    const Vec3 off = environment("cube.env", axes[k] + right[k] * 0.5f + up[k] * 0.25f);
    EXPECT_NEAR(off.x, 0.1f * float(k + 1), 1e-5f) << k;
    EXPECT_NEAR(off.y, 0.75f, 0.01f) << k;
    EXPECT_NEAR(off.z, 0.375f, 0.01f) << k;
  }
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

TEST_F(MapTest, CubeOfAFunctionOfDirection) {
  // Faces of 0.5 + 0.5 y, and what a blur must leave: no seam at the cube's edges, no neighbour of the file's
  // layout.
  const Vec3 axes[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  const Vec3 right[6] = {{0, 0, -1}, {0, 0, 1}, {1, 0, 0}, {1, 0, 0}, {1, 0, 0}, {-1, 0, 0}};
  const Vec3 up[6] = {{0, 1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}, {0, 1, 0}, {0, 1, 0}};
  std::vector<std::string> faces;
  for (int k = 0; k < 6; ++k) {
    faces.push_back("face" + std::to_string(k) + ".tif");
    picture(faces.back(), 64, 64, 1, [&](int x, int y, int) {
      const Vec3 d = glm::normalize(axes[k] + right[k] * ((float(x) + 0.5f) / 32 - 1) +
                                    up[k] * (1 - (float(y) + 0.5f) / 32));
      return 0.5f + 0.5f * d.y;
    });
  }
  ASSERT_TRUE(make(FR_MAKE_CUBE, faces, "cube.env").ok());
  for (float a = -1.2f; a < 1.21f; a += 0.1f)
    for (float b = -1.2f; b < 1.21f; b += 0.1f) {
      const Vec3 d(a, b, 1);
      EXPECT_NEAR(environment("cube.env", d).x, 0.5f + 0.5f * glm::normalize(d).y, 0.015f) << a << " " << b;
      EXPECT_NEAR(environment("cube.env", d, ", \"blur\", .1").x, 0.5f + 0.5f * glm::normalize(d).y, 0.03f)
          << a << " " << b;
    }
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

// A camera at `eye` that looks along +z, with a screen of +-1 at `fov`; perspective or parallel.
std::vector<float> cameraMatrices(const Vec3& eye, float fov) {
  DMat4 toCamera(1.0), screen(1.0);
  toCamera[3] = DVec4(-eye.x, -eye.y, -eye.z, 1);
  if (fov > 0) {
    const double scale = 1 / std::tan(double(fov) * 3.14159265358979 / 360), near = 0.1, far = 1000;
    screen = DMat4(0.0);
    screen[0][0] = screen[1][1] = scale;
    screen[2][2] = far / (far - near), screen[2][3] = 1, screen[3][2] = -far * near / (far - near);
  } else {
    screen[0][0] = screen[1][1] = 0.25;  // sees 8 x 8
  }
  const DMat4 toScreen = screen * toCamera;
  std::vector<float> m;
  for (const DMat4& x : {toCamera, toScreen})
    for (int k = 0; k < 16; ++k) m.push_back(float((&x[0][0])[k]));
  return m;
}

TEST_F(MapTest, PlanarMapsAreProjectedByTheirCamera) {
  const auto m = cameraMatrices({0, 0, -2}, 90);
  picture(
      "plane.tif", 64, 64, 3,
      [](int x, int y, int c) {
        return c == 0 ? (float(x) + 0.5f) / 64 : c == 1 ? (float(y) + 0.5f) / 64 : 1.0f;
      },
      OIIO::TypeDesc::FLOAT, m.data());
  ASSERT_TRUE(make(FR_MAKE_TEXTURE, {"plane.tif"}, "plane.tx").ok());
  for (const char* name : {"plane.tif", "plane.tx"}) {
    const Vec3 v = environment(name, {1, 0.5f, 0});  // 2 in front of the camera: screen (0.5, 0.25)
    EXPECT_NEAR(v.x, 0.75f, 0.005f) << name;
    EXPECT_NEAR(v.y, 0.375f, 0.005f) << name;
    EXPECT_EQ(environment(name, {0, 0, -3}), Vec3(0)) << "behind the camera";
  }
}

/// A shadow map of a ball of radius 1 at (0, 0, 4) in front of the plane z = 8, seen from the origin along
/// +z.
class ShadowTest : public MapTest {
 protected:
  static constexpr int kSize = 256;
  static constexpr float kFov = 60;
  void SetUp() override {
    matrices = cameraMatrices({0, 0, 0}, kFov);
    ball("ball.z");
  }
  void ball(const std::string& name) {
    const float scale = std::tan(kFov * kPi / 360);
    // "z" is no ending that the image library knows: through TIFF.
    picture("ball.tif", kSize, kSize, 1,
            [&](int x, int y, int) {
              const double dx = ((x + 0.5) / kSize * 2 - 1) * double(scale),
                           dy = (1 - (y + 0.5) / kSize * 2) * double(scale);
              // |t (dx, dy, 1) - (0, 0, 4)| = 1
              const double a = dx * dx + dy * dy + 1, b = -8, c = 15, d = b * b - 4 * a * c;
              return d > 0 ? float((-b - std::sqrt(d)) / (2 * a)) : 8.0f;
            },
            OIIO::TypeDesc::FLOAT, matrices.data(), {"Z"});
    std::filesystem::rename(file("ball.tif"), file(name));
  }
  /// Fraction in shadow of points of the plane z = `z`, x = from..to, y = 0.
  std::vector<float> along(float from, float to, float z, const std::string& rest = "",
                           const std::string& name = "ball.shd") {
    grid(63, 1);
    run(fmt::format("float shadow(\"{}\", point({} + {} * s, .02 * t, {}){})", name, from, to - from, z,
                    rest));
    std::vector<float> r;
    for (uint32_t i = 0; i < 64; ++i) r.push_back(f.Ci(i));
    return r;
  }
  std::vector<float> matrices;
};

TEST_F(ShadowTest, BallOverPlane) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  // The ball's cone has the half angle asin(1/4): its shadow on the plane is a disk of radius 8
  // tan(asin(1/4)).
  const float radius = 8 * std::tan(std::asin(0.25f));
  const float texel = 2 * 8 * std::tan(kFov * kPi / 360) / kSize;
  for (const char* rest : {"", ", \"bias\", 0.05", ", \"width\", 0"}) {
    const auto v = along(-4, 4, 8, rest);
    for (uint32_t i = 0; i < 64; ++i) {
      const float x = std::fabs(-4 + 8 * float(i) / 63);
      if (x < radius - 2 * texel - 0.07f) {
        ASSERT_FLOAT_EQ(v[i], 1.0f) << x << rest;
      }
      if (x > radius + 2 * texel + 0.07f) {
        ASSERT_FLOAT_EQ(v[i], 0.0f) << x << rest;
      }
    }
  }
  // The lit side of the ball does not shadow itself, what is in front of it is lit.
  for (float v : along(-0.3f, 0.3f, 2.9f)) ASSERT_FLOAT_EQ(v, 0.0f);
  // Outside of the map, and behind its camera.
  for (float v : along(100, 200, 8)) ASSERT_FLOAT_EQ(v, 0.0f);
  for (float v : along(-1, 1, -5)) ASSERT_FLOAT_EQ(v, 0.0f);
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

TEST_F(ShadowTest, PercentagesOfTheEdge) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  const float radius = 8 * std::tan(std::asin(0.25f)), span = 2 * 8 * std::tan(kFov * kPi / 360);
  // A blur of 0.1 of the map: a ramp of that width around the edge.
  const float blur = 0.1f;
  for (const char* samples : {"16", "256"}) {
    const auto v = along(0, 4, 8, std::string(", \"blur\", .1, \"samples\", ") + samples);
    double worst = 0;
    for (uint32_t i = 0; i < 64; ++i) {
      const float x = 4 * float(i) / 63, across = (radius - x) / (blur * span) + 0.5f;
      worst = std::max(worst, double(std::fabs(v[i] - std::clamp(across, 0.0f, 1.0f))));
    }
    // 16 stratified samples: an error of at most 2 strata of 4; the circle's curvature adds a little.
    EXPECT_LT(worst, samples[0] == '1' ? 0.3 : 0.12) << samples;
  }
  // The same numbers every time.
  EXPECT_EQ(along(0, 4, 8, ", \"blur\", .1"), along(0, 4, 8, ", \"blur\", .1"));
}

// A light as large as the ball: at the edge of the hard shadow half of it shows, its penumbra is as wide
// again.
TEST_F(ShadowTest, TheCornersOfALightMakePenumbras) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  const float radius = 8 * std::tan(std::asin(0.25f));
  const auto hard = along(0, 4, 8, ", \"source\", point(0, 0, 0), \"samples\", 4");
  const auto soft =
      along(0, 4, 8,
            ", \"source\", point(-.5, -.5, 0), point(.5, -.5, 0), point(.5, .5, 0), point(-.5, .5, 0), "
            "\"gapbias\", .1, \"samples\", 256");
  for (uint32_t i = 0; i < 64; ++i) {
    const float x = 4 * float(i) / 63;
    if (std::fabs(x - radius) > 0.2f) {
      EXPECT_FLOAT_EQ(hard[i], x < radius ? 1.0f : 0.0f) << x;
    }
    // By similar triangles the penumbra reaches 0.5 (8 - 4) / 4 to either side. Lines through the ball's rim
    // may pass between two steps.
    if (std::fabs(x - radius) > 0.7f) {
      EXPECT_NEAR(soft[i], x < radius ? 1.0f : 0.0f, 0.1f) << x;
    }
    if (std::fabs(x - radius) < 0.1f) {
      EXPECT_NEAR(soft[i], 0.5f, 0.2f) << x;
    }
  }
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

TEST_F(ShadowTest, ASlantedPlaneDoesNotShadowItself) {
  matrices = cameraMatrices({0, 0, 0}, kFov);
  const float scale = std::tan(kFov * kPi / 360);
  // The plane z = 6 + 1.5 x; texels hold the smallest depth of their area, as depth images do.
  picture("slant.tif", kSize, kSize, 1,
          [&](int x, int, int) {
            const auto depth = [&](double px) {
              return 6 / (1 - 1.5 * (px / kSize * 2 - 1) * double(scale));
            };
            const double d = std::min(depth(x), depth(x + 1));
            return d > 0 ? float(d) : 1e38f;
          },
          OIIO::TypeDesc::FLOAT, matrices.data(), {"Z"});
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"slant.tif"}, "slant.shd").ok());
  for (const char* blur : {"0", ".02"}) {
    grid(31, 31);
    run(std::string(
            "float shadow(\"slant.shd\", point(2 * s - 1, 2 * t - 1, 6 + 1.5 * (2 * s - 1)), \"blur\", ") +
        blur + ")");
    for (uint32_t i = 0; i < f.count; ++i) ASSERT_FLOAT_EQ(f.Ci(i), 0.0f) << i << " " << blur;
  }
  // With an explicit bias that is large enough, too; with none at all there is acne.
  f.host.bias = {0, 0};
  run("float shadow(\"slant.shd\", point(2 * s - 1, 2 * t - 1, 6 + 1.5 * (2 * s - 1)))");
  double acne = 0;
  for (uint32_t i = 0; i < f.count; ++i) acne += f.Ci(i);
  EXPECT_GT(acne, 50) << "the test can fail";
  f.host.bias = {0.2f, 0.3f};
  run("float shadow(\"slant.shd\", point(2 * s - 1, 2 * t - 1, 6 + 1.5 * (2 * s - 1)))");
  for (uint32_t i = 0; i < f.count; ++i) ASSERT_FLOAT_EQ(f.Ci(i), 0.0f);
}

TEST_F(ShadowTest, ListsOfMapsAndOtherWaysToNameThem) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  // The second map sees nothing but empty space around the same axis.
  picture("empty.tif", 64, 64, 1, [](int, int, int) { return 1e38f; }, OIIO::TypeDesc::FLOAT, matrices.data(),
          {"Z"});
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8, "", "ball.shd,empty.tif")[30], 0.5f);
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8, "", "ball.shd, ball.shd")[30], 1.0f);
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8, "", "ball.z")[30], 1.0f) << "a depth image is a map too";
  EXPECT_TRUE(errors.empty()) << errors[0].str();
  // A colour, four points.
  grid(3, 3);
  run("color shadow(\"ball.shd\", point(-.01,-.01,8), point(.01,-.01,8), point(-.01,.01,8), "
      "point(.01,.01,8))");
  EXPECT_EQ(Vec3(f.Ci(0, 0), f.Ci(0, 1), f.Ci(0, 2)), Vec3(1));
  // A missing map counts as absent and is said once.
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8, "", "ball.shd,nosuch.shd")[30], 1.0f);
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8, "", "nosuch.shd")[30], 0.0f);
  EXPECT_EQ(errorCount(RiError::kNoFile), 1);
}

TEST_F(ShadowTest, CurrentSpaceMayBeElsewhere) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  // World is current space moved by 5 in x: the point (5, 0, 8) of current space is (0, 0, 8) of the world.
  f.host.spaces["world"][3] = DVec4(5, 0, 0, 1);
  EXPECT_FLOAT_EQ(along(4.9f, 5.1f, 8)[30], 1.0f);
  EXPECT_FLOAT_EQ(along(-0.1f, 0.1f, 8)[30], 0.0f);
}

TEST_F(ShadowTest, TextureInfo) {
  ASSERT_TRUE(make(FR_MAKE_SHADOW, {"ball.z"}, "ball.shd").ok());
  picture(
      "p.tif", 40, 30, 3, [](int x, int, int c) { return c == 0 ? float(x) / 39 : 0.5f; },
      OIIO::TypeDesc::UINT16);
  ASSERT_TRUE(make(FR_MAKE_LATLONG, {"p.tif"}, "p.env").ok());
  const auto ask = [&](const std::string& name, const std::string& what, const std::string& type,
                       const std::string& expression) {
    f.resize(3, 3);
    run("color(found, " + expression + ", 0)", "",
        "uniform " + type + "; uniform float found = textureinfo(\"" + name + "\", \"" + what + "\", v);");
    return Vec2(f.Ci(0, 0), f.Ci(0, 1));
  };
  EXPECT_EQ(ask("p.tif", "resolution", "float v[2]", "v[0] + v[1] / 1000"), Vec2(1, 40.03f));
  EXPECT_EQ(ask("p.tif", "channels", "float v = 0", "v"), Vec2(1, 3));
  EXPECT_EQ(ask("p.tif", "bitsperchannel", "float v = 0", "v"), Vec2(1, 16));
  EXPECT_EQ(ask("p.tif", "type", "string v = \"\"", "(v == \"texture\" ? 1 : 0)"), Vec2(1, 1));
  EXPECT_EQ(ask("p.env", "type", "string v = \"\"", "(v == \"environment\" ? 1 : 0)"), Vec2(1, 1));
  EXPECT_EQ(ask("ball.shd", "type", "string v = \"\"", "(v == \"shadow\" ? 1 : 0)"), Vec2(1, 1));
  EXPECT_EQ(ask("ball.shd", "viewingmatrix", "matrix v = 3", "comp(v, 0, 0)"), Vec2(1, 1));
  const Vec2 p = ask("ball.shd", "projectionmatrix", "matrix v = 3", "comp(v, 0, 0)");
  EXPECT_NEAR(p.y, 1 / std::tan(kFov * kPi / 360), 1e-4f);
  EXPECT_EQ(ask("ball.shd", "viewingmatrix", "float v[16]", "v[5]"), Vec2(1, 1));
  EXPECT_EQ(ask("p.tif", "max", "float v[3]", "v[0] + v[1]"), Vec2(1, 1.5f + 0.5f / 65535))
      << "16 bits of one half";
  EXPECT_EQ(ask("p.tif", "viewingmatrix", "float v = 7", "v"), Vec2(0, 7)) << "no camera: nothing is written";
  EXPECT_EQ(ask("p.tif", "resolution", "float v[3]", "v[0]"), Vec2(0, 0)) << "another length";
  EXPECT_EQ(ask("p.tif", "nonsense", "float v = 7", "v"), Vec2(0, 7));
  EXPECT_EQ(ask("p.tif", "exists", "float v = 7", "v"), Vec2(1, 1));
}

}  // namespace
}  // namespace fr
