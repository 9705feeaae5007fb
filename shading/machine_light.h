// One light of a running batch: its frame and its cached results.
#pragma once

#include "shading/machine.h"

namespace fr {

/// A light is run once per point; its results serve every illuminance loop over the same position. What is
/// remembered is remembered per point, so a point never depends on what its neighbours asked for.
struct Machine::LightState {
  const ShaderInstance* instance = nullptr;
  Frame frame;
  AlignedFloats memory;
  bool begun = false;  // prepared for this batch
  bool ambient = false;
  bool readsNormal = false;
  const Emitter* emitter = nullptr;  // of an area light: P and N are this sample's
  uint32_t sample = 0, samples = 1;
  bool sentTo = false;  // the last loop over it set its parameters
  std::string_view category;
  Operand Ps, N, L, Cl, Ol;  // Ps, N: what it was run for. L as in the light: from the light to the point
  Operand emitterP, emitterN;
  AlignedFloats aimed;           // columns of emitters that are written out in code (light_column)
  float* factor = nullptr;       // of Cl, for area lights
  int32_t* evaluated = nullptr;  // points that it was run for
  int32_t* lit = nullptr;        // of these: reached by illuminate or solar
  int32_t* shadowed = nullptr;   // of these: Cl already holds the shadow
  int32_t* scratch = nullptr;
};

}  // namespace fr
