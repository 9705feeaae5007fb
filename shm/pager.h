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

/// Says that this process's pager, if it has or gets one, may let go of a range: for as long as this lives,
/// which must end before the mapping does. Thread safety: any thread.
class PagedMapping {
 public:
  PagedMapping() = default;
  explicit PagedMapping(PagedRange range);
  PagedMapping(PagedMapping&&) noexcept = default;
  PagedMapping& operator=(PagedMapping&& o) noexcept;
  ~PagedMapping();

 private:
  std::unique_ptr<PagedRange> range_;  // in the list of all
};

/// Says that so many bytes of paged mappings have been filled, by those who take memory faster than a look
/// every few milliseconds could follow: after some megabytes this process's pager, if there is one, looks in
/// the calling thread. Thread safety: any thread.
void noteGrowth(uint64_t bytes);

/// What a pager knows of the rest of the job.
struct PagerHooks {
  std::function<pid_t()> peer;  // the other process, 0: none now
  /// Asks for private memory to be given back; returns roughly how much was. Called when pages of files are
  /// not enough.
  std::function<uint64_t(uint64_t wanted)> giveBack;
};

struct PagerStatistics {
  uint64_t budget = 0;
  uint64_t peak = 0;   // largest sum that was seen, bytes
  uint64_t letGo = 0;  // bytes of pages taken out of the address space
  uint64_t asked = 0;  // bytes asked of giveBack
};

/// Thread safety: all members. A process has one at most: it should have it before it reads a scene.
class Pager {
 public:
  /// `budget`: bytes that both processes may hold. Error: kSystem when no thread can be started.
  static Result<std::unique_ptr<Pager>> start(uint64_t budget, PagerHooks hooks = {});
  ~Pager();
  /// Returns when nobody is in the old ones any more.
  void setHooks(PagerHooks hooks);
  PagerStatistics statistics() const;

  struct State;

 private:
  Pager();
  std::shared_ptr<State> state_;
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
