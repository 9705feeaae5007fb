#include "shm/hang_up.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>

namespace fr::shm {

Result<std::unique_ptr<HangUpWatch>> HangUpWatch::start(int socket, std::function<void()> gone) {
  std::unique_ptr<HangUpWatch> watch(new HangUpWatch);
  watch->socket_ = FileDescriptor(::fcntl(socket, F_DUPFD_CLOEXEC, 0));
  watch->end_ = FileDescriptor(::eventfd(0, EFD_CLOEXEC));
  if (!watch->socket_ || !watch->end_)
    return makeError(RiError::kSystem, "cannot watch a socket: {}", std::strerror(errno));
  sigset_t all, before;
  ::sigfillset(&all);
  ::pthread_sigmask(SIG_SETMASK, &all, &before);
  Result<void> started;
  try {
    watch->thread_ = std::thread([peer = watch->socket_.get(), end = watch->end_.get(), f = std::move(gone)] {
      pollfd fds[2] = {{peer, POLLRDHUP, 0}, {end, POLLIN, 0}};
      for (;;) {
        if (::poll(fds, 2, -1) < 0) continue;  // no memory for a moment
        if (fds[1].revents) return;
        if (fds[0].revents) return f();
      }
    });
  } catch (const std::system_error& e) {
    started = makeError(RiError::kSystem, "cannot watch a socket: {}", e.what());
  }
  ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
  if (!started) return std::move(started).error();
  return watch;
}

HangUpWatch::~HangUpWatch() {
  if (!thread_.joinable()) return;
  const uint64_t one = 1;
  (void)!::write(end_.get(), &one, sizeof one);
  thread_.join();
}

}  // namespace fr::shm
