// What answering needs at one depth of the ray tree. Internal to tracer/.
#pragma once

#include <cmath>
#include <memory>
#include <string>

#include "tracer/ray_tracer.h"

namespace fr::tracer {

/// A ray as it was asked: read once, nothing checked.
struct AnswerThread::AskedRay {
  Vec3 origin, direction, normal;
  float time, radius, spread;
  cache::NodeId node;
  uint64_t seed;

  float saneRadius() const { return radius >= 0 && std::isfinite(radius) ? radius : 0; }
  float saneSpread() const { return std::isfinite(spread) ? spread : 0; }
};

/// A ray on its way through the surfaces that it meets.
struct AnswerThread::PathRay {
  Ray ray;
  Vec3 askedOrigin, askedDirection;
  float radius, spread;
  uint64_t seed;
  bool sane;   // can be traced
  bool going;  // has not ended
  uint32_t steps;
  // The volume between the last surface and the next: that of the surface which the ray left or passed.
  cache::AttributeId volumeOf;  // kNone: it starts on no surface
  bool inside;
  float segmentStart;
  Hit hit;        // the surface it stands on now
  Color through;  // what still comes through everything passed
  Color color;
  Color hitColor, hitOpacity;  // of the surface it stands on, once shaded
  Hit firstHit;
  // The deepest ray below (this one included) that left the scene.
  uint32_t missDepth;
  Vec3 missP, missR;
};

struct AnswerThread::Level {
  PathRay path[kMaxRays];
  uint32_t count = 0;
  uint32_t rayLevel = 0;
  RayTerms terms{};
  // What terms.subset and terms.excludeSubset let be seen, by AttributeId; kept from question to question.
  std::vector<uint8_t> seen;
  std::string seenSubset, seenExclude;
  bool limited = false;  // `seen` is in force
  struct Extra {
    std::string name;
    uint32_t components, column;
  };
  std::vector<Extra> extras;
  std::string extrasText;
  float extra[kMaxExtraAnswers][kMaxRays];
  // Hits to be shaded now: indices into path, sorted by shade group.
  uint32_t order[kMaxRays];
  uint32_t group[kMaxRays];
  uint32_t volume[kMaxRays];  // volumeKey() of each path
  uint32_t orderCount = 0;
  // ShadePoints of one group, and the answers to its own questions.
  cache::NodeId node[kMaxRays];
  uint32_t cell[kMaxRays];
  float u[kMaxRays], v[kMaxRays];
  float direction[3][kMaxRays], origin[3][kMaxRays];
  float distance[kMaxRays], radius[kMaxRays], spread[kMaxRays], time[kMaxRays], segmentStart[kMaxRays];
  uint64_t seed[kMaxRays];
  std::unique_ptr<ShadeTask> task;
  RayQuery child;
};

}  // namespace fr::tracer
