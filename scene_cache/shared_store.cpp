#include "scene_cache/shared_store.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "scene_cache/cache.h"
#include "scene_cache/format.h"

namespace fr::cache {
namespace {

constexpr uint64_t kMostAddresses = uint64_t(1) << 40;
constexpr uint64_t kLeastAddresses = uint64_t(1) << 31;
constexpr uint64_t kGrowStep = uint64_t(1) << 20;

Error systemError(const char* what, int number) {
  return makeError(number == ENOMEM || number == ENOSPC ? RiError::kNoMem : RiError::kSystem, "{}: {}", what,
                   std::strerror(number));
}

}  // namespace

SharedStore& SharedStore::operator=(SharedStore&& o) noexcept {
  std::swap(fd_, o.fd_);
  std::swap(base_, o.base_);
  std::swap(reserved_, o.reserved_);
  std::swap(readOnly_, o.readOnly_);
  const uint64_t mine = usable_.load();
  usable_.store(o.usable_.load());
  o.usable_.store(mine);
  return *this;
}

SharedStore::~SharedStore() {
  if (base_) munmap(base_, reserved_);
  if (fd_ >= 0) close(fd_);
}

namespace {
std::byte* mapStore(int fd, bool readOnly, uint64_t* reserved) {
  // Pages beyond the end of the file are never touched; the reservation costs addresses only.
  for (uint64_t size = kMostAddresses; size >= kLeastAddresses; size /= 2) {
    void* p =
        mmap(nullptr, size, readOnly ? PROT_READ : PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE, fd, 0);
    if (p == MAP_FAILED) continue;
    *reserved = size;
    return static_cast<std::byte*>(p);
  }
  return nullptr;
}
}  // namespace

Result<SharedStore> SharedStore::create(const char* name, uint64_t magic) {
  SharedStore s;
  s.fd_ = memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (s.fd_ < 0) return systemError("cannot make shared memory for grids", errno);
  s.base_ = mapStore(s.fd_, false, &s.reserved_);
  if (!s.base_) return systemError("cannot map shared memory for grids", errno);
  if (const int e = posix_fallocate(s.fd_, 0, off_t(kStoreHeaderBytes))) {
    return systemError("cannot allocate shared memory for grids", e);
  }
  fcntl(s.fd_, F_ADD_SEALS, F_SEAL_SHRINK);
  s.usable_ = kStoreHeaderBytes;
  StoreHeader& h = s.header();
  h.version = kFormatVersion;
  h.byteOrder = 0x01020304;
  h.layout = layoutFingerprint();
  h.top = kStoreHeaderBytes;
  h.allocatedBytes = kStoreHeaderBytes;
  std::atomic_ref<uint64_t>(h.magic).store(magic, std::memory_order_release);
  return s;
}

Result<SharedStore> SharedStore::attach(int fd, uint64_t magic, bool readOnly) {
  SharedStore s;
  s.readOnly_ = readOnly;
  s.fd_ = fcntl(fd, F_DUPFD_CLOEXEC, 0);
  if (s.fd_ < 0) return systemError("cannot use the scene cache's descriptor", errno);
  struct stat st {};
  if (fstat(s.fd_, &st) != 0) return systemError("cannot use the scene cache's descriptor", errno);
  if (st.st_size < off_t(kStoreHeaderBytes)) {
    return makeError(RiError::kBadFile, "scene cache segment of {} bytes is too short", st.st_size);
  }
  s.base_ = mapStore(s.fd_, readOnly, &s.reserved_);
  if (!s.base_) return systemError("cannot map the scene cache", errno);
  s.usable_ = uint64_t(st.st_size);
  const StoreHeader& h = s.header();
  if (h.magic != magic || h.byteOrder != 0x01020304) {
    return makeError(RiError::kBadFile, "not a scene cache segment");
  }
  if (h.version != kFormatVersion || h.layout != layoutFingerprint()) {
    return makeError(RiError::kVersion, "scene cache segment of version {}, this build has {}", h.version,
                     kFormatVersion);
  }
  return s;
}

uint64_t SharedStore::top() const {
  return std::min(header().top.load(std::memory_order_relaxed),
                  usable_.load() < kStoreHeaderBytes ? 0 : reserved_);
}

bool SharedStore::refresh(uint64_t offset, uint64_t bytes) const {
  struct stat st {};
  if (fstat(fd_, &st) != 0) return false;
  const uint64_t size = std::min(uint64_t(st.st_size), reserved_);
  uint64_t known = usable_.load();
  while (known < size && !usable_.compare_exchange_weak(known, size)) {
  }
  return offset <= size && bytes <= size - offset;
}

bool SharedStore::grow(uint64_t end) {
  if (end > reserved_) return false;
  StoreHeader& h = header();
  uint64_t have = h.allocatedBytes.load(std::memory_order_acquire);
  if (end <= have) return true;
  uint64_t goal = std::max(end, have + std::min(have / 8, uint64_t(64) << 20));
  goal = std::min((goal + kGrowStep - 1) / kGrowStep * kGrowStep, reserved_);
  // Allocating what another process allocates at the same time is harmless.
  uint64_t from = std::min(have, end);
  while (from < goal) {
    const uint64_t piece = std::min(goal - from, uint64_t(1) << 30);
    const int e = posix_fallocate(fd_, off_t(from), off_t(piece));
    if (e == EINTR) continue;
    if (e != 0) {
      if (goal <= end) return false;
      goal = end;  // the surplus was only for speed
      if (from >= goal) break;
      const int again = posix_fallocate(fd_, off_t(from), off_t(goal - from));
      if (again != 0) return false;
    }
    from += piece;
  }
  while (have < goal && !h.allocatedBytes.compare_exchange_weak(have, goal, std::memory_order_release)) {
  }
  return true;
}

uint64_t SharedStore::allocate(uint64_t bytes, uint64_t align) {
  if (readOnly_ || bytes > reserved_) return 0;
  StoreHeader& h = header();
  uint64_t old = h.top.load(std::memory_order_relaxed), start;
  do {
    start = (old + align - 1) / align * align;
    if (start < kStoreHeaderBytes || start > reserved_ - bytes) return 0;
  } while (!h.top.compare_exchange_weak(old, start + bytes, std::memory_order_relaxed));
  if (!grow(start + bytes) || !at(start, bytes)) return 0;
  return start;
}

}  // namespace fr::cache
