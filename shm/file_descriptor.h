// A file descriptor that closes itself.
#pragma once

#include <utility>

namespace fr::shm {

/// Owns at most one descriptor. Not thread-safe.
class FileDescriptor {
 public:
  FileDescriptor() = default;
  explicit FileDescriptor(int fd) : fd_(fd) {}
  FileDescriptor(FileDescriptor&& o) noexcept : fd_(std::exchange(o.fd_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& o) noexcept {
    if (this != &o) {
      reset();
      fd_ = std::exchange(o.fd_, -1);
    }
    return *this;
  }
  ~FileDescriptor() { reset(); }

  int get() const { return fd_; }
  bool valid() const { return fd_ >= 0; }
  explicit operator bool() const { return valid(); }
  int release() { return std::exchange(fd_, -1); }
  /// Closes it. errno is kept.
  void reset();
  /// A second descriptor of the same open file, close-on-exec; invalid when the process has no descriptor
  /// left.
  FileDescriptor duplicate() const;

 private:
  int fd_ = -1;
};

/// Number of descriptors that this process has open (tests look for leaks with it), -1 if /proc is missing.
int openDescriptorCount();

}  // namespace fr::shm
