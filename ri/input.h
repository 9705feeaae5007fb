// Where RIB bytes come from: files, standard input, memory; gzip is undone on the way.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "base/error.h"

namespace fr::ri {

/// A forward-only stream of bytes. Not thread-safe.
class Input {
 public:
  virtual ~Input() = default;
  /// Fills the front of `to`; 0 = end. Blocks until there is at least one byte or the end.
  virtual Result<size_t> read(std::span<char> to) = 0;
};

/// Opens a file, plain or gzip. kNoFile / kSystem with the reason.
Result<std::unique_ptr<Input>> openFile(const std::string& path);
/// Standard input, plain or gzip.
Result<std::unique_ptr<Input>> openStdin();
/// A file descriptor that the caller keeps open (pipes of procedural programs).
Result<std::unique_ptr<Input>> openDescriptor(int fd);
/// Memory that outlives the input; gzip data are recognised too.
Result<std::unique_ptr<Input>> openMemory(std::string_view bytes);

}  // namespace fr::ri
