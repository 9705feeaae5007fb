#include "shm/peer.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>

extern char** environ;

namespace fr::shm {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

/// poll() on one descriptor until `events` or hang-up, or the time is over (negative: never); the returned
/// events, 0 = time over.
short pollUntil(int fd, short events, milliseconds timeout) {
  const bool ends = timeout.count() >= 0;
  const Clock::time_point end = Clock::now() + timeout;
  for (;;) {
    const auto left = ends ? std::chrono::ceil<milliseconds>(end - Clock::now()).count() : 0;
    pollfd p{fd, events, 0};
    const int n = ::poll(&p, 1, ends ? int(std::clamp<int64_t>(left, 0, 3600000)) : -1);
    if (n > 0) return p.revents;
    if (n < 0 && errno != EINTR) return POLLNVAL;
    if (n == 0 && ends && left <= 0) return 0;
  }
}

Error peerGone() { return makeError(RiError::kSystem, "the other process has closed the connection"); }

bool isPeerSocket(int fd) {
  int type = 0;
  socklen_t size = sizeof type;
  return ::getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &size) == 0 && type == SOCK_SEQPACKET;
}

/// posix_spawn's file actions and attributes, freed at the end of the scope.
struct SpawnSetup {
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  SpawnSetup() {
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawnattr_init(&attributes);
  }
  SpawnSetup(const SpawnSetup&) = delete;
  SpawnSetup& operator=(const SpawnSetup&) = delete;
  ~SpawnSetup() {
    ::posix_spawn_file_actions_destroy(&actions);
    ::posix_spawnattr_destroy(&attributes);
  }
};

}  // namespace

// ---------------------------------------------------------------------------------------------- PeerSocket

Result<std::pair<PeerSocket, PeerSocket>> PeerSocket::pair() {
  int fds[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, fds) != 0) {
    return makeError(RiError::kSystem, "cannot create a socket pair: {}", std::strerror(errno));
  }
  return std::pair(PeerSocket(FileDescriptor(fds[0])), PeerSocket(FileDescriptor(fds[1])));
}

Result<void> PeerSocket::send(std::span<const std::byte> bytes, std::span<const int> descriptors,
                              milliseconds timeout) {
  if (!valid()) return peerGone();
  // An empty message could not be told from the end of the connection.
  if (bytes.empty() || bytes.size() > kMaxMessageBytes || descriptors.size() > kMaxMessageDescriptors) {
    return makeError(RiError::kRange, "cannot send a message of {} bytes and {} descriptors", bytes.size(),
                     descriptors.size());
  }
  iovec part{const_cast<std::byte*>(bytes.data()), bytes.size()};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * kMaxMessageDescriptors)> control{};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    message.msg_control = control.data();
    message.msg_controllen = CMSG_SPACE(descriptors.size_bytes());
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(descriptors.size_bytes());
    std::memcpy(CMSG_DATA(header), descriptors.data(), descriptors.size_bytes());
  }
  const Clock::time_point end = Clock::now() + timeout;
  for (;;) {
    const ssize_t n = ::sendmsg(fd_.get(), &message, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n == ssize_t(bytes.size())) return {};
    if (n >= 0) return makeError(RiError::kSystem, "a message was cut while it was sent");
    if (errno == EINTR) continue;
    if (errno == EPIPE || errno == ECONNRESET || errno == ENOTCONN) return peerGone();
    if (errno != EAGAIN && errno != ENOBUFS) {
      return makeError(RiError::kSystem, "cannot send to the other process: {}", std::strerror(errno));
    }
    const milliseconds left = std::chrono::ceil<milliseconds>(end - Clock::now());
    if (left.count() <= 0) return makeError(RiError::kSystem, "the other process does not read its messages");
    pollUntil(fd_.get(), POLLOUT, std::min(left, milliseconds(100)));
  }
}

Result<std::optional<PeerMessage>> PeerSocket::receive(milliseconds timeout) {
  if (!valid()) return peerGone();
  const Clock::time_point end = Clock::now() + timeout;
  for (;;) {
    const milliseconds left =
        timeout.count() < 0 ? timeout
                            : std::max(milliseconds(0), std::chrono::ceil<milliseconds>(end - Clock::now()));
    if (pollUntil(fd_.get(), POLLIN, left) == 0) return std::optional<PeerMessage>();
    PeerMessage m;
    m.bytes.resize(kMaxMessageBytes);
    iovec part{m.bytes.data(), m.bytes.size()};
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int) * kMaxMessageDescriptors)> control;
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t n = ::recvmsg(fd_.get(), &message, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
    if (n < 0) {
      if (errno == EINTR || errno == EAGAIN) continue;
      if (errno == ECONNRESET) return peerGone();
      return makeError(RiError::kSystem, "cannot receive from the other process: {}", std::strerror(errno));
    }
    for (cmsghdr* header = CMSG_FIRSTHDR(&message); header; header = CMSG_NXTHDR(&message, header)) {
      if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) continue;
      const size_t count = (header->cmsg_len - CMSG_LEN(0)) / sizeof(int);
      for (size_t i = 0; i < count; ++i) {
        int fd = -1;
        std::memcpy(&fd, CMSG_DATA(header) + i * sizeof(int), sizeof fd);
        m.descriptors.emplace_back(FileDescriptor(fd));
      }
    }
    if (message.msg_flags & MSG_TRUNC)
      return makeError(RiError::kBadFile, "a message is longer than allowed");
    if (message.msg_flags & MSG_CTRUNC) {
      return makeError(RiError::kBadFile,
                       "a message brings more descriptors than allowed, or than we may open");
    }
    if (n == 0) return peerGone();
    m.bytes.resize(size_t(n));
    return std::optional<PeerMessage>(std::move(m));
  }
}

bool PeerSocket::alive() const {
  if (!valid()) return false;
  pollfd p{fd_.get(), 0, 0};
  for (;;) {
    const int n = ::poll(&p, 1, 0);
    if (n < 0 && errno == EINTR) continue;
    return n == 0 || (p.revents & (POLLHUP | POLLERR | POLLNVAL)) == 0;
  }
}

// ---------------------------------------------------------------------------------------------- ChildProcess

Result<ChildProcess> ChildProcess::spawn(const SpawnOptions& options) {
  Result<std::pair<PeerSocket, PeerSocket>> ends = PeerSocket::pair();
  if (!ends) return std::move(ends).error();
  PeerSocket& ours = ends->first;
  PeerSocket& theirs = ends->second;

  std::vector<std::string> arguments{options.program};
  arguments.insert(arguments.end(), options.arguments.begin(), options.arguments.end());
  std::vector<char*> argv;
  for (std::string& a : arguments) argv.push_back(a.data());
  argv.push_back(nullptr);

  const std::string prefix = options.socketVariable + "=";
  const bool hasSocket = !options.socketVariable.empty();
  std::string variable = fmt::format("{}{}", prefix, theirs.descriptor());
  std::vector<char*> environment;
  for (char** e = environ; *e; ++e) {
    if (!hasSocket || std::strncmp(*e, prefix.c_str(), prefix.size()) != 0) environment.push_back(*e);
  }
  if (hasSocket) environment.push_back(variable.data());
  environment.push_back(nullptr);

  SpawnSetup setup;
  // Duplicating a descriptor onto itself clears its close-on-exec flag in the child alone: no other thread
  // that spawns something at the same moment can leak it, and no number of somebody else's is overwritten.
  if (hasSocket) ::posix_spawn_file_actions_adddup2(&setup.actions, theirs.descriptor(), theirs.descriptor());
  if (options.standardInput >= 0)
    ::posix_spawn_file_actions_adddup2(&setup.actions, options.standardInput, STDIN_FILENO);
  if (options.standardOutput >= 0)
    ::posix_spawn_file_actions_adddup2(&setup.actions, options.standardOutput, STDOUT_FILENO);
  sigset_t none;
  ::sigemptyset(&none);
  sigset_t all;
  ::sigfillset(&all);
  for (const int s : {SIGKILL, SIGSTOP}) ::sigdelset(&all, s);
  ::posix_spawnattr_setsigmask(&setup.attributes, &none);
  ::posix_spawnattr_setsigdefault(&setup.attributes, &all);
  ::posix_spawnattr_setflags(&setup.attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);

  pid_t pid = -1;
  const int code = ::posix_spawnp(&pid, options.program.c_str(), &setup.actions, &setup.attributes,
                                  argv.data(), environment.data());
  if (code != 0) {
    return makeError(code == ENOENT || code == EACCES || code == ENOEXEC || code == ENOTDIR
                         ? RiError::kNoFile
                         : RiError::kSystem,
                     "cannot start '{}': {}", options.program, std::strerror(code));
  }
  // The pid is ours until we wait for it, so this cannot hit another process. Without pidfds: polling
  // instead.
  FileDescriptor pidfd(int(::syscall(SYS_pidfd_open, pid, 0)));
  theirs.close();
  if (!hasSocket) ours.close();
  ChildProcess child(pid, std::move(pidfd), std::move(ours));
  child.hasSocket_ = hasSocket;
  return child;
}

ChildProcess::ChildProcess(pid_t pid, FileDescriptor pidfd, PeerSocket socket)
    : pid_(pid), pidfd_(std::move(pidfd)), socket_(std::move(socket)) {}

ChildProcess::ChildProcess(ChildProcess&& o) noexcept
    : pid_(std::exchange(o.pid_, -1)),
      pidfd_(std::move(o.pidfd_)),
      socket_(std::move(o.socket_)),
      hasSocket_(o.hasSocket_),
      ended_(o.ended_.exchange(true)),
      waitStatus_(o.waitStatus_) {}

ChildProcess::~ChildProcess() {
  if (pid_ < 0 || ended_) return;
  socket_.close();
  if (wait(kGrace)) return;
  signal(SIGKILL);
  reap(true);
}

bool ChildProcess::alive() const {
  if (pid_ < 0 || ended_ || (hasSocket_ && !socket_.alive())) return false;
  if (!pidfd_) return ::kill(pid_, 0) == 0;
  pollfd p{pidfd_.get(), POLLIN, 0};
  return ::poll(&p, 1, 0) <= 0;
}

void ChildProcess::reap(bool block) {
  if (ended_ || pid_ < 0) return;
  int status = 0;
  pid_t r = 0;
  do {
    r = ::waitpid(pid_, &status, block ? 0 : WNOHANG);
  } while (r < 0 && errno == EINTR);
  if (r == 0) return;
  ended_ = true;
  // ECHILD: the host program ignores SIGCHLD or waits for all children itself; then nobody can tell us the
  // status.
  if (r == pid_) waitStatus_ = status;
}

bool ChildProcess::wait(milliseconds timeout) {
  if (pid_ < 0) return true;
  const Clock::time_point end = Clock::now() + timeout;
  for (;;) {
    reap(false);
    if (ended_) return true;
    const milliseconds left = std::chrono::ceil<milliseconds>(end - Clock::now());
    if (left.count() <= 0) return false;
    if (pidfd_) {
      pollUntil(pidfd_.get(), POLLIN, left);
    } else {
      ::poll(nullptr, 0, int(std::min<int64_t>(left.count(), 5)));
    }
  }
}

void ChildProcess::signal(int number) {
  reap(false);
  if (ended_ || pid_ < 0) return;  // the number may belong to somebody else by now
  if (pidfd_ && ::syscall(SYS_pidfd_send_signal, pidfd_.get(), number, nullptr, 0) == 0) return;
  ::kill(pid_, number);
}

std::optional<int> ChildProcess::exitStatus() {
  reap(false);
  if (!waitStatus_) return std::nullopt;
  if (WIFSIGNALED(*waitStatus_)) return -WTERMSIG(*waitStatus_);
  return WEXITSTATUS(*waitStatus_);
}

std::string ChildProcess::statusText() {
  reap(false);
  if (!ended_) return "running";
  return waitStatus_ ? describeWaitStatus(*waitStatus_) : "ended";
}

// ---------------------------------------------------------------------------------------------- the child's
// side

Result<PeerSocket> parentSocket(const char* socketVariable) {
  const char* text = std::getenv(socketVariable);
  if (!text)
    return makeError(RiError::kBadHandle, "{} is not set: this program is started by another",
                     socketVariable);
  int fd = -1;
  const char* end = text + std::strlen(text);
  const auto [rest, ec] = std::from_chars(text, end, fd);
  if (ec != std::errc() || rest != end || fd < 0 || !isPeerSocket(fd)) {
    return makeError(RiError::kBadHandle, "{}={} is not the number of a socket", socketVariable, text);
  }
  ucred peer{};
  socklen_t size = sizeof peer;
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 || peer.uid != ::geteuid())
    return makeError(RiError::kBadHandle, "{}={}: its other end belongs to another user", socketVariable,
                     text);
  ::unsetenv(socketVariable);
  ::fcntl(fd, F_SETFD, FD_CLOEXEC);
  return PeerSocket(FileDescriptor(fd));
}

void dieWithParentThread() { ::prctl(PR_SET_PDEATHSIG, SIGTERM); }

std::string describeWaitStatus(int status) {
  if (WIFEXITED(status)) return fmt::format("ended with status {}", WEXITSTATUS(status));
  if (WIFSIGNALED(status)) {
    return fmt::format("killed by signal {} ({})", WTERMSIG(status), ::strsignal(WTERMSIG(status)));
  }
  return fmt::format("in wait status {:#x}", unsigned(status));
}

}  // namespace fr::shm
