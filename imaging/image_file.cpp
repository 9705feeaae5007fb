#include "imaging/image_file.h"

#include <sys/stat.h>

#include <array>
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

}  // namespace

ImageFile::~ImageFile() { discard(); }

Result<void> ImageFile::open(const FrDisplayDriver& driver, FrDisplayImage image) {
  discard();
  driver_ = &driver;
  path_ = image.path;
  struct stat info {};
  const bool special = ::stat(path_.c_str(), &info) == 0 && !S_ISREG(info.st_mode);
  if ((driver.flags & FR_DISPLAY_WRITES_FILE) && !special) {
    if (const int error = file_.open(path_); error != 0) {
      Message message{};
      std::snprintf(message.data(), message.size(), "%s", std::strerror(error));
      return driverError(path_, "cannot be opened", message, error == ENOSPC || error == EDQUOT ? error : 0);
    }
    image.path = file_.temporaryPath().c_str();
  }
  Message message{};
  errno = 0;
  if (driver.open(&image, &handle_, message.data(), message.size()) != 0 || !handle_) {
    const int systemError = errno;
    handle_ = nullptr;
    file_.discard();
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
  const int failed = driver_->close(handle, 0, message.data(), message.size());
  int systemError = errno;
  if (failed) {
    const bool hasFile = file_.descriptor() >= 0;
    file_.discard();
    return driverError(path_, hasFile ? "cannot be completed" : "cannot be closed", message, systemError);
  }
  if (file_.descriptor() < 0) return {};
  systemError = file_.finish();
  if (systemError == 0) return {};
  if (message[0] == 0) std::snprintf(message.data(), message.size(), "%s", std::strerror(systemError));
  return driverError(path_, "cannot be completed", message, systemError);
}

void ImageFile::discard() {
  if (!handle_) return;
  Message message{};
  driver_->close(handle_, 1, message.data(), message.size());
  handle_ = nullptr;
  file_.discard();
}

}  // namespace fr
