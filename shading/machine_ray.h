// A ray question in the making: one ray a point, for the active points; and the call that asks it.
#pragma once

#include <limits>

#include "shading/machine.h"

namespace fr {

/// An optional number of a ray call: one for all points, or one for each.
struct Machine::Term {
  Operand given;  // no data: `fallback` everywhere
  float fallback = 0;
  float scale = 1;  // of what was given
  float at(uint32_t lane) const { return given.data ? given.at(lane) * scale : fallback; }
  bool varies() const { return given.data && given.varying(); }
};

struct Machine::Question {
  RayKind kind = RayKind::kTrace;
  Operand from;
  Operand direction;  // from `from`; or the end point
  bool toPoint = false;
  const int32_t* mask = nullptr;
  uint64_t site = 0;                  // call site, for the seeds
  const uint32_t* counter = nullptr;  // invocations of the site, per lane
  // A sample of a cone about the direction: index `sample` of `samples`.
  Term cone;            // half angle, radians; 0: the direction itself
  bool cosine = false;  // density falls with the cosine to the direction
  Term base;            // part of the micropolygon over which origins are spread
  Term samples;
  uint32_t sample = 0;  // the first that is asked now
  uint32_t run = 1;     // as many samples of a point as go into one block, one after the other
  bool hemisphere = false, aimed = false;  // samples differ even without a cone
  bool several = false;                    // as many samples as were asked for, whether they differ or not
  bool noRays = false;                     // directions alone are wanted
  bool pairs = false;                      // so are the random numbers that chose them
  // What the rays of one block have in common; points that say otherwise are asked in a block of their own.
  Term maxDistance{{}, 1e30f}, bias{{}, -1.0f};
  float diffuseBeyond = std::numeric_limits<float>::infinity();  // cones wider than this ask diffuse rays
  RayTerms terms{};

  float coneAt(uint32_t lane) const;
  float baseAt(uint32_t lane) const;
  uint32_t samplesAt(uint32_t lane) const;
};

/// What a ray operation is, beyond its question: trace, transmission, occlusion and so on differ in where
/// their operands stand and in what becomes of the answers.
struct Machine::RayCall {
  enum class Result { kColor, kDistance, kHidden, kHit, kFull, kChannel, kShadow };
  Result result = Result::kColor;
  uint32_t outputs = 1;  // written operands before the inputs
  uint32_t fixed = 0;    // operands before the optional ones
  bool averaged = false;
  Question question;
  uint32_t samples = 1;  // the most that any point wants
  Term falloff;
  bool polynomial = false;         // falloffmode 1
  bool sums[5] = {};               // which of the running sums somebody asks for
  std::string_view environment;    // map for rays that hit nothing, "" none
  std::string_view environmentIn;  // its coordinate system
};

/// Running sums of an averaged call, and their columns: color, hidden fraction, transmission, unoccluded
/// direction, environment.
enum RaySum : uint32_t { kOfColor, kOfHidden, kOfThrough, kOfClear, kOfEnvironment };
inline constexpr uint32_t kSumColor = 0, kSumHidden = 3, kSumThrough = 4, kSumClear = 7, kSumEnvironment = 10,
                          kSumColumns = 13;

}  // namespace fr
