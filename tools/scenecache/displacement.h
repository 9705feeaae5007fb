// Whether displacement shaders make the same of the same points as they did for an earlier cache.
#pragma once

#include <cstdint>

#include "scene_cache/cache.h"
#include "shading/shader_library.h"

namespace fr::tools {

/// Hash of the displacement and deformation shaders that live objects have and of what they read from the
/// disk: their code, and size and time of the files that their strings name (textures, found in the scene's
/// texture folders). 0 when a shader cannot be loaded.
uint64_t displacementFingerprint(const cache::Skeleton& skeleton, ShaderLibrary& library);

}  // namespace fr::tools
