#include "shm/pager.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <system_error>
#include <thread>

#include "shm/memory_info.h"

namespace fr::shm {
namespace {

constexpr uint64_t kStep = uint64_t(2) << 20;  // what one madvise lets go
/// How often the sums are looked at: two threads that fault pages in at 2 GB/s take 16 MB in the meantime.
constexpr std::chrono::milliseconds kPeriod{4};
/// The sum is kept at least this much under the budget, for what happens between two looks; more where more
/// has been seen to happen, as on a machine with other things to do.
constexpr uint64_t kMargin = uint64_t(32) << 20;
/// How often it is looked at which pages are shared: the kernel walks through all that is mapped, which takes
/// milliseconds and holds up page faults. So at most a fortieth of the time goes there.
constexpr std::chrono::milliseconds kSharesPeriod{64};
constexpr int kSharesPart = 40;
/// What files keep beside programs and libraries, which count as files too.
constexpr uint64_t kLeastFiles = uint64_t(4) << 20;
/// No more than this is taken for programs and libraries.
constexpr uint64_t kMostLibraries = uint64_t(24) << 20;
/// Files keep a quarter of the budget as long as private memory can be given back: with less, trees are built
/// of pages that have to be read for each.
constexpr uint64_t kFairPart = 4;
/// Looks after which a sudden growth counts a third.
constexpr uint64_t kLooksToForget = 512;
constexpr size_t kMostUnwritten = 4096;
/// Bytes between two looks of those who say how fast they fill memory.
constexpr uint64_t kLookEvery = uint64_t(4) << 20;

}  // namespace

ResidentBytes residentBytes(pid_t pid) {
  char path[64];
  if (pid > 0)
    std::snprintf(path, sizeof path, "/proc/%d/statm", int(pid));
  else
    std::snprintf(path, sizeof path, "/proc/self/statm");
  const int fd = ::open(path, O_RDONLY | O_CLOEXEC);
  if (fd < 0) return {};
  char text[256];
  const ssize_t n = ::read(fd, text, sizeof text - 1);
  ::close(fd);
  if (n <= 0) return {};
  text[n] = 0;
  unsigned long long size = 0, resident = 0, files = 0;
  if (std::sscanf(text, "%llu %llu %llu", &size, &resident, &files) != 3) return {};
  static const uint64_t page = uint64_t(std::max(::sysconf(_SC_PAGESIZE), 4096L));
  return {resident * page, files * page};
}

namespace {

/// All that this process's mappings let its pager have.
struct Registry {
  std::mutex mutex;
  std::vector<const PagedRange*> ranges;  // under mutex
  std::weak_ptr<Pager::State> pager;      // under mutex
};
Registry& registry() {
  static Registry r;
  return r;
}

}  // namespace

PagedMapping::PagedMapping(PagedRange range) : range_(std::make_unique<PagedRange>(std::move(range))) {
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  r.ranges.push_back(range_.get());
}

PagedMapping& PagedMapping::operator=(PagedMapping&& o) noexcept {
  std::swap(range_, o.range_);
  return *this;
}

PagedMapping::~PagedMapping() {
  if (!range_) return;
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  std::erase(r.ranges, range_.get());
}

struct Pager::State {
  uint64_t budget = 0;
  std::mutex mutex;
  std::condition_variable wake;
  bool ending = false;  // under mutex
  std::atomic<uint64_t> peak{0}, letGo{0}, asked{0};
  std::mutex looking;  // all below, to the thread
  PagerHooks hooks;
  size_t range = 0;
  uint64_t at = 0;
  bool warned = false;
  uint64_t twice = 0, filesThen = 0;
  std::chrono::steady_clock::time_point nextShares{};
  uint64_t floor = 0;    // resident bytes of files that are not let go
  uint64_t sumThen = 0;  // after the last look
  uint64_t growth = 0;   // the most by which looks found it larger than then
  std::thread thread;

  // Writing waits for the disk, looking must not.
  struct Piece {
    int fd;
    uint64_t offset, bytes;
  };
  std::mutex writing;
  std::condition_variable written;
  std::vector<Piece> toWrite;  // under writing
  bool closing = false;        // under writing
  std::thread writer;

  void write() {
    std::unique_lock lock(writing);
    for (;;) {
      written.wait(lock, [this] { return closing || !toWrite.empty(); });
      if (closing) return;
      const Piece p = toWrite.back();
      toWrite.pop_back();
      lock.unlock();
      ::sync_file_range(p.fd, off64_t(p.offset), off64_t(p.bytes), SYNC_FILE_RANGE_WRITE);
      lock.lock();
    }
  }

  void writeLater(const Piece& p) {
    {
      const std::lock_guard lock(writing);
      if (!toWrite.empty()) {
        Piece& last = toWrite.back();
        if (last.fd == p.fd && last.offset + last.bytes == p.offset) {
          last.bytes += p.bytes;
          return;
        }
      }
      // The kernel writes what it is not asked to as well, only later.
      if (toWrite.size() < kMostUnwritten) toWrite.push_back(p);
    }
    written.notify_one();
  }

  void run() {
    std::unique_lock lock(mutex);
    while (!wake.wait_for(lock, kPeriod, [this] { return ending; })) {
      lock.unlock();
      look();
      lock.lock();
    }
  }

  void look() {
    // Who fills memory waits for whoever is making room.
    const std::lock_guard lock(looking);
    const ResidentBytes own = residentBytes(0);
    const pid_t other = hooks.peer ? hooks.peer() : 0;
    const ResidentBytes peer = other > 0 ? residentBytes(other) : ResidentBytes{};
    const uint64_t sum = held(own.total + peer.total, own.files + peer.files, other);
    uint64_t old = peak.load(std::memory_order_relaxed);
    if (sum > old) peak.store(sum, std::memory_order_relaxed);
    const uint64_t grown = sum - std::min(sum, sumThen);
    sumThen = sum;
    growth = std::max(grown, growth - growth / kLooksToForget);
    const uint64_t least = std::min(kMargin + budget / 16, budget / 6);
    const uint64_t margin = std::clamp(growth + growth / 2, least, budget / 4);
    const uint64_t limit = budget - margin;
    if (sum <= limit) return;
    // Each process lets go of its share; somewhat more, so that this need not be done at every look.
    const uint64_t excess = sum - limit + budget / 64;
    const uint64_t files = own.files + peer.files;
    // What is read again and again needs room as well as what was built from it: below a fair part of the
    // budget pages stay, and private memory has to go. That takes time: when it is pressing, pages go first.
    const uint64_t fair = std::max(2 * floor, budget / kFairPart);
    const uint64_t spare = std::min(excess, files - std::min(files, fair));
    const uint64_t fromFiles = sum > limit + margin / 2 ? excess : spare;
    const uint64_t share = files > 0 ? uint64_t(double(fromFiles) * double(own.files) / double(files)) : 0;
    if (own.files > floor)
      sumThen -= std::min(sumThen, letPagesGo(own.files, std::min(share, own.files - floor)));
    if (spare < excess && hooks.giveBack) {
      asked.fetch_add(excess - spare, std::memory_order_relaxed);
      if (hooks.giveBack(excess - spare) >= excess - spare) return;
    }
    if (sum - std::min(sum, files) > budget && !warned) {
      warned = true;
      reportWarning(RiError::kNoMem,
                    "the memory budget of {} MiB is too small: what cannot be written to the scratch folder "
                    "alone takes {} MiB; going on",
                    budget >> 20, (sum - files) >> 20);
    }
  }

  /// What both hold, a page that both map counted once: resident bytes, less what counting each page by its
  /// share has taken off them not long ago. Pages that were let go since are not taken off twice.
  uint64_t held(uint64_t resident, uint64_t files, pid_t other) {
    const auto now = std::chrono::steady_clock::now();
    if (resident * 4 > budget * 3 && now >= nextShares) {
      uint64_t shares = 0;
      if (const auto m = processMemory(0)) shares += m->pss;
      if (other > 0)
        if (const auto m = processMemory(other)) shares += m->pss;
      twice = resident - std::min(resident, shares), filesThen = files;
      const auto after = std::chrono::steady_clock::now();
      nextShares =
          after + std::max<std::chrono::steady_clock::duration>(kSharesPeriod, kSharesPart * (after - now));
    }
    const double left = files < filesThen ? double(files) / double(filesThen) : 1.0;
    return resident - std::min(resident, uint64_t(double(twice) * left));
  }

  /// Moves the hand until `wanted` bytes less are resident, at most once around; returns how many less are.
  uint64_t letPagesGo(uint64_t residentFiles, uint64_t wanted) {
    Registry& all = registry();
    const std::lock_guard lock(all.mutex);  // nothing is unmapped meanwhile
    const auto& ranges = all.ranges;
    if (ranges.empty() || wanted == 0) return 0;
    uint64_t whole = 0;
    std::vector<uint64_t> sizes;
    for (const PagedRange* r : ranges)
      sizes.push_back(r->bytes() / 4096 * 4096);  // the last page is being written
    for (const uint64_t s : sizes) whole += s;
    const uint64_t goal = residentFiles - std::min(wanted, residentFiles);
    constexpr uint64_t kStepsBetweenLooks = 4;
    for (uint64_t moved = 0, steps = 0; moved <= whole + kStep * ranges.size(); ++steps) {
      if (range >= ranges.size()) range = 0, at = 0;
      const PagedRange& r = *ranges[range];
      const uint64_t size = sizes[range];
      if (at >= size) {
        ++range, at = 0;
        moved += kStep;
        continue;
      }
      const uint64_t n = std::min(kStep, size - at);
      // What is dirty stays with the kernel until it is written.
      ::madvise(r.data + at, n, MADV_DONTNEED);
      writeLater({r.fd, r.offset + at, n});
      at += n, moved += n;
      if (steps % kStepsBetweenLooks == kStepsBetweenLooks - 1) {
        const uint64_t now = residentBytes(0).files;
        if (now <= goal) break;
      }
    }
    const uint64_t gone = residentFiles - std::min(residentFiles, residentBytes(0).files);
    letGo.fetch_add(gone, std::memory_order_relaxed);
    return gone;
  }
};

Pager::Pager() : state_(std::make_shared<State>()) {}

Result<std::unique_ptr<Pager>> Pager::start(uint64_t budget, PagerHooks hooks) {
  std::unique_ptr<Pager> p(new Pager);
  State& s = *p->state_;
  s.budget = budget;
  s.hooks = std::move(hooks);
  s.floor = std::min(residentBytes(0).files, kMostLibraries) + kLeastFiles;
  try {
    s.writer = std::thread([&s] { s.write(); });
    s.thread = std::thread([&s] { s.run(); });
    const std::lock_guard lock(registry().mutex);
    registry().pager = p->state_;
  } catch (const std::system_error& e) {
    return makeError(RiError::kSystem, "no thread can be started to hold the memory budget: {}", e.what());
  }
  return p;
}

Pager::~Pager() {
  setHooks({});
  {
    const std::lock_guard lock(state_->mutex);
    state_->ending = true;
  }
  state_->wake.notify_all();
  if (state_->thread.joinable()) state_->thread.join();
  {
    const std::lock_guard lock(state_->writing);
    state_->closing = true;
  }
  state_->written.notify_all();
  if (state_->writer.joinable()) state_->writer.join();
}

void noteGrowth(uint64_t bytes) {
  static std::atomic<uint64_t> unlooked{0};
  if (unlooked.fetch_add(bytes, std::memory_order_relaxed) + bytes < kLookEvery) return;
  unlooked.store(0, std::memory_order_relaxed);
  Registry& r = registry();
  std::shared_ptr<Pager::State> pager;
  {
    const std::lock_guard lock(r.mutex);
    pager = r.pager.lock();
  }
  if (pager) pager->look();
}

void Pager::setHooks(PagerHooks hooks) {
  const std::lock_guard lock(state_->looking);
  state_->hooks = std::move(hooks);
}

PagerStatistics Pager::statistics() const {
  const State& s = *state_;
  return {s.budget, s.peak.load(std::memory_order_relaxed), s.letGo.load(std::memory_order_relaxed),
          s.asked.load(std::memory_order_relaxed)};
}

}  // namespace fr::shm
