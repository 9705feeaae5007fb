// The records of all traced grids: they keep their numbers and their places for ever. Internal to tracer/.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>

#include "base/error.h"

namespace fr::tracer {

struct SurfaceEntry;

/// Thread safety: append() from any thread; [] of what an append() that happened before has made.
template <class Entry>
class EntryStore {
 public:
  static constexpr uint32_t kMostEntries = 1u << 31;  // the highest bit of an entry's number marks stitches

  EntryStore() : chunks_(new std::atomic<Entry*>[kMostEntries >> kChunkLog2] {}) {}
  ~EntryStore() {
    for (uint32_t c = 0; c << kChunkLog2 < count_; ++c) delete[] chunks_[c].load();
  }
  EntryStore(const EntryStore&) = delete;
  EntryStore& operator=(const EntryStore&) = delete;

  /// Room for n more, default-made, with numbers that follow each other; returns the first.
  uint32_t append(size_t n) {
    const std::lock_guard lock(mutex_);
    FR_CHECK(n <= kMostEntries - count_);
    const uint32_t first = count_;
    const uint32_t end = first + uint32_t(n);
    for (uint64_t c = (uint64_t(first) + kChunk - 1) >> kChunkLog2; c << kChunkLog2 < end; ++c)
      chunks_[c].store(new Entry[kChunk], std::memory_order_release);
    count_ = end;
    size_.store(end, std::memory_order_release);
    return first;
  }
  uint32_t size() const { return size_.load(std::memory_order_acquire); }
  /// SYNC: whoever has a number got it from the thread that appended, after that; relaxed will do.
  const Entry& operator[](uint32_t i) const {
    return chunks_[i >> kChunkLog2].load(std::memory_order_relaxed)[i & (kChunk - 1)];
  }
  Entry& operator[](uint32_t i) {
    return chunks_[i >> kChunkLog2].load(std::memory_order_relaxed)[i & (kChunk - 1)];
  }

 private:
  static constexpr uint32_t kChunkLog2 = 12;
  static constexpr uint32_t kChunk = 1u << kChunkLog2;
  std::unique_ptr<std::atomic<Entry*>[]> chunks_;
  std::atomic<uint32_t> size_{0};
  std::mutex mutex_;
  uint32_t count_ = 0;  // under the mutex
};

}  // namespace fr::tracer
