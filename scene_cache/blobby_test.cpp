#include "scene_cache/blobby.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scene_cache/edge_count.h"

namespace fr::cache {
namespace {

const std::string kUnit = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 ";
std::string at(double x, double y, double z) {
  return fmt::format("1 0 0 0 0 1 0 0 0 0 1 0 {} {} {} 1 ", x, y, z);
}

BlobField fieldOf(int leaves, std::vector<int> code, std::vector<float> floats) {
  ri::Blobby b;
  b.nleaf = leaves, b.code = std::move(code), b.floats = std::move(floats);
  std::vector<std::string> warnings;
  auto f = BlobField::parse(b, &warnings);
  EXPECT_TRUE(f.ok());
  EXPECT_TRUE(warnings.empty());
  return f.ok() ? *std::move(f) : BlobField();
}

TEST(Blobby, OpcodesDoWhatTheTableSays) {
  const auto value = [](std::vector<int> op) {
    std::vector<int> code{1000, 0, 1000, 1};
    code.insert(code.end(), op.begin(), op.end());
    return fieldOf(2, code, {6, 2}).at(DVec3(0)).value;
  };
  EXPECT_EQ(value({0, 2, 0, 1}), 8);
  EXPECT_EQ(value({1, 2, 0, 1}), 12);
  EXPECT_EQ(value({2, 2, 0, 1}), 6);
  EXPECT_EQ(value({3, 2, 0, 1}), 2);
  EXPECT_EQ(value({4, 1, 0}), 4);  // subtrahend, minuend
  EXPECT_EQ(value({5, 0, 1}), 3);  // dividend, divisor
  EXPECT_EQ(value({6, 0}), -6);
  EXPECT_EQ(value({7, 1}), 2);
}

TEST(Blobby, GradientsRangesAndReductionsFitTheField) {
  const BlobField f =
      fieldOf(3, {1001, 0, 1002, 16, 1001, 39, 4, 2, 0, 1, 2, 1, 3, 2, 2, 4, 3},
              {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0,   0, 0, 0, 1, -1,  0, 0, 1, 0, 0,   .5f, 1,   0,   0, 0, 0,
               1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, .5f, 0, 0, 0, 0, .5f, 0, 0, 0, 0, .5f, 0,   .3f, .2f, 0, 1});
  for (int i = 0; i < 400; ++i) {
    const DVec3 p(std::sin(i * 1.7), std::sin(i * 2.3), 0.5 * std::sin(i * 3.1));
    const BlobSample s = f.at(p);
    for (int c = 0; c < 3; ++c) {
      DVec3 h(0);
      h[c] = 1e-6;
      const double slope = (f.at(p + h).value - f.at(p - h).value) / 2e-6;
      EXPECT_NEAR(s.gradient[c], slope, 1e-3) << i;
    }
    Box3d box;
    box.extend(p - DVec3(0.1, 0.05, 0.2)), box.extend(p + DVec3(0.02, 0.1, 0.1));
    const BlobRange r = f.over(box);
    const BlobField part = f.inside(box);
    for (int k = 0; k < 8; ++k) {
      const DVec3 q = box.corner(k);
      const double v = f.at(q).value;
      EXPECT_GE(v, r.low - 1e-12);
      EXPECT_LE(v, r.high + 1e-12);
      EXPECT_EQ(part.at(q).value, v);
    }
  }
}

TEST(Blobby, OneLeafIsASphere) {
  const BlobField f = fieldOf(1, {1001, 0}, {2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1});
  const BlobMesh m = polygonise(f, 0.1, 100000);
  ASSERT_GT(m.points.size(), 100u);
  double volume = 0;
  for (size_t i = 0; i < m.points.size(); ++i) {
    const DVec3 p = m.points[i] - DVec3(1, 0, 0);
    EXPECT_NEAR(glm::length(p), 1, 1e-6);  // half the radius of the leaf
    EXPECT_NEAR(glm::dot(p, m.normals[i]), 1, 1e-6);
  }
  for (size_t t = 0; t < m.triangles.size(); t += 3)
    volume += glm::dot(m.points[m.triangles[t]],
                       glm::cross(m.points[m.triangles[t + 1]], m.points[m.triangles[t + 2]])) /
              6;
  EXPECT_NEAR(volume, 4.18879, 0.05);  // outwards: positive
}

TEST(Blobby, SurfacesAreClosed) {
  const std::string two =
      "Blobby 2 [1001 0 1001 16 0 2 0 1] [" + at(-0.5, 0, 0) + at(0.6, 0.2, 0) + "] [\"\"]\n";
  const std::string cut =
      "Blobby 2 [1001 0 1002 16 4 1 0] [" + kUnit + "-1 0 -.4 1 0 -.4 .4 " + kUnit + "] [\"\"]\n";
  expectWatertight("two", two, {3, 8});
  expectWatertight("cut", cut, {3});
}

TEST(Blobby, VariablesAreBlended) {
  DiceScene s(diceWorld(diceCamera(4), "Blobby 2 [1001 0 1001 16 0 2 0 1] [" + at(-0.5, 0, 0) +
                                           at(0.5, 0, 0) + "] [\"\"] \"varying float a\" [0 1]\n"));
  ASSERT_TRUE(s.cache);
  EXPECT_TRUE(s.reports.empty());
  const ObjectRecord& o = s.cache->skeleton().objects()[0];
  const ParamRecord* a = s.cache->skeleton().find(o.primvars, "a");
  ASSERT_TRUE(a);
  const auto values = s.cache->skeleton().floats(*a);
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  EXPECT_EQ(*low, 0);  // where the other leaf does not reach
  EXPECT_EQ(*high, 1);
  EXPECT_TRUE(std::any_of(values.begin(), values.end(), [](float x) { return x > 0.45f && x < 0.55f; }));
}

TEST(Blobby, BadCodeIsReported) {
  const std::pair<const char*, const char*> bad[] = {
      {"Blobby 1 [1001] [1] [\"\"]", "no operand"},
      {"Blobby 1 [1001 0] [1 0 0] [\"\"]", "reads floats"},
      {"Blobby 1 [1000 0 0 2 0 1] [1] [\"\"]", "not an earlier"},
      {"Blobby 1 [1000 0 0 2000000000 0] [1] [\"\"]", "needs"},
      {"Blobby 1 [1000 0 99] [1] [\"\"]", "not known"},
      {"Blobby 2 [1000 0] [1] [\"\"]", "announced"},
      {"Blobby 1 [1001 0] [0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1] [\"\"]", "inverse"}};
  for (const auto& [body, message] : bad) {
    DiceScene s(diceWorld(diceCamera(4), std::string(body) + "\n"));
    ASSERT_TRUE(s.cache) << body;
    EXPECT_TRUE(s.cache->skeleton().objects().empty()) << body;
    ASSERT_FALSE(s.reports.empty()) << body;
    EXPECT_NE(s.reports[0].str().find(message), std::string::npos) << s.reports[0].str();
  }
}

}  // namespace
}  // namespace fr::cache
