// Writing to a process that may be gone.
#pragma once

#include <pthread.h>
#include <signal.h>
#include <time.h>

#include <cerrno>

namespace fr::shm {

/// While one lives, writing to a pipe that nobody reads fails with EPIPE on this thread and does not end the
/// process. Call raised() after such a failure. The dispositions of the process are left alone: it may be
/// someone else's.
class NoSigpipe {
 public:
  NoSigpipe() {
    ::sigemptyset(&set_);
    ::sigaddset(&set_, SIGPIPE);
    sigset_t pending;
    ::sigpending(&pending);
    pendingBefore_ = ::sigismember(&pending, SIGPIPE) == 1;
    ::pthread_sigmask(SIG_BLOCK, &set_, &before_);
  }
  NoSigpipe(const NoSigpipe&) = delete;
  NoSigpipe& operator=(const NoSigpipe&) = delete;
  ~NoSigpipe() {
    if (raised_ && !pendingBefore_) {
      const timespec none{};
      while (::sigtimedwait(&set_, nullptr, &none) < 0 && errno == EINTR) {
      }
    }
    ::pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  void raised() { raised_ = true; }

 private:
  sigset_t set_, before_;
  bool pendingBefore_ = false, raised_ = false;
};

}  // namespace fr::shm
