// Random shaders, for comparison of the virtual machine with reference_interpreter.h.
#pragma once

#include <cstdint>
#include <string>

namespace fr {

/// A surface shader that sets Ci, Oi and the output parameters "aov" (color) and "trail" (float), has the
/// parameters "gain" (float) and "tint" (color), compiles, and ends. The same text for the same seed.
std::string randomShader(uint64_t seed);
/// The same with loops over lights, diffuse() and specular(), and messages to lights: beyond what the
/// reference interpreter knows.
std::string randomLitShader(uint64_t seed);
/// A light for it: from a point, a cone, parallel, or ambient.
std::string randomLight(uint64_t seed);

}  // namespace fr
