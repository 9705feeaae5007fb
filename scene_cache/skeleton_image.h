// For tests: a private copy of a skeleton.
#pragma once

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <span>
#include <utility>

#include "scene_cache/cache.h"

namespace fr::cache {

/// A 64-byte aligned copy of a finished skeleton, to be damaged at will. The bytes end at an
/// inaccessible page, so a read beyond them ends the test.
class SkeletonImage {
 public:
  explicit SkeletonImage(std::span<const std::byte> bytes) { assign(bytes); }
  /// Takes the descriptor over. The file may be longer than the skeleton.
  explicit SkeletonImage(int fd) {
    struct stat st {};
    fstat(fd, &st);
    void* p = mmap(nullptr, size_t(st.st_size), PROT_READ, MAP_SHARED, fd, 0);
    assign({static_cast<std::byte*>(p), size_t(static_cast<const SkeletonHeader*>(p)->totalBytes)});
    munmap(p, size_t(st.st_size));
    close(fd);
  }
  ~SkeletonImage() {
    if (base_) munmap(base_, mapped_);
  }
  SkeletonImage(SkeletonImage&& o) noexcept
      : base_(std::exchange(o.base_, nullptr)), data_(o.data_), size_(o.size_), mapped_(o.mapped_) {}
  SkeletonImage& operator=(SkeletonImage&&) = delete;
  std::span<std::byte> bytes() { return {data_, size_}; }
  SkeletonHeader& header() { return *reinterpret_cast<SkeletonHeader*>(data_); }
  template <class T>
  std::span<T> table(const Range& r) {
    return {reinterpret_cast<T*>(data_ + r.offset), size_t(r.count)};
  }

 private:
  void assign(std::span<const std::byte> bytes) {
    const size_t page = size_t(sysconf(_SC_PAGESIZE));
    size_ = bytes.size();
    const size_t room = (size_ + page - 1) / page * page;
    mapped_ = room + page;
    base_ = static_cast<std::byte*>(
        mmap(nullptr, mapped_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    mprotect(base_ + room, page, PROT_NONE);
    data_ = base_ + room - (size_ + 63) / 64 * 64;
    std::memcpy(data_, bytes.data(), size_);
  }
  std::byte* base_ = nullptr;
  std::byte* data_ = nullptr;
  size_t size_ = 0, mapped_ = 0;
};

}  // namespace fr::cache
