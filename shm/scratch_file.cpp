#include "shm/scratch_file.h"

#include <fcntl.h>
#include <linux/magic.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <random>

namespace fr::shm {
namespace {

enum class Place { kNone, kMemory, kDisk };

Place placeOf(const std::string& folder) {
  struct stat st {};
  struct statfs fs {};
  if (::stat(folder.c_str(), &st) != 0 || !S_ISDIR(st.st_mode) || ::statfs(folder.c_str(), &fs) != 0)
    return Place::kNone;
  return fs.f_type == TMPFS_MAGIC || fs.f_type == RAMFS_MAGIC ? Place::kMemory : Place::kDisk;
}

Error cannotCreate(const std::string& folder, int code) {
  return makeError(RiError::kNoFile, "cannot make a scratch file in '{}': {}; --scratch names another folder",
                   folder, std::strerror(code));
}

}  // namespace

Result<FileDescriptor> createScratchFile(const std::string& folder) {
  FileDescriptor fd(::open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600));
  if (fd) return fd;
  if (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL) return cannotCreate(folder, errno);
  std::random_device random;
  for (int attempt = 0; attempt < 100; ++attempt) {
    const std::string name = fmt::format("{}/frankenrender-{}-{:08x}", folder, ::getpid(), random());
    fd = FileDescriptor(::open(name.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
    if (fd) {
      ::unlink(name.c_str());
      return fd;
    }
    if (errno != EEXIST) break;
  }
  return cannotCreate(folder, errno);
}

std::string scratchFolder(const std::string& wanted) {
  std::string folder = wanted;
  if (folder.empty()) {
    const char* variable = std::getenv("TMPDIR");
    for (const std::string& candidate :
         {std::string(variable ? variable : ""), std::string("/var/tmp"), std::string("/tmp")}) {
      if (candidate.empty() || placeOf(candidate) == Place::kNone) continue;
      if (folder.empty() || placeOf(candidate) == Place::kDisk) folder = candidate;
      if (placeOf(candidate) == Place::kDisk) break;
    }
  }
  if (placeOf(folder) == Place::kMemory)
    reportWarning(RiError::kNone,
                  "the scratch folder '{}' is memory, not a disk: what is written there stays in memory; "
                  "--scratch names another folder",
                  folder);
  return folder;
}

}  // namespace fr::shm
