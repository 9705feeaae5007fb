#include "shm/file_descriptor.h"

#include <dirent.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>

namespace fr::shm {

void FileDescriptor::reset() {
  if (fd_ < 0) return;
  const int saved = errno;
  ::close(fd_);  // EINTR: Linux has closed it all the same, a second close could hit somebody else's
  errno = saved;
  fd_ = -1;
}

FileDescriptor FileDescriptor::duplicate() const {
  return FileDescriptor(fd_ < 0 ? -1 : ::fcntl(fd_, F_DUPFD_CLOEXEC, 0));
}

int openDescriptorCount() {
  DIR* dir = ::opendir("/proc/self/fd");
  if (!dir) return -1;
  int n = 0;
  while (const dirent* e = ::readdir(dir)) n += e->d_name[0] != '.';
  ::closedir(dir);
  return n - 1;  // opendir's own
}

}  // namespace fr::shm
