// .fsc files: skeleton, nodes and grids of one frame in one file.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "base/whole_file.h"
#include "scene_cache/cache_impl.h"

namespace fr::cache {
namespace {

constexpr uint64_t kFileMagic = 0x31454c4946435346ull;  // "FSCFILE1"
constexpr uint64_t kPage = 4096;

struct FilePart {
  uint64_t offset;  // multiple of kPage
  uint64_t bytes;
  uint64_t checksum;  // XXH3-64
};
struct FileHeader {
  uint64_t magic;
  uint32_t version;
  uint32_t byteOrder;
  uint64_t layout;
  FilePart skeleton, nodes, arena;
  uint64_t checksum;  // of this header up to here
};

struct OwnedFd {
  int fd = -1;
  ~OwnedFd() {
    if (fd >= 0) close(fd);
  }
};

Error fileError(const std::string& path, const char* what, int number) {
  Error e = makeError(
      number == ENOSPC || number == EDQUOT || number == EFBIG ? RiError::kDiskFull : RiError::kSystem,
      "{}: {}", what, std::strerror(number));
  e.where.file = path;
  return e;
}
Error damaged(const std::string& path, std::string_view what) {
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

}  // namespace

Result<void> SceneCache::save(const std::string& path) {
  Impl& d = *impl_;
  WholeFile file;
  if (const int e = file.open(path)) return fileError(path, "cannot write", e);
  const int fd = file.descriptor();
  const auto pageUp = [](uint64_t x) { return (x + kPage - 1) / kPage * kPage; };
  FileHeader h{};
  h.magic = kFileMagic;
  h.version = kFormatVersion;
  h.byteOrder = 0x01020304;
  h.layout = layoutFingerprint();

  // Nodes as a copy without claims: who is building now is no fact about the scene. The arena's top is read
  // after the nodes, so every grid that the copy mentions lies below it.
  const uint64_t nodeBytes = kStoreHeaderBytes + uint64_t(nodeCount()) * sizeof(PatchNode);
  std::vector<std::byte> nodes(nodeBytes);
  std::memcpy(nodes.data(), d.nodes.base(), kStoreHeaderBytes);
  for (NodeId i = 0;
       i < nodeCount() && kStoreHeaderBytes + (uint64_t(i) + 1) * sizeof(PatchNode) <= nodeBytes; ++i) {
    const PatchNode& from = node(i);
    const uint64_t word = from.state.load(std::memory_order_acquire);
    std::byte* to = nodes.data() + kStoreHeaderBytes + uint64_t(i) * sizeof(PatchNode);
    std::memcpy(to + 8, reinterpret_cast<const std::byte*>(&from) + 8, sizeof(PatchNode) - 8);
    const uint64_t kept = stateOf(word) == NodeState::kBuilding ? 0 : word;
    std::memcpy(to, &kept, 8);
  }
  // A split published while the copy was made may point beyond it: undo such splits.
  for (uint64_t at = kStoreHeaderBytes; at + sizeof(PatchNode) <= nodeBytes; at += sizeof(PatchNode)) {
    uint64_t word;
    std::memcpy(&word, nodes.data() + at, 8);
    const uint64_t count = (nodeBytes - kStoreHeaderBytes) / sizeof(PatchNode);
    if (stateOf(word) == NodeState::kSplit && uint64_t(splitFirst(word)) + 2 > count) {
      word = 0;
      std::memcpy(nodes.data() + at, &word, 8);
    }
  }
  const uint64_t arenaBytes = d.arena.header().top.load();
  if (!d.arena.at(0, arenaBytes)) return damaged(path, "the grids are shorter than they say");

  h.skeleton = {pageUp(sizeof(FileHeader)), d.skeletonSize, 0};
  h.nodes = {pageUp(h.skeleton.offset + h.skeleton.bytes), nodeBytes, 0};
  h.arena = {pageUp(h.nodes.offset + h.nodes.bytes), arenaBytes, 0};
  // The arena goes on changing while it is written (new grids, never old ones): the checksum is that of what
  // was written.
  struct Part {
    FilePart* part;
    const std::byte* data;
  };
  if (const int e = posix_fallocate(fd, 0, off_t(h.arena.offset + h.arena.bytes));
      e != 0 && e != EINVAL && e != EOPNOTSUPP) {
    return fileError(path, "no room for the scene cache", e);
  }
  std::vector<std::byte> piece;
  for (const Part& p :
       {Part{&h.skeleton, d.skeletonMap}, Part{&h.nodes, nodes.data()}, Part{&h.arena, d.arena.base()}}) {
    XXH3_state_t* state = XXH3_createState();
    XXH3_64bits_reset(state);
    int e = 0;
    for (uint64_t at = 0; at < p.part->bytes && e == 0; at += piece.size()) {
      piece.resize(std::min<uint64_t>(p.part->bytes - at, uint64_t(4) << 20));
      std::memcpy(piece.data(), p.data + at, piece.size());
      XXH3_64bits_update(state, piece.data(), piece.size());
      e = writeAll(fd, piece.data(), piece.size(), p.part->offset + at);
    }
    p.part->checksum = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    if (e != 0) return fileError(path, "cannot write the scene cache", e);
  }
  h.checksum = XXH3_64bits(&h, offsetof(FileHeader, checksum));
  if (const int e = writeAll(fd, &h, sizeof h, 0)) return fileError(path, "cannot write the scene cache", e);
  if (const int e = file.finish()) return fileError(path, "cannot write the scene cache", e);
  return {};
}

Result<std::unique_ptr<SceneCache>> SceneCache::openFile(const std::string& path) {
  OwnedFd file;
  file.fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file.fd < 0) {
    Error e = makeError(RiError::kNoFile, "cannot open: {}", std::strerror(errno));
    e.where.file = path;
    return e;
  }
  struct stat st {};
  FileHeader h{};
  if (fstat(file.fd, &st) != 0 || uint64_t(st.st_size) < sizeof h || readAll(file.fd, &h, sizeof h, 0) != 0 ||
      h.magic != kFileMagic || h.byteOrder != 0x01020304) {
    return damaged(path, "not a scene cache");
  }
  if (h.version != kFormatVersion || h.layout != layoutFingerprint()) {
    Error e = makeError(RiError::kVersion, "scene cache of version {} or another build, this program has {}",
                        h.version, kFormatVersion);
    e.where.file = path;
    return e;
  }
  if (h.checksum != XXH3_64bits(&h, offsetof(FileHeader, checksum))) return damaged(path, "its header");
  const uint64_t size = uint64_t(st.st_size);
  for (const FilePart* p : {&h.skeleton, &h.nodes, &h.arena}) {
    if (p->offset % kPage != 0 || p->offset > size || p->bytes > size - p->offset)
      return damaged(path, "it is too short");
  }
  // Into memory files, so that the other process can share them and new grids can follow the stored ones.
  const auto load = [&](const FilePart& p, const char* name, OwnedFd& to) -> Result<void> {
    to.fd = memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (to.fd < 0 || fchmod(to.fd, 0600) != 0) return fileError(path, "cannot make shared memory", errno);
    if (p.bytes > 0) {
      if (const int e = posix_fallocate(to.fd, 0, off_t((p.bytes + 2 * kPage - 1) / kPage * kPage))) {
        return fileError(path, "no memory for the scene cache", e);
      }
    }
    XXH3_state_t* state = XXH3_createState();
    XXH3_64bits_reset(state);
    std::vector<std::byte> piece;
    int e = 0;
    for (uint64_t at = 0; at < p.bytes && e == 0; at += piece.size()) {
      piece.resize(std::min<uint64_t>(p.bytes - at, uint64_t(4) << 20));
      e = readAll(file.fd, piece.data(), piece.size(), p.offset + at);
      XXH3_64bits_update(state, piece.data(), piece.size());
      if (e == 0) e = writeAll(to.fd, piece.data(), piece.size(), at);
    }
    const uint64_t checksum = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    if (e == ENODATA) return damaged(path, "it is too short");
    if (e != 0) return fileError(path, "cannot read the scene cache", e);
    if (checksum != p.checksum) return damaged(path, "checksum");
    return {};
  };
  OwnedFd skeleton, nodes, arena;
  if (auto r = load(h.skeleton, "fr-skeleton", skeleton); !r) return std::move(r).error();
  if (auto r = load(h.nodes, "fr-nodes", nodes); !r) return std::move(r).error();
  if (auto r = load(h.arena, "fr-arena", arena); !r) return std::move(r).error();
  // The stores' own sizes: what they had allocated beyond the stored part is not there.
  for (const auto& [fd, part] : {std::pair{nodes.fd, h.nodes}, std::pair{arena.fd, h.arena}}) {
    const uint64_t bytes = part.bytes;
    if (bytes < kStoreHeaderBytes) return damaged(path, "a part is too short");
    const int e1 = writeAll(fd, &bytes, 8, offsetof(StoreHeader, top));
    if (e1) return fileError(path, "cannot prepare the scene cache", e1);
    fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK);
  }
  auto c = attach({skeleton.fd, nodes.fd, arena.fd}, false);
  if (!c) {
    Error e = std::move(c).error();
    e.where.file = path;
    return e;
  }
  // Everything once: roots and references of a stranger's file.
  const uint32_t roots = uint32_t((*c)->skeleton_.rootPatches().size());
  for (NodeId i = 0; i < (*c)->nodeCount(); ++i) {
    const PatchNode& n = (*c)->node(i);
    const uint64_t word = n.state.load();
    const bool rootOk = n.root < roots && (i >= roots || n.root == i) && n.du <= kMaxSplitDepth &&
                        n.dv <= kMaxSplitDepth && n.iu < 1u << n.du && n.iv < 1u << n.dv;
    const ResolvedNode r = (*c)->peek(i);
    const bool stateOk =
        stateOf(word) == NodeState::kEmpty || (r.state == stateOf(word) && r.state != NodeState::kBuilding);
    const bool childrenOk = r.state != NodeState::kSplit || r.children[0] > i;  // no cycles
    if (!rootOk || !stateOk || !childrenOk) return damaged(path, fmt::format("node {}", i));
  }
  return c;
}

}  // namespace fr::cache
