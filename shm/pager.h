// Holding two processes together inside one budget of memory.
//
// What is larger than memory lives in mapped files (Segment::createScratch). Reading a page that is not there
// is a page fault, so nobody who reads has to know: no lock, no count of readers, no epoch. What this class
// does is to let go of pages in time: it takes them out of this process's address space and starts writing
// what is not on the disk yet. The kernel keeps such a page as long as nothing else wants its memory, so a
// page that was let go too early comes back in a microsecond; under a control group's limit it gives it up at
// once.
//
// Each process runs a pager of its own, over its own mappings, and looks at both.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "base/error.h"

namespace fr::shm {

/// A mapping of a file, shared and readable.
struct PagedRange {
  std::byte* data = nullptr;
  std::function<uint64_t()> bytes;  // that are in use now
  int fd = -1;
  uint64_t offset = 0;  // of `data` in the file
};

struct PagerOptions {
  uint64_t budget = 0;          // bytes that both processes may hold
  std::function<pid_t()> peer;  // the other process, 0: none now
  /// Asks for private memory to be given back; returns roughly how much was. Called by the pager's thread
  /// when pages of files are not enough.
  std::function<uint64_t(uint64_t wanted)> giveBack;
};

struct PagerStatistics {
  uint64_t budget = 0;
  uint64_t peak = 0;   // largest sum that was seen, bytes
  uint64_t letGo = 0;  // bytes of pages taken out of the address space
  uint64_t asked = 0;  // bytes asked of giveBack
};

/// Thread safety: all members. The ranges must stay mapped while the pager lives.
class Pager {
 public:
  /// Error: kSystem when no thread can be started.
  static Result<std::unique_ptr<Pager>> start(PagerOptions options, std::vector<PagedRange> ranges);
  ~Pager();
  PagerStatistics statistics() const;
  /// Looks now, in the calling thread, unless somebody is at it: for those who take memory faster than a look
  /// every few milliseconds could follow.
  void look();

 private:
  Pager();
  struct State;
  std::unique_ptr<State> state_;
};

/// Resident bytes of a process, from /proc/<pid>/statm: cheap, and not exact (the kernel counts per
/// processor).
struct ResidentBytes {
  uint64_t total = 0;
  uint64_t files = 0;  // of mapped files and shared memory
};
/// pid 0: this process. All zero when the process is gone.
ResidentBytes residentBytes(pid_t pid);

}  // namespace fr::shm
