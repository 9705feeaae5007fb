// The byte layout of .fsc files, and reading and writing their parts. docs/format/scenecache.md says why.
// Included by SceneCache's .cpp files alone.
#pragma once

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"

namespace fr::cache {

inline constexpr uint64_t kFileMagic = 0x32454c4946435346ull;     // "FSCFILE2"
inline constexpr uint64_t kOldFileMagic = 0x31454c4946435346ull;  // "FSCFILE1": began with a header
inline constexpr uint64_t kFilePage = 4096;

inline uint64_t filePages(uint64_t bytes) { return (bytes + kFilePage - 1) / kFilePage * kFilePage; }

/// A section: `bytes` at `offset`, zeros up to the next page.
struct FilePart {
  uint64_t offset;  // multiple of kFilePage
  uint64_t bytes;
  uint64_t checksum;  // XXH3-64, of the zeros too
  uint64_t end() const { return offset + filePages(bytes); }
};

/// Last bytes of a file. The sections stand one behind the other, without gaps, from the file's first byte to
/// here.
struct FileFooter {
  uint64_t magic;
  uint32_t version;
  uint32_t byteOrder;
  uint64_t layout;
  FilePart arenaHeader;  // StoreHeader: the arena begins the file, so that it can be diced into
  FilePart grids;
  FilePart skeleton;
  FilePart nodes;
  uint64_t displacement;  // fingerprint of the displacement shaders and of what they read, 0: unknown
  uint64_t checksum;      // of this footer up to here
};

class Checksum {
 public:
  Checksum() : state_(XXH3_createState()) { XXH3_64bits_reset(state_); }
  ~Checksum() { XXH3_freeState(state_); }
  Checksum(const Checksum&) = delete;
  Checksum& operator=(const Checksum&) = delete;
  void add(const void* data, uint64_t bytes) { XXH3_64bits_update(state_, data, size_t(bytes)); }
  uint64_t value() const { return XXH3_64bits_digest(state_); }

 private:
  XXH3_state_t* state_;
};

Error fileError(const std::string& path, const char* what, int number);
Error damagedFile(const std::string& path, std::string_view what);

/// 0 or an errno; ENODATA: the file ends too soon.
int writeAll(int fd, const void* data, uint64_t bytes, uint64_t offset);
int readAll(int fd, void* data, uint64_t bytes, uint64_t offset);

/// Writes one section, piece by piece.
class PartWriter {
 public:
  PartWriter(int fd, uint64_t offset) : fd_(fd), part_{offset, 0, 0} {}
  /// 0 or an errno.
  int add(std::span<const std::byte> bytes);
  /// Pads; the section as the footer has it.
  int finish(FilePart* part);

 private:
  int fd_;
  FilePart part_;
  Checksum sum_;
};

/// The footer of an open file: checked against the file's size and against itself, not against the sections'
/// bytes.
Result<FileFooter> readFooter(int fd, const std::string& path);
/// Completes the footer and writes it at the end of the last section.
int writeFooter(int fd, FileFooter& footer);

/// Reads a section in pieces of a few MB and compares its checksum. `piece(data, bytes, offset in the
/// section)` may be empty; it returns 0 or an errno.
template <class F>
Result<void> readPart(int fd, const std::string& path, const FilePart& part, const char* name, F&& piece) {
  Checksum sum;
  std::vector<std::byte> buffer;
  const uint64_t all = filePages(part.bytes);
  for (uint64_t at = 0; at < all; at += buffer.size()) {
    buffer.resize(std::min<uint64_t>(all - at, uint64_t(4) << 20));
    if (const int e = readAll(fd, buffer.data(), buffer.size(), part.offset + at))
      return e == ENODATA ? damagedFile(path, "it is too short")
                          : fileError(path, "cannot read the scene cache", e);
    sum.add(buffer.data(), buffer.size());
    if (const int e = piece(std::span<const std::byte>(buffer), at))
      return fileError(path, "no memory for the scene cache", e);
  }
  if (sum.value() != part.checksum) return damagedFile(path, fmt::format("checksum of its {}", name));
  return {};
}

}  // namespace fr::cache
