// A piece of memory that several processes map and that grows in place.
#pragma once

#include <atomic>
#include <memory>
#include <span>
#include <string>

#include "base/error.h"
#include "shm/cache_line.h"
#include "shm/file_descriptor.h"

namespace fr::shm {

enum class Access { kReadOnly, kReadWrite };

struct SegmentOptions {
  std::string name = "frankenrender";  // what /proc/<pid>/maps shows for anonymous segments
  uint64_t reserve = 64ull << 30;      // bytes of address space; the segment can never outgrow them
  /// Where address space is limited (ulimit -v), the segment reserves no more than this part of it: it is not
  /// the only one.
  double addressShare = 1.0 / 8;
  uint64_t limit = ~0ull;          // bytes; growing beyond is an error (the memory budget)
  uint64_t growStep = 4ull << 20;  // bytes; growth is rounded up to multiples of this
  /// Bytes of memory that must remain available on the machine and in our control group after an anonymous
  /// segment has grown. File-backed segments are not held to it: the kernel can write their pages back.
  uint64_t keepFree = 64ull << 20;
  /// attach(): refuse files on disks, which their creator can truncate under us. For segments from a
  /// stranger.
  bool sealedOnly = false;
};

/// A growable segment: anonymous shared memory (memfd, sealed against shrinking) or a file.
///
/// Growing: the whole reservation is mapped once, so addresses never move, here or in the other processes;
/// behind the end of the file there is nothing yet. grow() really allocates (fallocate), after a look at the
/// limit, the free memory and the control group, so that a full disk or memory is an Error here and not a
/// SIGBUS or a killed process at the first write. What another process has grown is seen after refresh().
///
/// Thread safety: all const members, grow(), commit(), discard() and refresh() from any thread. Two processes
/// may grow the same segment at once: the larger size wins, nothing is lost. Invariants: [data(), data() +
/// size() + kEndPadding) is readable; size() never falls, except through finish(). Ownership: the object owns
/// mapping and descriptor. An anonymous segment ends with its last process, however that one dies. A created
/// file has a temporary name until finish(); the destructor removes it if finish() was not reached; after a
/// kill -9 the "<path>.partial-*" file stays behind and nothing else.
class Segment {
 public:
  Segment();
  Segment(Segment&&) noexcept;
  Segment& operator=(Segment&&) noexcept;
  ~Segment();

  /// `bytes`: size to start with, zero filled. Errors: kNoMem (no memory, limit, address space), kSystem.
  static Result<Segment> createAnonymous(const SegmentOptions& options, uint64_t bytes);
  /// A file without a name in `folder`, whose pages the kernel can write out: for what is larger than memory.
  /// It ends with its last process, like an anonymous segment, and nothing is sealed. Errors: kNoFile
  /// (folder), kDiskFull, kNoMem, kSystem.
  static Result<Segment> createScratch(const std::string& folder, const SegmentOptions& options,
                                       uint64_t bytes);
  /// Creates "<path>.partial-...", to be renamed to `path` by finish(). Errors: kNoFile, kDiskFull, kNoMem,
  /// kSystem.
  static Result<Segment> createFile(const std::string& path, const SegmentOptions& options, uint64_t bytes);
  /// Maps the whole of an existing file, read-only. Padding is provided even when the file ends at a page.
  /// The file is not ours: if somebody truncates it while it is mapped, reading beyond its new end is a
  /// SIGBUS that nobody can prevent; files of ours are replaced by renaming and never truncated. Errors:
  /// kNoFile, kBadFile (empty, a directory, a pipe), kNoMem.
  static Result<Segment> openFile(const std::string& path);
  /// Maps a segment that another process created and sent (peer.h). An anonymous one must be sealed against
  /// shrinking, else kBadFile: its creator could crash us. options.reserve bounds how much of later growth is
  /// visible.
  static Result<Segment> attach(FileDescriptor fd, Access access, const SegmentOptions& options = {});

  bool valid() const { return state_ != nullptr; }
  /// Start of the mapping, page aligned; constant for the life of the segment. Writing is only allowed (no
  /// SIGSEGV) when writable().
  std::byte* data() const { return data_; }
  bool writable() const;
  /// Usable bytes as far as this process knows.
  uint64_t size() const;
  std::span<const std::byte> bytes() const { return {data_, size_t(size())}; }
  /// Bytes of address space reserved.
  uint64_t reserved() const;
  /// Bytes of memory or disk really taken now (discarded pages do not count).
  uint64_t allocated() const;

  /// Makes size() at least `bytes`. Allocated bytes are zero. On an error the segment is as before.
  /// Errors: kNoMem, kDiskFull (file), kLimit (options.limit or the reservation), kIllState (read-only).
  Result<void> grow(uint64_t bytes);
  /// Looks up how far others have grown the segment and returns size(). A cheap system call.
  uint64_t refresh();
  /// Gives the whole pages inside [offset, offset + bytes) back to the system; they read as zero afterwards,
  /// in every process. Before they are written again, call commit(). Errors: kRange, kIllState, kSystem (not
  /// supported).
  Result<void> discard(uint64_t offset, uint64_t bytes);
  /// Really allocates [offset, offset + bytes) again, within size(). Errors as grow(), and kRange.
  Result<void> commit(uint64_t offset, uint64_t bytes);

  /// File-backed segments: cuts the file to exactly `bytes`, writes it to the disk and renames it to its
  /// final name. The segment can still be read, not grown. Errors: kDiskFull, kSystem; the temporary file is
  /// then removed.
  Result<void> finish(uint64_t bytes);

  int descriptor() const;
  /// A descriptor to send to another process. Read-only: the receiver cannot map it writable by accident; a
  /// process of the same user that means harm can reopen it, so nothing secret depends on it.
  Result<FileDescriptor> share(Access access) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
  std::byte* data_ = nullptr;
};

/// A memfd of exactly `bytes`, zero filled, allocated, sealed against shrinking, growing and further seals:
/// what channels live in. Errors: kNoMem, kSystem.
Result<FileDescriptor> createSealedMemory(const std::string& name, uint64_t bytes);

}  // namespace fr::shm
