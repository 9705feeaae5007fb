// .fsc files: skeleton, nodes and grids of one frame in one file.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

#include "base/whole_file.h"
#include "scene_cache/cache_impl.h"
#include "scene_cache/file_layout.h"
#include "shm/file_descriptor.h"
#include "shm/scratch_file.h"

namespace fr::cache {

void SceneCache::Impl::copyNodes(NodeId first, NodeId count, NodeId total, std::byte* out) const {
  for (NodeId i = 0; i < count; ++i, out += sizeof(PatchNode)) {
    const PatchNode* from = node(first + i);
    FR_CHECK(from);
    uint64_t word = from->state.load(std::memory_order_acquire);
    std::memcpy(out + 8, reinterpret_cast<const std::byte*>(from) + 8, sizeof(PatchNode) - 8);
    // Who is building now is no fact about the scene, and a split made since may point beyond the copy.
    if (stateOf(word) == NodeState::kBuilding ||
        (stateOf(word) == NodeState::kSplit && uint64_t(splitFirst(word)) + 2 > total))
      word = 0;
    std::memcpy(out, &word, 8);
  }
}

int SceneCache::Impl::writeSkeleton(int fd, FileFooter* footer) const {
  PartWriter w(fd, footer->grids.end());
  // In pieces: the checksum is that of what was written, whatever happens to the memory.
  // Behind its tables the segment has room that nobody needs.
  const size_t bytes =
      std::min(skeletonSize, size_t(reinterpret_cast<const SkeletonHeader*>(skeletonMap)->totalBytes));
  for (size_t at = 0; at < bytes; at += kPiece)
    if (const int e = w.add({skeletonMap + at, std::min(kPiece, bytes - at)})) return e;
  return w.finish(&footer->skeleton);
}

Result<void> SceneCache::save(const std::string& path) {
  Impl& d = *impl_;
  WholeFile file;
  if (const int e = file.open(path)) return fileError(path, "cannot write", e);
  const int fd = file.descriptor();
  const auto failed = [&](int e) { return fileError(path, "cannot write the scene cache", e); };

  // The arena's top is read after the nodes, so every grid that the copy mentions lies below it.
  const NodeId count = d.nodeCount();
  std::vector<std::byte> nodes(kStoreHeaderBytes + size_t(count) * sizeof(PatchNode));
  std::memcpy(nodes.data(), d.nodes.base(), kStoreHeaderBytes);
  d.copyNodes(0, count, count, nodes.data() + kStoreHeaderBytes);
  const uint64_t arenaBytes = d.arena.header().top.load();
  if (!d.arena.at(0, arenaBytes)) return damagedFile(path, "the grids are shorter than they say");

  const uint64_t all = filePages(arenaBytes) + filePages(d.skeletonSize) + filePages(nodes.size());
  if (const int e = posix_fallocate(fd, 0, off_t(all)); e != 0 && e != EINVAL && e != EOPNOTSUPP)
    return fileError(path, "no room for the scene cache", e);
  FileFooter f{};
  std::vector<std::byte> piece(kStoreHeaderBytes);
  std::memcpy(piece.data(), d.arena.base(), piece.size());
  std::memcpy(piece.data() + offsetof(StoreHeader, top), &arenaBytes, 8);
  PartWriter header(fd, 0);
  if (const int e = header.add(piece)) return failed(e);
  if (const int e = header.finish(&f.arenaHeader)) return failed(e);
  // The arena goes on changing while it is written (new grids, never old ones): the checksum is that of the
  // copy.
  PartWriter grids(fd, f.arenaHeader.end());
  for (uint64_t at = kStoreHeaderBytes; at < arenaBytes; at += piece.size()) {
    piece.resize(std::min<uint64_t>(arenaBytes - at, kPiece));
    std::memcpy(piece.data(), d.arena.base() + at, piece.size());
    if (const int e = grids.add(piece)) return failed(e);
  }
  if (const int e = grids.finish(&f.grids)) return failed(e);
  if (const int e = d.writeSkeleton(fd, &f)) return failed(e);
  PartWriter nodesPart(fd, f.skeleton.end());
  if (const int e = nodesPart.add(nodes)) return failed(e);
  if (const int e = nodesPart.finish(&f.nodes)) return failed(e);
  if (const int e = writeFooter(fd, f)) return failed(e);
  if (const int e = file.finish()) return failed(e);
  return {};
}

namespace {

struct OpenedFile {
  shm::FileDescriptor fd;
  FileFooter footer;
};

Result<OpenedFile> openChecked(const std::string& path) {
  // O_NONBLOCK: a pipe of that name must not hang us.
  OpenedFile o{shm::FileDescriptor(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)), {}};
  if (!o.fd) {
    Error e = makeError(RiError::kNoFile, "cannot open: {}", std::strerror(errno));
    e.where.file = path;
    return e;
  }
  auto footer = readFooter(o.fd.get(), path);
  if (!footer) return std::move(footer).error();
  o.footer = *footer;
  return o;
}

/// A memory file of `bytes`, or a file in the folder `scratch` if that is not empty; allocated.
Result<shm::FileDescriptor> memoryFile(const std::string& path, const char* name, uint64_t bytes,
                                       const std::string& scratch) {
  shm::FileDescriptor fd;
  if (scratch.empty()) {
    fd = shm::FileDescriptor(memfd_create(name, MFD_CLOEXEC | MFD_ALLOW_SEALING));
    if (!fd || fchmod(fd.get(), 0600) != 0) return fileError(path, "cannot make shared memory", errno);
  } else {
    auto made = shm::createScratchFile(scratch);
    if (!made) return std::move(made).error();
    fd = *std::move(made);
  }
  if (const int e = posix_fallocate(fd.get(), 0, off_t(filePages(bytes) + kFilePage)))
    return fileError(path, "no memory for the scene cache", e);
  return fd;
}

/// Copies sections into a memory file, so that another process can share them and new records can follow.
Result<void> copyPart(const OpenedFile& from, const std::string& path, const FilePart& part, const char* name,
                      int to, uint64_t at) {
  return readPart(from.fd.get(), path, part, name, [&](std::span<const std::byte> piece, uint64_t offset) {
    const uint64_t bytes = std::min<uint64_t>(piece.size(), part.bytes - offset);  // without the padding
    return writeAll(to, piece.data(), bytes, at + offset);
  });
}

/// A store's header says how much of it is in use; what had been allocated beyond that is not in the file.
Result<void> setTop(const std::string& path, int fd, uint64_t bytes) {
  if (const int e = writeAll(fd, &bytes, 8, offsetof(StoreHeader, top)))
    return fileError(path, "cannot prepare the scene cache", e);
  fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK);
  return {};
}

Result<shm::FileDescriptor> nodesInMemory(const OpenedFile& file, const std::string& path,
                                          const std::string& scratch = {}) {
  auto nodes = memoryFile(path, "fr-nodes", file.footer.nodes.bytes, scratch);
  if (!nodes) return std::move(nodes).error();
  if (auto r = copyPart(file, path, file.footer.nodes, "patches", nodes->get(), 0); !r)
    return std::move(r).error();
  if (auto r = setTop(path, nodes->get(), file.footer.nodes.bytes); !r) return std::move(r).error();
  return nodes;
}

Error named(Error e, const std::string& path) {
  e.where.file = path;
  return e;
}

}  // namespace

Result<void> SceneCache::checkNodes(const std::string& path, bool grids) const {
  const uint32_t roots = uint32_t(skeleton_.rootPatches().size());
  for (NodeId i = 0; i < nodeCount(); ++i) {
    const PatchNode& n = node(i);
    const uint64_t word = n.state.load();
    const bool rootOk = n.root < roots && (i >= roots || n.root == i) && n.du <= kMaxSplitDepth &&
                        n.dv <= kMaxSplitDepth && n.iu < 1u << n.du && n.iv < 1u << n.dv;
    bool stateOk = stateOf(word) != NodeState::kBuilding;
    if (grids || stateOf(word) == NodeState::kSplit) {
      const ResolvedNode r = peek(i);
      // Children stand behind their parents: no cycles.
      stateOk = stateOk && (stateOf(word) == NodeState::kEmpty || r.state == stateOf(word)) &&
                (r.state != NodeState::kSplit || r.children[0] > i);
    }
    if (!rootOk || !stateOk) return damagedFile(path, fmt::format("node {}", i));
  }
  return {};
}

Result<std::unique_ptr<SceneCache>> SceneCache::openFile(const std::string& path,
                                                         const std::string& scratch) {
  auto file = openChecked(path);
  if (!file) return std::move(file).error();
  const FileFooter& f = file->footer;
  auto skeleton = memoryFile(path, "fr-skeleton", f.skeleton.bytes, scratch);
  if (!skeleton) return std::move(skeleton).error();
  if (auto r = copyPart(*file, path, f.skeleton, "skeleton", skeleton->get(), 0); !r)
    return std::move(r).error();
  auto nodes = nodesInMemory(*file, path, scratch);
  if (!nodes) return std::move(nodes).error();
  auto arena = memoryFile(path, "fr-arena", kStoreHeaderBytes + f.grids.bytes, scratch);
  if (!arena) return std::move(arena).error();
  if (auto r = copyPart(*file, path, f.arenaHeader, "header", arena->get(), 0); !r)
    return std::move(r).error();
  if (auto r = copyPart(*file, path, f.grids, "grids", arena->get(), kStoreHeaderBytes); !r)
    return std::move(r).error();
  if (auto r = setTop(path, arena->get(), kStoreHeaderBytes + f.grids.bytes); !r) return std::move(r).error();
  auto c = attach({skeleton->get(), nodes->get(), arena->get()}, false, scratch);
  if (!c) return named(std::move(c).error(), path);
  // Everything once: roots and references of a stranger's file.
  if (auto r = (*c)->checkNodes(path, true); !r) return std::move(r).error();
  return c;
}

Result<std::unique_ptr<SceneCache>> SceneCache::openMapped(const std::string& path) {
  auto file = openChecked(path);
  if (!file) return std::move(file).error();
  std::unique_ptr<SceneCache> c(new SceneCache);
  Impl& d = *c->impl_;
  d.readOnly = true;
  d.displacement = file->footer.displacement;
  const auto skip = [](std::span<const std::byte>, uint64_t) { return 0; };
  if (auto r = readPart(file->fd.get(), path, file->footer.skeleton, "skeleton", skip); !r)
    return std::move(r).error();
  d.skeletonSize = size_t(file->footer.skeleton.bytes);
  void* p = mmap(nullptr, d.skeletonSize, PROT_READ, MAP_SHARED, file->fd.get(),
                 off_t(file->footer.skeleton.offset));
  if (p == MAP_FAILED) return fileError(path, "cannot map", errno);
  d.skeletonMap = static_cast<std::byte*>(p);
  auto s = Skeleton::open({d.skeletonMap, d.skeletonSize}, false);
  if (!s) return named(std::move(s).error(), path);
  c->skeleton_ = *s;
  auto nodes = nodesInMemory(*file, path);
  if (!nodes) return std::move(nodes).error();
  auto nodeStore = SharedStore::attach(nodes->get(), kNodesMagic, true);
  if (!nodeStore) return named(std::move(nodeStore).error(), path);
  d.nodes = *std::move(nodeStore);
  auto arena = SharedStore::attach(file->fd.get(), kArenaMagic, true);
  if (!arena) return named(std::move(arena).error(), path);
  d.arena = *std::move(arena);
  if (d.nodeCount() < c->skeleton_.rootPatches().size()) return damagedFile(path, "patches are missing");
  if (auto r = c->checkNodes(path, false); !r) return std::move(r).error();
  d.deriveFrom(c->skeleton_);
  return c;
}

Result<void> SceneCache::verifyFile(const std::string& path) {
  auto file = openChecked(path);
  if (!file) return std::move(file).error();
  const auto skip = [](std::span<const std::byte>, uint64_t) { return 0; };
  const FileFooter& f = file->footer;
  for (const auto& [part, name] : {std::pair{&f.arenaHeader, "header"},
                                   {&f.grids, "grids"},
                                   {&f.skeleton, "skeleton"},
                                   {&f.nodes, "patches"}})
    if (auto r = readPart(file->fd.get(), path, *part, name, skip); !r) return r;
  return {};
}

void SceneCache::letGo() const {
  // Of a mapped file or one that is diced into: the pages are still in the file.
  if (impl_->readOnly || impl_->build)
    madvise(impl_->arena.base(), impl_->arena.header().top.load(), MADV_DONTNEED);
}

}  // namespace fr::cache
