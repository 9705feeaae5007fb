#include "tracer/leaf_kernel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "base/isa.h"
#include "base/math.h"

namespace fr::tracer {
namespace {

/// A closed mesh, its triangles in an order that leaves neighbours in different leaves.
struct Mesh {
  std::vector<float> vertices, later;  // and one float more than needed
  std::vector<uint8_t> indices;
  uint32_t vertexCount = 0, triangleCount = 0;

  Vec3 vertex(uint32_t i) const { return {vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2]}; }
  LeafTriangles leaf(uint32_t first) const {
    LeafTriangles t;
    t.vertices = vertices.data();
    t.vertexCount = vertexCount;
    t.indices = indices.data() + 3 * first;
    t.count = std::min(kLeafTriangles, triangleCount - first);
    return t;
  }
};

/// A ball of irregular triangles about `middle`, stretched by `size`.
Mesh ball(uint32_t seed, const Vec3& middle, const Vec3& size) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> jitter(-0.3f, 0.3f);
  Mesh m;
  constexpr uint32_t kRows = 9, kColumns = 20;
  const auto add = [&](float theta, float phi) {
    const Vec3 p(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta));
    for (int c = 0; c < 3; ++c) {
      m.vertices.push_back(middle[c] + size[c] * p[c]);
      m.later.push_back(m.vertices.back() + size[c] * (0.2f + 0.05f * jitter(random)));
    }
    return m.vertexCount++;
  };
  const uint32_t top = add(0, 0), bottom = add(3.14159265f, 0);
  for (uint32_t j = 0; j < kRows; ++j)
    for (uint32_t i = 0; i < kColumns; ++i)
      add(3.14159265f * (float(j + 1) + jitter(random)) / float(kRows + 1),
          6.2831853f * (float(i) + jitter(random)) / float(kColumns));
  std::vector<std::array<uint32_t, 3>> triangles;
  const auto at = [](uint32_t j, uint32_t i) { return 2 + j * kColumns + i % kColumns; };
  for (uint32_t i = 0; i < kColumns; ++i) {
    triangles.push_back({top, at(0, i), at(0, i + 1)});
    triangles.push_back({bottom, at(kRows - 1, i + 1), at(kRows - 1, i)});
    for (uint32_t j = 0; j + 1 < kRows; ++j) {
      triangles.push_back({at(j, i), at(j + 1, i), at(j, i + 1)});
      triangles.push_back({at(j, i + 1), at(j + 1, i), at(j + 1, i + 1)});
    }
  }
  std::shuffle(triangles.begin(), triangles.end(), random);
  for (auto& t : triangles) {
    std::rotate(t.begin(), t.begin() + std::ptrdiff_t(random() % 3), t.end());
    for (uint32_t v : t) m.indices.push_back(uint8_t(v));
  }
  m.triangleCount = uint32_t(triangles.size());
  m.vertices.push_back(0), m.later.push_back(0);
  return m;
}

LeafRay rayTo(const Vec3& from, const Vec3& to) {
  const Vec3 d(glm::normalize(DVec3(to) - DVec3(from)));
  return {{from.x, from.y, from.z}, {d.x, d.y, d.z}, 0, std::numeric_limits<float>::infinity()};
}

/// How many triangles of the mesh are met; with `part`, in motion.
uint32_t countHits(const Mesh& m, const LeafRay& ray, float part = -1) {
  uint32_t n = 0;
  for (uint32_t first = 0; first < m.triangleCount; first += kLeafTriangles) {
    LeafTriangles t = m.leaf(first);
    if (part >= 0) t.later = m.later.data(), t.part = part;
    LeafHits hits;
    leafKernel()(ray, t, hits);
    n += uint32_t(__builtin_popcount(hits.mask));
  }
  return n;
}

struct Place {
  Vec3 middle, size;
};
const Place kPlaces[] = {{{0, 0, 0}, {1, 1, 1}},
                         {{1, 2, 3}, {1, 1, 1}},
                         {{-300, 40, 7}, {0.5f, 2, 1}},
                         {{0, 0, 0}, {1e-12f, 1e-12f, 1e-12f}},
                         {{0, 0, 0}, {1e-22f, 1e-22f, 1e-22f}},
                         {{0, 0, 0}, {1e14f, 1e14f, 1e14f}},
                         {{5, 5, 5}, {1, 1e-3f, 1}}};

TEST(LeafKernel, NoRayPassesBetweenTrianglesOfAClosedMesh) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> unit(0, 1);
  for (const Place& place : kPlaces)
    for (uint32_t seed = 1; seed <= 4; ++seed) {
      const Mesh m = ball(seed, place.middle, place.size);
      const auto inside = [&] {
        return place.middle +
               place.size * 0.3f * Vec3(unit(random) - 0.5f, unit(random) - 0.5f, unit(random) - 0.5f);
      };
      for (uint32_t i = 0; i < m.triangleCount; ++i) {
        const auto corner = [&](uint32_t c) { return m.vertex(m.indices[3 * i + c]); };
        const Vec3 a = corner(0), b = corner(1), c = corner(2);
        // At a vertex, the middle of an edge and a place on it, and anywhere.
        const float s = unit(random), r = unit(random) * (1 - s);
        for (const Vec3& to : {a, b, c, (a + b) * 0.5f, b + (c - b) * s, a + (b - a) * s + (c - a) * r})
          for (const Vec3& from : {place.middle, inside(), inside()})
            ASSERT_GE(countHits(m, rayTo(from, to)), 1u) << "triangle " << i << " seed " << seed;
      }
    }
}

TEST(LeafKernel, NoRayPassesAlongTheAxes) {
  // Vertices, edges and rays on the same lattice: much of it is exactly 0.
  Mesh m;
  for (int k = 0; k < 27; ++k)
    for (int c = 0, d = k; c < 3; ++c, d /= 3) m.vertices.push_back(float(d % 3 - 1));
  m.vertexCount = 27, m.vertices.push_back(0);
  const auto add = [&](int a, int b, int c) {
    for (int i : {a, b, c}) m.indices.push_back(uint8_t(i));
    ++m.triangleCount;
  };
  static constexpr int kStep[3] = {1, 3, 9};
  for (int axis = 0; axis < 3; ++axis)
    for (int end = 0; end < 2; ++end)
      for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i) {
          const int x = kStep[(axis + 1) % 3], y = kStep[(axis + 2) % 3];
          const int a = 2 * end * kStep[axis] + i * x + j * y;
          add(a, a + x, a + x + y), add(a, a + x + y, a + y);
        }
  for (const Vec3& from : {Vec3(0), Vec3(0.5f, 0, 0), Vec3(0.25f, -0.5f, 0.125f)})
    for (int z = -4; z <= 4; ++z)
      for (int y = -4; y <= 4; ++y)
        for (int x = -4; x <= 4; ++x)
          if (x || y || z) {
            const LeafRay ray{{from.x, from.y, from.z},
                              {float(x), float(y), float(z)},
                              0,
                              std::numeric_limits<float>::infinity()};
            ASSERT_GE(countHits(m, ray), 1u) << x << ' ' << y << ' ' << z;
          }
}

TEST(LeafKernel, NoRayPassesBetweenMovingTriangles) {
  const Mesh m = ball(3, {1, 2, 3}, {1, 1, 1});
  for (float part : {0.0f, 0.1f, 0.5f, 0.9f, 1.0f})
    for (uint32_t v = 0; v < m.vertexCount; ++v) {
      const Vec3 later(m.later[3 * v], m.later[3 * v + 1], m.later[3 * v + 2]);
      const Vec3 to = m.vertex(v) * (1 - part) + later * part;
      ASSERT_GE(countHits(m, rayTo(Vec3(1.1f, 2.1f, 3.1f), to), part), 1u) << v;
    }
}

TEST(LeafKernel, SaysWhatDoublesSay) {
  std::mt19937 random(9);
  std::uniform_real_distribution<float> unit(0, 1);
  uint32_t met = 0, missed = 0;
  for (const Place& place : kPlaces) {
    const Mesh m = ball(11, place.middle, place.size);
    for (int k = 0; k < 400; ++k) {
      const auto anywhere = [&] {
        return place.middle + place.size * 3.0f * (Vec3(unit(random), unit(random), unit(random)) - 0.5f);
      };
      const LeafRay ray = rayTo(anywhere(), anywhere());
      const DVec3 o(ray.origin[0], ray.origin[1], ray.origin[2]),
          d(ray.direction[0], ray.direction[1], ray.direction[2]);
      for (uint32_t first = 0; first < m.triangleCount; first += kLeafTriangles) {
        const LeafTriangles leaf = m.leaf(first);
        LeafHits hits;
        leafKernel()(ray, leaf, hits);
        ASSERT_EQ(hits.mask >> leaf.count, 0u);
        for (uint32_t i = 0; i < leaf.count; ++i) {
          const DVec3 a(m.vertex(leaf.indices[3 * i])), e1 = DVec3(m.vertex(leaf.indices[3 * i + 1])) - a,
                                                        e2 = DVec3(m.vertex(leaf.indices[3 * i + 2])) - a;
          const DVec3 n = glm::cross(e1, e2);
          const double det = -glm::dot(d, n);
          const DVec3 s = o - a, q = glm::cross(s, d);
          const double t = glm::dot(s, n) / det, u = glm::dot(e2, q) / det, v = -glm::dot(e1, q) / det;
          const double least = std::min({u, v, 1 - u - v});
          const double size = std::max({glm::length(e1), glm::length(e2), glm::length(e1 - e2)});
          const double far = glm::length(s) + glm::length(DVec3(place.middle));
          // As far as positions are known.
          const double sine = std::abs(det) / glm::length(n);
          const double rounding = 1e-6 * far / (std::max(sine, 1e-9) * (glm::length(n) / size));
          if (rounding > 0.05) continue;
          const bool hit = hits.mask >> i & 1;
          if (least > rounding && t > 1e-5 * far) {
            ASSERT_TRUE(hit) << "inside by " << least;
            EXPECT_NEAR(hits.distance[i], t, 4e-6 * far / sine);
            EXPECT_NEAR(hits.u[i], u, rounding);
            EXPECT_NEAR(hits.v[i], v, rounding);
            const DVec3 got(hits.normal[0][i], hits.normal[1][i], hits.normal[2][i]);
            if (glm::length(n) > 1e-30) {
              EXPECT_GT(glm::dot(got, n), 0.999 * glm::length(n) * glm::length(got));
            }
            ++met;
          } else if (least < -rounding || t < -1e-5 * far) {
            ASSERT_FALSE(hit) << "outside by " << -least;
            ++missed;
          }
        }
      }
    }
  }
  EXPECT_GT(met, 500u);
  EXPECT_GT(missed, 100000u);
}

TEST(LeafKernel, SameBitsOnEverySet) {
  std::vector<MeetLeaf> sets = {sse4::meetLeaf};
  if (currentIsa() >= Isa::kAvx2) sets.push_back(avx2::meetLeaf);
  if (currentIsa() >= Isa::kAvx512) sets.push_back(avx512::meetLeaf);
  std::mt19937 random(13);
  std::uniform_real_distribution<float> unit(-1, 1);
  const Mesh m = ball(2, {1, 0, 0}, {1, 1, 1});
  for (int k = 0; k < 3000; ++k) {
    const Vec3 from(unit(random), unit(random), unit(random));
    const LeafRay ray = rayTo(
        from, k % 2 ? m.vertex(uint32_t(k) % m.vertexCount) : Vec3(unit(random), unit(random), unit(random)));
    LeafTriangles t = m.leaf(uint32_t(k) * kLeafTriangles % m.triangleCount);
    if (k % 3 == 0) t.later = m.later.data(), t.part = 0.3f;
    LeafHits one;
    sets[0](ray, t, one);
    for (MeetLeaf set : sets) {
      LeafHits other;
      set(ray, t, other);
      ASSERT_EQ(one.mask, other.mask);
      for (uint32_t i = 0; i < kLeafTriangles; ++i) {
        if (!(one.mask >> i & 1)) continue;
        ASSERT_EQ(one.distance[i], other.distance[i]);
        ASSERT_EQ(one.u[i], other.u[i]);
        ASSERT_EQ(one.v[i], other.v[i]);
        for (int c = 0; c < 3; ++c) ASSERT_EQ(one.normal[c][i], other.normal[c][i]);
      }
    }
  }
}

TEST(LeafKernel, HitsAreBeyondNearAndNotBeyondFar) {
  Mesh m;
  m.vertices = {-1, -1, 2, 3, -1, 2, -1, 3, 2, 0};
  m.vertexCount = 3, m.indices = {0, 1, 2}, m.triangleCount = 1;
  LeafRay ray{{0, 0, 0}, {0, 0, 1}, 0, 10};
  EXPECT_EQ(countHits(m, ray), 1u);
  ray.far = 2;
  EXPECT_EQ(countHits(m, ray), 1u);
  ray.near = 2, ray.far = 10;
  EXPECT_EQ(countHits(m, ray), 0u);
  ray.near = 0, ray.far = 1.999f;
  EXPECT_EQ(countHits(m, ray), 0u);
}

TEST(LeafKernel, DamagedTrianglesAreNotMet) {
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInf = std::numeric_limits<float>::infinity();
  Mesh m;
  // No area; no number; infinite; and one that names vertices which are not there.
  m.vertices = {0, 0, 2, 1, 0, 2, 2, 0, 2, kNaN, 0, 2, kInf, 1, 2, 0};
  m.vertexCount = 5;
  m.indices = {0, 1, 2, 0, 0, 0, 3, 1, 2, 4, 0, 3, 200, 255, 17};
  m.triangleCount = 5;
  for (const Vec3& to : {Vec3(0, 0, 2), Vec3(1, 0, 2), Vec3(0.5f, 0, 2), Vec3(0.5f, 0.1f, 2)})
    EXPECT_EQ(countHits(m, rayTo(Vec3(0), to)), 0u);
}

}  // namespace
}  // namespace fr::tracer
