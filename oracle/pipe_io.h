// Reading and writing pipes to a process that may be gone: no signal, no half writes.
#pragma once

#include <chrono>
#include <span>

#include "base/error.h"
#include "shm/file_descriptor.h"

namespace fr {

struct PipePair {
  shm::FileDescriptor read, write;
};
/// A pipe, close-on-exec at both ends, with room for a few frames. Errors: kSystem.
Result<PipePair> makePipe();

/// Writes everything; blocks while the pipe is full. A reader that is gone is an error and not the signal
/// SIGPIPE, which would end the program we are part of. Errors: kSystem.
Result<void> writePipe(int fd, std::span<const std::byte> bytes);

/// Reads what is there, at least one byte; 0 at the end. Blocks until then, or until `stop` (a descriptor,
/// -1: none) becomes readable: then 0 as well. Errors: kSystem.
Result<size_t> readPipe(int fd, std::span<std::byte> bytes, int stop);

}  // namespace fr
