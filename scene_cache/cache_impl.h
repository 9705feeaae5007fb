// The inside of SceneCache. Included by its .cpp files alone.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "scene_cache/cache.h"
#include "scene_cache/dice_metric.h"
#include "scene_cache/dicer.h"
#include "scene_cache/primitive_source.h"
#include "scene_cache/shared_store.h"
#include "scene_cache/subdivision.h"
#include "scene_cache/surface.h"

namespace fr::cache {

struct FileBuild;
struct FileFooter;
class GridSource;

inline constexpr size_t kPiece = size_t(4) << 20;               // that files are read and written in
inline constexpr uint64_t kNodesMagic = 0x3145444f4e435346ull;  // "FSCNODE1"
inline constexpr uint64_t kArenaMagic = 0x314e455241435346ull;  // "FSCAREN1"

// State words of PatchNode::state; see format.h.
inline NodeState stateOf(uint64_t word) { return NodeState(word & 3); }
inline uint64_t buildingWord(uint32_t slot, uint64_t generation) {
  return 1 | uint64_t(slot & 255) << 2 | generation << 10;
}
inline uint32_t slotOf(uint64_t word) { return uint32_t(word >> 2) & 255; }
inline uint64_t gridWord(uint64_t offset) { return 2 | offset << 2; }
inline uint64_t gridOffset(uint64_t word) { return word >> 2; }
inline uint64_t splitWord(NodeId first, bool inV) {
  return 3 | uint64_t(first) << 2 | (inV ? uint64_t(1) << 63 : 0);
}
inline NodeId splitFirst(uint64_t word) { return NodeId((word >> 2) & 0xffffffffu); }
inline bool splitInV(uint64_t word) { return (word >> 63) != 0; }

/// A root patch at one time with the foreign borders that it needs.
struct DiceSurfaces {
  Surface own;
  RootBorders borders;
  std::vector<Surface> owners;
};

struct SceneCache::Impl {
  ~Impl();

  // ---- mapping
  int skeletonFd = -1;
  std::byte* skeletonMap = nullptr;
  size_t skeletonSize = 0;
  SharedStore nodes, arena;
  bool readOnly = false;
  std::vector<shm::PagedMapping> paged;
  bool meetsRays = true;
  uint64_t id = 0;                   // of this instance within the process, for the threads' chunks
  std::unique_ptr<FileBuild> build;  // grids go to this file
  std::atomic<bool> noRoom{false};   // a grid could not be stored
  uint64_t displacement = 0;         // FileFooter::displacement of the file that this is
  std::unique_ptr<GridSource> gridSource;

  // ---- ownership of claims: a slot whose byte of the nodes file this process has locked
  int ownerFd = -1;
  uint32_t ownerSlot = 0;
  uint64_t generation = 0;

  // ---- derived
  DiceEye eye;
  /// How many times as long segments may be on an object that moves before the camera (motionSide()).
  float motionSideOf(const Skeleton& skeleton, const ObjectRecord& object) const;
  std::unique_ptr<SubdivisionStore> subdivisions;

  std::atomic<uint64_t> gridsDiced{0}, micropolygonsDiced{0}, nodesSplit{0}, claimsTakenOver{0},
      gridsShared{0}, gridsReused{0}, diceNanoseconds{0};

  Result<void> mapSkeleton(int fd, Skeleton* out);
  Result<void> takeOwnerSlot();
  void pageStores();  // from now on a pager may let go of nodes and grids
  void deriveFrom(const Skeleton& skeleton);
  /// Whether whoever wrote this building word still lives.
  bool ownerAlive(uint64_t word) const;

  PatchNode* node(NodeId id) const;
  uint32_t nodeCount() const;
  /// False: no room.
  bool addRootNodes(const Skeleton& skeleton);
  /// Offsets; 0: no room.
  /// Room for the record of a grid of so many levels and so many bytes behind it, which start at a multiple
  /// of positionAlign(levels): offset of the record, 0 when there is none.
  uint64_t allocateGrid(uint32_t levels, uint64_t bytesBehind);
  uint64_t allocateChildren();
  /// Threads go on with fresh chunks. While nobody dices.
  void dropChunks();
  /// Nodes as a file has them. `total`: how many it has.
  void copyNodes(NodeId first, NodeId count, NodeId total, std::byte* out) const;
  /// Behind the footer's grids. 0 or an errno.
  int writeSkeleton(int fd, FileFooter* footer) const;
  /// Checked view of the grid at an arena offset, or nullptr.
  const GridRecord* grid(uint64_t offset, NodeId node) const;

  // ---- making (cache_dice.cpp): the word to publish, 0 when it could not be made
  uint64_t make(const Skeleton& skeleton, NodeId id, Displacer* displacer);
  /// Of an instance: what the prototype's node is, which has been resolved.
  uint64_t makePlaced(const Skeleton& skeleton, NodeId id, const ObjectRecord& object);
  bool prototypeReady(NodeId prototype) const;
  /// The old cache's node, where it is the same; 0: has to be made (cache_reuse.cpp).
  uint64_t makeReused(const Skeleton& skeleton, NodeId id, const ObjectRecord& object, Displacer* displacer);
  /// A planned grid that differs at its borders at most.
  uint64_t reusePlanned(NodeId id, const DicePlan& plan, int keys,
                        const std::function<void(int key, float* xyz)>& borders);
  uint64_t copyGrid(const SceneCache& from, const GridRecord& grid, NodeId id);
  uint64_t makeMeshlet(const Skeleton& skeleton, NodeId id, const ObjectRecord& object, Displacer* displacer);
  uint64_t makeThin(const Skeleton& skeleton, NodeId id, const ObjectRecord& object, Displacer* displacer);
  uint64_t makeGrid(const Skeleton& skeleton, NodeId id, const ObjectRecord& object, Displacer* displacer);
  void reportNoRoom(const Skeleton& skeleton, const ObjectRecord& object);
  /// Rectangles from the root to the node; empty when the tree is damaged.
  std::vector<NodeRect> pathTo(const PatchNode& n) const;
  bool prepare(const Skeleton& skeleton, uint32_t root, float time, bool borders, DiceSurfaces* out);
  /// Shading normals N (or, where nullptr, none) and geometric normals Ng of a root patch, oriented; arrays
  /// of n.
  void surfaceNormals(const Skeleton& skeleton, NodeId root, float time, size_t n, const uint32_t* cell,
                      const float* u, const float* v, float* const* N, float* const* Ng) const;
  void displace(const Skeleton& skeleton, NodeId id, const ObjectRecord& object, Displacer& displacer,
                GridRecord& record, const uint32_t* cell, const float* u, const float* v);
};

/// A box of object space, transformed.
Box3f placedBound(const DMat4& placement, const Box3f& box);

/// Sign to apply to dPdu x dPdv in cache space.
inline float normalSign(const AttributeRecord& a) {
  return (a.flags & kReverseInCacheSpace) != 0 ? -1.0f : 1.0f;
}

/// Vertices of a meshlet's source, with indices clamped to what exists.
struct MeshletView {
  const MeshletSource* source = nullptr;
  MeshletRecord record{};
  std::span<const uint32_t> vertices, corners, faces;
  std::span<const uint8_t> triangles;
  bool valid = false;
};
MeshletView meshletView(const Skeleton& skeleton, const ObjectRecord& object, uint32_t index);
/// Object-space positions of a source at one time: pointers to two keys' floats and the weight of the second.
struct PositionKeys {
  const float* a = nullptr;
  const float* b = nullptr;
  double weight = 0;
  uint64_t count = 0;
  uint32_t components = 3;
  DVec3 at(uint64_t i) const;
};
PositionKeys positionsAt(const Skeleton& skeleton, const SourcePositions& p, float time);

}  // namespace fr::cache
