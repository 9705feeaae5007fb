// Dices every patch of a cache that is built in a file, within a budget of memory.
#pragma once

#include <functional>

#include "scene_cache/cache.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {

struct DiceAllOptions {
  uint64_t bytesHeld = uint64_t(64) << 20;  // grids that may be in memory before they go to the disk
  /// Objects that get grids; all when empty.
  std::function<bool(cache::ObjectId)> wanted;
  std::string title;
  bool progress = false;  // a line on standard error
};

/// Stops at Ctrl-C (an error without a message of its own: kNone), and when disk or memory are full.
Result<Tally> diceAll(cache::SceneCache& cache, const DiceAllOptions& options);

}  // namespace fr::tools
