// --memory and --scratch: how much memory a job may hold, and where the rest goes.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "base/error.h"
#include "scene_cache/cache.h"
#include "shm/pager.h"

namespace fr::tools {

struct MemoryOptions {
  uint64_t budget = 0;  // bytes that all processes of the job may hold together; 0: none was given
  std::string scratch;  // --scratch; empty: none was given
};

/// "512M", "2G", "1.5g", "300000k", "4GiB"; a number alone counts bytes. Nothing on rubbish, and for less
/// than a mebibyte: no process is that small.
std::optional<uint64_t> parseMemorySize(std::string_view text);

/// Folder that the scene cache's files go to, empty where it stays in memory: it is in files as soon as one
/// of the options was given. Looks once where that is; warns about folders in memory.
class ScratchPlace {
 public:
  explicit ScratchPlace(const MemoryOptions& options);
  const std::string& folder() const { return folder_; }

 private:
  std::string folder_;
};

/// Of texels in one process: an eighth of the budget, 0 without one.
uint32_t textureKilobytes(const MemoryOptions& options);

/// Holds this process's part of the budget from now on; nullptr without a budget. Nothing may be diced after
/// it is gone.
Result<std::unique_ptr<shm::Pager>> holdBudget(const MemoryOptions& options, cache::SceneCache& cache,
                                               std::function<pid_t()> peer,
                                               std::function<uint64_t(uint64_t)> giveBack);

}  // namespace fr::tools
