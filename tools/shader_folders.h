// Where the programs look for a scene's shaders.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "scene_cache/cache.h"
#include "scene_cache/scene_loader.h"

namespace fr::tools {

/// In order: `first` (colon-separated), the scene's own search path, SHADERS, the folders of the scene files,
/// the current folder. Standard shaders come after all of these (ShadingSystem::Options::standardShaders).
std::vector<std::string> shaderFolders(std::string_view first, const cache::Skeleton& skeleton,
                                       std::span<const cache::RibInput> inputs);

/// The same before there is a skeleton; `scene`: the scene's own search path.
std::vector<std::string> shaderFolders(std::string_view first, std::span<const std::string> scene,
                                       std::span<const cache::RibInput> inputs);

}  // namespace fr::tools
