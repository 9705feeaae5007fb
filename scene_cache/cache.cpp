#include "scene_cache/cache.h"

#include <fcntl.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "scene_cache/cache_impl.h"
#include "scene_cache/file_build.h"
#include "scene_cache/grid_source.h"

namespace fr::cache {
namespace {

std::atomic<uint64_t> nextInstance{1};

/// A thread's piece of an arena.
struct Chunk {
  uint64_t instance = 0, at = 0, end = 0;
};
constexpr uint64_t kChunkBytes = 128 << 10;
/// Embree loads 16 bytes for a position of 12; so much more than it may read is readable behind any of them.
constexpr uint64_t kReadBehind = 64;

/// Claims that this thread holds; while there is one it never waits.
thread_local int claimsHeld = 0;

constexpr uint64_t kGenerationMask = (uint64_t(1) << 54) - 1;
constexpr int kSpins = 2000;
constexpr int kNapsBetweenLifeChecks = 64;

}  // namespace

SceneCache::SceneCache() : impl_(std::make_unique<Impl>()) {}
SceneCache::~SceneCache() = default;

SceneCache::Impl::~Impl() {
  paged.clear();
  if (skeletonMap) munmap(skeletonMap, skeletonSize);
  if (skeletonFd >= 0) close(skeletonFd);
  if (ownerFd >= 0) close(ownerFd);  // releases the lock
}

Result<void> SceneCache::Impl::mapSkeleton(int fd, Skeleton* out) {
  skeletonFd = fcntl(fd, F_DUPFD_CLOEXEC, 0);
  struct stat st {};
  if (skeletonFd < 0 || fstat(skeletonFd, &st) != 0) {
    return makeError(RiError::kSystem, "cannot use the scene's descriptor: {}", std::strerror(errno));
  }
  if (st.st_size <= 0) return makeError(RiError::kBadFile, "the scene is empty");
  skeletonSize = size_t(st.st_size);
  void* p = mmap(nullptr, skeletonSize, PROT_READ, MAP_SHARED, skeletonFd, 0);
  if (p == MAP_FAILED) return makeError(RiError::kSystem, "cannot map the scene: {}", std::strerror(errno));
  skeletonMap = static_cast<std::byte*>(p);
  paged.emplace_back(shm::PagedRange{skeletonMap, [this] { return uint64_t(skeletonSize); }, skeletonFd, 0});
  // Written by this program a moment ago; files are verified by openFile().
  auto s = Skeleton::open({skeletonMap, skeletonSize}, false);
  if (!s) return std::move(s).error();
  *out = *s;
  return {};
}

void SceneCache::Impl::pageStores() {
  // Their first pages hold what every allocation changes.
  for (const SharedStore* s : {&arena, &nodes})
    paged.emplace_back(shm::PagedRange{s->base() + kStoreHeaderBytes,
                                       [s] { return s->size() - std::min(s->size(), kStoreHeaderBytes); },
                                       s->fd(), kStoreHeaderBytes});
}

Result<void> SceneCache::Impl::takeOwnerSlot() {
  // A lock of our own needs an open file description of our own: descriptors that came over a socket share
  // one.
  const std::string path = fmt::format("/proc/self/fd/{}", nodes.fd());
  ownerFd = open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (ownerFd < 0)
    ownerFd = fcntl(nodes.fd(), F_DUPFD_CLOEXEC, 0);  // no /proc: processes must not share descriptors
  if (ownerFd < 0)
    return makeError(RiError::kSystem, "cannot use the scene cache's descriptor: {}", std::strerror(errno));
  for (uint32_t slot = 1; slot < 256; ++slot) {
    struct flock lock {};
    lock.l_type = F_WRLCK;
    lock.l_whence = SEEK_SET;
    lock.l_start = off_t(slot);
    lock.l_len = 1;
    if (fcntl(ownerFd, F_OFD_SETLK, &lock) == 0) {
      ownerSlot = slot;
      generation = (nodes.header().ownerTickets[slot].fetch_add(1) + 1) & kGenerationMask;
      return {};
    }
  }
  return makeError(RiError::kLimit, "more than 255 processes use this scene cache");
}

bool SceneCache::Impl::ownerAlive(uint64_t word) const {
  const uint32_t slot = slotOf(word);
  // A later process in the same slot is not the one that made this claim.
  if ((nodes.header().ownerTickets[slot].load() & kGenerationMask) != word >> 10) return false;
  if (slot == ownerSlot) return true;
  struct flock lock {};
  lock.l_type = F_WRLCK;
  lock.l_whence = SEEK_SET;
  lock.l_start = off_t(slot);
  lock.l_len = 1;
  if (fcntl(ownerFd, F_OFD_GETLK, &lock) != 0) return true;  // unknown: wait on
  return lock.l_type != F_UNLCK;
}

void SceneCache::Impl::deriveFrom(const Skeleton& skeleton) {
  id = nextInstance.fetch_add(1);
  const CameraRecord& camera = skeleton.camera();
  const DMat4 m = skeleton.cacheToCamera(camera.shutter[0]);
  eye = diceEye(camera, m);
  subdivisions = std::make_unique<SubdivisionStore>(skeleton);
}

bool SceneCache::Impl::addRootNodes(const Skeleton& skeleton) {
  const auto roots = skeleton.rootPatches();
  if (roots.empty()) return true;
  if (nodes.allocate(roots.size() * sizeof(PatchNode), 64) != kStoreHeaderBytes) return false;
  PatchNode* n = reinterpret_cast<PatchNode*>(nodes.base() + kStoreHeaderBytes);
  const auto objects = skeleton.objects();
  for (size_t i = 0; i < roots.size(); ++i) {
    n[i].root = uint32_t(i), n[i].bound = roots[i].bound;
    const ObjectRecord& o = objects[roots[i].object];
    if (o.prototype != kNone)
      n[i].prototype = 1 + objects[o.prototype].firstPatch + (uint32_t(i) - o.firstPatch);
  }
  return true;
}

Result<std::unique_ptr<SceneCache>> SceneCache::create(int skeletonFd, const std::string& scratch) {
  std::unique_ptr<SceneCache> c(new SceneCache);
  c->scratch_ = scratch;
  Impl& d = *c->impl_;
  if (auto r = d.mapSkeleton(skeletonFd, &c->skeleton_); !r) return std::move(r).error();
  auto nodes = SharedStore::create("fr-nodes", kNodesMagic, scratch);
  if (!nodes) return std::move(nodes).error();
  d.nodes = *std::move(nodes);
  auto arena = SharedStore::create("fr-arena", kArenaMagic, scratch);
  if (!arena) return std::move(arena).error();
  d.arena = *std::move(arena);
  d.pageStores();
  if (!d.addRootNodes(c->skeleton_)) {
    return makeError(RiError::kNoMem, "no memory for the {} patches of the scene",
                     c->skeleton_.rootPatches().size());
  }
  if (auto r = d.takeOwnerSlot(); !r) return std::move(r).error();
  d.deriveFrom(c->skeleton_);
  return c;
}

Result<std::unique_ptr<SceneCache>> SceneCache::attach(const Segments& fds, bool readOnly,
                                                       const std::string& scratch) {
  std::unique_ptr<SceneCache> c(new SceneCache);
  c->scratch_ = scratch;
  Impl& d = *c->impl_;
  d.readOnly = readOnly;
  if (auto r = d.mapSkeleton(fds.skeleton, &c->skeleton_); !r) return std::move(r).error();
  auto nodes = SharedStore::attach(fds.nodes, kNodesMagic, readOnly);
  if (!nodes) return std::move(nodes).error().context("nodes");
  d.nodes = *std::move(nodes);
  auto arena = SharedStore::attach(fds.arena, kArenaMagic, readOnly);
  if (!arena) return std::move(arena).error().context("grids");
  d.arena = *std::move(arena);
  d.pageStores();
  if (d.nodeCount() < c->skeleton_.rootPatches().size()) {
    return makeError(RiError::kBadFile, "the scene cache has {} nodes for {} patches", d.nodeCount(),
                     c->skeleton_.rootPatches().size());
  }
  if (!readOnly) {
    if (auto r = d.takeOwnerSlot(); !r) return std::move(r).error();
  }
  d.deriveFrom(c->skeleton_);
  return c;
}

SceneCache::Segments SceneCache::segments() const {
  return {impl_->skeletonFd, impl_->nodes.fd(), impl_->arena.fd()};
}

void SceneCache::setMeetsRays(bool meets) { impl_->meetsRays = meets; }

// ---- nodes
// ---------------------------------------------------------------------------------------------------------

uint32_t SceneCache::Impl::nodeCount() const {
  const uint64_t top = nodes.header().top.load(std::memory_order_relaxed);
  return top < kStoreHeaderBytes
             ? 0
             : uint32_t(std::min<uint64_t>((top - kStoreHeaderBytes) / sizeof(PatchNode), kNone));
}

PatchNode* SceneCache::Impl::node(NodeId id_) const {
  return reinterpret_cast<PatchNode*>(
      nodes.at(kStoreHeaderBytes + uint64_t(id_) * sizeof(PatchNode), sizeof(PatchNode)));
}

const PatchNode& SceneCache::node(NodeId id) const {
  PatchNode* n = id < impl_->nodeCount() ? impl_->node(id) : nullptr;
  FR_CHECK(n);
  return *n;
}
uint32_t SceneCache::nodeCount() const { return impl_->nodeCount(); }
const RootPatchRecord& SceneCache::rootOf(NodeId id) const {
  const auto roots = skeleton_.rootPatches();
  const uint32_t root = node(id).root;
  FR_CHECK(root < roots.size());
  return roots[root];
}
const ObjectRecord& SceneCache::objectOf(NodeId id) const { return skeleton_.objects()[rootOf(id).object]; }
const AttributeRecord& SceneCache::attributesOf(NodeId id) const {
  return skeleton_.attributes()[objectOf(id).attributes];
}

void SceneCache::Impl::dropChunks() { id = nextInstance.fetch_add(1); }

uint64_t SceneCache::Impl::allocateChildren() {
  const uint64_t offset = nodes.allocate(2 * sizeof(PatchNode), sizeof(PatchNode));
  if (!offset) noRoom = true;
  return offset;
}

uint64_t SceneCache::Impl::allocateGrid(uint32_t levels, uint64_t bytesBehind) {
  // Where positions may start there is a record in front of them.
  const auto recordFrom = [align = positionAlign(levels)](uint64_t at) {
    return (at + sizeof(GridRecord) + align - 1) / align * align - sizeof(GridRecord);
  };
  const uint64_t bytes = sizeof(GridRecord) + bytesBehind, most = bytes + kPositionAlign + kReadBehind;
  // Few caches are open at a time; the oldest one's chunk is dropped when another needs its place.
  thread_local Chunk chunks[4];
  thread_local unsigned next = 0;
  if (most > kChunkBytes / 4) {
    const uint64_t start = arena.allocate(most, kPositionAlign);
    if (!start) noRoom = true;
    return start ? recordFrom(start) : 0;
  }
  Chunk* c = std::find_if(chunks, chunks + 4, [this](const Chunk& k) { return k.instance == id; });
  if (c == chunks + 4) {
    c = &chunks[next++ % 4];
    *c = {id, 0, 0};
  }
  if (c->end - c->at < most) {
    // A little at first: a small scene should stay small.
    const uint64_t size = c->end == 0 ? kChunkBytes / 4 : kChunkBytes;
    const uint64_t start = arena.allocate(size, kPositionAlign);
    if (!start) {
      noRoom = true;
      return 0;
    }
    *c = {id, start, start + size};
    shm::noteGrowth(size);
  }
  const uint64_t r = recordFrom(c->at);
  c->at = r + bytes;
  return r;
}

const GridRecord* SceneCache::Impl::grid(uint64_t offset, NodeId nodeId) const {
  if (offset % alignof(GridRecord) != 0 || offset < kStoreHeaderBytes) return nullptr;
  const auto* g = reinterpret_cast<const GridRecord*>(arena.at(offset, sizeof(GridRecord)));
  if (!g || g->node != nodeId || g->keyCount < 1 || g->keyCount > kMaxGridKeys || g->levels < 1 ||
      g->levels > kLevels || g->positions % positionAlign(g->levels) != 0)
    return nullptr;
  uint64_t span, vertices;
  if (g->kind == GridKind::kGrid) {
    const auto sideOk = [](uint32_t n) {
      return n >= 1 && n <= uint32_t(kMaxGridSide) && (n & (n - 1)) == 0;
    };
    if (!sideOk(g->nu) || !sideOk(g->nv) || g->rowStride < g->nu + 1u || g->rowStride > 64) return nullptr;
    if ((1u << (g->levels - 1)) > std::min(g->nu, g->nv)) return nullptr;
    span = uint64_t(g->rowStride) * g->nv + g->nu + 1u;
    vertices = uint64_t(g->nu + 1u) * (g->nv + 1u);
  } else if (g->kind == GridKind::kMeshlet) {
    if (g->nu > kMaxMeshletVertices || g->nv > kMaxMeshletTriangles || g->levels != 1) return nullptr;
    if (!arena.at(g->indices, uint64_t(g->nv) * 3)) return nullptr;
    if ((g->flags & kGridSprites) && (g->rowStride < 3 || g->nu == 0 || g->nu % g->rowStride != 0 ||
                                      g->nv != g->nu / g->rowStride * (g->rowStride - 2)))
      return nullptr;
    span = vertices = g->nu;
  } else {
    return nullptr;
  }
  const uint64_t keyBytes = span * 12;
  if (g->keyCount > 1 && (g->keyBytes < keyBytes || g->keyBytes > (uint64_t(1) << 20))) return nullptr;
  if (!arena.at(g->positions, (g->keyCount - 1u) * g->keyBytes + keyBytes + kReadBehind)) return nullptr;
  if (g->placement && (g->placement % 4 != 0 || !arena.at(g->placement, 12 * sizeof(float)))) return nullptr;
  if (g->normals && (g->normals % 4 != 0 || !arena.at(g->normals, vertices * sizeof(uint32_t))))
    return nullptr;
  return g;
}

GridView SceneCache::view(const GridRecord& g) const {
  const std::byte* base = impl_->arena.base();
  GridView v;
  v.record = &g;
  v.positions = reinterpret_cast<const float*>(base + g.positions);
  if (g.placement) v.placement = reinterpret_cast<const float*>(base + g.placement);
  if (g.normals) v.normals = reinterpret_cast<const uint32_t*>(base + g.normals);
  if (g.kind == GridKind::kMeshlet) v.indices = reinterpret_cast<const uint8_t*>(base + g.indices);
  return v;
}

std::span<const std::byte> SceneCache::arena() const {
  return {impl_->arena.base(), size_t(impl_->arena.mappedBytes())};
}

ResolvedNode SceneCache::peek(NodeId id) const {
  ResolvedNode r;
  if (id >= impl_->nodeCount()) return r;
  const PatchNode* n = impl_->node(id);
  if (!n) return r;
  const uint64_t word =
      n->state.load(std::memory_order_acquire);  // SYNC: pairs with resolve()'s release store
  r.state = stateOf(word);
  if (r.state == NodeState::kSplit) {
    const NodeId first = splitFirst(word);
    if (uint64_t(first) + 2 > impl_->nodeCount()) return {};
    r.children[0] = first, r.children[1] = first + 1;
  } else if (r.state == NodeState::kGrid) {
    r.grid = impl_->grid(gridOffset(word), id);
    if (!r.grid) return {};
  }
  return r;
}

ResolvedNode SceneCache::resolve(NodeId id) {
  Impl& d = *impl_;
  if (id >= d.nodeCount()) return {};
  PatchNode* n = d.node(id);
  if (!n) return {};
  const uint64_t mine = buildingWord(d.ownerSlot, d.generation);
  int spins = 0, naps = 0;
  for (;;) {
    uint64_t word = n->state.load(std::memory_order_acquire);  // SYNC: pairs with the release store below
    const NodeState state = stateOf(word);
    if (state == NodeState::kGrid || state == NodeState::kSplit) return peek(id);
    // Whoever holds a claim must not wait for another one, nor nest: two could wait for each other.
    if (d.readOnly || claimsHeld > 0) return {};
    if (const uint32_t prototype = n->prototype; prototype != 0 && !d.prototypeReady(prototype - 1)) {
      // Before the claim: nobody waits while holding one. A prototype has no prototype.
      const PatchNode* shared = prototype - 1 < d.nodeCount() ? d.node(prototype - 1) : nullptr;
      if (!shared || shared->prototype != 0 || resolve(prototype - 1).state == NodeState::kEmpty) return {};
    }
    if (state == NodeState::kBuilding) {
      if (++spins < kSpins) {
        __builtin_ia32_pause();
        continue;
      }
      if (++naps % kNapsBetweenLifeChecks != 1 || d.ownerAlive(word)) {
        if (naps < 16) {
          sched_yield();
        } else {
          const timespec nap{0, 50'000};
          nanosleep(&nap, nullptr);
        }
        continue;
      }
      if (!n->state.compare_exchange_strong(word, mine, std::memory_order_acq_rel)) continue;
      d.claimsTakenOver.fetch_add(1, std::memory_order_relaxed);
    } else if (!n->state.compare_exchange_strong(word, mine, std::memory_order_acq_rel)) {
      continue;
    }
    ++claimsHeld;
    timespec t0{}, t1{};
    clock_gettime(CLOCK_MONOTONIC, &t0);
    const uint64_t result = d.make(skeleton_, id, displacer_);
    clock_gettime(CLOCK_MONOTONIC, &t1);
    d.diceNanoseconds.fetch_add(uint64_t((t1.tv_sec - t0.tv_sec) * 1'000'000'000 + t1.tv_nsec - t0.tv_nsec),
                                std::memory_order_relaxed);
    --claimsHeld;
    // SYNC: pairs with the acquire loads of resolve() and peek(), here and in the other process.
    n->state.store(result, std::memory_order_release);
    return result ? peek(id) : ResolvedNode{};
  }
}

CacheStatistics SceneCache::statistics() const {
  const Impl& d = *impl_;
  CacheStatistics s;
  s.gridsDiced = d.gridsDiced.load(std::memory_order_relaxed);
  s.micropolygonsDiced = d.micropolygonsDiced.load(std::memory_order_relaxed);
  s.nodesSplit = d.nodesSplit.load(std::memory_order_relaxed);
  s.gridsReused = d.gridsReused.load(std::memory_order_relaxed);
  s.gridsShared = d.gridsShared.load(std::memory_order_relaxed);
  s.claimsTakenOver = d.claimsTakenOver.load(std::memory_order_relaxed);
  s.dicingSeconds = double(d.diceNanoseconds.load(std::memory_order_relaxed)) * 1e-9;
  s.arenaBytes = d.arena.header().top.load(std::memory_order_relaxed);
  s.nodeBytes = d.nodes.header().top.load(std::memory_order_relaxed);
  s.skeletonBytes = d.skeletonSize;
  return s;
}

}  // namespace fr::cache
