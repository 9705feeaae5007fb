// One image being written through a display driver: whole rows in order, without a name until it is complete.
#pragma once

#include <string>
#include <vector>

#include "base/error.h"
#include "base/whole_file.h"
#include "imaging/display_driver.h"

namespace fr {

/// Not thread-safe. The destructor discards an image that was not finished.
class ImageFile {
 public:
  ImageFile() = default;
  ~ImageFile();
  ImageFile(const ImageFile&) = delete;
  ImageFile& operator=(const ImageFile&) = delete;

  /// `image.path` is the final name. A target that exists and is no regular file (a device, a pipe) is
  /// written directly. Errors: kSystem, with the driver's reason.
  Result<void> open(const FrDisplayDriver& driver, FrDisplayImage image);
  bool isOpen() const { return handle_ != nullptr; }
  Result<void> write(int x, int y, int width, int height, const void* pixels, size_t rowBytes);
  /// Closes, brings the bytes to the disk, and gives the file its name. On an error nothing is left behind.
  Result<void> finish();
  void discard();

 private:
  const FrDisplayDriver* driver_ = nullptr;
  void* handle_ = nullptr;
  std::string path_;
  WholeFile file_;  // open unless the driver writes no file
};

}  // namespace fr
