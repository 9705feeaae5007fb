#include "oracle/pipe_io.h"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "shm/no_sigpipe.h"

namespace fr {
namespace {

constexpr int kPipeBytes = 1 << 20;

}  // namespace

Result<PipePair> makePipe() {
  int fds[2];
  if (::pipe2(fds, O_CLOEXEC) != 0)
    return makeError(RiError::kSystem, "cannot make a pipe: {}", std::strerror(errno));
  ::fcntl(fds[1], F_SETPIPE_SZ, kPipeBytes);  // a wish: the default works too
  return PipePair{shm::FileDescriptor(fds[0]), shm::FileDescriptor(fds[1])};
}

Result<void> writePipe(int fd, std::span<const std::byte> bytes) {
  shm::NoSigpipe guard;
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n > 0) {
      bytes = bytes.subspan(size_t(n));
    } else if (n < 0 && errno == EAGAIN) {
      pollfd p{fd, POLLOUT, 0};
      ::poll(&p, 1, 1000);
    } else if (n < 0 && errno != EINTR) {
      if (errno == EPIPE) guard.raised();
      return makeError(RiError::kSystem, "cannot write to the pipe: {}", std::strerror(errno));
    }
  }
  return {};
}

Result<size_t> readPipe(int fd, std::span<std::byte> bytes, int stop) {
  for (;;) {
    pollfd p[2] = {{fd, POLLIN, 0}, {stop, POLLIN, 0}};
    const int ready = ::poll(p, stop >= 0 ? 2 : 1, -1);
    if (ready < 0 && errno == EINTR) continue;
    if (ready < 0) return makeError(RiError::kSystem, "cannot wait for the pipe: {}", std::strerror(errno));
    if (stop >= 0 && p[1].revents != 0) return size_t(0);
    if (p[0].revents == 0) continue;
    const ssize_t n = ::read(fd, bytes.data(), bytes.size());
    if (n >= 0) return size_t(n);
    if (errno == EINTR || errno == EAGAIN) continue;
    return makeError(RiError::kSystem, "cannot read from the pipe: {}", std::strerror(errno));
  }
}

}  // namespace fr
