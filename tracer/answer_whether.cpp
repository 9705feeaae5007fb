// rayhittest that only wants to know whether anything is hit, as occlusion does. Most of these rays meet
// nothing that could be a hit, so what only hits ask of a ray is not worked out before one comes up.
#include <algorithm>
#include <array>
#include <span>

#include "base/isa.h"
#include "tracer/answer_level.h"
#include "tracer/ray_order.h"
#include "tracer/ray_start_kernel.h"

namespace fr::tracer {

using namespace cache;

RayStartKernels rayStartKernels() {
  return forIsa(RayStartKernels{sse4::startRays, sse4::nudgeRays},
                RayStartKernels{avx2::startRays, avx2::nudgeRays},
                RayStartKernels{avx512::startRays, avx512::nudgeRays});
}

namespace {

/// Rays of a block as they are traced.
struct Started {
  alignas(32) float origin[3][kMaxRays];
  alignas(32) float direction[3][kMaxRays];
  float near[kMaxRays];
  bool sane[kMaxRays], plain[kMaxRays];

  StartedColumns columns() {
    return {{origin[0], origin[1], origin[2]}, {direction[0], direction[1], direction[2]}};
  }
  void set(uint32_t k, const Ray& ray) {
    for (int c = 0; c < 3; ++c) origin[c][k] = ray.origin[c], direction[c][k] = ray.direction[c];
    near[k] = ray.nearDistance;
  }
};

}  // namespace

void AnswerThread::answerWhether(RayQuery& query, uint32_t count, uint32_t mask, const Level& at) {
  const RayScene* scene = tracer_.scene();
  if (!scene) return void(std::fill_n(query.hitDistance, count, kNoHit));
  static const RayStartKernels kernels = rayStartKernels();
  static thread_local Started started;
  const volatile RayQuery& q = query;
  const AskedColumns asked{{query.origin[0], query.origin[1], query.origin[2]},
                           {query.direction[0], query.direction[1], query.direction[2]},
                           {query.normal[0], query.normal[1], query.normal[2]}};
  const bool hasBias = at.terms.flags & RayTerms::kHasBias;
  std::optional<LeavingRays> leaving;
  NodeId leavingNode = kNone;
  bool known = false;
  for (uint32_t first = 0; first < count; first += kRaysAtOnce) {
    const uint32_t end = std::min(first + kRaysAtOnce, count);
    // Points that ask together nearly always lie on one patch.
    const NodeId node = q.node[first];
    bool same = !hasBias;
    for (uint32_t k = first + 1; k < end; ++k) same &= q.node[k] == node;
    if (same && (!known || node != leavingNode))
      leaving = scene->leavingRays(node), leavingNode = node, known = true;
    const uint32_t plain = same && leaving ? kernels.startRays(asked, first, *leaving, started.columns()) : 0;
    for (uint32_t k = first; k < end; ++k) {
      started.plain[k] = started.sane[k] = plain >> (k - first) & 1;
      started.near[k] = 0;
      if (started.plain[k]) continue;
      Ray ray;
      started.sane[k] = startRay(ray, askedRay(query, k), mask, at);
      started.set(k, ray);
    }
    // A second ray beside those that meet nothing would cost too much: all go beside their aim.
    kernels.nudgeRays(started.columns(), first);
  }

  uint32_t order[kMaxRays];
  orderRays(scene, count, order, [](uint32_t k) {
    const auto at3 = [k](const auto& c) { return Vec3(c[0][k], c[1][k], c[2][k]); };
    return std::pair(at3(started.origin), at3(started.direction));
  });
  struct Rest {
    AnswerThread* self;
    const RayQuery* query;
    const Level* at;
    uint32_t k, mask;
    static void fill(void* who, Ray& ray) {
      const Rest& r = *static_cast<const Rest*>(who);
      const AskedRay again = askedRay(*r.query, r.k);
      if (started.plain[r.k]) {
        r.self->fillRay(ray, again, r.mask, *r.at);
        ray.departure = r.self->tracer_.scene()->departure(again.node, ray.direction, again.normal);
      } else {
        // A ray that a client has changed meanwhile is answered as something in between.
        Ray whole;
        (void)r.self->startRay(whole, again, r.mask, *r.at);
        whole.origin = ray.origin, whole.direction = ray.direction;
        ray = whole;
      }
    }
  } rest{this, &query, &at, 0, mask};
  const float farDistance = at.terms.maxDistance > 0 ? at.terms.maxDistance : kInfinity;
  for (const uint32_t k : std::span(order, count)) {
    query.hitDistance[k] = kNoHit;
    if (!started.sane[k]) continue;
    counts_.intersections += 1;
    Ray ray;
    for (int c = 0; c < 3; ++c)
      ray.origin[c] = started.origin[c][k], ray.direction[c] = started.direction[c][k];
    const float time = q.time[k];
    ray.time = time >= 0 && time <= 1 ? time : time > 1 ? 1.0f : 0.0f;
    ray.nearDistance = started.near[k], ray.farDistance = farDistance, ray.mask = mask;
    rest.k = k;
    if (scene->anyHit(ray, &rest, &Rest::fill)) query.hitDistance[k] = 0;
  }
}

}  // namespace fr::tracer
