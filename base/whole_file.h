// A file that appears under its name when it is whole, and not before.
#pragma once

#include <string>

namespace fr {

/// While it is written the file has no name at all (O_TMPFILE), where the file system can do that: whatever
/// kills the program, nothing is left behind. Elsewhere it is called "<path>.partial-<process id>-<number>"
/// until it is whole, and a kill -9 leaves that.
///
/// Functions return 0 or an errno. Not thread-safe. The destructor discards a file that was not finished.
class WholeFile {
 public:
  WholeFile() = default;
  ~WholeFile() { discard(); }
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  /// `path` may exist: it stays as it is until finish().
  int open(const std::string& path);
  /// Read and write, close-on-exec; -1 when not open.
  int descriptor() const { return fd_; }
  /// For code that opens files by name, in this process. Do not rename, remove, or take the name apart.
  const std::string& temporaryPath() const { return temporaryPath_; }
  /// Brings the bytes to the disk and gives the file its name, in place of what had it. On an error nothing
  /// is left.
  int finish();
  void discard();

 private:
  int fd_ = -1;
  bool named_ = false;  // temporaryPath_ is a name in the file system
  std::string path_, temporaryPath_;
};

}  // namespace fr
