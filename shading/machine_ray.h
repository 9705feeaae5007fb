// A ray question in the making: one ray a point, for the active points; and the call that asks it.
#pragma once

#include "shading/machine.h"

namespace fr {

struct Machine::Question {
  RayKind kind = RayKind::kTrace;
  Operand from;
  Operand direction;  // from `from`; or the end point
  bool toPoint = false;
  const int32_t* mask = nullptr;
  uint64_t site = 0;                  // call site, for the seeds
  const uint32_t* counter = nullptr;  // invocations of the site, per lane
  // A sample of a cone about the direction: index `sample` of `samples`.
  float cone = 0;       // half angle, radians; 0: the direction itself
  bool cosine = false;  // density falls with the cosine to the direction
  float base = 0;       // part of the micropolygon over which origins are spread
  uint32_t sample = 0, samples = 1;
  bool noRays = false;  // directions alone are wanted
  RayTerms terms{};
};

/// What a ray operation is, beyond its question: trace, transmission, occlusion and so on differ in where
/// their operands stand and in what becomes of the answers.
struct Machine::RayCall {
  enum class Result { kColor, kDistance, kHidden, kHit, kFull, kChannel, kShadow };
  Result result = Result::kColor;
  uint32_t outputs = 1;  // written operands before the inputs
  uint32_t fixed = 0;    // operands before the optional ones
  bool averaged = false;
  bool aimed = false;  // each sample goes to another point of a light
  Question question;
  float maxDistance = 1e30f;
  float falloff = 0;
  bool polynomial = false;  // falloffmode 1
  const int32_t* mask = nullptr;
};

/// Columns of the running sums: color, hidden fraction, transmission, unoccluded direction.
inline constexpr uint32_t kSumColor = 0, kSumHidden = 3, kSumThrough = 4, kSumClear = 7, kSumColumns = 10;

}  // namespace fr
