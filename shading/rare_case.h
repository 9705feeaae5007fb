// Cases that kernels compute out of line: lanes that are next to never there.
#pragma once

#include <cstdint>

namespace fr {

enum class RareCase : uint8_t {
  kDenormalLog,  // of a number below the smallest normal one
  kLargeAngle,   // an angle of thousands of turns, brought into range
  kLength,       // of a vector whose squares over- or underflow
  kNormalize,    // the same
  kHomogeneous,  // x, y, z, w: divided by w
  kLargeExp,     // e^(x + y), far above 1
  kLargePow,     // x^y, far above 1
  kCount
};
inline constexpr int kMostRareValues = 4;

}  // namespace fr
