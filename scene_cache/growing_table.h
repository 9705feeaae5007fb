// Records that are added one by one, in a segment of their own: an array that never moves, and that a pager
// can let go of where it is a file in a scratch folder. Internal to SkeletonWriter.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>

#include "shm/paged_segment.h"

namespace fr::cache {

/// Not thread-safe. Nothing is made before the first record.
template <class T>
class GrowingTable {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  /// `scratch`: folder for a file without a name; empty: anonymous memory.
  explicit GrowingTable(const std::string& scratch) : scratch_(&scratch) {}

  size_t size() const { return size_; }
  T& operator[](size_t i) { return data()[i]; }
  const T& operator[](size_t i) const { return data()[i]; }
  std::span<const T> all() const { return {data(), size_}; }

  /// Errors: kNoMem, kDiskFull, kLimit; the table is as before.
  Result<void> append(std::span<const T> records) {
    if (records.empty()) return {};
    if (!store_) {
      shm::SegmentOptions options;
      options.name = "frankenrender-table";
      options.reserve = kReserve;
      options.addressShare = 1.0 / 64;  // there are half a dozen tables
      options.growStep = kStep;
      auto made = scratch_->empty() ? shm::Segment::createAnonymous(options, kStep)
                                    : shm::Segment::createScratch(*scratch_, options, kStep);
      if (!made) return std::move(made).error();
      store_ = std::make_unique<shm::PagedSegment>(*std::move(made));
    }
    shm::Segment& s = store_->segment;
    const size_t bytes = (size_ + records.size()) * sizeof(T);
    if (bytes > s.size()) {
      auto r = s.grow(bytes + std::min<size_t>(bytes / 4, size_t(64) << 20));
      if (!r) r = s.grow(bytes);
      if (!r) return r;
    }
    std::memcpy(s.data() + size_ * sizeof(T), records.data(), records.size_bytes());
    size_ += records.size();
    shm::noteGrowth(records.size_bytes());
    return {};
  }
  /// Forgets the last ones.
  void cut(size_t size) { size_ = std::min(size_, size); }
  void clear() { store_.reset(), size_ = 0; }

 private:
  static constexpr uint64_t kReserve = uint64_t(1) << 40, kStep = uint64_t(64) << 10;
  T* data() const { return store_ ? reinterpret_cast<T*>(store_->segment.data()) : nullptr; }

  const std::string* scratch_;
  std::unique_ptr<shm::PagedSegment> store_;
  size_t size_ = 0;
};

}  // namespace fr::cache
