// Rays that leave a surface: neither the surface itself shadows them, nor does anything else get lost.
#include <gtest/gtest.h>

#include "tests/stability/traced_model.h"

namespace fr::test {
namespace {

using namespace cache;

struct Start {
  NodeId node;
  Vec3 p, normal;  // geometric, oriented as the surface is
  float out;       // 1 or -1: the normal points out of the model, or into it
};

/// Points that shaders stand on: vertices of grids (every stride's are among them), and points where rays
/// hit, as their shading sees them.
std::vector<Start> shadedPoints(TracedModel& model, size_t wanted) {
  std::vector<Start> all;
  Counted random(7);
  std::vector<std::pair<NodeId, GridRecord>> grids;
  size_t vertices = 0;
  model.scene().forEachGrid([&](NodeId id, const GridRecord& g) {
    if (g.flags & kGridAbsent) return;
    grids.emplace_back(id, g);
    vertices += model.cache().view(g).vertexCount();
  });
  const double keep = double(wanted) / 2 / double(vertices);
  for (const auto& [id, g] : grids) {
    const GridView view = model.cache().view(g);
    const size_t n = view.vertexCount();
    std::vector<uint32_t> cell(n);
    std::vector<float> u(n), v(n), ng[3], p[3];
    model.cache().vertexParameters(g, cell.data(), u.data(), v.data());
    SurfaceOut out;
    for (int c = 0; c < 3; ++c)
      ng[c].resize(n), p[c].resize(n), out.Ng[c] = ng[c].data(), out.P[c] = p[c].data();
    const auto take = [&](size_t i) {
      Start s{id, {p[0][i], p[1][i], p[2][i]}, {ng[0][i], ng[1][i], ng[2][i]}, 1};
      if (glm::dot(s.normal, s.p - model.inside) < 0) s.out = -1;  // all are star-shaped, or nearly
      all.push_back(s);
    };
    model.cache().evaluateDiced(id, n, cell.data(), u.data(), v.data(), out);
    for (size_t i = 0; i < n; ++i)
      if (random() < keep) {
        take(i);
        if (g.kind == GridKind::kGrid)  // as stored, not as interpolated
          all.back().p = view.vertex(i / (g.nu + 1u) * g.rowStride + i % (g.nu + 1u));
      }
    // Somewhere in the cells.
    for (size_t i = 0; i < n; ++i) {
      if (g.kind == GridKind::kMeshlet) {
        cell[i] = std::min(uint32_t(random() * g.nv), g.nv - 1u);
        u[i] = random(), v[i] = random();
        if (u[i] + v[i] > 1) u[i] = 1 - u[i], v[i] = 1 - v[i];
      } else {
        const PatchNode& place = model.cache().node(id);
        u[i] = std::ldexp(float(place.iu) + random(), -place.du);
        v[i] = std::ldexp(float(place.iv) + random(), -place.dv);
      }
    }
    model.cache().evaluateDiced(id, n, cell.data(), u.data(), v.data(), out);
    for (size_t i = 0; i < n; ++i)
      if (random() < keep) take(i);
  }
  return all;
}

/// A direction at this cosine to the normal.
Vec3 directionAt(const Vec3& normal, float cosine, Counted& random) {
  Vec3 t;
  do {
    t = random.direction();
    t -= normal * glm::dot(t, normal);
  } while (glm::length(t) < 1e-2f);
  return glm::normalize(cosine * normal + std::sqrt(1 - cosine * cosine) * glm::normalize(t));
}

tracer::Ray leaving(const tracer::RayScene& scene, const Start& s, const Vec3& direction) {
  tracer::Ray r;
  r.direction = direction;
  r.origin = s.p;
  scene.leave(r, s.node, s.normal);
  return r;
}

class Leaving : public ::testing::TestWithParam<Model> {};

/// Grazing ones too: the logarithm of the cosine is spread evenly over a millionth to one for half of the
/// rays, the others are as diffuse reflection sends them.
float anyCosine(uint64_t i, Counted& random) {
  return i % 2 ? std::pow(10.0f, -6 * random()) : std::sqrt(std::max(1e-12f, random()));
}

/// The ray runs through the inside of the facets somewhere, by more than rounding: a convex model's facets
/// lie within it, so it is inside the model too.
bool runsInside(const tracer::RayScene& scene, const Vec3& center, const Vec3& origin,
                const Vec3& direction) {
  for (float t = 1e-3f; t < 3; t *= 1.5f) {
    const Vec3 q = origin + t * direction;
    tracer::Ray r;
    r.origin = center, r.direction = glm::normalize(q - center);
    const tracer::Hit hit = scene.closest(r);
    if (hit.any() && glm::distance(q, center) < hit.distance - 1e-4f) return true;
  }
  return false;
}

TEST_P(Leaving, NothingShadowsConvexSurfacesAndInsidesAreClosed) {
  const Model& m = GetParam();
  if (!m.convex) GTEST_SKIP() << "nothing is known of where such rays end";
  TracedModel model(m);
  const std::vector<Start> starts = shadedPoints(model, effort(20'000, 1'000'000));
  for (const float multiplier : {1.0f, 0.5f, 0.25f, 0.125f}) {
    const auto scene = model.trace(multiplier);
    ASSERT_TRUE(scene);
    Counted random(3);
    uint64_t falseHits = 0, falseShadows = 0, lost = 0, slivers = 0, rays = 0;
    for (const Start& s : starts) {
      const float cosine = anyCosine(rays++, random);
      tracer::Ray out = leaving(*scene, s, directionAt(s.normal, s.out * cosine, random));
      falseHits += scene->closest(out).any();
      out.farDistance = 100, out.endsOnSurface = true;
      falseShadows += scene->obstacle(out) != tracer::Obstacle::kNone;
      const tracer::Ray in = leaving(*scene, s, directionAt(s.normal, -s.out * cosine, random));
      if (scene->closest(in).any()) continue;
      lost += runsInside(*scene, model.inside, s.p, in.direction);
      // On a unit sphere it is known how deep the ray goes.
      slivers += m.name.ends_with("Sphere") && m.name[1] != 't' && cosine * cosine > 1e-4f;
    }
    // What is left: starts on the very edge of two primitives, and grazing starts on coarse facets. Half of
    // these rays graze, so diffuse ones see much less of it.
    EXPECT_LE(falseHits, rays / 4000) << "of " << rays << " at " << multiplier;
    EXPECT_LE(falseShadows, rays / 4000) << "of " << rays << " at " << multiplier;
    EXPECT_LE(lost, rays / 80) << "of " << rays << " at " << multiplier;
    EXPECT_LE(slivers, rays / 80) << "of " << rays << " at " << multiplier;
  }
}

INSTANTIATE_TEST_SUITE_P(Models, Leaving, ::testing::ValuesIn(closedModels()),
                         [](const auto& p) { return p.param.name; });

}  // namespace
}  // namespace fr::test
