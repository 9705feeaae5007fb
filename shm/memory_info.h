// What memory and processor time processes use, and how much memory may still be taken.
#pragma once

#include <sys/types.h>

#include <cstdint>

#include "base/error.h"

namespace fr::shm {

/// Bytes, from /proc/<pid>/smaps_rollup.
struct ProcessMemory {
  uint64_t rss = 0;
  uint64_t pss = 0;           // shared pages divided by the number of processes that map them: add these up
  uint64_t privateBytes = 0;  // clean + dirty pages that nobody else maps
  uint64_t privateDirty = 0;
  uint64_t sharedBytes = 0;  // clean + dirty pages that others map too
  uint64_t swap = 0;
};
/// Of process `pid`, 0 = this one. Error: kSystem when the process is gone or not ours to look at.
/// Thread-safe. Costs about a millisecond per gigabyte mapped: for reports, not for loops.
Result<ProcessMemory> processMemory(pid_t pid = 0);

/// Bytes; kUnlimited where there is no limit.
struct AvailableMemory {
  static constexpr uint64_t kUnlimited = ~0ull;
  uint64_t physical = 0;             // installed
  uint64_t free = 0;                 // MemAvailable: what can be taken without swapping
  uint64_t groupLimit = kUnlimited;  // lowest limit of our control group and its parents, version 1 or 2
  uint64_t groupFree =
      kUnlimited;  // the smallest (limit - use) of them; reclaimable file pages count as free
  /// What can be taken before the kernel starts to kill.
  uint64_t usable() const { return free < groupFree ? free : groupFree; }
};
/// Thread-safe. Where /proc or the control group cannot be read, that limit counts as unlimited. About 0.1
/// ms.
AvailableMemory availableMemory();

/// Processes that the kernel has killed since it started because memory ran out, on the machine or in a
/// control group: compare before and after. 0 where it does not say. Thread-safe.
uint64_t outOfMemoryKills();

/// Parsers of the kernel's files, apart for the tests. `text` is input from outside: bad lines are skipped.
uint64_t parseMemAvailable(std::string_view meminfo);
/// memory.max / memory.limit_in_bytes: kUnlimited for "max", rubbish, and version 1's huge "no limit" value.
uint64_t parseGroupLimit(std::string_view text);

struct CpuTime {
  double user = 0;    // seconds
  double system = 0;  // seconds
};
/// Of all threads of process `pid`, 0 = this one. Error: kSystem when the process is gone.
Result<CpuTime> processCpuTime(pid_t pid = 0);

}  // namespace fr::shm
