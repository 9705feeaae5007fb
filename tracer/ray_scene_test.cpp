// Rays against shapes with closed forms: nothing but the surface itself may be hit, and never where the ray
// starts.
#include "tracer/ray_scene.h"

#include <gtest/gtest.h>

#include <random>

#include "tracer/testing/analytic_scene.h"

namespace fr::tracer {
namespace {

using cache::CastsShadows;
using cache::NodeId;
using testing::AnalyticLook;
using testing::AnalyticScene;
using testing::AnalyticShape;

struct Traced {
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<RayScene> scene;
};

Traced trace(AnalyticScene& s, RaySceneOptions o) {
  Traced t;
  t.cache = s.finish();
  const auto opaque = [&](cache::ObjectId id) {
    const auto& a = t.cache->skeleton().attributes()[t.cache->skeleton().objects()[id].attributes];
    return a.castsShadows == CastsShadows::kOpaque;
  };
  auto r = RayScene::build(*t.cache, opaque, o);
  EXPECT_TRUE(r.ok());
  t.scene = std::move(r).value();
  return t;
}
Traced trace(AnalyticScene& s, float multiplier, int threads = 1) {
  RaySceneOptions o;
  o.patchMultiplier = multiplier;
  o.threads = threads;
  return trace(s, o);
}

Ray makeRay(const Vec3& origin, const Vec3& direction, uint32_t mask = kReflectionRay) {
  Ray r;
  r.origin = origin;
  r.direction = glm::normalize(direction);
  r.mask = mask;
  return r;
}

struct Random {
  std::mt19937 g{12345};
  float operator()(float a = 0, float b = 1) {
    return a + (b - a) * std::uniform_real_distribution<float>(0, 1)(g);
  }
  Vec3 onSphere() {
    const float z = (*this)(-1, 1), a = (*this)(0, 6.2831853f), r = std::sqrt(1 - z * z);
    return {r * std::cos(a), r * std::sin(a), z};
  }
};

/// Signed distance, positive on the side that the oriented normal shows to. Double: it is the yardstick.
double signedDistance(const AnalyticShape& s, const DVec3& p) {
  const DVec3 d = p - DVec3(s.center);
  double f = 0;
  switch (s.kind) {
    case AnalyticShape::kPlane:
      f = glm::dot(d, glm::normalize(glm::cross(DVec3(s.axisU), DVec3(s.axisV))));
      break;
    case AnalyticShape::kTorus:
      f = std::hypot(std::hypot(d.x, d.y) - s.radius, d.z) - s.tube;
      break;
    default:
      f = glm::length(d) - s.radius;
      break;
  }
  return s.inward ? -f : f;
}

TEST(RayScene, HitsSphereWithinRecordedDeviation) {
  for (float multiplier : {1.0f, 0.5f, 0.25f, 0.125f, 0.0625f}) {
    AnalyticScene s;
    s.add({.center = {0.5f, -1, 3}, .radius = 2, .patchesU = 4, .patchesV = 4});
    Traced t = trace(s, multiplier);
    float deviation = 0;
    for (uint32_t i = 0; i < t.scene->entryCount(); ++i)
      deviation = std::max(deviation, t.scene->entry(i).deviation);
    Random random;
    int hits = 0;
    for (int i = 0; i < 4000; ++i) {
      const DVec3 c(0.5, -1, 3), o = c + 7.0 * DVec3(random.onSphere());
      const DVec3 target = c + 2.2 * double(random()) * DVec3(random.onSphere());
      const Ray ray = makeRay(Vec3(o), Vec3(target - o));
      const DVec3 d(ray.direction), oc = DVec3(ray.origin) - c;
      const double b = glm::dot(oc, d), h = b * b - glm::dot(oc, oc) + 4;
      const Hit hit = t.scene->closest(ray);
      const double off = 2 - std::sqrt(std::max(0.0, 4 - h));  // depth of the ray below the sphere
      if (off > 2 * deviation) {
        ASSERT_TRUE(hit.any()) << i << " depth " << off << " deviation " << deviation;
        const double inner = 2 - 2 * deviation;  // a sphere inside of all facets
        EXPECT_GE(hit.distance, -b - std::sqrt(h) - 1e-5);
        EXPECT_LE(hit.distance, -b - std::sqrt(std::max(0.0, h - (4 - inner * inner))) + 1e-5);
        EXPECT_LT(glm::dot(hit.normal, ray.direction), 0);
        ++hits;
      } else if (h < -1e-4) {
        EXPECT_FALSE(hit.any());
      }
    }
    EXPECT_GT(hits, 1500);
  }
}

TEST(RayScene, HitAddressLeadsBackToThePoint) {
  AnalyticScene s;
  s.add({.radius = 2, .patchesU = 8, .patchesV = 8});
  s.add({.kind = AnalyticShape::kMeshSphere,
         .center = {5, 0, 0},
         .radius = 1,
         .patchesU = 4,
         .patchesV = 4,
         .cells = 8});
  Traced t = trace(s, 0.5f);
  Random random;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 c = i & 1 ? Vec3(5, 0, 0) : Vec3(0);
    const Vec3 o = c + (i & 1 ? 1.5f : 3.0f) * random.onSphere();
    const Ray ray = makeRay(o, c + 0.5f * random.onSphere() - o);
    const Hit hit = t.scene->closest(ray);
    ASSERT_TRUE(hit.any());
    const SurfaceEntry& e = t.scene->entry(hit.entry);
    EXPECT_EQ(e.object, cache::ObjectId(i & 1));
    float p[3];
    cache::SurfaceOut out;
    for (int k = 0; k < 3; ++k) out.P[k] = p + k;
    t.cache->evaluateDiced(e.node, 1, &hit.cell, &hit.u, &hit.v, out);
    EXPECT_LT(glm::distance(Vec3(p[0], p[1], p[2]), ray.origin + hit.distance * ray.direction),
              i & 1 ? 1e-5f : 3 * e.deviation);
  }
}

struct Start {
  NodeId node;
  Vec3 p, n;
};

Start startOn(const Traced& t, cache::ObjectId object, Random& random, bool diced) {
  const auto& o = t.cache->skeleton().objects()[object];
  Start s;
  s.node = o.firstPatch + uint32_t(random(0, 0.99999f) * float(o.patchCount));
  const auto& shape = testing::shapeOf(*t.cache, object);
  // Facets at the poles of the mesh have no area, so no normal to leave along.
  if (shape.kind == AnalyticShape::kMeshSphere)
    s.node = o.firstPatch + shape.patchesU + uint32_t(random(0, 0.99999f) * float(2 * shape.patchesU));
  const uint32_t cell = shape.kind == AnalyticShape::kMeshSphere
                            ? uint32_t(random(0, 0.9999f) * float(2 * shape.cells * shape.cells))
                            : 0;
  float u = random(), v = random();
  if (u + v > 1 && shape.kind == AnalyticShape::kMeshSphere) u = 1 - u, v = 1 - v;
  float p[3], n[3];
  cache::SurfaceOut out;
  for (int k = 0; k < 3; ++k) out.P[k] = p + k, out.Ng[k] = n + k;
  if (diced)
    t.cache->evaluateDiced(s.node, 1, &cell, &u, &v, out);
  else
    t.cache->evaluateSurface(s.node, 1, &cell, &u, &v, out);
  s.p = {p[0], p[1], p[2]};
  s.n = {n[0], n[1], n[2]};
  return s;
}

void depart(const Traced& t, Ray& ray, const Start& start) { t.scene->leave(ray, start.node, start.n); }

/// Direction with the given cosine to n.
Vec3 directionAt(const Vec3& n, float cosine, Random& random) {
  Vec3 t;
  do {
    t = random.onSphere();
    t -= n * glm::dot(t, n);
  } while (glm::length(t) < 1e-2f);
  return glm::normalize(cosine * n + std::sqrt(1 - cosine * cosine) * glm::normalize(t));
}

struct DepartureCase {
  const char* name;
  AnalyticShape shape;
  bool convexOutside;  // nothing can be hit on the side of the normal
};

class Departing : public ::testing::TestWithParam<DepartureCase> {};

TEST_P(Departing, NoFalseHits) {
  const DepartureCase& c = GetParam();
  for (float scale : {1.0f, 1e-3f, 1e4f})
    for (float multiplier : {1.0f, 0.5f, 0.25f, 0.125f, 0.0625f}) {
      AnalyticScene s;
      AnalyticShape shape = c.shape;
      shape.center *= scale, shape.axisU *= scale, shape.axisV *= scale, shape.radius *= scale,
          shape.tube *= scale;
      s.add(shape);
      Traced t = trace(s, multiplier);
      const double deviation = t.scene->entry(0).deviation, cell = t.scene->entry(0).cellSize;
      Random random;
      int wrong = 0, missed = 0, rays = 0;
      for (int i = 0; i < 20000; ++i) {
        const Start start = startOn(t, 0, random, i & 1);
        // The inside of a polygon mesh is that of a polyhedron, for which the sphere is no yardstick.
        const bool outwards = !(i & 2) || shape.kind == AnalyticShape::kMeshSphere;
        const float cosine = std::pow(10.0f, random(-6, 0)) * (outwards ? 1.0f : -1.0f);
        Ray ray = makeRay(start.p, directionAt(start.n, cosine, random));
        depart(t, ray, start);
        const Hit hit = t.scene->closest(ray);
        ++rays;
        if (c.convexOutside && cosine > 0) {
          wrong += hit.any();
          continue;
        }
        if (shape.kind == AnalyticShape::kPlane) {
          wrong += hit.any();
          continue;
        }
        // First place where the true ray meets the true surface again.
        const double sense = cosine > 0 ? 1 : -1, far = 3 * shape.radius,
                     step = std::min(cell / 16, far / 300);
        double truth = -1;
        const DVec3 o(ray.origin), d(ray.direction);
        bool left = false;
        for (double x = step; x < far; x += step) {
          const double f = sense * signedDistance(shape, o + x * d);
          if (!left && f > 0) left = true;
          if (left && f <= 0) {
            truth = x;
            break;
          }
          if (!left && x > cell) break;  // leaves along the surface: no yardstick
        }
        if (!left) continue;
        if (truth < 0) {
          // A hit is false unless the facets reach as far as the ray's nearest approach far from the start.
          double nearest = 1e30;
          for (double x = std::max(2 * cell, 0.3 * double(hit.distance)); hit.any() && x < far; x += step)
            nearest = std::min(nearest, sense * signedDistance(shape, o + x * d));
          wrong += hit.any() && nearest > 2 * deviation;
        } else {
          const double at = std::abs(glm::dot(d, glm::normalize(DVec3(hit.normal))));
          if (!hit.any())
            missed += truth > 2 * cell;  // nearer ones lie between the chord and its arc
          else
            wrong += hit.distance < truth - 4 * deviation / std::max(at, 1e-2) - 2 * step - 0.5 * cell;
        }
      }
      // In a saddle the chords stand above the surface here and there; the log-uniform cosines dwell on such
      // rays.
      EXPECT_LE(wrong, shape.kind == AnalyticShape::kTorus ? rays / 1000 : 0)
          << c.name << " scale " << scale << " multiplier " << multiplier << " of " << rays;
      EXPECT_LE(missed, rays / 1000) << c.name << " scale " << scale << " multiplier " << multiplier;
    }
}

INSTANTIATE_TEST_SUITE_P(
    Shapes, Departing,
    ::testing::Values(
        DepartureCase{
            "sphere", {.center = {0.3f, 0.2f, 1}, .radius = 1.5f, .patchesU = 4, .patchesV = 4}, true},
        DepartureCase{"bowl",
                      {.center = {0.3f, 0.2f, 1}, .radius = 1.5f, .patchesU = 4, .patchesV = 4, .inward = 1},
                      false},
        DepartureCase{
            "torus",
            {.kind = AnalyticShape::kTorus, .radius = 1.5f, .tube = 0.5f, .patchesU = 8, .patchesV = 4},
            false},
        DepartureCase{"plane",
                      {.kind = AnalyticShape::kPlane,
                       .center = {0.1f, 0.3f, 2.7f},
                       .axisU = {1, 0.3f, 0.2f},
                       .axisV = {-0.3f, 1, 0.77f}},
                      true},
        DepartureCase{
            "meshlets",
            {.kind = AnalyticShape::kMeshSphere, .radius = 1, .patchesU = 4, .patchesV = 4, .cells = 8},
            true}),
    [](const auto& i) { return std::string(i.param.name); });

TEST(RayScene, NearThingsAreStillHit) {
  // Another object a hundredth of a cell above a plane; and the opposite wall of a thin box of the same
  // surface.
  AnalyticScene s;
  const AnalyticShape plane{
      .kind = AnalyticShape::kPlane, .patchesU = 1, .patchesV = 1, .cells = 4, .group = 7};
  s.add(plane);
  AnalyticShape near = plane;
  near.center = {0, 0, 0.005f}, near.group = 8;
  s.add(near);
  AnalyticShape under = plane;
  under.center = {0, 0, -0.005f}, under.inward = 1;  // same group, faces down
  s.add(under);
  AnalyticShape parallel = plane;
  parallel.center = {0, 0, 0.01f};  // same group, faces up
  s.add(parallel);
  for (float multiplier : {1.0f, 0.25f}) {
    Traced t = trace(s, multiplier);
    Random random;
    for (int i = 0; i < 2000; ++i) {
      const Start start = startOn(t, 0, random, true);
      if (glm::length(start.p) > 0.8f) continue;
      const float cosine = random(0.05f, 1);
      for (float sign : {1.0f, -1.0f}) {
        Ray ray = makeRay(start.p, directionAt(start.n, sign * cosine, random));
        depart(t, ray, start);
        const Hit hit = t.scene->closest(ray);
        ASSERT_TRUE(hit.any());
        EXPECT_EQ(t.scene->entry(hit.entry).object, sign > 0 ? 1u : 2u);
        EXPECT_NEAR(hit.distance, 0.005f / cosine, 1e-4f);
        // Behind the near one stands the parallel sheet of the starting surface itself.
        if (sign > 0) {
          t.scene->stepBehind(ray, hit);
          const Hit next = t.scene->closest(ray);
          ASSERT_TRUE(next.any());
          EXPECT_EQ(t.scene->entry(next.entry).object, 3u);
        }
      }
    }
  }
}

TEST(RayScene, SegmentsBetweenSurfacePointsAreClear) {
  // Both ends on the inside of a sphere: a light on a wall, a point on the opposite one.
  for (float multiplier : {1.0f, 0.5f, 0.25f}) {
    AnalyticScene s;
    s.add({.radius = 3, .patchesU = 4, .patchesV = 4, .inward = 1}, {.castsShadows = CastsShadows::kOpaque});
    Traced t = trace(s, multiplier);
    const float cell = t.scene->entry(0).cellSize;
    Random random;
    int shadows = 0, rays = 0;
    for (int i = 0; i < 20000; ++i) {
      const Start a = startOn(t, 0, random, i & 1), b = startOn(t, 0, random, i & 2);
      const float length = glm::distance(a.p, b.p);
      if (length < 3 * cell) continue;
      Ray ray = makeRay(a.p, b.p - a.p, kOpaqueShadowRay);
      ray.farDistance = length;
      ray.endsOnSurface = true;
      depart(t, ray, a);
      shadows += t.scene->obstacle(ray) != Obstacle::kNone;
      ++rays;
    }
    EXPECT_EQ(shadows, 0) << "of " << rays << " at " << multiplier;
  }
}

TEST(RayScene, StepsThroughEachSurfaceOnce) {
  AnalyticScene s;
  for (int i = 0; i < 5; ++i)
    s.add({.kind = AnalyticShape::kPlane,
           .center = {0, 0, float(i)},
           .patchesU = 4,
           .patchesV = 4,
           .cells = 8});
  Traced t = trace(s, 1);
  Random random;
  for (int i = 0; i < 3000; ++i) {
    // Every second ray goes exactly through an edge between cells or patches.
    const float x = i & 1 ? float(int(random(-7, 7))) / 8 : random(-0.9f, 0.9f);
    Ray ray = makeRay({x, random(-0.9f, 0.9f), -1}, {0, 0, 1});
    int hits = 0;
    for (Hit hit = t.scene->closest(ray); hit.any() && hits < 100; hit = t.scene->closest(ray)) {
      EXPECT_FLOAT_EQ(hit.distance, float(hits + 1));
      ++hits;
      t.scene->stepBehind(ray, hit);
    }
    EXPECT_EQ(hits, 5);
  }
}

TEST(RayScene, EqualDistancesGoToTheLowestObject) {
  for (int order : {0, 1}) {
    AnalyticScene s;
    AnalyticShape a{.kind = AnalyticShape::kPlane, .patchesU = 2, .patchesV = 2, .cells = 4};
    s.add(a, {.patchMultiplier = order ? 1.0f : 0.5f});
    s.add(a, {.patchMultiplier = order ? 0.25f : 1.0f});
    s.add(a);
    Traced t = trace(s, 1, 1 + order);
    Random random;
    for (int i = 0; i < 2000; ++i) {
      Ray ray = makeRay({random(-0.9f, 0.9f), random(-0.9f, 0.9f), -1}, {0, 0, 1});
      for (uint32_t k = 0; k < 3; ++k) {
        const Hit hit = t.scene->closest(ray);
        ASSERT_TRUE(hit.any());
        EXPECT_EQ(t.scene->entry(hit.entry).object, k);
        t.scene->stepBehind(ray, hit);
      }
      EXPECT_FALSE(t.scene->closest(ray).any());
    }
  }
}

TEST(RayScene, OneSidedSurfacesAreInvisibleFromBehind) {
  AnalyticScene s;
  s.add({.kind = AnalyticShape::kPlane}, {.sides = 1});
  AnalyticShape in{.kind = AnalyticShape::kPlane, .center = {0, 0, 5}, .inward = 1};
  s.add(in, {.sides = 1});
  Traced t = trace(s, 1);
  EXPECT_TRUE(t.scene->closest(makeRay({0.1f, 0.2f, 1}, {0, 0, -1})).any());
  // Embree's instruction sets differ in the last bits.
  EXPECT_FLOAT_EQ(t.scene->closest(makeRay({0.1f, 0.2f, -1}, {0, 0, 1})).distance, 6);
  EXPECT_FLOAT_EQ(t.scene->closest(makeRay({0.1f, 0.2f, 9}, {0, 0, -1})).distance, 9);
}

TEST(RayScene, VisibilityMasks) {
  AnalyticScene s;
  const auto plane = [](float z) {
    return AnalyticShape{.kind = AnalyticShape::kPlane, .center = {0, 0, z}};
  };
  s.add(plane(1), {.visibility = cache::kVisibleReflection});
  s.add(plane(2), {.visibility = cache::kVisibleShadow, .castsShadows = CastsShadows::kOpaque});
  s.add(plane(3), {.visibility = 7, .castsShadows = CastsShadows::kOs});
  s.add(plane(4), {.visibility = 7, .castsShadows = CastsShadows::kNever});
  s.add(plane(5), {.visibility = 7, .forTracer = false});
  s.add(plane(6), {.visibility = cache::kVisibleCamera});
  Traced t = trace(s, 0.5f);
  const auto distance = [&](float z, uint32_t mask) {
    return t.scene->closest(makeRay({0, 0, z}, {0, 0, 1}, mask)).distance;
  };
  EXPECT_FLOAT_EQ(distance(0, kReflectionRay), 1);
  EXPECT_FLOAT_EQ(distance(1.5f, kReflectionRay), 1.5f);
  EXPECT_FLOAT_EQ(distance(0, kOpaqueShadowRay), 2);
  EXPECT_EQ(distance(2.5f, kOpaqueShadowRay), kInfinity);
  EXPECT_FLOAT_EQ(distance(0, kFilteredShadowRay), 3);
  EXPECT_EQ(distance(3.5f, kFilteredShadowRay), kInfinity);
  EXPECT_FLOAT_EQ(distance(3.5f, kReflectionRay), 0.5f);
  EXPECT_EQ(distance(4.5f, kReflectionRay), kInfinity);
  EXPECT_EQ(t.scene->entryOf(t.cache->skeleton().objects()[5].firstPatch), cache::kNone);

  const auto obstacle = [&](float z, float end) {
    Ray ray = makeRay({0, 0, z}, {0, 0, 1}, kOpaqueShadowRay);
    ray.farDistance = end - z;
    return t.scene->obstacle(ray);
  };
  EXPECT_EQ(obstacle(0, 1.5f), Obstacle::kNone);
  EXPECT_EQ(obstacle(0, 6.5f), Obstacle::kOpaque);
  EXPECT_EQ(obstacle(2.5f, 6.5f), Obstacle::kFiltered);
  EXPECT_EQ(obstacle(3.5f, 6.5f), Obstacle::kNone);
}

/// A whole sphere in one grid of 16 cells keeps four.
TEST(RayScene, PatchMultiplierChoosesTheStride) {
  for (auto [multiplier, level] :
       {std::pair(2.0f, 0), {1.0f, 0}, {0.9f, 1}, {0.5f, 1}, {0.3f, 2}, {0.25f, 2}, {0.06f, 2}, {0.0f, 2}}) {
    AnalyticScene s;
    s.add({}, {.patchMultiplier = multiplier});
    Traced t = trace(s, 1);
    EXPECT_EQ(t.scene->entry(0).level, level) << multiplier;
    EXPECT_EQ(t.scene->entry(0).cellsU, 16 >> level);
  }
}

TEST(RayScene, QuadrilateralsAreHitWhereGridsAre) {
  const auto build = [](double quadCells) {
    AnalyticScene s;
    s.add({.center = {0, 0, 3}, .radius = 2, .patchesU = 4, .patchesV = 4});
    s.add({.kind = AnalyticShape::kTorus,
           .center = {3, 0, 0},
           .radius = 1,
           .tube = 0.4f,
           .patchesU = 3,
           .patchesV = 5});
    s.add({.kind = AnalyticShape::kPlane, .center = {0, 0, -2}, .axisU = {5, 0, 0}, .axisV = {0, 5, 0}});
    s.add({.center = {-3, 1, 0}, .radius = 1, .patchesU = 2, .patchesV = 1}, {.patchMultiplier = 1});
    RaySceneOptions o;
    o.quadCells = quadCells;
    return trace(s, o);
  };
  const Traced grids = build(0), quads = build(1e6);
  EXPECT_EQ(grids.scene->statistics().quads, quads.scene->statistics().quads);
  EXPECT_GT(quads.scene->statistics().embreeBytes, 2 * grids.scene->statistics().embreeBytes);
  Random random;
  int hits = 0, otherCells = 0;
  for (int i = 0; i < 20000; ++i) {
    const Ray ray = makeRay(5.0f * Vec3(random(-1), random(-1), random(-1)), random.onSphere());
    const Hit a = grids.scene->closest(ray), b = quads.scene->closest(ray);
    ASSERT_EQ(a.any(), b.any()) << i;
    if (!a.any()) continue;
    ++hits;
    // Places in a grid are rounded once more or less: a hundred millionth of it.
    ASSERT_EQ(a.entry, b.entry) << i;
    EXPECT_EQ(a.distance, b.distance);
    EXPECT_NEAR(a.u, b.u, 1e-6f);
    EXPECT_NEAR(a.v, b.v, 1e-6f);
    EXPECT_EQ(a.normal, b.normal);
    otherCells += a.cell != b.cell;
  }
  EXPECT_GT(hits, 5000);
  EXPECT_LE(otherCells, 3);
}

TEST(RayScene, AnEmptySceneIsHitByNothing) {
  AnalyticScene s;
  s.add({}, {.visibility = 0});
  Traced t = trace(s, 1);
  EXPECT_FALSE(t.scene->closest(makeRay({0, 0, -5}, {0, 0, 1})).any());
  EXPECT_EQ(t.scene->entryCount(), 0u);
}

TEST(RayScene, DamagedGridsAreLeftOut) {
  const auto damage = [](auto change) {
    AnalyticScene s;
    s.add({.kind = AnalyticShape::kPlane, .patchesU = 1, .patchesV = 1});
    auto cache = s.finish();
    auto* g = const_cast<cache::GridRecord*>(cache->resolve(0).grid);
    change(*g);
    auto r = RayScene::build(*cache, [](cache::ObjectId) { return true; }, {});
    return r.ok() ? (*r)->entryCount() : 99;
  };
  setReportSink([](const Error&) {});
  EXPECT_EQ(damage([](cache::GridRecord&) {}), 1u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.nu = 40000; }), 0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.rowStride = 3; }), 0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.positions += 4; }), 0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.positions = ~uint64_t(0) / 192 * 192; }), 0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.keyCount = 3, g.keyBytes = uint64_t(1) << 62; }), 0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) {
              g.kind = cache::GridKind::kMeshlet, g.nu = 10, g.nv = 300, g.indices = 1ull << 40;
            }),
            0u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.levels = 200; }), 1u);
  EXPECT_EQ(damage([](cache::GridRecord& g) { g.cellSize = NAN, g.deviation[1] = -INFINITY; }), 1u);
  setReportSink({});
}

}  // namespace
}  // namespace fr::tracer
