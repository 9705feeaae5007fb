// A batch of ray questions and the place for their answers: what travels through the rings.
//
// Structure of arrays. Everything spatial is in cache space (scene_cache/cache.h). Trivially copyable: it
// lives in shared memory, and whoever reads it checks every field.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "base/math.h"

namespace fr {

inline constexpr uint32_t kMaxRays = 1024;
/// Places of an array: one cache line more than used. Arrays at a power of two from each other would share
/// one set of every cache, and a ray touches all of them.
inline constexpr uint32_t kRayRow = kMaxRays + 16;

/// What is asked of every ray of a batch.
enum class RayKind : uint32_t {
  kTrace,       // color, hitDistance
  kVisibility,  // color: 1 clear ... 0 opaque, between origin and origin + direction (t in [0,1])
  kHitTest,     // hitDistance (1e38 on a miss), hitP, hitN; or less: RayTerms::kOnlyDistance, kOnlyWhether
  kFullTrace,   // all; hitDistance 1e30 on a miss; missDepth, missP, missR
};

/// Which rays of a kind these are: what surfaces they can see, and rayinfo("type") at their hits. Visibility
/// questions are always transmission rays, whatever stands here.
enum class RayClass : uint32_t { kSpecular, kDiffuse };

/// How the surfaces that rays hit are asked for colour or opacity; kDefault: as their attributes say.
enum class HitMode : uint32_t { kDefault, kPrimitive, kShader };

/// Floats per ray beyond the fixed answers.
inline constexpr uint32_t kMaxExtraAnswers = 12;

/// What a call site says about all its rays. All bytes 0: nothing said. Strings end with 0.
struct RayTerms {
  /// kOnlyDistance: rayhittest leaves hitP and hitN alone. kOnlyWhether: so it does, and hitDistance only
  /// says whether there is a hit (0, or 1e38), which is quicker than to find the first one; unless the patch
  /// or extra answers are wanted, too.
  enum Flags : uint32_t {
    kHasBias = 1,
    kFrontOnly = 2,
    kBackOnly = 4,
    kWantsNode = 8,
    kHasOpaque = 16,
    kOnlyDistance = 32,
    kOnlyWhether = 64,
  };
  RayClass rayClass;
  uint32_t flags;
  float maxDistance;      // hits farther away are none; 0: no limit. Not for visibility
  float bias;             // kHasBias: hits nearer than this are none, instead of any other care at the start
  uint32_t diffuseDepth;  // of these rays: diffuse rays on the way from the camera, themselves included
  uint32_t shadowDepth;   // the same of transmission rays
  HitMode hitMode;
  float opaque[3];  // kHasOpaque: a ray ends at the surface behind which its opacity is this everywhere
  char label[40];   // raylabel() at hits
  char subset[64];  // groups (Attribute "grouping" "membership") that are seen, "": all
  char excludeSubset[64];  // groups that are not
  /// Wanted extra answers, not of visibility, a line each: number of components (1 or 3), a space, a name:
  /// "surface:x", "displacement:x", "volume:x", "primitive:x", "attribute:x" of the nearest hit;
  /// "surface:Oi" and "ray:transmission" of the ray. Current space.
  char extras[256];
};
static_assert(sizeof(RayTerms) % 8 == 0);

/// What oracles map read-only, if they are another process: the question. Whole pages.
inline constexpr size_t kQuestionBytes = [] {
  constexpr size_t bytes = 16 + sizeof(RayTerms) + 18 * kRayRow * sizeof(float) + (kMaxRays + 8) * 8;
  return (bytes + 4095) / 4096 * 4096;
}();

/// The question is written by the client alone, the answer by the oracle. Only [0, count) is meaningful.
struct RayQuery {
  RayKind kind;
  uint32_t count;
  uint32_t level;     // ray level of these rays: 1 for rays asked by camera-visible points
  uint32_t reserved;  // anything
  RayTerms terms;     // oracles clear it when a block is acquired

  float origin[3][kRayRow];
  float direction[3][kRayRow];  // need not be unit; kVisibility: to - from
  float time[kRayRow];          // 0..1 within the shutter
  float radius[kRayRow];        // footprint at the origin
  float spread[kRayRow];        // growth of the footprint's radius per unit of distance
  float normal[3][kRayRow];  // geometric normal (unit, oriented) at the start point; 0: does not start on a
                             // surface
  uint32_t node[kRayRow];    // patch the ray starts on, cache::kNone: none
  uint32_t cell[kRayRow];
  float u[kRayRow], v[kRayRow];
  uint64_t seed[kMaxRays + 8];   // path of counter-based random numbers
  uint32_t importance[kRayRow];  // weight as float bits; reserved for pruning
  uint32_t
      point[kRayRow];  // which point of the asking batch this ray belongs to: ShadeTask::writeRays sets it,
                       // the tracer uses it to find the deepest miss below each hit; 0xffffffff: all of them
                       // (one ray whose operands are uniform). Clients of an oracle may leave it alone

  std::byte pad[kQuestionBytes - 16 - sizeof(RayTerms) - 18 * kRayRow * sizeof(float) - (kMaxRays + 8) * 8];

  float color[3][kRayRow];
  float hitDistance[kRayRow];
  float hitP[3][kRayRow];
  float hitN[3][kRayRow];
  float missP[3][kRayRow];
  float missR[3][kRayRow];
  float missDepth[kRayRow];                // depth of the deepest ray that missed everything, 0: none missed
  uint32_t hitNode[kRayRow];               // kWantsNode: patch that was hit, cache::kNone: none
  float extra[kMaxExtraAnswers][kRayRow];  // as terms.extras asks, component after component
};
static_assert(offsetof(RayQuery, color) == kQuestionBytes);
static_assert(std::is_trivially_copyable_v<RayQuery> && std::is_standard_layout_v<RayQuery>);

inline constexpr float kNoHit = 1.0e38f;           // rayhittest
inline constexpr float kNoHitFullTrace = 1.0e30f;  // fulltrace

}  // namespace fr
