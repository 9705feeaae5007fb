// What the user of rendrib -rayserver typed.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene_cache/scene_loader.h"
#include "tools/memory_budget.h"

namespace fr::tools {

struct RayServerCommand {
  std::vector<cache::RibInput> inputs;  // in order; one .fsc stands alone
  cache::LoadOptions load;
  std::string name;  // empty: none was given
  int threads = 0;   // 0: all cores
  MemoryOptions memory;
  float patchMultiplier = 0.5f;
  bool silent = false, deterministic = false;
  std::string shaderPath;  // colon-separated, searched first
};

struct ParsedRayServerCommand {
  std::optional<RayServerCommand> run;  // empty: exit with `exitCode`
  int exitCode = 0;
};

/// Options have one dash, as in 1998, or two. Prints help, version or a usage error itself.
ParsedRayServerCommand parseRayServerCommand(int argc, char** argv);

}  // namespace fr::tools
