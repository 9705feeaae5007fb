// What the user of frankenrender typed.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "imaging/adaptive_sampling.h"
#include "scene_cache/scene_loader.h"
#include "tools/memory_budget.h"

namespace fr::tools {

struct CommandLine {
  std::vector<cache::RibInput> inputs;  // in order; one .fsc stands alone
  cache::LoadOptions load;
  bool inproc = false;
  bool pipe = false;
  std::vector<std::string> words;  // as typed, without the program: a ray server of --pipe gets the same
  int threads = 0;                 // 0: all cores
  std::optional<AdaptiveSampling> adaptive;
  bool tellError = false;  // that adaptive sampling reached
  MemoryOptions memory;
  bool progress = false;
  bool stats = false;
  bool resume = false;
  bool deterministic = false;
  bool progressive = false;
  bool quiet = false;
  std::string shaderPath;  // colon-separated, searched first
};

struct ParsedCommandLine {
  std::optional<CommandLine> run;  // empty: exit with `exitCode`
  int exitCode = 0;
};

/// Prints help, version or a usage error itself.
ParsedCommandLine parseCommandLine(int argc, char** argv);

}  // namespace fr::tools
