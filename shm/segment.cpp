#include "shm/segment.h"

#include <fcntl.h>
#include <linux/falloc.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <boost/interprocess/mapped_region.hpp>
#include <cerrno>
#include <cstring>
#include <exception>
#include <mutex>
#include <random>

#include "shm/memory_info.h"
#include "shm/scratch_file.h"

namespace fr::shm {
namespace {

namespace ipc = boost::interprocess;

constexpr uint64_t kLargestPiece = 1ull << 30;
constexpr uint64_t kSmallestPiece = 2ull << 20;
constexpr uint64_t kSmallestReserve = 16ull << 20;
constexpr uint64_t kLargestReserve = 64ull << 40;

uint64_t pageSize() {
  static const uint64_t size = uint64_t(std::max(::sysconf(_SC_PAGESIZE), 4096L));
  return size;
}

uint64_t fileSize(int fd) {
  struct stat st {};
  return ::fstat(fd, &st) == 0 && st.st_size > 0 ? uint64_t(st.st_size) : 0;
}

/// What ENOMEM and friends mean to the user.
Error allocationError(int code, bool file, const std::string& name, uint64_t bytes) {
  switch (code) {
    case ENOSPC:
    case EDQUOT:
      return makeError(file ? RiError::kDiskFull : RiError::kNoMem,
                       "cannot allocate {} bytes for '{}': no space left", bytes, name);
    case EFBIG:
      return makeError(file ? RiError::kDiskFull : RiError::kNoMem,
                       "cannot allocate {} bytes for '{}': larger than the file size limit", bytes, name);
    case ENOMEM:
      return makeError(RiError::kNoMem, "cannot allocate {} bytes for '{}': out of memory", bytes, name);
    default:
      return makeError(RiError::kSystem, "cannot allocate {} bytes for '{}': {}", bytes, name,
                       std::strerror(code));
  }
}

/// Writes zeros, for file systems that cannot allocate. Only beyond the end of the file, which nobody uses
/// yet.
int appendZeros(int fd, uint64_t offset, uint64_t bytes) {
  static const std::byte zeros[65536] = {};
  for (const uint64_t end = offset + bytes; offset < end;) {
    const ssize_t n = ::pwrite(fd, zeros, std::min<uint64_t>(sizeof zeros, end - offset), off_t(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return n < 0 ? errno : ENOSPC;
    offset += uint64_t(n);
  }
  return 0;
}

/// Really allocates [offset, offset + bytes); 0 or an errno. In pieces: tmpfs undoes a piece when a signal
/// arrives, so with a profiler's timer running one large piece would never end; after an EINTR the pieces
/// shrink.
int allocateRange(int fd, uint64_t offset, uint64_t bytes) {
  rlimit limit{};
  if (::getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY &&
      offset + bytes > limit.rlim_cur) {
    return EFBIG;  // asking the kernel would cost a SIGXFSZ
  }
  uint64_t piece = kLargestPiece;
  while (bytes > 0) {
    const uint64_t n = std::min(piece, bytes);
    if (::fallocate(fd, 0, off_t(offset), off_t(n)) != 0) {
      if (errno == EINTR) {
        piece = std::max(kSmallestPiece, piece / 2);
        continue;
      }
      if (errno == EOPNOTSUPP || errno == ENOSYS || errno == EINVAL) {
        const uint64_t end = fileSize(fd);
        const uint64_t start = std::max(end, offset);
        return start < offset + bytes ? appendZeros(fd, start, offset + bytes - start) : 0;
      }
      return errno;
    }
    offset += n;
    bytes -= n;
  }
  return 0;
}

Result<FileDescriptor> createMemory(const std::string& name) {
  FileDescriptor fd(::memfd_create(name.substr(0, 200).c_str(), MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!fd) {
    return makeError(errno == ENOMEM ? RiError::kNoMem : RiError::kSystem,
                     "cannot create shared memory '{}': {}", name, std::strerror(errno));
  }
  // Nobody else can reach it but through our /proc; ours alone there too.
  if (::fchmod(fd.get(), 0600) != 0)
    return makeError(RiError::kSystem, "cannot protect shared memory '{}': {}", name, std::strerror(errno));
  return fd;
}

/// Bytes of address space that this process may have (ulimit -v); all ones: no limit.
uint64_t addressLimit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return ~uint64_t(0);
  return uint64_t(limit.rlim_cur);
}

/// Refuses what would leave the machine or our control group without memory. The pages are not taken yet:
/// without this look the kernel would hand them out and kill somebody afterwards.
Result<void> checkMemory(const std::string& name, uint64_t bytes, uint64_t keepFree) {
  const AvailableMemory m = availableMemory();
  const uint64_t usable = m.usable();
  if (usable == AvailableMemory::kUnlimited || (bytes <= usable && usable - bytes >= keepFree)) return {};
  return makeError(
      RiError::kNoMem, "cannot allocate {} KiB for '{}': {} MiB are available{}, and {} MiB must stay so",
      bytes >> 10, name, usable >> 20, m.groupFree < m.free ? " in this control group" : "", keepFree >> 20);
}

}  // namespace

struct Segment::State {
  FileDescriptor fd;
  SegmentOptions options;
  ipc::mapped_region region;
  void* reservation = nullptr;  // the file's mapping and the readable padding after it
  uint64_t reservationBytes = 0;
  uint64_t reserve = 0;  // bytes of file that the mapping can show
  bool file = false;
  bool writable = false;
  bool exact = false;    // size() is the whole file: padding comes from the reservation
  bool limited = false;  // ulimit -v made the reservation smaller than it should be
  std::string finalPath;
  std::string temporaryPath;
  std::mutex growing;
  std::atomic<uint64_t> size{0};

  ~State() {
    const bool mapped = region.get_size() != 0;
    region = ipc::mapped_region();
    // The region has unmapped its part, and another thread may have got those addresses already.
    const uint64_t left = mapped ? reserve : 0;
    if (reservation) ::munmap(static_cast<std::byte*>(reservation) + left, reservationBytes - left);
    if (!temporaryPath.empty()) ::unlink(temporaryPath.c_str());
  }

  /// Bytes of file needed to use `bytes`.
  uint64_t needed(uint64_t bytes) const {
    return roundUp(bytes + kEndPadding, std::max(pageSize(), roundUp(options.growStep, pageSize())));
  }

  /// Maps `wish` bytes of the file, whatever its length now, with at least kEndPadding readable bytes after
  /// them; down to `least` where address space is limited.
  Result<void> map(uint64_t least, uint64_t wish) {
    if (const uint64_t limit = addressLimit(); !exact && limit != ~uint64_t(0)) {
      const uint64_t share = std::max(uint64_t(double(limit) * options.addressShare), least);
      limited = share < wish;
      wish = std::min(wish, share);
    }
    reserve = roundUp(std::clamp(std::max(least, wish), pageSize(), kLargestReserve), pageSize());
    const uint64_t wanted = reserve;
    void* p = MAP_FAILED;
    // Its share may be taken by others already: less then.
    for (;; reserve = roundUp(reserve / 2, pageSize())) {
      reservationBytes = reserve + pageSize();
      p = ::mmap(nullptr, reservationBytes, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
      if (p != MAP_FAILED || reserve <= kSmallestReserve || exact) break;
    }
    if (p == MAP_FAILED) {
      return makeError(RiError::kNoMem, "cannot reserve {} MiB of address space for '{}': {}{}", wanted >> 20,
                       options.name, std::strerror(errno),
                       addressLimit() != ~uint64_t(0) ? "; raise the limit (ulimit -v)" : "");
    }
    if (reserve < wanted) {
      reportWarning(RiError::kNoMem, "'{}' can grow to {} MiB only: not enough address space for {} MiB",
                    options.name, reserve >> 20, wanted >> 20);
    }
    reservation = p;
    struct Mappable {
      int fd;
      ipc::mapping_handle_t get_mapping_handle() const {
        return ipc::ipcdetail::mapping_handle_from_file_handle(fd);
      }
    };
    try {
      region = ipc::mapped_region(Mappable{fd.get()}, writable ? ipc::read_write : ipc::read_only, 0, reserve,
                                  p, ipc::map_options_t(MAP_FIXED | MAP_NORESERVE));
    } catch (const std::exception& e) {
      return makeError(RiError::kNoMem, "cannot map '{}': {}", options.name, e.what());
    }
    // A core file with a reservation of terabytes helps nobody.
    ::madvise(p, reserve, MADV_DONTDUMP);
    return {};
  }

  /// size() for a file of `bytes`.
  uint64_t usable(uint64_t bytes) const {
    const uint64_t visible = std::min(bytes, reserve);
    return exact ? visible : visible - std::min(visible, kEndPadding);
  }

  void raiseSize(uint64_t bytes) {
    uint64_t old = size.load(std::memory_order_relaxed);
    // Pairs with the acquire load in Segment::size(): whoever sees the size may use the bytes.
    while (old < bytes && !size.compare_exchange_weak(old, bytes, std::memory_order_release)) {
    }
  }
};

Segment::Segment() = default;
Segment::Segment(Segment&& o) noexcept
    : state_(std::move(o.state_)), data_(std::exchange(o.data_, nullptr)) {}
Segment& Segment::operator=(Segment&& o) noexcept {
  state_ = std::move(o.state_);
  data_ = std::exchange(o.data_, nullptr);
  return *this;
}
Segment::~Segment() = default;

Result<Segment> Segment::createAnonymous(const SegmentOptions& options, uint64_t bytes) {
  Result<FileDescriptor> fd = createMemory(options.name);
  if (!fd) return std::move(fd).error();
  Segment s;
  s.state_ = std::make_unique<State>();
  s.state_->fd = std::move(*fd);
  s.state_->options = options;
  s.state_->writable = true;
  if (Result<void> r = s.state_->map(s.state_->needed(bytes), options.reserve); !r) return r.error();
  s.data_ = static_cast<std::byte*>(s.state_->reservation);
  if (Result<void> r = s.grow(bytes); !r) return r.error();
  // Only now: seals are for the others, and nothing shrinks a segment that is not shared yet.
  if (::fcntl(s.state_->fd.get(), F_ADD_SEALS, F_SEAL_SHRINK) != 0) {
    return makeError(RiError::kSystem, "cannot seal shared memory '{}': {}", options.name,
                     std::strerror(errno));
  }
  return s;
}

Result<Segment> Segment::createScratch(const std::string& folder, const SegmentOptions& options,
                                       uint64_t bytes) {
  Result<FileDescriptor> fd = createScratchFile(folder);
  if (!fd) return std::move(fd).error();
  Segment s;
  s.state_ = std::make_unique<State>();
  State& st = *s.state_;
  st.fd = std::move(*fd);
  st.options = options;
  st.options.name = fmt::format("{} in the scratch folder {}", options.name, folder);
  st.file = true;
  st.writable = true;
  if (Result<void> r = st.map(st.needed(bytes), options.reserve); !r) return r.error();
  s.data_ = static_cast<std::byte*>(st.reservation);
  if (Result<void> r = s.grow(bytes); !r) return r.error();
  return s;
}

Result<Segment> Segment::createFile(const std::string& path, const SegmentOptions& options, uint64_t bytes) {
  Segment s;
  s.state_ = std::make_unique<State>();
  State& st = *s.state_;
  st.options = options;
  st.options.name = path;
  st.file = true;
  st.writable = true;
  // Our own random name rather than mkstemp's, so that the final file gets the permissions of the user's
  // umask.
  std::random_device random;
  for (int attempt = 0; attempt < 100 && !st.fd; ++attempt) {
    std::string name = fmt::format("{}.partial-{}-{:08x}", path, ::getpid(), random());
    st.fd = FileDescriptor(::open(name.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666));
    if (st.fd) {
      st.temporaryPath = std::move(name);
    } else if (errno != EEXIST) {
      break;
    }
  }
  if (!st.fd) return makeError(RiError::kNoFile, "cannot create '{}': {}", path, std::strerror(errno));
  st.finalPath = path;
  if (Result<void> r = st.map(st.needed(bytes), options.reserve); !r) return r.error();
  s.data_ = static_cast<std::byte*>(st.reservation);
  if (Result<void> r = s.grow(bytes); !r) return r.error();
  return s;
}

Result<Segment> Segment::openFile(const std::string& path) {
  Segment s;
  s.state_ = std::make_unique<State>();
  State& st = *s.state_;
  st.options.name = path;
  st.file = true;
  st.exact = true;
  // O_NONBLOCK: a pipe of that name must not hang us.
  st.fd = FileDescriptor(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!st.fd) return makeError(RiError::kNoFile, "cannot open '{}': {}", path, std::strerror(errno));
  struct stat info {};
  if (::fstat(st.fd.get(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return makeError(RiError::kBadFile, "'{}' is not a regular file", path);
  }
  if (info.st_size <= 0) return makeError(RiError::kBadFile, "'{}' is empty", path);
  if (uint64_t(info.st_size) > kLargestReserve)
    return makeError(RiError::kBadFile, "'{}' is too large", path);
  if (Result<void> r = st.map(uint64_t(info.st_size), uint64_t(info.st_size)); !r) return r.error();
  s.data_ = static_cast<std::byte*>(st.reservation);
  st.raiseSize(st.usable(uint64_t(info.st_size)));
  return s;
}

Result<Segment> Segment::attach(FileDescriptor fd, Access access, const SegmentOptions& options) {
  struct stat info {};
  if (!fd || ::fstat(fd.get(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return makeError(RiError::kBadFile, "'{}': what was sent is not a memory segment", options.name);
  }
  // Files on disks have no seals, and those of a tmpfs answer F_SEAL_SEAL: they can never get any. A file of
  // ours is never truncated.
  const int seals = ::fcntl(fd.get(), F_GET_SEALS);
  const bool file = seals < 0 || seals == F_SEAL_SEAL;
  if (file && options.sealedOnly) {
    return makeError(RiError::kBadFile, "'{}': what was sent is not anonymous shared memory", options.name);
  }
  if (!file && !(seals & F_SEAL_SHRINK)) {
    return makeError(RiError::kBadFile, "'{}': the segment is not sealed against shrinking", options.name);
  }
  const int mode = ::fcntl(fd.get(), F_GETFL);
  if (access == Access::kReadWrite && (mode & O_ACCMODE) != O_RDWR) {
    return makeError(RiError::kBadFile, "'{}': the segment was sent read-only", options.name);
  }
  Segment s;
  s.state_ = std::make_unique<State>();
  State& st = *s.state_;
  st.fd = std::move(fd);
  st.options = options;
  st.file = file;
  st.writable = access == Access::kReadWrite;
  const uint64_t bytes = fileSize(st.fd.get());
  if (bytes > kLargestReserve)
    return makeError(RiError::kBadFile, "'{}': the segment is too large", options.name);
  if (Result<void> r = st.map(bytes, options.reserve); !r) return r.error();
  s.data_ = static_cast<std::byte*>(st.reservation);
  s.refresh();
  return s;
}

bool Segment::writable() const { return state_ && state_->writable; }
// Acquire: pairs with the release in State::raiseSize.
uint64_t Segment::size() const { return state_ ? state_->size.load(std::memory_order_acquire) : 0; }
uint64_t Segment::reserved() const { return state_ ? state_->reserve : 0; }
int Segment::descriptor() const { return state_ ? state_->fd.get() : -1; }

uint64_t Segment::allocated() const {
  struct stat info {};
  return state_ && ::fstat(state_->fd.get(), &info) == 0 ? uint64_t(info.st_blocks) * 512 : 0;
}

uint64_t Segment::refresh() {
  if (!state_) return 0;
  state_->raiseSize(state_->usable(fileSize(state_->fd.get())));
  return size();
}

Result<void> Segment::grow(uint64_t bytes) {
  if (!state_ || !state_->writable || state_->exact) {
    return makeError(RiError::kIllState, "this segment cannot grow");
  }
  if (bytes <= size() && size() > 0) return {};
  State& st = *state_;
  const std::lock_guard lock(st.growing);
  const uint64_t now = fileSize(st.fd.get());
  if (now > kEndPadding && bytes <= st.usable(now)) {
    st.raiseSize(st.usable(now));  // somebody else has grown it
    return {};
  }
  if (bytes > st.options.limit) {
    return makeError(RiError::kLimit, "'{}' would need {} MiB: its limit is {} MiB", st.options.name,
                     bytes >> 20, st.options.limit >> 20);
  }
  if (bytes > st.reserve - kEndPadding) {
    return makeError(RiError::kLimit, "'{}' would need {} MiB: its address space ends at {} MiB{}",
                     st.options.name, bytes >> 20, st.reserve >> 20,
                     st.limited ? "; raise the limit (ulimit -v)" : "");
  }
  // The rounding up to whole steps must not be what exceeds the limit or the reservation.
  const uint64_t exactly = roundUp(bytes + kEndPadding, pageSize());
  const uint64_t most = std::min(st.reserve, st.options.limit > st.reserve
                                                 ? st.reserve
                                                 : roundUp(st.options.limit + kEndPadding, pageSize()));
  const uint64_t target = std::clamp(st.needed(bytes), exactly, std::max(exactly, most));
  if (!st.file) {
    if (Result<void> r = checkMemory(st.options.name, target - now, st.options.keepFree); !r) return r;
  }
  if (const int code = allocateRange(st.fd.get(), now, target - now); code != 0) {
    return allocationError(code, st.file, st.options.name, target - now);
  }
  st.raiseSize(st.usable(target));
  return {};
}

Result<void> Segment::discard(uint64_t offset, uint64_t bytes) {
  if (!state_ || !state_->writable) return makeError(RiError::kIllState, "this segment is read-only");
  if (offset > size() || bytes > size() - offset) {
    return makeError(RiError::kRange, "'{}': discarding bytes beyond the end", state_->options.name);
  }
  const uint64_t first = roundUp(offset, pageSize());
  const uint64_t last = (offset + bytes) / pageSize() * pageSize();
  if (first >= last) return {};
  while (::fallocate(state_->fd.get(), FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, off_t(first),
                     off_t(last - first)) != 0) {
    if (errno == EINTR) continue;
    return makeError(RiError::kSystem, "'{}': cannot give memory back: {}", state_->options.name,
                     std::strerror(errno));
  }
  return {};
}

Result<void> Segment::commit(uint64_t offset, uint64_t bytes) {
  if (!state_ || !state_->writable) return makeError(RiError::kIllState, "this segment is read-only");
  State& st = *state_;
  if (offset > size() || bytes > size() - offset) {
    return makeError(RiError::kRange, "'{}': committing bytes beyond the end", st.options.name);
  }
  if (bytes == 0) return {};
  if (!st.file) {
    if (Result<void> r = checkMemory(st.options.name, bytes, st.options.keepFree); !r) return r;
  }
  if (const int code = allocateRange(st.fd.get(), offset, bytes); code != 0) {
    return allocationError(code, st.file, st.options.name, bytes);
  }
  return {};
}

Result<void> Segment::finish(uint64_t bytes) {
  if (!state_ || state_->temporaryPath.empty()) {
    return makeError(RiError::kIllState, "this segment is not a file that is being written");
  }
  State& st = *state_;
  const std::lock_guard lock(st.growing);
  if (bytes == 0 || bytes > size())
    return makeError(RiError::kRange, "'{}': finishing at a size of {}", st.finalPath, bytes);
  const std::string temporary = std::exchange(st.temporaryPath, {});
  auto fail = [&](const char* what, int code) {
    ::unlink(temporary.c_str());
    return makeError(code == ENOSPC || code == EDQUOT || code == EIO ? RiError::kDiskFull : RiError::kSystem,
                     "cannot {} '{}': {}", what, st.finalPath, std::strerror(code));
  };
  if (::ftruncate(st.fd.get(), off_t(bytes)) != 0) return fail("cut", errno);
  st.exact = true;
  st.size.store(bytes, std::memory_order_release);
  // The page after the end keeps the padding readable.
  const uint64_t end = roundUp(bytes, pageSize());
  if (::mmap(data_ + end, pageSize(), PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0) ==
      MAP_FAILED) {
    return fail("pad", errno);
  }
  if (::fsync(st.fd.get()) != 0) return fail("write", errno);
  if (::rename(temporary.c_str(), st.finalPath.c_str()) != 0) return fail("rename", errno);
  return {};
}

Result<FileDescriptor> Segment::share(Access access) const {
  if (!state_) return makeError(RiError::kIllState, "no segment to share");
  FileDescriptor fd;
  if (access == Access::kReadWrite) {
    if (!state_->writable)
      return makeError(RiError::kIllState, "a read-only segment cannot be shared for writing");
    fd = state_->fd.duplicate();
  } else {
    fd = FileDescriptor(
        ::open(fmt::format("/proc/self/fd/{}", state_->fd.get()).c_str(), O_RDONLY | O_CLOEXEC));
    if (!fd && !state_->writable) fd = state_->fd.duplicate();
  }
  if (!fd)
    return makeError(RiError::kSystem, "cannot share '{}': {}", state_->options.name, std::strerror(errno));
  return fd;
}

Result<FileDescriptor> createSealedMemory(const std::string& name, uint64_t bytes) {
  Result<FileDescriptor> fd = createMemory(name);
  if (!fd) return fd;
  if (Result<void> r = checkMemory(name, bytes, SegmentOptions{}.keepFree); !r) return r.error();
  if (const int code = allocateRange(fd->get(), 0, bytes); code != 0)
    return allocationError(code, false, name, bytes);
  if (::fcntl(fd->get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    return makeError(RiError::kSystem, "cannot seal shared memory '{}': {}", name, std::strerror(errno));
  }
  return fd;
}

}  // namespace fr::shm
