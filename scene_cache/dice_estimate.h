// How many micropolygons a box of surface will be, before anything is diced.
#pragma once

#include "scene_cache/dice_metric.h"

namespace fr::cache {

/// Micropolygons of a surface that fills `bound` (cache space) about once, rated as dicing will rate it:
/// before it is displaced, so `displacement`, by which the box was grown for that, is taken off again. A
/// rough figure (within a factor of a few for most patches) that depends on the arguments alone; 0 for an
/// empty or infinite box.
double estimateMicropolygons(const DiceRate& rate, const Box3f& bound, float displacement);

}  // namespace fr::cache
