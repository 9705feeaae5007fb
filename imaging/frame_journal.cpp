#include "imaging/frame_journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cerrno>
#include <cstring>

namespace fr {
namespace {

constexpr char kMagic[8] = {'F', 'R', 'J', 'O', 'U', 'R', 'N', '1'};

struct Header {
  char magic[8];
  uint32_t byteOrder;
  uint32_t channels;
  uint64_t frame;
};

struct Record {
  int32_t x0, y0, x1, y1;
  uint64_t checksum;  // XXH3-64 of the rectangle and the pixels
};

/// Largest side of a tile, as Film clamps it: a rectangle beyond it is none of ours.
constexpr int kMostSide = 1024;

uint64_t checksumOf(const Record& r, const std::vector<float>& pixels) {
  const uint64_t place = XXH3_64bits(&r, offsetof(Record, checksum));
  return XXH3_64bits_withSeed(pixels.data(), pixels.size() * sizeof(float), place);
}

/// All bytes at `offset`, or false.
bool readAll(int fd, void* to, size_t bytes, uint64_t offset) {
  auto* at = static_cast<char*>(to);
  while (bytes > 0) {
    const ssize_t n = ::pread(fd, at, bytes, off_t(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    at += n, bytes -= size_t(n), offset += uint64_t(n);
  }
  return true;
}
bool writeAll(int fd, const void* from, size_t bytes, uint64_t offset) {
  const auto* at = static_cast<const char*>(from);
  while (bytes > 0) {
    const ssize_t n = ::pwrite(fd, at, bytes, off_t(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    at += n, bytes -= size_t(n), offset += uint64_t(n);
  }
  return true;
}

}  // namespace

std::string journalPath(const std::string& picture) { return picture + ".unfinished"; }

Result<std::unique_ptr<FrameJournal>> FrameJournal::open(const std::string& path, uint64_t frame,
                                                         size_t channels) {
  const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (fd < 0)
    return makeError(RiError::kSystem, "{}: finished parts of the picture cannot be kept there: {}", path,
                     std::strerror(errno));
  std::unique_ptr<FrameJournal> journal(new FrameJournal(path, fd, channels));
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0)
    return makeError(RiError::kSystem, "{}: another program is rendering this picture now", path);
  if (auto r = journal->read(frame); !r) return r.error();
  return journal;
}

FrameJournal::~FrameJournal() { ::close(fd_); }

Result<void> FrameJournal::read(uint64_t frame) {
  struct stat info {};
  if (::fstat(fd_, &info) != 0 || !S_ISREG(info.st_mode))
    return makeError(RiError::kSystem, "{}: is no file that parts of a picture could be kept in", path_);
  const auto length = uint64_t(info.st_size);
  Header want{};
  std::memcpy(want.magic, kMagic, sizeof kMagic);
  want.byteOrder = 0x01020304, want.channels = uint32_t(channels_), want.frame = frame;
  Header have{};
  const bool ours = readAll(fd_, &have, sizeof have, 0) && std::memcmp(&have, &want, sizeof have) == 0;
  size_ = sizeof(Header);
  if (ours) {
    Record r{};
    while (length - size_ >= sizeof r && readAll(fd_, &r, sizeof r, size_)) {
      const int64_t width = int64_t(r.x1) - r.x0, height = int64_t(r.y1) - r.y0;
      if (width <= 0 || height <= 0 || width > kMostSide || height > kMostSide) break;
      const auto area = size_t(width * height);
      if (length - size_ - sizeof r < area * channels_ * sizeof(float)) break;
      std::vector<float> pixels(area * channels_);
      if (!readAll(fd_, pixels.data(), pixels.size() * sizeof(float), size_ + sizeof r) ||
          checksumOf(r, pixels) != r.checksum)
        break;
      FilmTile tile;
      tile.rect = {r.x0, r.y0, r.x1, r.y1};
      for (size_t c = 0; c < channels_; ++c)
        tile.channels.emplace_back(pixels.begin() + ptrdiff_t(c * area),
                                   pixels.begin() + ptrdiff_t((c + 1) * area));
      finished_.push_back(std::move(tile));
      size_ += sizeof r + pixels.size() * sizeof(float);
    }
  } else if (length > 0) {
    reportWarning(RiError::kNone,
                  "{}: is of another picture, or of another version: starting from the beginning", path_);
  }
  if (::ftruncate(fd_, ours ? off_t(size_) : 0) != 0 || (!ours && !writeAll(fd_, &want, sizeof want, 0)))
    return makeError(RiError::kSystem, "{}: finished parts of the picture cannot be kept there: {}", path_,
                     std::strerror(errno));
  return {};
}

void FrameJournal::add(const FilmTile& tile) {
  Record r{tile.rect.x0, tile.rect.y0, tile.rect.x1, tile.rect.y1, 0};
  std::vector<float> pixels;
  for (size_t c = 0; c < channels_; ++c)
    pixels.insert(pixels.end(), tile.channels[c].begin(), tile.channels[c].end());
  r.checksum = checksumOf(r, pixels);
  const size_t bytes = pixels.size() * sizeof(float);
  const std::lock_guard lock(mutex_);
  if (failed_) return;
  // The pixels first: a record without them would be read as torn, and so would all after it.
  if (writeAll(fd_, pixels.data(), bytes, size_ + sizeof r) && writeAll(fd_, &r, sizeof r, size_)) {
    size_ += sizeof r + bytes;
    return;
  }
  failed_ = true;
  reportWarning(RiError::kSystem, "{}: {}; what is finished from now on is not kept", path_,
                std::strerror(errno));
}

void FrameJournal::remove() { ::unlink(path_.c_str()); }

}  // namespace fr
