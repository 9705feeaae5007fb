// Owen-scrambled Sobol points (Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 9(4)):
// low-discrepancy samples whose scramble and order depend on a 32-bit seed alone.
#pragma once

#include <cstdint>

#include "base/math.h"

namespace fr {

/// Point `index` of dimension 0..3 of the sequence, shuffled and scrambled by `seed`; in [0,1).
/// Any power-of-two run of indices from 0 is stratified in every pair of dimensions 0,1.
float sobolOwen(uint32_t index, int dimension, uint32_t seed);
/// Dimensions 0 and 1 of one point (a (0,2)-sequence).
Vec2 sobolOwen2(uint32_t index, uint32_t seed);

}  // namespace fr
