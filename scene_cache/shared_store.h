// A memory file that several processes append to: nodes and grids live in one each.
//
// Thread safety: allocate() and the accessors may be called from any thread of any process that maps the
// store. Invariants: bytes [0, allocatedBytes) are really allocated; top <= allocatedBytes once allocate()
// has returned; the mapping's address never changes; the file never shrinks (sealed).
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "base/error.h"

namespace fr::cache {

inline constexpr uint64_t kStoreHeaderBytes = 12288;  // a multiple of the page size and of kPositionAlign

/// First bytes of a store. Each 64-bit word is its own state; none needs another one to be read.
struct StoreHeader {
  uint64_t magic;
  uint32_t version;
  uint32_t byteOrder;
  uint64_t layout;  // layoutFingerprint()
  std::atomic<uint64_t>
      top;  // bytes handed out; SYNC: relaxed, a block's contents are published by node states
  std::atomic<uint64_t>
      allocatedBytes;  // bytes of file that exist; release after fallocate, acquire before use
  std::atomic<uint64_t> ownerTickets[256];  // times that each owner slot was taken (nodes only)
};
static_assert(sizeof(StoreHeader) <= kStoreHeaderBytes);
static_assert(std::atomic<uint64_t>::is_always_lock_free);

class SharedStore {
 public:
  SharedStore() = default;
  SharedStore(SharedStore&& o) noexcept { *this = std::move(o); }
  SharedStore& operator=(SharedStore&& o) noexcept;
  ~SharedStore();

  static Result<SharedStore> create(const char* name, uint64_t magic);
  /// Maps a store that another process made; takes its own descriptor. kBadFile, kVersion when it is none.
  static Result<SharedStore> attach(int fd, uint64_t magic, bool readOnly);

  /// `bytes` zeroed bytes at a multiple of `align` (at most kStoreHeaderBytes); their offset, 0 when memory
  /// ran out.
  uint64_t allocate(uint64_t bytes, uint64_t align);
  /// Pointer to [offset, offset + bytes), or nullptr when that is not inside the allocated part.
  std::byte* at(uint64_t offset, uint64_t bytes) const {
    if (offset > usable_.load(std::memory_order_acquire) ||
        bytes > usable_.load(std::memory_order_relaxed) - offset) {
      if (!refresh(offset, bytes)) return nullptr;
    }
    return base_ + offset;
  }
  StoreHeader& header() const { return *reinterpret_cast<StoreHeader*>(base_); }
  uint64_t top() const;
  int fd() const { return fd_; }
  std::byte* base() const { return base_; }
  uint64_t mappedBytes() const { return reserved_; }
  bool readOnly() const { return readOnly_; }

 private:
  bool refresh(uint64_t offset, uint64_t bytes) const;
  bool grow(uint64_t end);

  int fd_ = -1;
  std::byte* base_ = nullptr;
  uint64_t reserved_ = 0;
  bool readOnly_ = false;
  mutable std::atomic<uint64_t> usable_{0};  // what this process knows to exist, from fstat
};

}  // namespace fr::cache
