// The four questions against closed forms, and what must not change an answer.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <random>

#include "tracer/inproc_oracle.h"
#include "tracer/testing/analytic_scene.h"
#include "tracer/testing/ray_batches.h"

namespace fr::tracer {
namespace {

using cache::CastsShadows;
using testing::AnalyticLook;
using testing::AnalyticScene;
using testing::AnalyticShape;
using testing::setRay;

struct Fixed {
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<ShadingSystem> shading;
  std::unique_ptr<RayTracer> tracer;
  std::unique_ptr<AnswerThread> thread;
  std::unique_ptr<RayQuery> q = std::make_unique<RayQuery>();

  explicit Fixed(AnalyticScene& s, RayTracerOptions o = {}) {
    cache = s.finish();
    shading = std::make_unique<ShadingSystem>(*cache, ShadingSystem::Options{});
    tracer = std::make_unique<RayTracer>(*cache, *shading, o);
    thread = std::make_unique<AnswerThread>(*tracer);
    std::memset(static_cast<void*>(q.get()), 0, sizeof *q);
  }
  RayQuery& ask(RayKind kind, const Vec3& origin, const Vec3& direction, uint32_t level = 1) {
    q->kind = kind, q->count = 1, q->level = level;
    setRay(*q, 0, origin, direction);
    thread->answer(*q);
    return *q;
  }
};

AnalyticShape plane(float z, float size = 5) {
  return {.kind = AnalyticShape::kPlane, .center = {0, 0, z}, .axisU = {size, 0, 0}, .axisV = {0, size, 0}};
}

TEST(Answer, HitTestGivesDistanceInUnitsOfLength) {
  AnalyticScene s;
  s.add({.center = {0, 0, 10}, .radius = 2, .patchesU = 8, .patchesV = 8});
  Fixed t(s);
  for (float scale : {1.0f, 1e-6f, 1e6f, 1e-30f}) {
    const RayQuery& q = t.ask(RayKind::kHitTest, {0.5f, 0, 0}, Vec3(0, 0, scale));
    const float z = 10 - std::sqrt(4 - 0.25f);
    EXPECT_NEAR(q.hitDistance[0], z, 0.01f);
    EXPECT_NEAR(q.hitP[2][0], z, 0.01f);
    EXPECT_NEAR(q.hitN[2][0], -std::sqrt(4 - 0.25f) / 2, 0.02f);
  }
  EXPECT_EQ(t.ask(RayKind::kHitTest, {5, 0, 0}, {0, 0, 1}).hitDistance[0], kNoHit);
}

TEST(Answer, HitTestSaysNoMoreThanIsWanted) {
  AnalyticScene s;
  s.add({.center = {0, 0, 4}, .radius = 2, .patchesU = 8, .patchesV = 8});
  s.add(plane(7), {.opacity = {0.5f, 0.25f, 0}});
  Fixed t(s);
  std::mt19937 random(3);
  std::uniform_real_distribution<float> at(-1, 1);
  uint32_t hits = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 from(at(random), at(random), at(random)), direction(at(random), at(random), at(random));
    t.q->terms = RayTerms{};
    t.q->terms.maxDistance = i % 2 ? 3.0f : 0.0f;
    const float distance = t.ask(RayKind::kHitTest, from, direction).hitDistance[0];
    const float x = t.q->hitP[0][0] = 17;
    t.q->terms.flags = RayTerms::kOnlyDistance;
    EXPECT_EQ(t.ask(RayKind::kHitTest, from, direction).hitDistance[0], distance);
    t.q->terms.flags = RayTerms::kOnlyWhether;
    EXPECT_EQ(t.ask(RayKind::kHitTest, from, direction).hitDistance[0], distance < kNoHit ? 0.0f : kNoHit);
    EXPECT_EQ(t.q->hitP[0][0], x);
    t.q->terms.flags = RayTerms::kOnlyWhether | RayTerms::kWantsNode;
    t.ask(RayKind::kHitTest, from, direction);
    EXPECT_EQ(t.q->hitNode[0] != cache::kNone, distance < kNoHit);
    hits += distance < kNoHit;
  }
  EXPECT_GT(hits, 100u);
  EXPECT_LT(hits, 1700u);
}

TEST(Answer, VisibilityMultipliesOpacities) {
  AnalyticScene s;
  s.add(plane(1), {.opacity = {0.5f, 0.25f, 0}});
  s.add(plane(2), {.opacity = {0.5f, 0.5f, 0.5f}});
  s.add(plane(7), {});
  Fixed t(s);
  auto& q = t.ask(RayKind::kVisibility, {0.1f, 0.2f, 0}, {0, 0, 5});
  EXPECT_FLOAT_EQ(q.color[0][0], 0.25f);
  EXPECT_FLOAT_EQ(q.color[1][0], 0.375f);
  EXPECT_FLOAT_EQ(q.color[2][0], 0.5f);
  t.ask(RayKind::kVisibility, {0.1f, 0.2f, 0}, {0, 0, 6.9f});
  EXPECT_FLOAT_EQ(q.color[0][0], 0.25f);
  t.ask(RayKind::kVisibility, {0.1f, 0.2f, 0}, {0, 0, 7});  // ends on the opaque one
  EXPECT_FLOAT_EQ(q.color[0][0], 0.25f);
  t.ask(RayKind::kVisibility, {0.1f, 0.2f, 0}, {0, 0, 7.1f});
  EXPECT_EQ(q.color[0][0], 0);
  t.ask(RayKind::kVisibility, {0.1f, 0.2f, 0}, {0, 0, 0});
  EXPECT_EQ(q.color[0][0], 1);
}

TEST(Answer, VisibilityThroughAHalfOpaqueSphereIsAQuarter) {
  AnalyticScene s;
  s.add({.radius = 1, .patchesU = 4, .patchesV = 4}, {.opacity = {0.5f, 0.5f, 0.5f}});
  Fixed t(s);
  std::mt19937 g(1);
  std::uniform_real_distribution<float> r(-0.6f, 0.6f);
  for (int i = 0; i < 1000; ++i) {
    const Vec3 a(r(g), r(g), -4), b(r(g), r(g), 4);
    EXPECT_FLOAT_EQ(t.ask(RayKind::kVisibility, a, b - a).color[0][0], 0.25f);
  }
}

TEST(Answer, CastsShadowsModes) {
  const auto visibility = [](const AnalyticLook& look, float x = 0.5f) {
    AnalyticScene s;
    s.add(plane(1), look);
    Fixed t(s);
    return t.ask(RayKind::kVisibility, {x, 0.2f, 0}, {0, 0, 2}).color[0][0];
  };
  const Color half(0.5f);
  EXPECT_EQ(visibility({.opacity = half, .castsShadows = CastsShadows::kNever}), 1);
  EXPECT_EQ(visibility({.opacity = half, .castsShadows = CastsShadows::kOpaque}), 0);
  EXPECT_EQ(visibility({.opacity = half, .castsShadows = CastsShadows::kOs}), 0.5f);
  EXPECT_EQ(visibility({.shader = "clear", .castsShadows = CastsShadows::kShade}), 0.75f);
  EXPECT_EQ(visibility({.shader = "halves", .castsShadows = CastsShadows::kShade}, 1),
            0);  // u < 0.5 of its patch
  EXPECT_EQ(visibility({.shader = "halves", .castsShadows = CastsShadows::kShade}, 4), 1);
  EXPECT_EQ(visibility({.shader = "constant", .castsShadows = CastsShadows::kShade}), 0);
  EXPECT_EQ(visibility({.shader = "wild", .castsShadows = CastsShadows::kShade}), 0);
}

TEST(Answer, ShadersThatAskForeverEnd) {
  AnalyticScene s;
  for (int i = 0; i < 4; ++i)
    s.add(plane(float(i + 1)), {.shader = "endless", .castsShadows = CastsShadows::kShade});
  s.setMaxRayLevel(3);
  Fixed t(s);
  EXPECT_GE(t.ask(RayKind::kVisibility, {0, 0.1f, 0}, {0, 0, 9}).color[0][0], 0);
}

TEST(Answer, TraceCompositesFrontToBack) {
  AnalyticScene s;
  s.add(plane(1), {.color = {1, 0, 0}, .opacity = {0.5f, 0.5f, 0.5f}});
  s.add(plane(2), {.color = {0, 1, 0}, .opacity = {0.5f, 0.5f, 0.5f}});
  s.add(plane(3), {.color = {0, 0, 1}});
  s.add(plane(4), {.color = {9, 9, 9}});
  Fixed t(s);
  const RayQuery& q = t.ask(RayKind::kFullTrace, {0.3f, 0.4f, 0}, {0, 0, 1});
  EXPECT_FLOAT_EQ(q.color[0][0], 0.5f);
  EXPECT_FLOAT_EQ(q.color[1][0], 0.25f);
  EXPECT_FLOAT_EQ(q.color[2][0], 0.25f);
  EXPECT_FLOAT_EQ(q.hitDistance[0], 1);
  EXPECT_FLOAT_EQ(q.hitP[2][0], 1);
  EXPECT_EQ(q.missDepth[0], 0);
}

TEST(Answer, MirrorsRecurseToTheMaximalLevel) {
  for (int levels : {0, 1, 2, 4, 7}) {
    AnalyticScene s;
    s.add(plane(-1), {.shader = "mirror"});
    AnalyticShape top = plane(1);
    top.inward = 1;
    s.add(top, {.shader = "mirror"});
    s.setMaxRayLevel(levels);
    Fixed t(s);
    float expected = 0;
    for (int i = 0; i < levels; ++i) expected = 0.05f + 0.8f * expected;
    EXPECT_FLOAT_EQ(t.ask(RayKind::kTrace, {0, 0, 0}, {0.01f, 0, 1}).color[0][0], expected) << levels;
    EXPECT_EQ(t.ask(RayKind::kTrace, {0, 0, 0}, {0.01f, 0, 1}, uint32_t(levels) + 1).color[0][0], 0);
  }
}

TEST(Answer, ConcentricMirrorMatchesTheClosedForm) {
  // From outside, a mirror ball reflects a constant white dome: 0.05 + 0.8.
  AnalyticScene s;
  s.add({.radius = 1, .patchesU = 8, .patchesV = 8}, {.shader = "mirror"});
  s.add({.radius = 50, .patchesU = 8, .patchesV = 8, .inward = 1});
  Fixed t(s);
  std::mt19937 g(3);
  std::normal_distribution<float> n;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 o = 3.0f * glm::normalize(Vec3(n(g), n(g), n(g))),
               to = 0.9f * glm::normalize(Vec3(n(g), n(g), n(g)));
    EXPECT_FLOAT_EQ(t.ask(RayKind::kTrace, o, to - o).color[0][0], 0.85f);
  }
}

TEST(Answer, ShadowsFromALightHaveNoAcne) {
  AnalyticScene s;  // the lit shader's light stands at (0.3, 0.2, 8)
  s.add({.radius = 1, .patchesU = 4, .patchesV = 4}, {.shader = "lit"});
  s.add({.kind = AnalyticShape::kPlane, .center = {0, 0, -3}, .axisU = {3, 0, 0}, .axisV = {0, 3, 0}},
        {.shader = "lit"});
  Fixed t(s);
  std::mt19937 g(3);
  std::uniform_real_distribution<float> r(-1, 1);
  int dark = 0;
  for (int i = 0; i < 4000; ++i) {
    const float x = r(g), y = r(g);
    if (x * x + y * y > 0.95f) continue;
    const float z = std::sqrt(1 - x * x - y * y);
    const float cosine = glm::dot(glm::normalize(Vec3(0.3f, 0.2f, 8) - Vec3(x, y, z)), Vec3(x, y, z));
    if (cosine < 0.02f) continue;
    dark += t.ask(RayKind::kTrace, {x, y, 5}, {0, 0, -1}).color[0][0] != 1;
  }
  EXPECT_EQ(dark, 0);
  EXPECT_EQ(t.ask(RayKind::kTrace, {0, 0, -2.5f}, {0, 0, -1}).color[0][0], 0);  // in the shadow of the sphere
  EXPECT_EQ(t.ask(RayKind::kTrace, {2.5f, 2.5f, 0}, {0, 0, -1}).color[0][0], 1);
}

TEST(Answer, FullTraceReportsTheDeepestMiss) {
  AnalyticScene s;
  s.add(plane(1), {.shader = "clear"});
  s.add(plane(2), {.shader = "clear"});
  Fixed t(s);
  auto& q = t.ask(RayKind::kFullTrace, {0.3f, 0.4f, 0}, {0, 0, 2});
  EXPECT_EQ(q.missDepth[0], 3);  // the ray itself, and one more behind each pane
  EXPECT_NEAR(q.missP[2][0], 2, 1e-5);
  EXPECT_GT(q.missR[2][0], 0);
  EXPECT_FLOAT_EQ(q.hitDistance[0], 1);
  t.ask(RayKind::kFullTrace, {0.3f, 0.4f, 0}, {0, 0, -2});
  EXPECT_EQ(q.missDepth[0], 1);
  EXPECT_EQ(q.missP[2][0], 0);
  EXPECT_EQ(q.missR[2][0], -2);
  EXPECT_EQ(q.hitDistance[0], kNoHitFullTrace);
  EXPECT_EQ(q.color[0][0], 0);
}

TEST(Answer, WildShadersGiveFiniteColours) {
  AnalyticScene s;
  s.add(plane(1), {.shader = "wild"});
  Fixed t(s);
  EXPECT_EQ(t.ask(RayKind::kTrace, {0, 0.1f, 0}, {0, 0, 1}).color[0][0], 0);
}

TEST(Answer, HostileRaysAreMisses) {
  AnalyticScene s;
  s.add({.center = {0, 0, 3}}, {});
  Fixed t(s);
  const float wild[] = {NAN, INFINITY, -INFINITY, 0, 1e38f, -1e38f, 1e-42f, 1, 3e19f};
  std::mt19937 g(7);
  const auto pick = [&] { return wild[g() % std::size(wild)]; };
  for (int round = 0; round < 300; ++round) {
    RayQuery& q = *t.q;
    q.kind = RayKind(g() % 6);
    q.count = round % 7 == 0 ? uint32_t(g()) : 64;
    q.level = round % 5 == 0 ? uint32_t(g()) : 1;
    q.reserved = uint32_t(g());
    for (uint32_t i = 0; i < kMaxRays; ++i) {
      for (int c = 0; c < 3; ++c)
        q.origin[c][i] = pick(), q.direction[c][i] = pick(), q.normal[c][i] = pick();
      q.time[i] = pick(), q.radius[i] = pick(), q.spread[i] = pick(), q.u[i] = pick(), q.v[i] = pick();
      q.node[i] = g() % 3 ? uint32_t(g()) : uint32_t(g() % 8), q.cell[i] = uint32_t(g()), q.seed[i] = g();
    }
    t.thread->answer(q);
  }
  t.ask(RayKind::kHitTest, {NAN, 0, 0}, {0, 0, 1});
  EXPECT_EQ(t.q->hitDistance[0], kNoHit);
  t.ask(RayKind::kHitTest, {0, 0, 0}, {0, 0, 0});
  EXPECT_EQ(t.q->hitDistance[0], kNoHit);
  t.ask(RayKind::kTrace, {0, 0, 0}, {0, INFINITY, 0});
  EXPECT_EQ(t.q->color[0][0], 0);
}

TEST(Answer, BatchesDoNotMatter) {
  AnalyticScene s;
  testing::addZoo(s);
  Fixed t(s);
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
    testing::RayList rays = testing::randomRays(*t.cache, 2000, 99);
    const auto whole = testing::answerInBatches(*t.thread, rays, kind, kMaxRays);
    for (uint32_t batch : {1u, 7u, 256u}) {
      const auto parts = testing::answerInBatches(*t.thread, rays, kind, batch);
      EXPECT_EQ(whole, parts) << int(kind) << " in batches of " << batch;
    }
    testing::shuffle(rays);
    auto shuffled = testing::answerInBatches(*t.thread, rays, kind, kMaxRays);
    testing::unshuffle(rays, shuffled);
    EXPECT_EQ(whole, shuffled);
  }
}

/// Rays of one patch in a row start eight at a time, the others one by one.
TEST(Answer, WhetherIsTheSameForRaysInARowAndByThemselves) {
  AnalyticScene s;
  testing::addZoo(s);
  Fixed t(s);
  testing::RayList rays = testing::randomRays(*t.cache, 6000, 7);
  const auto ask = [&](uint32_t flags, uint32_t batch) {
    std::vector<float> distances(rays.size());
    for (size_t first = 0; first < rays.size(); first += batch) {
      RayQuery& q = *t.q;
      q.terms = RayTerms{};
      q.terms.flags = flags, q.terms.maxDistance = 20;
      q.kind = RayKind::kHitTest, q.level = 1;
      q.count = uint32_t(std::min<size_t>(batch, rays.size() - first));
      for (uint32_t i = 0; i < q.count; ++i) setRay(q, i, rays[first + i]);
      t.thread->answer(q);
      for (uint32_t i = 0; i < q.count; ++i) distances[rays[first + i].index] = q.hitDistance[i];
    }
    return distances;
  };
  const auto single = ask(RayTerms::kOnlyWhether, 1);
  std::sort(rays.begin(), rays.end(), [](const auto& a, const auto& b) { return a.node < b.node; });
  const auto inARow = ask(RayTerms::kOnlyWhether, kMaxRays);
  EXPECT_EQ(single, inARow);
  testing::shuffle(rays);
  EXPECT_EQ(single, ask(RayTerms::kOnlyWhether, 13));
  // They go 2^-20 beside their aim.
  const auto distances = ask(RayTerms::kOnlyDistance, kMaxRays);
  size_t hits = 0, different = 0;
  for (size_t i = 0; i < distances.size(); ++i) {
    hits += distances[i] < kNoHit;
    different += (distances[i] < kNoHit) != (single[i] < kNoHit);
  }
  EXPECT_GT(hits, 1000u);
  EXPECT_LT(hits, 5500u);
  EXPECT_LE(different, 3u);
}

TEST(Answer, OneRayIsAnsweredAsInABlock) {
  AnalyticScene s;
  testing::addZoo(s);
  Fixed t(s);
  const testing::RayList rays = testing::randomRays(*t.cache, 2000, 17);
  for (RayKind kind : {RayKind::kTrace, RayKind::kVisibility, RayKind::kHitTest, RayKind::kFullTrace}) {
    const auto block = testing::answerInBatches(*t.thread, rays, kind, kMaxRays);
    testing::Answers single;
    for (const testing::RayItem& ray : rays) {
      SingleAnswer a;
      ASSERT_TRUE(t.thread->answerOne(testing::mailOf(ray, kind), a));
      testing::append(single, a, kind);
    }
    EXPECT_EQ(block, single) << int(kind);
  }
  t.thread->publishCounts();
  const auto n = t.tracer->statistics();
  EXPECT_EQ(n.rays[int(RayKind::kTrace)], 2 * rays.size());
}

TEST(Answer, HostileSingleRaysAreMisses) {
  AnalyticScene s;
  s.add({.center = {0, 0, 3}}, {});
  Fixed t(s);
  const float wild[] = {NAN, INFINITY, -INFINITY, 0, 1e38f, -1e38f, 1e-42f, 1, 3e19f};
  std::mt19937 g(8);
  const auto pick = [&] { return wild[g() % std::size(wild)]; };
  for (int round = 0; round < 20000; ++round) {
    SingleRayMail m;
    auto* bytes = reinterpret_cast<unsigned char*>(&m);
    if (round & 1) {
      for (size_t i = 0; i < sizeof m; ++i) bytes[i] = uint8_t(g());
    } else {
      for (int c = 0; c < 3; ++c) {
        m.ray.origin[c] = pick(), m.ray.direction[c] = pick(), m.start.normal[c] = pick();
      }
      m.ray.time = pick(), m.ray.radius = pick(), m.ray.spread = pick();
      m.ray.level = uint16_t(g()), m.ray.kind = uint8_t(g() % 6);
      m.start.node = g() % 3 ? uint32_t(g()) : uint32_t(g() % 8), m.start.cell = uint32_t(g());
    }
    SingleAnswer a;
    EXPECT_EQ(t.thread->answerOne(m, a), m.ray.kind <= 3);
    if (m.ray.kind < 2) {
      EXPECT_TRUE(std::isfinite(a.color[0]));
    }
  }
  SingleRayMail m;
  m.ray.kind = uint8_t(RayKind::kHitTest);
  SingleAnswer a;
  EXPECT_TRUE(t.thread->answerOne(m, a));  // no direction
  EXPECT_EQ(a.hitDistance, kNoHit);
  m.ray.direction[2] = 1;
  EXPECT_TRUE(t.thread->answerOne(m, a));
  EXPECT_NEAR(a.hitDistance, 2, 0.01f);
  m.ray.origin[0] = NAN;
  EXPECT_TRUE(t.thread->answerOne(m, a));
  EXPECT_EQ(a.hitDistance, kNoHit);
}

TEST(SingleRay, TheBytesSayWhatTheyAre) {
  SingleRayMail m, out;
  m.ray.origin[1] = 7, m.start.importance = 9;
  EXPECT_TRUE(readSingleRay(singleRayBytes(m), out));
  EXPECT_EQ(out.start.importance, 9u);
  EXPECT_EQ(singleRayBytes(m).size(), kSingleRayMailBytes);
  m.start = {};
  EXPECT_EQ(singleRayBytes(m).size(), kSingleRayBytes) << "it starts nowhere";
  EXPECT_TRUE(readSingleRay(singleRayBytes(m), out));
  EXPECT_EQ(out.ray.origin[1], 7);
  EXPECT_EQ(out.start.importance, 0u);
  EXPECT_EQ(out.start.node, cache::kNone);
  m.start.node = 3;
  for (size_t n : {0, 1, 47, 49, 87}) EXPECT_FALSE(readSingleRay(singleRayBytes(m).first(n), out)) << n;
  for (int kind = 4; kind < 256; ++kind) {
    m.ray.kind = uint8_t(kind);
    EXPECT_FALSE(readSingleRay(singleRayBytes(m), out)) << kind;
  }
  const SingleAnswer a;
  const auto bytes = std::as_bytes(std::span(&a, 1));
  SingleAnswer b;
  EXPECT_TRUE(readSingleAnswer(bytes, RayKind::kFullTrace, b));
  EXPECT_TRUE(readSingleAnswer(bytes.first(48), RayKind::kTrace, b));
  EXPECT_FALSE(readSingleAnswer(bytes, RayKind::kTrace, b));
  EXPECT_FALSE(readSingleAnswer(bytes.first(47), RayKind::kHitTest, b));
  EXPECT_FALSE(readSingleAnswer(bytes.first(48), RayKind::kFullTrace, b));
}

TEST(Answer, ThreadsOfTheBuildDoNotMatter) {
  std::vector<testing::Answers> answers;
  for (int threads : {1, 2, 5}) {
    AnalyticScene s;
    testing::addZoo(s);
    RayTracerOptions o;
    o.scene.threads = threads;
    Fixed t(s, o);
    answers.push_back(testing::answerInBatches(*t.thread, testing::randomRays(*t.cache, 2000, 5),
                                               RayKind::kFullTrace, 512));
  }
  EXPECT_EQ(answers[0], answers[1]);
  EXPECT_EQ(answers[0], answers[2]);
}

TEST(Answer, MovingSurfacesAreHitWhereTheyAre) {
  for (float multiplier : {1.0f, 0.25f}) {
    AnalyticScene s;
    AnalyticShape moving = plane(1);
    moving.motion = {0, 0, 2};
    s.add(moving, {.patchMultiplier = multiplier});
    Fixed t(s);
    for (float time : {0.0f, 0.25f, 0.5f, 1.0f, 7.0f, -NAN}) {
      t.q->kind = RayKind::kHitTest, t.q->count = 1, t.q->level = 1;
      setRay(*t.q, 0, {0.1f, 0.3f, 0}, {0, 0, 1});
      t.q->time[0] = time;
      t.thread->answer(*t.q);
      const float expected = 1 + 2 * (time >= 0 ? std::min(time, 1.0f) : 0.0f);
      EXPECT_NEAR(t.q->hitDistance[0], expected, 1e-5f) << time;
      EXPECT_NEAR(t.q->hitP[2][0], expected, 1e-5f) << time;
    }
  }
}

TEST(Answer, BiasOverridesTheDeparture) {
  const auto distance = [](float bias) {
    AnalyticScene s;
    s.add(plane(0), {.bias = bias});
    s.add(plane(0.01f));
    s.add(plane(1));
    Fixed t(s);
    RayQuery& q = *t.q;
    q.kind = RayKind::kHitTest, q.count = 1, q.level = 1;
    setRay(q, 0, {0.1f, 0.3f, 0}, {0, 0, 1});
    q.node[0] = 0, q.normal[2][0] = 1;
    t.thread->answer(q);
    return q.hitDistance[0];
  };
  EXPECT_NEAR(distance(-1), 0.01f, 2e-7f);  // starts within rounding of its coordinates
  EXPECT_FLOAT_EQ(distance(0.005f), 0.01f);
  EXPECT_FLOAT_EQ(distance(0.05f), 1);
}

TEST(Answer, StatisticsCountRaysByKind) {
  AnalyticScene s;
  s.add(plane(1), {.shader = "lit"});
  Fixed t(s);
  t.ask(RayKind::kTrace, {0, 0, 0}, {0, 0, 1});
  t.ask(RayKind::kHitTest, {0, 0, 0}, {0, 0, 1});
  const TracerStatistics st = t.tracer->statistics();
  EXPECT_EQ(st.rays[int(RayKind::kTrace)], 1u);
  EXPECT_EQ(st.rays[int(RayKind::kHitTest)], 1u);
  EXPECT_EQ(st.nestedRays[int(RayKind::kVisibility)], 1u);
  EXPECT_EQ(st.hitsShaded, 1u);
  EXPECT_EQ(st.quads, 4u * 64);
}

TEST(InprocOracle, KeepsItsBlocksApart) {
  AnalyticScene s;
  s.add(plane(1));
  auto cache = s.finish();
  ShadingSystem shading(*cache, {});
  InprocOracleService service(*cache, shading, {});
  auto line = std::move(service.connect()).value();
  EXPECT_FALSE(line->wait().ok());
  std::vector<RayQuery*> blocks;
  while (RayQuery* q = line->acquire()) {
    setRay(*q, 0, {0, 0, -float(blocks.size())}, {0, 0, 1});
    q->kind = RayKind::kHitTest, q->count = 1, q->level = 1;
    blocks.push_back(q);
  }
  EXPECT_EQ(blocks.size(), kBlocksPerLine);
  for (RayQuery* q : blocks) EXPECT_TRUE(line->submit(q).ok());
  EXPECT_TRUE(line->wait().ok());
  for (size_t i = 0; i < blocks.size(); ++i) {
    EXPECT_TRUE(line->answered(blocks[i]));
    EXPECT_FLOAT_EQ(blocks[i]->hitDistance[0], float(i) + 1);
    line->release(blocks[i]);
  }
  EXPECT_TRUE(line->acquire());
  RayQuery stranger;
  EXPECT_FALSE(line->submit(&stranger).ok());
}

}  // namespace
}  // namespace fr::tracer
