#include "scene_cache/append_segment.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace fr::cache {
namespace {

constexpr uint64_t kGrowStep = uint64_t(1) << 20;
constexpr uint64_t kMostAddresses = uint64_t(1) << 40;
constexpr uint64_t kLeastAddresses = uint64_t(1) << 32;

Error systemError(const char* what, int number) {
  const bool memory = number == ENOMEM || number == ENOSPC;
  return makeError(memory ? RiError::kNoMem : RiError::kSystem, "{}: {}", what, std::strerror(number));
}

}  // namespace

Result<AppendSegment> AppendSegment::create(const char* name) {
  AppendSegment s;
  s.fd_ = memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING);
  if (s.fd_ < 0) return systemError("cannot make shared memory for the scene", errno);
  // Pages beyond the end of the file are never touched, so the reservation costs addresses only; a limit on
  // those (ulimit -v) makes it smaller, not impossible.
  for (uint64_t size = kMostAddresses; size >= kLeastAddresses; size /= 2) {
    void* p = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE, s.fd_, 0);
    if (p == MAP_FAILED) continue;
    s.base_ = static_cast<std::byte*>(p);
    s.reservedAddresses_ = size;
    return s;
  }
  return systemError("cannot map shared memory for the scene", errno);
}

AppendSegment& AppendSegment::operator=(AppendSegment&& o) noexcept {
  std::swap(fd_, o.fd_);
  std::swap(base_, o.base_);
  std::swap(reservedAddresses_, o.reservedAddresses_);
  std::swap(allocated_, o.allocated_);
  return *this;
}

AppendSegment::~AppendSegment() {
  if (base_) munmap(base_, reservedAddresses_);
  if (fd_ >= 0) close(fd_);
}

Result<void> AppendSegment::reserve(uint64_t bytes) {
  if (bytes <= allocated_) return {};
  if (bytes > reservedAddresses_)
    return makeError(RiError::kLimit, "the scene needs more than {} GB", reservedAddresses_ >> 30);
  uint64_t goal = std::max(bytes, allocated_ + allocated_ / 8);
  goal = std::min((goal + kGrowStep - 1) / kGrowStep * kGrowStep, reservedAddresses_);
  // In steps: one big request fails as a whole on tmpfs and is cut short by signals.
  while (allocated_ < goal) {
    const uint64_t step = std::min(goal - allocated_, 64 * kGrowStep);
    int e;
    do e = posix_fallocate(fd_, off_t(allocated_), off_t(step));
    while (e == EINTR);
    if (e != 0) {
      if (allocated_ >= bytes) break;
      return systemError("no memory for the scene", e);
    }
    allocated_ += step;
  }
  return {};
}

Result<int> AppendSegment::seal(uint64_t bytes) {
  // A file with a writable mapping cannot be sealed against writing.
  munmap(base_, reservedAddresses_);
  base_ = nullptr;
  if (ftruncate(fd_, off_t(bytes)) != 0) return systemError("cannot cut shared memory to size", errno);
  if (fcntl(fd_, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL) != 0)
    return systemError("cannot seal shared memory", errno);
  return std::exchange(fd_, -1);
}

}  // namespace fr::cache
