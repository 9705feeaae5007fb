// A ray question in the making: one ray a point, for the active points.
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
  uint32_t sample = 0, samples = 1;
};

}  // namespace fr
