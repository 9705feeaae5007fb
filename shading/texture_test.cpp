// texture(): values against closed form.
#include <cmath>
#include <thread>

#include "shading/texture_fixture.h"

namespace fr {
namespace {

using OIIO::TypeDesc;

TEST_F(TextureTest, AConstantMapIsConstantUnderEveryFilter) {
  picture(
      "c.png", 64, 32, 3, [](int, int, int c) { return c == 0   ? 1.0f
                                                       : c == 1 ? 0.2f
                                                                : 0.0f; },
      TypeDesc::UINT8);
  picture("c.tif", 50, 37, 3, [](int, int, int c) { return c == 0 ? 1.0f : c == 1 ? 0.2f : 0.0f; });
  picture(
      "c.exr", 33, 64, 3, [](int, int, int c) { return c == 0   ? 1.0f
                                                       : c == 1 ? 0.2f
                                                                : 0.0f; },
      TypeDesc::HALF);
  for (const char* name : {"c.png", "c.tif", "c.exr"})
    for (const char* rest :
         {"", ", \"blur\", 0.2", ", \"width\", 0", ", \"width\", 4", ", \"filter\", \"gaussian\""}) {
      grid(7, 7);
      const std::string coordinates = ", 0.4 + 0.2 * s, 0.4 + 0.2 * t";
      run("color texture(\"" + std::string(name) + "\"" + coordinates + rest + ")");
      for (uint32_t i = 0; i < f.count; ++i) {
        ASSERT_NEAR(f.Ci(i, 0), 1.0f, 1e-3f) << name << rest;
        ASSERT_NEAR(f.Ci(i, 1), 0.2f, 1e-3f) << name << rest;
        ASSERT_NEAR(f.Ci(i, 2), 0.0f, 1e-3f) << name << rest;
      }
    }
  EXPECT_TRUE(errors.empty()) << errors[0].str();
}

// s to the right, t downwards, (0,0) is the top left corner; texel centres stand at (i + 1/2) / n.
TEST_F(TextureTest, LinearRampsAreReproduced) {
  picture("ramp.tif", 64, 64, 3, [](int x, int y, int c) {
    return c == 0 ? (float(x) + 0.5f) / 64 : c == 1 ? (float(y) + 0.5f) / 64 : 0.0f;
  });
  for (const char* width : {"0", "1", "3"}) {
    grid(15, 15);
    run("color texture(\"ramp.tif\", 0.3 + 0.4 * s, 0.3 + 0.4 * t, \"width\", " + std::string(width) + ")");
    for (uint32_t i = 0; i < f.count; ++i) {
      const float s = 0.3f + 0.4f * f.batch.globals[size_t(GlobalId::k_s)].at(i);
      const float t = 0.3f + 0.4f * f.batch.globals[size_t(GlobalId::k_t)].at(i);
      ASSERT_NEAR(f.Ci(i, 0), s, 2e-3f) << width;
      ASSERT_NEAR(f.Ci(i, 1), t, 2e-3f) << width;
    }
  }
}

TEST_F(TextureTest, ChannelsFillAndGreyFiles) {
  picture("four.tif", 8, 8, 4, [](int, int, int c) { return 0.1f * float(c + 1); }, TypeDesc::FLOAT, nullptr,
          {"R", "G", "B", "A"});
  picture("grey.tif", 8, 8, 1, [](int, int, int) { return 0.25f; });
  EXPECT_NEAR(value("float texture(\"four.tif\"[2], .5, .5)").x, 0.3f, 1e-6f);
  EXPECT_NEAR(value("float texture(\"four.tif\"[3], .5, .5)").x, 0.4f, 1e-6f);
  const Vec3 last = value("color texture(\"four.tif\"[2], .5, .5, \"fill\", .75)");
  EXPECT_NEAR(last.x, 0.3f, 1e-6f);
  EXPECT_NEAR(last.y, 0.4f, 1e-6f);
  EXPECT_NEAR(last.z, 0.75f, 1e-6f);
  EXPECT_NEAR(value("float texture(\"four.tif\"[9], .5, .5)").x, 0.0f, 1e-6f);
  // Up to the last texel of a tile, where OpenImageIO would read behind it.
  picture("large.tif", 128, 128, 3, [](int, int, int) { return 0.5f; });
  for (const char* place : {".001", ".497", ".999"}) {
    EXPECT_EQ(value(fmt::format("float texture(\"large.tif\"[3], {0}, {0}, \"fill\", .75)", place)).x, 0.75f);
    EXPECT_EQ(value(fmt::format("color environment(\"large.tif\"[5], vector ({0}, -{0}, 1))", place)),
              Vec3(0.0f));
  }
  const Vec3 grey = value("color texture(\"grey.tif\", .5, .5)");
  EXPECT_EQ(grey, Vec3(0.25f));
  const Vec3 filled = value("color texture(\"grey.tif\", .5, .5, \"fill\", 1)");
  EXPECT_EQ(filled, Vec3(0.25f, 1, 1));
}

TEST_F(TextureTest, WrapModesComeFromTheFile) {
  // Left half 0.25, right half 1.
  picture("half.tif", 64, 64, 1, [](int x, int, int) { return x < 32 ? 0.25f : 1.0f; });
  const auto at = [&](const std::string& name, const std::string& s) {
    return value("float texture(\"" + name + "\", " + s + ", .5)").x;
  };
  for (const char* wrap : {"black", "clamp", "periodic"})
    ASSERT_EQ(madeError(FR_MAKE_TEXTURE, {"half.tif"}, std::string(wrap) + ".tx", wrap), "");
  EXPECT_NEAR(at("black.tx", "1.25"), 0, 1e-6f);
  EXPECT_NEAR(at("black.tx", "-.25"), 0, 1e-6f);
  EXPECT_NEAR(at("clamp.tx", "1.25"), 1, 1e-6f);
  EXPECT_NEAR(at("clamp.tx", "-.25"), 0.25f, 1e-6f);
  EXPECT_NEAR(at("periodic.tx", "1.25"), 0.25f, 1e-6f);
  EXPECT_NEAR(at("periodic.tx", "-.25"), 1, 1e-6f);
  EXPECT_NEAR(at("black.tx", ".25"), 0.25f, 1e-6f);
  EXPECT_NEAR(at("half.tif", "1.25"), 0, 1e-6f) << "files that say nothing are black outside";
}

TEST_F(TextureTest, WidthAndBlurAverage) {
  picture("checker.tif", 256, 256, 1, [](int x, int y, int) { return (x + y) & 1 ? 1.0f : 0.0f; });
  // Neighbours 16 texels apart see the mean; without a filter they see single texels.
  grid(15, 15);
  const std::string place = "\"checker.tif\", (0.5 + 240 * s) / 256, (0.5 + 240 * t) / 256";
  run("float texture(" + place + ")");
  for (uint32_t i = 0; i < f.count; ++i) {
    const float s = f.batch.globals[size_t(GlobalId::k_s)].at(i),
                t = f.batch.globals[size_t(GlobalId::k_t)].at(i);
    if (s > 0.1f && s < 0.9f && t > 0.1f && t < 0.9f) {
      ASSERT_NEAR(f.Ci(i), 0.5f, 0.01f);
    }
  }
  run("float texture(" + place + ", \"width\", 0)");
  for (uint32_t i = 0; i < f.count; ++i)
    ASSERT_NEAR(f.Ci(i), 0.0f, 1e-3f) << "even texels of even rows are black";

  picture("step.tif", 256, 256, 1, [](int x, int, int) { return x < 128 ? 0.0f : 1.0f; });
  const auto step = [&](float s, const std::string& blur) {
    return value("float texture(\"step.tif\", " + std::to_string(s) + ", .5, " + blur + ")").x;
  };
  EXPECT_NEAR(step(0.5f, "\"sblur\", .2"), 0.5f, 0.01f);
  EXPECT_NEAR(step(0.25f, "\"sblur\", .2"), 0.0f, 0.01f);
  EXPECT_NEAR(step(0.75f, "\"sblur\", .2"), 1.0f, 0.01f);
  float last = -1;
  for (float s = 0.3f; s <= 0.7f; s += 0.02f) {
    const float now = step(s, "\"blur\", .2");
    EXPECT_GE(now, last - 1e-3f);
    last = now;
  }
  EXPECT_GT(step(0.47f, "\"sblur\", .2"), 0.15f) << "blur reaches past the edge";
  EXPECT_LT(step(0.47f, "\"tblur\", .2"), 0.02f) << "blur in t does not blur in s";
  EXPECT_LT(step(0.47f, "\"blur\", 0"), 0.02f);
}

// A zone plate's frequency grows with the radius. Where it is beyond what the samples can carry, a good
// filter leaves the mean and no rings.
TEST_F(TextureTest, AZonePlateDoesNotAlias) {
  constexpr int n = 512, m = 31;
  picture("zone.tif", n, n, 1, [](int x, int y, int) {
    const double dx = x + 0.5 - n / 2, dy = y + 0.5 - n / 2;
    return float(0.5 + 0.5 * std::cos((dx * dx + dy * dy) * 3.14159265358979 / n));
  });
  const auto aliasEnergy = [&](const std::string& width) {
    grid(m, m);
    run("float texture(\"zone.tif\", .05 + .9 * s, .05 + .9 * t, \"width\", " + width + ")");
    double sum = 0;
    int count = 0;
    for (uint32_t i = 0; i < f.count; ++i) {
      const double s = f.batch.globals[size_t(GlobalId::k_s)].at(i) - 0.5,
                   t = f.batch.globals[size_t(GlobalId::k_t)].at(i) - 0.5;
      if (s * s + t * t < 0.12) continue;  // cycles a sample at this radius: far above one half
      sum += (f.Ci(i) - 0.5) * (f.Ci(i) - 0.5), ++count;
    }
    return std::sqrt(sum / count);
  };
  EXPECT_LT(aliasEnergy("1"), 0.02);
  EXPECT_GT(aliasEnergy("0"), 0.2) << "the test can fail";
}

TEST_F(TextureTest, EightCoordinatesAreAFilterQuad) {
  picture("ramp.tif", 64, 64, 3, [](int x, int y, int c) {
    return c == 0 ? (float(x) + 0.5f) / 64 : c == 1 ? (float(y) + 0.5f) / 64 : float((x / 4 + y / 4) & 1);
  });
  const Vec3 patch = value("color texture(\"ramp.tif\", .3,.3, .7,.3, .3,.7, .7,.7)");
  const Vec3 around = value("color texture(\"ramp.tif\", .3,.3, .7,.3, .7,.7, .3,.7)");
  EXPECT_NEAR(patch.x, 0.5f, 0.01f);
  EXPECT_NEAR(patch.y, 0.5f, 0.01f);
  EXPECT_NEAR(patch.z, 0.5f, 0.05f) << "the checker is averaged";
  EXPECT_EQ(patch, around);
  const Vec3 small = value("color texture(\"ramp.tif\", .53,.53, .531,.53, .53,.531, .531,.531)");
  EXPECT_TRUE(small.z < 0.1f || small.z > 0.9f) << small.z;
  // The same as two coordinates whose neighbours are so far away.
  grid(4, 4);
  run("color texture(\"ramp.tif\", .2 + .6 * s, .2 + .6 * t)");
  const Vec3 twoCoordinates(f.Ci(12, 0), f.Ci(12, 1), f.Ci(12, 2));
  const Vec3 eight = value("color texture(\"ramp.tif\", .425,.425, .575,.425, .425,.575, .575,.575)");
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(twoCoordinates[c], eight[c], 1e-4f);
}

TEST_F(TextureTest, UniformAndVaryingCallsAgreeAtEveryBatchSize) {
  picture("noise.tif", 32, 32, 3,
          [](int x, int y, int c) { return float((x * 7 + y * 13 + c * 5) % 11) / 10; });
  const Vec3 one = value("color texture(\"noise.tif\", .37, .61)");
  for (uint32_t columns : {1u, 2u, 14u, 15u, 16u, 17u, 31u, 32u, 33u}) {
    f.resize(columns, 0);
    run("color texture(\"noise.tif\", .37 + 0 * s, .61 + 0 * t)");
    for (uint32_t i = 0; i < f.count; ++i)
      for (uint32_t c = 0; c < 3; ++c) ASSERT_EQ(f.Ci(i, c), one[int(c)]) << columns << " " << i;
  }
  // A point's value does not depend on its place in the batch.
  f.resize(47, 0);
  run("color texture(\"noise.tif\", s, .3)");
  const std::vector<float> all = [&] {
    std::vector<float> v;
    for (uint32_t i = 0; i < f.count; ++i) v.push_back(f.Ci(i, 1));
    return v;
  }();
  for (uint32_t i : {0u, 15u, 16u, 31u, 46u}) {
    const Vec3 v =
        value("color texture(\"noise.tif\", " + fmt::format("{:.9g}", double(float(i) / 47.0f)) + ", .3)");
    EXPECT_NEAR(v.y, all[i], 1e-5f) << i;
  }
}

TEST_F(TextureTest, OnlyActivePointsAreLookedUp) {
  picture("one.tif", 16, 16, 1, [](int, int, int) { return 1.0f; });
  grid(15, 3);
  run("float texture(\"one.tif\", s, t)");  // the count is the process's, and known from the first call on
  const auto before = library->statistics().lookups;
  run("c", "", "float c = 0.5; if (s > 0.5) c = float texture(\"one.tif\", .5 + 0 * s, t * .5 + .25);");
  uint64_t active = 0;
  for (uint32_t i = 0; i < f.count; ++i) {
    const bool in = f.batch.globals[size_t(GlobalId::k_s)].at(i) > 0.5f;
    active += in;
    ASSERT_NEAR(f.Ci(i), in ? 1.0f : 0.5f, 1e-6f);
  }
  EXPECT_EQ(library->statistics().lookups - before, active);
}

TEST_F(TextureTest, DerivativesOfTexturesFollowTheRamp) {
  picture("ramp.tif", 64, 64, 1, [](int x, int, int) { return (float(x) + 0.5f) / 64; });
  grid(15, 15);
  run("Du(float texture(\"ramp.tif\", .3 + .4 * s, .3 + .4 * t))");
  for (uint32_t i = 0; i < f.count; ++i) ASSERT_NEAR(f.Ci(i), 0.4f, 0.01f);
}

TEST_F(TextureTest, NumbersWithoutSenseDoNoHarm) {
  picture("one.tif", 16, 16, 1, [](int, int, int) { return 1.0f; });
  for (const char* s : {"1e30", "-1e30", "1e38 * 1e38", "log(0) * 0", "sqrt(-1)"}) {
    grid(3, 3);
    run("float texture(\"one.tif\", s * (" + std::string(s) + "), t, \"blur\", s * " + s + ", \"width\", " +
        s + ")");
    for (uint32_t i = 0; i < f.count; ++i) ASSERT_TRUE(std::isfinite(f.Ci(i)) && std::fabs(f.Ci(i)) < 2) << s;
    run("color environment(\"one.tif\", P * " + std::string(s) + ", \"blur\", 1e30)");
    for (uint32_t i = 0; i < f.count; ++i) ASSERT_TRUE(std::isfinite(f.Ci(i)) && std::fabs(f.Ci(i)) < 2) << s;
  }
}

TEST_F(TextureTest, EveryFootprintIsFinite) {
  picture("one.tif", 64, 16, 1, [](int, int, int) { return 1.0f; });
  const Texture& texture = library->find("one.tif");
  ASSERT_TRUE(texture.file);
  uint64_t random = 1;
  const auto next = [&] { return toUnitFloat64(random = mix64(random + 0x9e3779b97f4a7c15ull)); };
  for (int k = 0; k < 100000; ++k) {
    float place[2], change[4], blur[2], result = 0;
    for (float& x : place) x = next() * 3 - 1;
    for (float& x : change)
      x = (next() - 0.5f) * std::pow(10.0f, next() * 34 - 14) * (next() < 0.7f ? 1.0f : 0.0f);
    if (next() < 0.3f) change[2] = change[0], change[3] = change[1] * (next() < 0.5f ? 1.0f : 1.0000001f);
    for (float& x : blur) x = next() < 0.5f ? 0 : std::pow(10.0f, next() * 20 - 14);
    FrTextureCall call{};
    call.lanes = 1, call.channelCount = 1, call.sWidth = call.tWidth = 1;
    for (int c = 0; c < 2; ++c)
      call.place[c] = {place + c, 0}, call.placeDx[c] = {change + c, 0},
      call.placeDy[c] = {change + 2 + c, 0};
    call.sBlur = {blur, 0}, call.tBlur = {blur + 1, 0};
    call.result = &result, call.resultStride = 1;
    library->call(texture, [&](const FrTextureModule& m, char* message, size_t size) {
      return m.texture(texture.file, &call, message, size);
    });
    ASSERT_TRUE(result >= -1e-3f && result <= 1.001f) << k << " " << result;
  }
}

TEST_F(TextureTest, BumpTiltsTheNormalByTheSlope) {
  // Height 0.5 s over a plane of dPds = x, dPdt = y: the normal of (1, 0, .5 h) x (0, 1, 0).
  picture("height.tif", 128, 128, 1, [](int x, int, int) { return 0.5f * (float(x) + 0.5f) / 128; });
  grid(7, 7);
  run("color(xcomp(n), ycomp(n), zcomp(n))", "",
      "normal n = bump(\"height.tif\", normal(0,0,1), vector(1,0,0), vector(0,1,0), .4 + .2 * s, .4 + .2 * "
      "t);");
  for (uint32_t i = 0; i < f.count; ++i) {
    ASSERT_NEAR(f.Ci(i, 0), -0.5f, 0.02f);
    ASSERT_NEAR(f.Ci(i, 1), 0.0f, 0.01f);
    ASSERT_NEAR(f.Ci(i, 2), 1.0f, 1e-4f);
  }
  // A normal that looks the other way keeps its side; the surface is moved along it.
  run("color(xcomp(n), ycomp(n), zcomp(n))", "",
      "normal n = bump(\"height.tif\", normal(0,0,-2), vector(1,0,0), vector(0,1,0), .4 + .2 * s, .4 + .2 * "
      "t);");
  ASSERT_NEAR(f.Ci(9, 0), -1.0f, 0.04f);
  ASSERT_NEAR(f.Ci(9, 2), -2.0f, 1e-4f);
}

TEST_F(TextureTest, ThreadsShareOneCache) {
  picture("noise.tif", 300, 200, 3,
          [](int x, int y, int c) { return float((x * 7 + y * 13 + c * 5) % 11) / 10; });
  const std::string source = "surface t() { Ci = color texture(\"noise.tif\", s, t); Oi = 1; }";
  std::vector<float> results[4];
  std::vector<std::thread> threads;
  for (auto& result : results)
    threads.emplace_back([&, this] {
      MachineFixture mine(15, 15);
      mine.host.library = library.get();
      const auto shader = mine.shader(source);
      for (int repeat = 0; repeat < 20; ++repeat) mine.run(*shader);
      for (uint32_t i = 0; i < mine.count; ++i) result.push_back(mine.Ci(i, 0));
    });
  for (std::thread& t : threads) t.join();
  for (int k = 1; k < 4; ++k) EXPECT_EQ(results[0], results[k]);
}

}  // namespace
}  // namespace fr
