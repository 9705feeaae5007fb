// A finished world becomes pictures, in this process.
#pragma once

#include "scene_cache/scene_loader.h"

namespace fr::libri {

/// Renders one world to its displays: REYES, with the ray tracer in this process. Errors are reported.
void renderWorld(cache::Frame&& frame);

}  // namespace fr::libri
