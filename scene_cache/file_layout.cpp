#include "scene_cache/file_layout.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cstring>

#include "scene_cache/cache_impl.h"

namespace fr::cache {

Error fileError(const std::string& path, const char* what, int number) {
  Error e = makeError(
      number == ENOSPC || number == EDQUOT || number == EFBIG ? RiError::kDiskFull : RiError::kSystem,
      "{}: {}", what, std::strerror(number));
  e.where.file = path;
  return e;
}

Error damagedFile(const std::string& path, std::string_view what) {
  Error e = makeError(RiError::kBadFile, "damaged scene cache: {}", what);
  e.where.file = path;
  return e;
}

int writeAll(int fd, const void* data, uint64_t bytes, uint64_t offset) {
  const char* p = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t n = pwrite(fd, p, std::min<uint64_t>(bytes, uint64_t(1) << 28), off_t(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return n < 0 ? errno : EIO;
    p += n, bytes -= uint64_t(n), offset += uint64_t(n);
  }
  return 0;
}

int readAll(int fd, void* data, uint64_t bytes, uint64_t offset) {
  char* p = static_cast<char*>(data);
  while (bytes > 0) {
    const ssize_t n = pread(fd, p, std::min<uint64_t>(bytes, uint64_t(1) << 28), off_t(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return n < 0 ? errno : ENODATA;
    p += n, bytes -= uint64_t(n), offset += uint64_t(n);
  }
  return 0;
}

int PartWriter::add(std::span<const std::byte> bytes) {
  const int e = writeAll(fd_, bytes.data(), bytes.size(), part_.offset + part_.bytes);
  sum_.add(bytes.data(), bytes.size());
  part_.bytes += bytes.size();
  return e;
}

int PartWriter::finish(FilePart* part) {
  static constexpr std::byte kZeros[kFilePage] = {};
  const uint64_t padding = filePages(part_.bytes) - part_.bytes;
  const int e = writeAll(fd_, kZeros, padding, part_.offset + part_.bytes);
  sum_.add(kZeros, padding);
  *part = part_;
  part->checksum = sum_.value();
  return e;
}

Result<FileFooter> readFooter(int fd, const std::string& path) {
  struct stat st {};
  uint64_t first = 0;
  FileFooter f{};
  if (fstat(fd, &st) != 0 || !S_ISREG(st.st_mode)) return damagedFile(path, "not a regular file");
  const uint64_t size = uint64_t(st.st_size);
  if (size < sizeof first || readAll(fd, &first, sizeof first, 0) != 0 ||
      (first != kArenaMagic && first != kOldFileMagic))
    return damagedFile(path, "not a scene cache");
  const auto otherVersion = [&](uint32_t version) {
    Error e = makeError(RiError::kVersion, "scene cache of version {} or another build, this program has {}",
                        version, kFormatVersion);
    e.where.file = path;
    return e;
  };
  if (first == kOldFileMagic) {
    uint32_t version = 0;
    if (readAll(fd, &version, sizeof version, sizeof first) != 0) version = 0;
    return otherVersion(version);
  }
  if (size < kStoreHeaderBytes + sizeof f || readAll(fd, &f, sizeof f, size - sizeof f) != 0 ||
      f.magic != kFileMagic || f.byteOrder != 0x01020304)
    return damagedFile(path, "it is cut off");
  if (f.version != kFormatVersion || f.layout != layoutFingerprint()) return otherVersion(f.version);
  if (f.checksum != XXH3_64bits(&f, offsetof(FileFooter, checksum))) return damagedFile(path, "its footer");
  uint64_t at = 0;
  for (const FilePart* p : {&f.arenaHeader, &f.grids, &f.skeleton, &f.nodes}) {
    if (p->offset != at || p->bytes > size - at || filePages(p->bytes) > size - at)
      return damagedFile(path, "its parts do not fit");
    at = p->end();
  }
  if (at + sizeof f != size || f.arenaHeader.bytes != kStoreHeaderBytes || f.nodes.bytes < kStoreHeaderBytes)
    return damagedFile(path, "its parts do not fit");
  return f;
}

int writeFooter(int fd, FileFooter& f) {
  f.magic = kFileMagic;
  f.version = kFormatVersion;
  f.byteOrder = 0x01020304;
  f.layout = layoutFingerprint();
  f.checksum = XXH3_64bits(&f, offsetof(FileFooter, checksum));
  if (const int e = writeAll(fd, &f, sizeof f, f.nodes.end())) return e;
  // What was allocated beyond it would hide it.
  return ftruncate(fd, off_t(f.nodes.end() + sizeof f)) == 0 ? 0 : errno;
}

}  // namespace fr::cache
