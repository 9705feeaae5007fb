// Files for what does not fit into memory: without a name, gone with the last process that holds them.
#pragma once

#include <string>

#include "base/error.h"
#include "shm/file_descriptor.h"

namespace fr::shm {

/// An empty file in `folder`, read and write, close-on-exec, 0600. It never has a name where the file system
/// knows files without (O_TMPFILE); elsewhere it has one for an instant. Errors: kNoFile (no such folder, not
/// ours to write in), kSystem.
Result<FileDescriptor> createScratchFile(const std::string& folder);

/// `wanted`, or where nothing is wanted the first of $TMPDIR, /var/tmp and /tmp that is a folder on a disk.
/// Files on a tmpfs are memory: one warning says so when there is nothing better.
std::string scratchFolder(const std::string& wanted);

}  // namespace fr::shm
