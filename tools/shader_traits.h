// Which shaders of a scene can ask for rays, before the scene is complete.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "scene_cache/scene_loader.h"

namespace fr::tools {

/// For cache::LoadOptions::asksRays. Shaders are searched where shaderFolders() will say; each is loaded or
/// compiled at the first question about it. `first` as in shaderFolders().
std::function<bool(const std::string&, const std::vector<std::string>&)> shaderRays(
    std::string_view first, std::span<const cache::RibInput> inputs);

}  // namespace fr::tools
