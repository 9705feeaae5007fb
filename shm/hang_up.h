// Noticing the end of the other process without looking again and again.
#pragma once

#include <functional>
#include <memory>
#include <thread>

#include "base/error.h"
#include "shm/file_descriptor.h"

namespace fr::shm {

/// A thread that sleeps, without a timer, until the other end of a socket is closed by its last holder (which
/// the kernel does for a process that dies), and then calls a function, once.
///
/// The thread takes no signals. Thread safety: none; the function is called from the thread.
class HangUpWatch {
 public:
  /// `socket` is duplicated. `gone` must not destroy the watch. Errors: kSystem (no descriptor, no thread).
  static Result<std::unique_ptr<HangUpWatch>> start(int socket, std::function<void()> gone);
  /// The function is not called any more once this has returned.
  ~HangUpWatch();
  HangUpWatch(const HangUpWatch&) = delete;
  HangUpWatch& operator=(const HangUpWatch&) = delete;

 private:
  HangUpWatch() = default;
  FileDescriptor socket_, end_;
  std::thread thread_;
};

}  // namespace fr::shm
