#include "imaging/image_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>

namespace fr {
namespace {

using Message = std::array<char, 512>;

Error driverError(const std::string& path, const char* doing, Message& message, int systemError) {
  message.back() = 0;
  const bool full = systemError == ENOSPC || systemError == EDQUOT || systemError == EFBIG;
  std::string reason = message.data();
  while (!reason.empty() && (reason.back() == '\n' || reason.back() == '.')) reason.pop_back();
  if (full) reason += (reason.empty() ? "" : "; ") + std::string(std::strerror(systemError));
  return makeError(full ? RiError::kDiskFull : RiError::kSystem, "image {}: {}: {}", path, doing,
                   reason.empty() ? "unknown reason" : reason);
}

/// Late write errors (a full disk, a network file system) come out here at the latest.
int syncFile(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return errno;
  const int error = ::fsync(fd) == 0 || errno == EINVAL ? 0 : errno;
  ::close(fd);
  return error;
}

}  // namespace

ImageFile::~ImageFile() { discard(); }

Result<void> ImageFile::open(const FrDisplayDriver& driver, FrDisplayImage image) {
  discard();
  driver_ = &driver;
  path_ = image.path;
  temporary_.clear();
  struct stat info {};
  const bool special = ::stat(path_.c_str(), &info) == 0 && !S_ISREG(info.st_mode);
  if ((driver.flags & FR_DISPLAY_WRITES_FILE) && !special) {
    static std::atomic<unsigned> counter{0};
    temporary_ = fmt::format("{}.partial-{}-{}", path_, ::getpid(), counter++);
    image.path = temporary_.c_str();
  }
  Message message{};
  errno = 0;
  if (driver.open(&image, &handle_, message.data(), message.size()) != 0 || !handle_) {
    const int systemError = errno;
    handle_ = nullptr;
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
    return driverError(path_, "cannot be opened", message, systemError);
  }
  return {};
}

Result<void> ImageFile::write(int x, int y, int width, int height, const void* pixels, size_t rowBytes) {
  if (!handle_) return makeError(RiError::kSystem, "image {}: is not open", path_);
  Message message{};
  errno = 0;
  if (driver_->write(handle_, x, y, width, height, pixels, rowBytes, message.data(), message.size()) == 0)
    return {};
  const int systemError = errno;
  discard();
  return driverError(path_, "cannot be written", message, systemError);
}

Result<void> ImageFile::finish() {
  if (!handle_) return makeError(RiError::kSystem, "image {}: is not open", path_);
  Message message{};
  errno = 0;
  void* handle = handle_;
  handle_ = nullptr;
  int failed = driver_->close(handle, 0, message.data(), message.size());
  int systemError = errno;
  if (temporary_.empty()) {
    if (failed) return driverError(path_, "cannot be closed", message, systemError);
    return {};
  }
  if (!failed) failed = systemError = syncFile(temporary_);
  if (!failed && ::rename(temporary_.c_str(), path_.c_str()) != 0) failed = systemError = errno;
  if (!failed) return {};
  ::unlink(temporary_.c_str());
  if (message[0] == 0) std::snprintf(message.data(), message.size(), "%s", std::strerror(systemError));
  return driverError(path_, "cannot be completed", message, systemError);
}

void ImageFile::discard() {
  if (!handle_) return;
  Message message{};
  driver_->close(handle_, 1, message.data(), message.size());
  handle_ = nullptr;
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

}  // namespace fr
