// Several RIB files read as one stream into a builder.
#pragma once

#include <span>
#include <string>

#include "scene_cache/scene_builder.h"

namespace fr::cache {

/// Reads the inputs that `side` (kForReyes or kForTracer) sees, in order, and closes what is open at the end.
/// Archives are also looked for beside the inputs. `standardInput`, when not null, stands for "-". `mute`:
/// nothing is reported about files that both sides see, because the other side's stream does. Returns the
/// first error of a file that could not be read, after the others have been read.
Result<void> readStream(SceneBuilder& builder, std::span<const RibInput> inputs, uint8_t side,
                        const std::string* standardInput, bool mute);

/// The standard search paths, which "@" in Option "searchpath" stands for: SHADERS, TEXTURES, ARCHIVES,
/// PROCEDURALS and DISPLAYS of the environment.
ri::StateRenderer::PathLists environmentPaths();

}  // namespace fr::cache
