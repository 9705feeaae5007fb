// A transform between its motion keys.
#pragma once

#include <span>

#include "base/math.h"

namespace fr::cache {

/// Matrix at `time` between ascending keys; clamped outside them. Between two keys, the rotation turns along
/// the shortest arc and stretch and translation go straight (polar decomposition: Shoemake and Duff, "Matrix
/// Animation and Polar Decomposition", 1992). A plain blend of the matrices would shrink what turns. Keys
/// that cannot be decomposed (singular, or of different handedness, or projections) are blended entry by
/// entry.
DMat4 interpolateMotion(std::span<const float> times, std::span<const DMat4> matrices, float time);

}  // namespace fr::cache
