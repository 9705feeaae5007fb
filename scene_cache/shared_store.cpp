#include "scene_cache/shared_store.h"

#include <fcntl.h>

#include <algorithm>

#include "scene_cache/cache.h"
#include "scene_cache/format.h"

namespace fr::cache {
namespace {

shm::SegmentOptions options(const char* name, uint64_t reserve) {
  shm::SegmentOptions o;
  o.name = name;
  o.reserve = reserve;
  o.growStep = uint64_t(1) << 20;
  return o;
}

// Addresses cost nothing, but may be limited (ulimit -v).
constexpr uint64_t kMostAddresses = uint64_t(1) << 40;
constexpr uint64_t kLeastAddresses = uint64_t(1) << 32;

}  // namespace

Result<SharedStore> SharedStore::create(const char* name, uint64_t magic, const std::string& scratch) {
  SharedStore s;
  for (uint64_t size = kMostAddresses;; size /= 4) {
    auto made = scratch.empty()
                    ? shm::Segment::createAnonymous(options(name, size), kStoreHeaderBytes)
                    : shm::Segment::createScratch(scratch, options(name, size), kStoreHeaderBytes);
    if (made) {
      s.segment_ = *std::move(made);
      break;
    }
    if (size <= kLeastAddresses || made.error().code == RiError::kNoFile) return std::move(made).error();
  }
  StoreHeader& h = s.header();
  h.version = kFormatVersion;
  h.byteOrder = 0x01020304;
  h.layout = layoutFingerprint();
  h.top = kStoreHeaderBytes;
  std::atomic_ref<uint64_t>(h.magic).store(magic, std::memory_order_release);
  return s;
}

Result<SharedStore> SharedStore::attach(int fd, uint64_t magic, bool readOnly) {
  SharedStore s;
  s.readOnly_ = readOnly;
  for (uint64_t size = kMostAddresses;; size /= 4) {
    shm::FileDescriptor own(fcntl(fd, F_DUPFD_CLOEXEC, 0));
    if (!own) return makeError(RiError::kSystem, "cannot use the scene cache's descriptor {}", fd);
    auto made =
        shm::Segment::attach(std::move(own), readOnly ? shm::Access::kReadOnly : shm::Access::kReadWrite,
                             options("fr-store", size));
    if (made) {
      s.segment_ = *std::move(made);
      break;
    }
    if (made.error().code == RiError::kBadFile || size <= kLeastAddresses) return std::move(made).error();
  }
  if (s.segment_.size() < kStoreHeaderBytes) {
    return makeError(RiError::kBadFile, "scene cache segment of {} bytes is too short", s.segment_.size());
  }
  const StoreHeader& h = s.header();
  if (h.magic != magic || h.byteOrder != 0x01020304)
    return makeError(RiError::kBadFile, "not a scene cache segment");
  if (h.version != kFormatVersion || h.layout != layoutFingerprint()) {
    return makeError(RiError::kVersion, "scene cache segment of version {}, this build has {}", h.version,
                     kFormatVersion);
  }
  return s;
}

std::byte* SharedStore::atAfterRefresh(uint64_t offset, uint64_t bytes) const {
  const uint64_t size = segment_.refresh();
  return offset <= size && bytes <= size - offset ? segment_.data() + offset : nullptr;
}

uint64_t SharedStore::allocate(uint64_t bytes, uint64_t align) {
  if (readOnly_ || bytes > segment_.reserved()) return 0;
  StoreHeader& h = header();
  uint64_t old = h.top.load(std::memory_order_relaxed), start;
  do {
    start = (old + align - 1) / align * align;
    if (start < kStoreHeaderBytes || start > segment_.reserved() - bytes) return 0;
  } while (!h.top.compare_exchange_weak(old, start + bytes, std::memory_order_relaxed));
  if (at(start, bytes)) return start;
  // An eighth more than needed, for speed; exactly as much when that is not to be had.
  const uint64_t end = start + bytes;
  if (segment_.grow(end + std::min(end / 8, uint64_t(64) << 20))) return start;
  if (const Result<void> grown = segment_.grow(end); !grown) {
    reportOnce("store.grow", grown.error());
    return 0;
  }
  return start;
}

}  // namespace fr::cache
