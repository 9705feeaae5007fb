// What a scene needs to know of its shaders before it is complete.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "scene_cache/scene_loader.h"

namespace fr::tools {

/// For cache::LoadOptions.
struct ShaderTraits {
  std::function<bool(const std::string&, const std::vector<std::string>&)> asksRays, movesPoints;
  std::function<bool(const std::string&, const std::vector<std::string>&, const std::string&)> takesString;
};
/// Shaders are searched where shaderFolders() will say; each is loaded or compiled at the first question
/// about it. `first` as in shaderFolders(). The answers are thread-safe.
ShaderTraits shaderTraits(std::string_view first, std::span<const cache::RibInput> inputs);

}  // namespace fr::tools
