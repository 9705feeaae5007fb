// The records of all traced grids: they keep their numbers and their places for ever. Internal to tracer/.
#pragma once

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <type_traits>

#include "base/error.h"
#include "shm/paged_segment.h"

namespace fr::tracer {

struct SurfaceEntry;

/// Records stand in a segment, so that a pager can let go of those of places where no ray is: trees can be
/// built again, records must stay, and a scene of 200 million micropolygons has 40 MiB of them.
/// Thread safety: append() from any thread; [] of what an append() that happened before has made.
template <class Entry>
class EntryStore {
 public:
  static constexpr uint32_t kMostEntries = 1u << 31;  // the highest bit of an entry's number marks stitches

  /// Once, before anything else. `scratch`: a folder for a file without a name; empty: anonymous memory.
  Result<void> open(const std::string& scratch) {
    static_assert(std::is_trivially_copyable_v<Entry>);
    shm::SegmentOptions options;
    options.name = "frankenrender-entries";
    options.growStep = kStep;
    options.reserve = uint64_t(kMostEntries) * sizeof(Entry);
    options.addressShare = 1.0 / 32;
    auto made = scratch.empty() ? shm::Segment::createAnonymous(options, kStep)
                                : shm::Segment::createScratch(scratch, options, kStep);
    if (!made) return std::move(made).error();
    store_ = std::make_unique<shm::PagedSegment>(*std::move(made));
    entries_ = reinterpret_cast<Entry*>(store_->segment.data());
    return {};
  }

  /// Room for n more, default-made, with numbers that follow each other; returns the first. Where there is no
  /// memory or disk for them it fails as operator new does.
  uint32_t append(size_t n) {
    const std::lock_guard lock(mutex_);
    const uint32_t first = size_.load(std::memory_order_relaxed);
    FR_CHECK(n <= kMostEntries - first);
    shm::Segment& s = store_->segment;
    if (const uint64_t bytes = (first + n) * sizeof(Entry); bytes > s.size()) {
      Result<void> grown = s.grow(bytes + std::min<uint64_t>(bytes / 8, uint64_t(16) << 20));
      if (!grown) grown = s.grow(bytes);
      if (!grown) {
        report(grown.error());
        if (const std::new_handler handler = std::get_new_handler()) handler();
        throw std::bad_alloc();
      }
    }
    for (size_t i = 0; i < n; ++i) new (entries_ + first + i) Entry{};
    shm::noteGrowth(n * sizeof(Entry));
    size_.store(uint32_t(first + n), std::memory_order_release);
    return first;
  }
  uint32_t size() const { return size_.load(std::memory_order_acquire); }
  /// SYNC: whoever has a number got it from the thread that appended, after that.
  const Entry& operator[](uint32_t i) const { return entries_[i]; }
  Entry& operator[](uint32_t i) { return entries_[i]; }

 private:
  static constexpr uint64_t kStep = uint64_t(64) << 10;
  std::unique_ptr<shm::PagedSegment> store_;
  Entry* entries_ = nullptr;
  std::atomic<uint32_t> size_{0};
  std::mutex mutex_;  // append()
};

}  // namespace fr::tracer
