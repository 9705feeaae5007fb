#include "tracer/testing/ray_batches.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <random>

namespace fr::testing {

using cache::CastsShadows;

namespace {
constexpr size_t kWords = 17;

void collect(const RayQuery& q, RayKind kind, size_t first, Answers& out) {
  const bool color = kind != RayKind::kHitTest, distance = kind != RayKind::kVisibility;
  const bool full = kind == RayKind::kFullTrace, hit = full || kind == RayKind::kHitTest;
  for (uint32_t i = 0; i < q.count; ++i) {
    uint32_t* w = out.data() + (first + i) * kWords;
    const auto put = [&](bool wanted, float f) { *w++ = wanted ? std::bit_cast<uint32_t>(f) : 0; };
    for (int c = 0; c < 3; ++c) put(color, q.color[c][i]);
    put(distance, q.hitDistance[i]);
    for (int c = 0; c < 3; ++c) put(hit, q.hitP[c][i]), put(hit, q.hitN[c][i]);
    for (int c = 0; c < 3; ++c) put(full, q.missP[c][i]), put(full, q.missR[c][i]);
    put(full, q.missDepth[i]);
  }
}
}  // namespace

void setRay(RayQuery& q, uint32_t i, const RayItem& r) {
  for (int c = 0; c < 3; ++c)
    q.origin[c][i] = r.origin[c], q.direction[c][i] = r.direction[c], q.normal[c][i] = r.normal[c];
  q.time[i] = r.time, q.u[i] = r.u, q.v[i] = r.v;
  q.node[i] = r.node, q.cell[i] = r.cell, q.seed[i] = r.seed;
  q.radius[i] = 0, q.spread[i] = 0.001f, q.importance[i] = 0, q.point[i] = 0;
}

void setRay(RayQuery& q, uint32_t i, const Vec3& origin, const Vec3& direction) {
  setRay(q, i, RayItem{origin, direction, Vec3(0), 0, 0, 0, cache::kNone, 0, i, i});
}

SingleRayMail mailOf(const RayItem& r, RayKind kind) {
  SingleRayMail m;
  for (int c = 0; c < 3; ++c)
    m.ray.origin[c] = r.origin[c], m.ray.direction[c] = r.direction[c], m.start.normal[c] = r.normal[c];
  m.ray.time = r.time, m.ray.spread = 0.001f, m.ray.seed = r.seed;
  m.ray.kind = uint8_t(kind);
  m.start.node = r.node, m.start.cell = r.cell, m.start.u = r.u, m.start.v = r.v;
  return m;
}

void append(Answers& answers, const SingleAnswer& a, RayKind kind) {
  const auto q = std::make_unique<RayQuery>();
  q->count = 1;
  for (int c = 0; c < 3; ++c) {
    q->color[c][0] = a.color[c];
    q->hitP[c][0] = a.hitP[c], q->hitN[c][0] = a.hitN[c];
    q->missP[c][0] = a.missP[c], q->missR[c][0] = a.missR[c];
  }
  q->hitDistance[0] = a.hitDistance, q->missDepth[0] = a.missDepth;
  answers.resize(answers.size() + kWords);
  collect(*q, kind, answers.size() / kWords - 1, answers);
}

void addZoo(AnalyticScene& s) {
  const Color half(0.5f), tint(0.9f, 0.6f, 0.3f);
  s.add({.center = {-2, 0, 0}, .radius = 1, .patchesU = 4, .patchesV = 4},
        {.shader = "mirror", .color = tint});
  s.add({.center = {2, 0, 0}, .radius = 1, .patchesU = 4, .patchesV = 4},
        {.shader = "clear", .color = tint, .castsShadows = CastsShadows::kShade});
  s.add({.kind = AnalyticShape::kTorus, .radius = 2.5f, .tube = 0.6f, .patchesU = 8, .patchesV = 4},
        {.shader = "lit", .color = tint, .opacity = half});
  s.add({.kind = AnalyticShape::kMeshSphere, .center = {0, 3, 1}, .patchesU = 4, .patchesV = 4, .cells = 8},
        {.shader = "noise", .castsShadows = CastsShadows::kShade});
  s.add({.kind = AnalyticShape::kPlane, .center = {0, 0, -3}, .axisU = {8, 0, 0}, .axisV = {0, 8, 0}},
        {.shader = "lit", .castsShadows = CastsShadows::kOpaque});
  s.add({.kind = AnalyticShape::kPlane, .center = {0, 0, 4}, .axisU = {4, 0, 0}, .axisV = {0, 4, 0}},
        {.shader = "halves", .castsShadows = CastsShadows::kShade});
  s.add({.kind = AnalyticShape::kPlane, .center = {0, 0, 4}, .axisU = {4, 0, 0}, .axisV = {0, 4, 0}},
        {.opacity = tint, .patchMultiplier = 1});
}

RayList randomRays(const cache::SceneCache& cache, size_t n, uint32_t seed) {
  std::mt19937 g(seed);
  const auto r = [&] { return float(g() >> 8) * 0x1p-24f; };
  RayList rays;
  for (size_t i = 0; i < n; ++i) {
    RayItem ray{};
    ray.origin = Vec3(r(), r(), r()) * 10.0f - 5.0f;
    ray.direction = Vec3(r(), r(), r()) * 10.0f - 5.0f - ray.origin;
    ray.node = cache::kNone;
    ray.time = r();
    ray.seed = g();
    ray.index = uint32_t(i);
    if (i & 1) {
      ray.node = uint32_t(g() % cache.nodeCount());
      ray.u = r() * 0.5f, ray.v = r() * 0.5f;
      cache::SurfaceOut out;
      for (int c = 0; c < 3; ++c) out.P[c] = &ray.origin[c], out.Ng[c] = &ray.normal[c];
      cache.evaluateDiced(ray.node, 1, &ray.cell, &ray.u, &ray.v, out);
    }
    rays.push_back(ray);
  }
  return rays;
}

void shuffle(RayList& rays) { std::shuffle(rays.begin(), rays.end(), std::mt19937(4)); }

void unshuffle(const RayList& rays, Answers& answers) {
  Answers sorted(answers.size());
  for (size_t i = 0; i < rays.size(); ++i)
    std::copy_n(answers.begin() + i * kWords, kWords, sorted.begin() + rays[i].index * kWords);
  answers = std::move(sorted);
}

Answers answerInBatches(tracer::AnswerThread& thread, const RayList& rays, RayKind kind, uint32_t batch) {
  Answers out(rays.size() * kWords);
  auto q = std::make_unique<RayQuery>();
  for (size_t first = 0; first < rays.size(); first += batch) {
    q->kind = kind, q->level = 1;
    q->count = uint32_t(std::min<size_t>(batch, rays.size() - first));
    for (uint32_t i = 0; i < q->count; ++i) setRay(*q, i, rays[first + i]);
    thread.answer(*q);
    collect(*q, kind, first, out);
  }
  return out;
}

Result<Answers> askOneByOne(RayOracle& oracle, const RayList& rays, RayKind kind) {
  Answers out;
  for (const RayItem& ray : rays) {
    Result<SingleAnswer> a = oracle.ask(mailOf(ray, kind));
    if (!a) return std::move(a).error();
    append(out, *a, kind);
  }
  return out;
}

Result<Answers> askInBatches(RayOracle& oracle, const RayList& rays, RayKind kind, uint32_t batch) {
  Answers out(rays.size() * kWords);
  struct Flight {
    RayQuery* q;
    size_t first;
  };
  std::vector<Flight> flying;
  const auto land = [&]() -> Result<void> {
    if (Result<void> w = oracle.wait(); !w) return w;
    for (size_t k = 0; k < flying.size();) {
      if (!oracle.answered(flying[k].q)) {
        ++k;
        continue;
      }
      collect(*flying[k].q, kind, flying[k].first, out);
      oracle.release(flying[k].q);
      flying.erase(flying.begin() + ptrdiff_t(k));
    }
    return {};
  };
  for (size_t first = 0; first < rays.size(); first += batch) {
    RayQuery* q;
    while (!(q = oracle.acquire()))
      if (Result<void> l = land(); !l) return std::move(l).error();
    q->kind = kind, q->level = 1;
    q->count = uint32_t(std::min<size_t>(batch, rays.size() - first));
    for (uint32_t i = 0; i < q->count; ++i) setRay(*q, i, rays[first + i]);
    flying.push_back({q, first});
    if (Result<void> s = oracle.submit(q); !s) return std::move(s).error();
  }
  while (!flying.empty())
    if (Result<void> l = land(); !l) return std::move(l).error();
  return out;
}

}  // namespace fr::testing
