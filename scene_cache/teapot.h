// Geometry "teapot".
#pragma once

#include <vector>

#include "ri/primitives.h"

namespace fr::cache {

/// 32 bicubic patches to be made under the Bezier basis; about 3 units high, standing on the plane z = 0.
std::vector<ri::Patch> teapotPatches();

}  // namespace fr::cache
