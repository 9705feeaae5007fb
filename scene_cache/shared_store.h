// A growing segment that several processes append to: nodes and grids live in one each.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>

#include "base/error.h"
#include "shm/segment.h"

namespace fr::cache {

inline constexpr uint64_t kStoreHeaderBytes = 12288;  // a multiple of the page size and of kPositionAlign

/// First bytes of a store. Each 64-bit word is its own state; none needs another one to be read.
struct StoreHeader {
  uint64_t magic;
  uint32_t version;
  uint32_t byteOrder;
  uint64_t layout;  // layoutFingerprint()
  std::atomic<uint64_t>
      top;  // bytes handed out. SYNC: relaxed; a block's contents are published by node states
  std::atomic<uint64_t> ownerTickets[256];  // times that each owner slot was taken (nodes only)
};
static_assert(sizeof(StoreHeader) <= kStoreHeaderBytes);
static_assert(std::atomic<uint64_t>::is_always_lock_free);

/// Thread safety: all members but moving, from any thread of any process that maps the store.
/// Invariants: a block returned by allocate() is really allocated; addresses never change; the file never
/// shrinks.
class SharedStore {
 public:
  /// `scratch`: a folder for a file without a name, whose pages need not stay in memory; empty: anonymous
  /// memory.
  static Result<SharedStore> create(const char* name, uint64_t magic, const std::string& scratch = {});
  /// Maps a store that another process made; takes its own descriptor. kBadFile, kVersion when it is none.
  static Result<SharedStore> attach(int fd, uint64_t magic, bool readOnly);

  /// `bytes` zeroed bytes at a multiple of `align` (a divisor of kStoreHeaderBytes); their offset, 0 when
  /// memory ran out or the store is read-only.
  uint64_t allocate(uint64_t bytes, uint64_t align);
  /// Pointer to [offset, offset + bytes), or nullptr when that is not inside the allocated part.
  std::byte* at(uint64_t offset, uint64_t bytes) const {
    const uint64_t size = segment_.size();
    if (offset <= size && bytes <= size - offset) return segment_.data() + offset;
    return atAfterRefresh(offset, bytes);
  }
  StoreHeader& header() const { return *reinterpret_cast<StoreHeader*>(segment_.data()); }
  std::byte* base() const { return segment_.data(); }
  int fd() const { return segment_.valid() ? segment_.descriptor() : -1; }
  uint64_t mappedBytes() const { return segment_.reserved(); }
  uint64_t size() const { return segment_.refresh(); }

 private:
  std::byte* atAfterRefresh(uint64_t offset, uint64_t bytes) const;
  mutable shm::Segment segment_;  // refresh() changes only what is known of the size
  bool readOnly_ = false;
};

}  // namespace fr::cache
