#include "base/whole_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>

namespace fr {
namespace {

std::string partialName(const std::string& path) {
  static std::atomic<unsigned> counter{0};
  return fmt::format("{}.partial-{}-{}", path, ::getpid(), counter.fetch_add(1));
}

std::string folderOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  return slash == std::string::npos ? "." : slash == 0 ? "/" : path.substr(0, slash);
}

constexpr int kAttempts = 100;  // names left behind by a process that had our number

}  // namespace

int WholeFile::open(const std::string& path) {
  discard();
  path_ = path;
  fd_ = ::open(folderOf(path).c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0666);
  if (fd_ >= 0) {
    temporaryPath_ = fmt::format("/proc/self/fd/{}", fd_);
    // Without /proc nobody could give it a name.
    if (::access(temporaryPath_.c_str(), W_OK) == 0) return 0;
    ::close(fd_);
    fd_ = -1;
  }
  for (int i = 0; i < kAttempts; ++i) {
    temporaryPath_ = partialName(path);
    fd_ = ::open(temporaryPath_.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd_ >= 0) {
      named_ = true;
      return 0;
    }
    if (errno != EEXIST) return errno;
  }
  return EEXIST;
}

int WholeFile::finish() {
  if (fd_ < 0) return EBADF;
  const auto fail = [this](int error) {
    discard();
    return error;
  };
  // Late write errors (a full disk, a network file system) come out here at the latest.
  if (::fsync(fd_) != 0 && errno != EINVAL && errno != EROFS) return fail(errno);
  if (!named_) {
    const auto link = [this](const std::string& to) {
      return ::linkat(AT_FDCWD, temporaryPath_.c_str(), AT_FDCWD, to.c_str(), AT_SYMLINK_FOLLOW) == 0 ? 0
                                                                                                      : errno;
    };
    int error = link(path_);
    // What has the name can be replaced by renaming only: the whole file has a name of its own for a moment.
    for (int i = 0; error == EEXIST && i < kAttempts; ++i) {
      const std::string name = partialName(path_);
      error = link(name);
      if (error == 0) {
        temporaryPath_ = name;
        named_ = true;
        break;
      }
    }
    if (error != 0) return fail(error);
  }
  if (named_ && ::rename(temporaryPath_.c_str(), path_.c_str()) != 0) return fail(errno);
  named_ = false;
  ::close(fd_);
  fd_ = -1;
  return 0;
}

void WholeFile::discard() {
  if (named_) ::unlink(temporaryPath_.c_str());
  named_ = false;
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

}  // namespace fr
