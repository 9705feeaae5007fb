#include "scene_cache/primitive_run.h"

#include <gtest/gtest.h>

#include <fmt/format.h>

#include "scene_cache/dice_scene.h"

namespace fr::cache {
namespace {

/// Requests of one kind, each with values of its own.
std::string request(bool bicubic, int i) {
  const int side = bicubic ? 4 : 2;
  std::string p, weights, corners;
  for (int v = 0; v < side; ++v)
    for (int u = 0; u < side; ++u) {
      p += fmt::format("{} {} {} ", i + double(u) / (side - 1), double(v) / (side - 1),
                       0.1 * ((i + u * v) % 3));
      weights += fmt::format("{} ", i * 100 + v * 10 + u);
    }
  for (int k = 0; k < 4; ++k) corners += fmt::format("{} ", i * 10 + k);
  return fmt::format(
      "Patch \"{}\" \"P\" [{}] \"vertex float weight\" [{}] \"varying float corner\" [{}] \"facevarying "
      "float "
      "own\" [{}] \"uniform color tint\" [{} 1 2]\n",
      bicubic ? "bicubic" : "bilinear", p, weights, corners, corners, i);
}

/// What a shader gets at a few places of every patch.
std::vector<float> valuesOf(const SceneCache& c) {
  std::vector<float> all;
  const Skeleton& s = c.skeleton();
  const float u[5] = {0, 0.25f, 0.7f, 1, 1}, v[5] = {0, 0.5f, 0.1f, 0, 1};
  for (NodeId n = 0; n < s.rootPatches().size(); ++n) {
    float x[12][5];
    SurfaceOut out;
    for (int k = 0; k < 3; ++k) out.P[k] = x[k], out.dPdu[k] = x[3 + k], out.N[k] = x[6 + k];
    c.evaluateSurface(n, 5, nullptr, u, v, out);
    for (int k = 0; k < 9; ++k) all.insert(all.end(), x[k], x[k] + 5);
    c.evaluateParameters(n, 5, nullptr, u, v, x[0], x[1], x[2], x[3]);
    for (int k = 0; k < 4; ++k) all.insert(all.end(), x[k], x[k] + 5);
    for (const char* name : {"weight", "corner", "own", "tint"}) {
      const ParamRecord* p = s.find(c.objectOf(n).primvars, name);
      if (!p) continue;
      float* const values[3] = {x[0], x[1], x[2]};
      EXPECT_TRUE(c.evaluatePrimvar(n, *p, 5, nullptr, u, v, values)) << name;
      for (int k = 0; k < (std::string_view(name) == "tint" ? 3 : 1); ++k)
        all.insert(all.end(), x[k], x[k] + 5);
    }
  }
  return all;
}

/// The requests, one after the other or each under an attribute state of its own.
std::string scene(int n, bool apart, const std::function<std::string(int)>& one) {
  std::string body;
  for (int i = 0; i < n; ++i)
    body += (apart ? fmt::format("Attribute \"user\" \"float i\" [{}]\n", i) : "") + one(i);
  return diceWorld("Format 64 64 1\nProjection \"perspective\" \"fov\" [40]\nTranslate 0 0 12", body);
}

class PatchRuns : public ::testing::TestWithParam<bool> {};

TEST_P(PatchRuns, AreThePatchesThatWereGiven) {
  const auto one = [](int i) { return request(GetParam(), i); };
  const DiceScene together(scene(7, false, one)), apart(scene(7, true, one));
  ASSERT_TRUE(together.cache && apart.cache);
  EXPECT_EQ(together.cache->skeleton().objects().size(), 1u);
  EXPECT_EQ(apart.cache->skeleton().objects().size(), 7u);
  EXPECT_EQ(together.cache->skeleton().rootPatches().size(), 7u);
  EXPECT_EQ(valuesOf(*together.cache), valuesOf(*apart.cache));
  EXPECT_EQ(together.frame.counts().primitives, 7u);
  EXPECT_TRUE(together.reports.empty());
}

INSTANTIATE_TEST_SUITE_P(Kinds, PatchRuns, ::testing::Bool(),
                         [](const auto& i) { return i.param ? "bicubic" : "bilinear"; });

std::string triangle(int i, const std::string& x = "0") {
  return fmt::format("Polygon \"P\" [{0} 0 {1}  {2} 0 0  {0} 1 0] \"uniform color tint\" [{0} 1 2]\n", i, x,
                     i + 1);
}

TEST(PolygonRuns, AreOneMesh) {
  const auto one = [](int i) { return triangle(i); };
  const DiceScene together(scene(5, false, one)), apart(scene(5, true, one));
  ASSERT_TRUE(together.cache && apart.cache);
  EXPECT_EQ(together.cache->skeleton().objects().size(), 1u);
  EXPECT_EQ(apart.cache->skeleton().objects().size(), 5u);
  EXPECT_EQ(valuesOf(*together.cache), valuesOf(*apart.cache));
}

TEST(PolygonRuns, OneBadPolygonLosesNoOther) {
  DiceScene s(scene(5, false, [](int i) { return triangle(i, i == 2 ? "nan" : "0"); }));
  ASSERT_TRUE(s.cache);
  EXPECT_EQ(s.cache->skeleton().objects().size(), 2u);
  EXPECT_EQ(s.cache->skeleton().rootPatches().size(), 4u);
  EXPECT_FALSE(s.reports.empty());
}

TEST(PolygonRuns, EndWhereTheStateOrTheVariablesChange) {
  const std::string body = triangle(0) + triangle(1) + "Color 1 0 0\n" + triangle(2) + "Translate 1 0 0\n" +
                           triangle(3) + "Polygon \"P\" [0 0 0 1 0 0 0 1 0]\n" + "Sphere 1 -1 1 360\n" +
                           triangle(4);
  const DiceScene s(diceWorld("Format 64 64 1\nTranslate 0 0 5", body));
  ASSERT_TRUE(s.cache);
  const auto objects = s.cache->skeleton().objects();
  ASSERT_EQ(objects.size(), 6u);
  EXPECT_EQ(objects[0].patchCount, 2u);
  EXPECT_EQ(objects[4].type, PrimitiveType::kSphere) << "in the order of the requests";
  EXPECT_EQ(objects[5].locationLine, s.frame.counts().primitives > 0 ? objects[4].locationLine + 1 : 0u);
}

TEST(PolygonRuns, ConstantsKeepPolygonsApart) {
  const auto one = [](int i) {
    return fmt::format("Polygon \"P\" [0 0 {0} 1 0 {0} 0 1 {0}] \"constant color tint\" [{0} 0 0]\n", i);
  };
  const DiceScene s(scene(3, false, one));
  ASSERT_TRUE(s.cache);
  EXPECT_EQ(s.cache->skeleton().objects().size(), 3u);
}

}  // namespace
}  // namespace fr::cache
