// Dicing straight into a file.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "scene_cache/cache_impl.h"
#include "scene_cache/file_build.h"

namespace fr::cache {
namespace {

constexpr uint64_t kFirstBytes = uint64_t(1) << 20;

/// Makes an empty store of an empty file.
int initialize(int fd, uint64_t magic) {
  rlimit limit{};
  if (getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur < kFirstBytes) return EFBIG;
  if (const int e = posix_fallocate(fd, 0, off_t(kFirstBytes))) return e;
  const uint32_t version = kFormatVersion, order = 0x01020304;
  const uint64_t layout = layoutFingerprint(), top = kStoreHeaderBytes;
  std::byte header[offsetof(StoreHeader, ownerTickets)] = {};
  std::memcpy(header + offsetof(StoreHeader, magic), &magic, 8);
  std::memcpy(header + offsetof(StoreHeader, version), &version, 4);
  std::memcpy(header + offsetof(StoreHeader, byteOrder), &order, 4);
  std::memcpy(header + offsetof(StoreHeader, layout), &layout, 8);
  std::memcpy(header + offsetof(StoreHeader, top), &top, 8);
  return writeAll(fd, header, sizeof header, 0);
}

std::string folderOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  return slash == std::string::npos ? "." : path.substr(0, slash + 1);
}

/// Why the file did not grow: asked again, a little.
int whyNoRoom(int fd) {
  struct stat st {};
  rlimit limit{};
  constexpr uint64_t kMore = uint64_t(4) << 20;
  if (fstat(fd, &st) != 0) return errno;
  if (getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY &&
      uint64_t(st.st_size) + kMore > limit.rlim_cur)
    return EFBIG;
  const int e = posix_fallocate(fd, st.st_size, off_t(kMore));
  return e != 0 ? e : ENOSPC;
}

}  // namespace

int namelessFile(const std::string& folder) {
  const int fd = open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (fd >= 0) return fd;
  std::string name = folder + "/.frankenrender-XXXXXX";
  const int named = mkostemp(name.data(), O_CLOEXEC);
  if (named >= 0) unlink(name.c_str());
  return named;
}

Result<std::unique_ptr<SceneCache>> SceneCache::createInFile(int skeletonFd, const std::string& path,
                                                             const std::string& scratch) {
  std::unique_ptr<SceneCache> c(new SceneCache);
  Impl& d = *c->impl_;
  d.build = std::make_unique<FileBuild>();
  FileBuild& b = *d.build;
  b.path = path;
  b.settled = b.onDisk = kStoreHeaderBytes;
  if (auto r = d.mapSkeleton(skeletonFd, &c->skeleton_); !r) return std::move(r).error();
  if (const int e = b.file.open(path)) return fileError(path, "cannot write", e);
  if (const int e = initialize(b.file.descriptor(), kArenaMagic))
    return fileError(path, "no room for the scene cache", e);
  auto arena = SharedStore::attach(b.file.descriptor(), kArenaMagic, false);
  if (!arena) return std::move(arena).error();
  d.arena = *std::move(arena);
  // Nodes change until the end and stand last in the file: they get there when all is diced.
  const std::string folder = scratch.empty() ? folderOf(path) : scratch;
  shm::FileDescriptor nodes(namelessFile(folder));
  if (!nodes) return fileError(folder, "cannot write", errno);
  if (const int e = initialize(nodes.get(), kNodesMagic))
    return fileError(folder, "no room for the scene cache's patches", e);
  auto nodeStore = SharedStore::attach(nodes.get(), kNodesMagic, false);
  if (!nodeStore) return std::move(nodeStore).error();
  d.nodes = *std::move(nodeStore);
  d.pageStores();
  if (!d.addRootNodes(c->skeleton_))
    return fileError(folder, "no room for the scene cache's patches", whyNoRoom(nodes.get()));
  if (auto r = d.takeOwnerSlot(); !r) return std::move(r).error();
  d.deriveFrom(c->skeleton_);
  return c;
}

Result<void> SceneCache::settle() {
  Impl& d = *impl_;
  FR_CHECK(d.build);
  FileBuild& b = *d.build;
  d.dropChunks();  // whatever lies below the top is final
  const uint64_t top = d.arena.header().top.load();
  const int fd = b.file.descriptor();
  if (!d.arena.at(0, top)) return fileError(b.path, "cannot write the scene cache", EIO);
  b.grids.add(d.arena.base() + b.settled, top - b.settled);
  // The last part has had the time of this one to get to the disk.
  if (b.settled > b.onDisk) {
    if (sync_file_range(fd, off_t(b.onDisk), off_t(b.settled - b.onDisk),
                        SYNC_FILE_RANGE_WAIT_BEFORE | SYNC_FILE_RANGE_WRITE | SYNC_FILE_RANGE_WAIT_AFTER) !=
            0 &&
        (errno == EIO || errno == ENOSPC || errno == EDQUOT))
      return fileError(b.path, "cannot write the scene cache", errno);
    posix_fadvise(fd, off_t(b.onDisk), off_t(b.settled - b.onDisk), POSIX_FADV_DONTNEED);
    b.onDisk = b.settled;
  }
  sync_file_range(fd, off_t(b.settled), off_t(top - b.settled), SYNC_FILE_RANGE_WRITE);
  b.settled = top;
  // Prototypes are read again by their instances: the kernel finds their pages in the file.
  madvise(d.arena.base(), top, MADV_DONTNEED);
  madvise(d.nodes.base(), d.nodes.header().top.load(), MADV_DONTNEED);
  madvise(d.skeletonMap, d.skeletonSize, MADV_DONTNEED);
  return {};
}

uint64_t SceneCache::unsettledBytes() const {
  return impl_->build ? impl_->arena.header().top.load(std::memory_order_relaxed) - impl_->build->settled : 0;
}

Result<void> SceneCache::finishFile(uint64_t displacement) {
  Impl& d = *impl_;
  FR_CHECK(d.build);
  FileBuild& b = *d.build;
  if (auto r = settle(); !r) return r;
  const int fd = b.file.descriptor();
  const auto failed = [&](int e) { return fileError(b.path, "cannot write the scene cache", e); };
  FileFooter f{};
  f.displacement = displacement;
  f.grids = {kStoreHeaderBytes, b.settled - kStoreHeaderBytes, 0};
  // Behind the last grid there are zeros that were allocated for others.
  if (ftruncate(fd, off_t(f.grids.end())) != 0) return failed(errno);
  static constexpr std::byte kZeros[kFilePage] = {};
  b.grids.add(kZeros, f.grids.end() - b.settled);
  f.grids.checksum = b.grids.value();
  std::vector<std::byte> piece(kStoreHeaderBytes);
  if (const int e = readAll(fd, piece.data(), piece.size(), 0)) return failed(e);
  PartWriter header(fd, 0);
  if (const int e = header.add(piece)) return failed(e);
  if (const int e = header.finish(&f.arenaHeader)) return failed(e);
  if (const int e = d.writeSkeleton(fd, &f)) return failed(e);
  PartWriter nodes(fd, f.skeleton.end());
  std::memcpy(piece.data(), d.nodes.base(), piece.size());
  if (const int e = nodes.add(piece)) return failed(e);
  const NodeId count = d.nodeCount();
  constexpr NodeId kNodesAPiece = kPiece / sizeof(PatchNode);
  for (NodeId at = 0; at < count; at += kNodesAPiece) {
    const NodeId n = std::min(kNodesAPiece, count - at);
    piece.resize(size_t(n) * sizeof(PatchNode));
    d.copyNodes(at, n, count, piece.data());
    if (const int e = nodes.add(piece)) return failed(e);
    madvise(d.nodes.base(), kStoreHeaderBytes + uint64_t(at) * sizeof(PatchNode), MADV_DONTNEED);
  }
  if (const int e = nodes.finish(&f.nodes)) return failed(e);
  if (const int e = writeFooter(fd, f)) return failed(e);
  if (const int e = b.file.finish()) return failed(e);
  return {};
}

Result<void> SceneCache::room() const {
  if (!impl_->noRoom.load(std::memory_order_relaxed)) return {};
  if (!impl_->build) return makeError(RiError::kNoMem, "no memory for more grids");
  const FileBuild& b = *impl_->build;
  const int e = whyNoRoom(b.file.descriptor());
  return fileError(b.path, "no room for more grids", e);
}

}  // namespace fr::cache
