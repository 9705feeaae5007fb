// Many random rays over a mixed scene, asked in batches of any size: for tests that compare answers bit for
// bit.
#pragma once

#include <vector>

#include "oracle/ray_oracle.h"
#include "tracer/ray_tracer.h"
#include "tracer/testing/analytic_scene.h"

namespace fr::testing {

struct RayItem {
  Vec3 origin, direction, normal;
  float time, u, v;
  uint32_t node, cell;
  uint64_t seed;
  uint32_t index;  // place in the list as made
};
using RayList = std::vector<RayItem>;
/// Bits of all outputs, ray after ray; kWords each.
using Answers = std::vector<uint32_t>;

/// Fills one ray that does not start on a surface.
void setRay(RayQuery& q, uint32_t i, const Vec3& origin, const Vec3& direction);
void setRay(RayQuery& q, uint32_t i, const RayItem& ray);

/// The same ray for a mailbox.
SingleRayMail mailOf(const RayItem& ray, RayKind kind);
/// The bits of a single answer, as the functions below give them for blocks.
void append(Answers& answers, const SingleAnswer& answer, RayKind kind);

/// Spheres, a torus, planes and a mesh with every shader and way to cast shadows.
void addZoo(AnalyticScene& scene);
/// Half of them start on surfaces.
RayList randomRays(const cache::SceneCache& cache, size_t n, uint32_t seed);
void shuffle(RayList& rays);
/// Brings answers to shuffled rays into the order of the rays as made.
void unshuffle(const RayList& rays, Answers& answers);

Answers answerInBatches(tracer::AnswerThread& thread, const RayList& rays, RayKind kind, uint32_t batch);
/// Through an oracle's way for single rays.
Result<Answers> askOneByOne(RayOracle& oracle, const RayList& rays, RayKind kind);
/// Through an oracle, with several blocks in flight.
Result<Answers> askInBatches(RayOracle& oracle, const RayList& rays, RayKind kind, uint32_t batch);

}  // namespace fr::testing
