// A RIB file being written: plain or gzip, to a file or to standard output.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "base/error.h"

namespace fr::ri {

/// Where RIB goes. A file appears under its name when it is whole; standard output gets bytes as they come.
/// Not thread-safe. The destructor discards a file that was not finished.
class RibFile {
 public:
  RibFile();
  ~RibFile();
  RibFile(const RibFile&) = delete;
  RibFile& operator=(const RibFile&) = delete;

  /// `path` "-": standard output. Other than regular files (pipes, devices) are written directly. kNoFile
  /// with the reason.
  Result<void> open(const std::string& path, bool gzip);
  /// To the standard input of a command of the shell. A command that ends early is a failed write, no signal.
  Result<void> openCommand(const std::string& command, bool gzip);
  /// The first failure is kept for finish(); what follows it is dropped.
  void write(std::string_view bytes);
  bool failed() const { return failed_; }
  /// kSystem or kDiskFull when anything could not be written; there is no file then. A command is waited for:
  /// kSystem when it failed.
  Result<void> finish();

 private:
  struct State;
  Result<void> start(std::unique_ptr<State> s, bool gzip);
  std::unique_ptr<State> state_;
  bool failed_ = false;
};

}  // namespace fr::ri
