#include "ri/rib_file.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#include <zlib.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "base/whole_file.h"

namespace fr::ri {

struct RibFile::State {
  std::string path;
  WholeFile whole;
  int fd = -1;         // standard output, a pipe or a device; else whole's
  bool owned = false;  // fd is ours to close
  pid_t command = -1;  // fd is a socket to its standard input
  bool gzip = false;
  z_stream z{};
  int error = 0;  // errno of the first failure

  ~State() {
    if (gzip) deflateEnd(&z);
    (void)end();
  }

  /// Closes what is ours; the status of a command, as waitpid() has it.
  int end() {
    if (std::exchange(owned, false)) ::close(fd);
    int status = 0;
    if (const pid_t p = std::exchange(command, -1); p > 0)
      while (::waitpid(p, &status, 0) < 0 && errno == EINTR) {
      }
    return status;
  }

  void put(const char* p, size_t n) {
    while (n > 0 && error == 0) {
      const ssize_t written = command > 0 ? ::send(fd, p, n, MSG_NOSIGNAL) : ::write(fd, p, n);
      if (written < 0 && errno == EINTR) continue;
      if (written < 0) {
        error = errno;
        return;
      }
      p += written, n -= size_t(written);
    }
  }

  void compress(std::string_view bytes, int flush) {
    z.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    z.avail_in = uInt(bytes.size());
    std::array<char, 65536> out;
    do {
      z.next_out = reinterpret_cast<Bytef*>(out.data());
      z.avail_out = uInt(out.size());
      deflate(&z, flush);
      put(out.data(), out.size() - z.avail_out);
    } while (z.avail_out == 0 && error == 0);
  }
};

RibFile::RibFile() = default;
RibFile::~RibFile() = default;

Result<void> RibFile::open(const std::string& path, bool gzip) {
  auto s = std::make_unique<State>();
  s->path = path;
  struct stat is {};
  const bool direct = path == "-" || (::stat(path.c_str(), &is) == 0 && !S_ISREG(is.st_mode));
  if (path == "-") {
    s->fd = STDOUT_FILENO;
  } else if (direct) {
    s->fd = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
    if (s->fd < 0) return makeError(RiError::kNoFile, "cannot write {}: {}", path, std::strerror(errno));
    s->owned = true;
  } else {
    if (const int error = s->whole.open(path); error != 0)
      return makeError(RiError::kNoFile, "cannot write {}: {}", path, std::strerror(error));
    s->fd = s->whole.descriptor();
  }
  return start(std::move(s), gzip);
}

Result<void> RibFile::openCommand(const std::string& command, bool gzip) {
  auto s = std::make_unique<State>();
  s->path = "\"" + command + "\"";
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
    return makeError(RiError::kSystem, "cannot run {}: {}", s->path, std::strerror(errno));
  s->fd = ends[0];
  s->owned = true;
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[1], STDIN_FILENO);
  const char* words[] = {"sh", "-c", command.c_str(), nullptr};
  const int error =
      ::posix_spawn(&s->command, "/bin/sh", &actions, nullptr, const_cast<char* const*>(words), environ);
  posix_spawn_file_actions_destroy(&actions);
  ::close(ends[1]);
  if (error != 0) {
    s->command = -1;
    return makeError(RiError::kSystem, "cannot run {}: {}", s->path, std::strerror(error));
  }
  return start(std::move(s), gzip);
}

Result<void> RibFile::start(std::unique_ptr<State> s, bool gzip) {
  if (gzip) {
    if (deflateInit2(&s->z, Z_DEFAULT_COMPRESSION, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK)
      return makeError(RiError::kNoMem, "cannot start zlib");
    s->gzip = true;
  }
  state_ = std::move(s);
  failed_ = false;
  return {};
}

void RibFile::write(std::string_view bytes) {
  if (!state_ || state_->error != 0) return;
  constexpr size_t kMost = size_t(1) << 30;  // zlib counts in 32 bits
  for (; !bytes.empty(); bytes.remove_prefix(std::min(bytes.size(), kMost))) {
    const std::string_view part = bytes.substr(0, kMost);
    if (state_->gzip)
      state_->compress(part, Z_NO_FLUSH);
    else
      state_->put(part.data(), part.size());
  }
  failed_ = state_->error != 0;
}

Result<void> RibFile::finish() {
  if (!state_) return {};
  const std::unique_ptr<State> s = std::move(state_);
  if (s->gzip && s->error == 0) s->compress({}, Z_FINISH);
  if (s->error == 0 && s->whole.descriptor() >= 0) s->error = s->whole.finish();
  const bool command = s->command > 0;
  const int status = s->end();
  if (s->error == 0 && status == 0) return {};
  failed_ = true;
  if (command && status != 0)
    return makeError(RiError::kSystem, "{} {} {}", s->path,
                     WIFEXITED(status) ? "ended with status" : "was killed by signal",
                     WIFEXITED(status) ? WEXITSTATUS(status) : WTERMSIG(status));
  return makeError(s->error == ENOSPC || s->error == EDQUOT ? RiError::kDiskFull : RiError::kSystem,
                   "cannot write {}: {}", s->path, std::strerror(s->error));
}

}  // namespace fr::ri
