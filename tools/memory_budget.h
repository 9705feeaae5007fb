// --memory and --scratch: how much memory a job may hold, and where the rest goes.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "base/error.h"
#include "shm/pager.h"

namespace fr::tools {

struct MemoryOptions {
  uint64_t budget = 0;  // bytes that all processes of the job may hold together; 0: none was given
  std::string scratch;  // --scratch; empty: none was given
};

/// "512M", "2G", "1.5g", "300000k", "4GiB"; a number alone counts bytes. Nothing on rubbish, and for less
/// than a mebibyte: no process is that small.
std::optional<uint64_t> parseMemorySize(std::string_view text);

/// Holds this process's part of the budget while it lives: made before a scene is read.
class MemoryBudget {
 public:
  /// Looks where scratch files go, and warns about folders in memory. Error: no thread can be started.
  static Result<MemoryBudget> hold(const MemoryOptions& options);
  /// Folder that the scene cache's files go to, empty where it stays in memory: it is in files as soon as one
  /// of the options was given.
  const std::string& folder() const { return folder_; }
  /// nullptr without a budget.
  shm::Pager* pager() const { return pager_.get(); }

 private:
  std::string folder_;
  std::unique_ptr<shm::Pager> pager_;
};

/// What the budget has to know of a job while it runs.
class BudgetOfJob {
 public:
  BudgetOfJob(const MemoryBudget& budget, shm::PagerHooks hooks);
  ~BudgetOfJob();
  BudgetOfJob(const BudgetOfJob&) = delete;
  BudgetOfJob& operator=(const BudgetOfJob&) = delete;

 private:
  shm::Pager* pager_;
};

/// Of texels in one process: an eighth of the budget, 0 without one.
uint32_t textureKilobytes(const MemoryOptions& options);

}  // namespace fr::tools
