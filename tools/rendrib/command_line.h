// What the user of rendrib typed. The options are those of BMRT's rendrib, with one dash as in 1998 or with
// two.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene_cache/scene_loader.h"
#include "tools/memory_budget.h"
#include "tracer/render.h"

namespace fr::tools {

struct RendribCommandLine {
  std::vector<cache::RibInput> inputs;  // .rendribrc first; one .fsc stands alone
  cache::LoadOptions load;
  std::optional<AdaptiveSampling> adaptive;
  float patchMultiplier = 1;
  int threads = 0;  // 0: all cores
  MemoryOptions memory;
  bool safe = false, window = false, verbose = false, stats = false, silent = false, beep = false;
  bool progressLines = false;  // "R90000 nn%", for queue managers
  bool radiosity = false;      // asked for
  bool deterministic = false;
  std::string shaderPath;  // colon-separated, searched first
};

struct ParsedRendribCommandLine {
  std::optional<RendribCommandLine> run;  // empty: exit with `exitCode`
  int exitCode = 0;
};

/// Prints help, version, architecture or a usage error itself.
ParsedRendribCommandLine parseRendribCommandLine(int argc, char** argv);

}  // namespace fr::tools
