// The scene cache as its users see it: objects, patches, and grids diced on first need.
//
// Both of our processes hold a SceneCache over the same three segments (format.h). All positions are in cache
// space: world space minus a double-precision origin near the camera, as floats.
//
// A patch is addressed by (NodeId, cell, u, v): for surface patches u and v are the parameters of the *root*
// patch, in [0,1], and cell is unused; for meshlets cell is the triangle and (u,v) its barycentric
// coordinates: P = (1-u-v) A + u B + v C. One function, evaluateSurface(), gives the attributes of such an
// address to both renderers.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "scene_cache/format.h"
#include "shm/pager.h"

namespace fr::cache {

/// Hash of the sizes and member offsets of every record in format.h: two builds that disagree refuse each
/// other.
uint64_t layoutFingerprint();
/// What SkeletonHeader::checksum holds in a file: XXH3-64 of everything after the header.
uint64_t skeletonChecksum(std::span<const std::byte> skeleton);

/// A validated, read-only skeleton. Cheap to copy; does not own the bytes. All spans have been checked once,
/// by open(); indices found inside records (AttributeId, ShaderId, ...) are in range or kNone. Thread-safe.
class Skeleton {
 public:
  Skeleton() = default;
  /// Checks everything: magic, version, layout, sizes, every range and index, and the checksum when
  /// `verifyChecksum`.
  static Result<Skeleton> open(std::span<const std::byte> bytes, bool verifyChecksum);

  const SkeletonHeader& header() const { return *header_; }
  std::span<const std::byte> bytes() const { return bytes_; }
  std::span<const ParamRecord> params(Slice s) const;
  std::span<const TransformRecord> transforms() const;
  std::span<const ShaderRecord> shaders() const;
  std::span<const ShaderId> lightList(Slice s) const;
  std::span<const NamedSpaceRecord> namedSpaces() const;
  std::span<const AttributeRecord> attributes() const;
  std::span<const ObjectRecord> objects() const;
  std::span<const RootPatchRecord> rootPatches() const;
  std::span<const EdgeRecord> edges() const;
  std::span<const DisplayRecord> displays(Slice s) const;
  const CameraRecord& camera() const;
  const OptionsRecord& options() const;
  /// Five ":"-separated lists: shader, texture, archive, procedural, display. May be empty.
  std::span<const StringId> searchPaths() const;
  std::span<const SolidRecord> solids() const;
  std::string_view string(StringId id) const;
  std::span<const float> floats(const ParamRecord& p) const;  // empty for other types
  std::span<const int32_t> integers(const ParamRecord& p) const;
  std::span<const StringId> strings(const ParamRecord& p) const;
  /// A named param in a slice (Option or Attribute "category:name", shader parameter), or nullptr.
  const ParamRecord* find(Slice s, std::string_view name) const;
  /// Matrix of `transform` at `time` (keys interpolated, clamped outside).
  DMat4 toWorld(TransformId transform, float time) const;
  /// Space -> cache space: toWorld, then minus the cache origin, in double.
  DMat4 toCache(TransformId transform, float time) const;
  DMat4 worldToCamera(float time) const;
  DMat4 cacheToCamera(float time) const;
  /// The space of the prototype's vertices -> cache space, of an object that has a prototype.
  DMat4 placement(const ObjectRecord& object) const;

 private:
  std::span<const std::byte> bytes_;
  const SkeletonHeader* header_ = nullptr;
};

/// Called while a grid is diced, before it is published. Implemented by shading/.
/// Thread-safe. Must not dice, wait or trace: nobody waits for anything while holding a claim.
class Displacer {
 public:
  virtual ~Displacer() = default;
  /// True when the object's displacement shader exists and can move points.
  virtual bool displaces(ObjectId object) const = 0;
  /// Moves n points of `node`. P and N: three arrays of n floats each, cache space, in and out. (u, v, cell)
  /// as in evaluateSurface. gridNu, gridNv: cells when the points are a grid in row order, 0 otherwise.
  virtual void displace(NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                        int gridNu, int gridNv, float* const P[3], float* const N[3]) = 0;
};

/// Where to put the attributes of n surface points: structure of arrays, each n floats; nullptr = not wanted.
struct SurfaceOut {
  float* P[3] = {};
  float* N[3] = {};   // unit shading normal: "N" primitive variable where given, else the surface's; oriented
  float* Ng[3] = {};  // unit geometric normal, oriented as N is
  float* dPdu[3] = {};  // per unit of the shader's u (root patch parameter)
  float* dPdv[3] = {};
};

/// What a node is once it was needed.
struct ResolvedNode {
  NodeState state =
      NodeState::kEmpty;  // kGrid or kSplit; kEmpty: could not be made (reported), treat as absent
  NodeId children[2] = {kNone, kNone};  // kSplit
  const GridRecord* grid = nullptr;     // kGrid; checked against the arena's bounds
};

/// Pointers into a checked grid.
struct GridView {
  const GridRecord* record = nullptr;
  const float* positions = nullptr;   // key 0, xyz interleaved, row stride record->rowStride * 3 floats; see
                                      // placement
  const uint32_t* normals = nullptr;  // packed (packed_normal.h), dense; nullptr: evaluate them
  const uint8_t* indices = nullptr;   // meshlet triangles
  /// Takes the positions to cache space, three rows of four; nullptr: they are there.
  const float* placement = nullptr;
  Vec3 placed(const float* p) const {
    if (!placement) return {p[0], p[1], p[2]};
    const float* m = placement;
    return {m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3], m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7],
            m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]};
  }
  /// Vertex `index` of key 0 in cache space; rows are record->rowStride vertices apart.
  Vec3 vertex(size_t index) const { return placed(positions + 3 * index); }
  /// Points that are shaded.
  size_t vertexCount() const {
    if (record->flags & kGridSprites) return record->nu / record->rowStride;
    return record->kind == GridKind::kMeshlet ? record->nu : size_t(record->nu + 1) * size_t(record->nv + 1);
  }
};

struct CacheStatistics {  // totals of this process since it opened the cache
  uint64_t gridsDiced = 0, micropolygonsDiced = 0, nodesSplit = 0, claimsTakenOver = 0;
  uint64_t gridsShared = 0;                                   // that show a prototype's
  uint64_t gridsReused = 0;                                   // that came from another cache
  uint64_t arenaBytes = 0, nodeBytes = 0, skeletonBytes = 0;  // of the shared segments
  double dicingSeconds = 0;
};

struct PatchTrim;

class SceneCache {
 public:
  /// Descriptors of the three segments; what one process sends to the other.
  struct Segments {
    int skeleton = -1, nodes = -1, arena = -1;
  };
  ~SceneCache();
  SceneCache(const SceneCache&) = delete;
  SceneCache& operator=(const SceneCache&) = delete;

  /// Makes empty nodes and arena segments beside a finished skeleton (the cache takes its own duplicate).
  /// `scratch`: a folder, for scenes that may be larger than memory; empty: all is memory.
  static Result<std::unique_ptr<SceneCache>> create(int skeletonFd, const std::string& scratch = {});
  /// Maps segments made by another process. readOnly: third-party clients; resolve() then never dices.
  /// `scratch`: what scratch() is to say.
  static Result<std::unique_ptr<SceneCache>> attach(const Segments& fds, bool readOnly,
                                                    const std::string& scratch = {});
  /// The folder for what belongs to this scene and need not stay in memory; empty: it stays there.
  const std::string& scratch() const { return scratch_; }
  /// Opens a .fsc file (validated, checksums included); grids that it lacks are diced on demand into private
  /// arena space. save() writes one: temporary name, then rename.
  static Result<std::unique_ptr<SceneCache>> openFile(const std::string& path,
                                                      const std::string& scratch = {});
  Result<void> save(const std::string& path);
  /// Opens a .fsc file to look at it: nothing is ever diced, and grids are read where they stand in the file,
  /// so it may be larger than memory. Checked: the checksums of skeleton and nodes and what they refer to;
  /// grids only when they are used (peek()). The file must stay as it is while it is open.
  static Result<std::unique_ptr<SceneCache>> openMapped(const std::string& path);
  /// All checksums of a .fsc file.
  static Result<void> verifyFile(const std::string& path);
  /// Drops this process's pages of grids that also stand in a file. References stay good.
  void letGo() const;

  // ---- building a file that may be larger than memory

  /// As create(), but grids go straight to where they will stand in the file `path`, which appears when
  /// finishFile() is done. `scratch`: folder for nodes meanwhile; "": the file's own.
  static Result<std::unique_ptr<SceneCache>> createInFile(int skeletonFd, const std::string& path,
                                                          const std::string& scratch);
  /// What was diced is final: brings it to the disk and lets go of its memory. No other thread may be in
  /// resolve().
  Result<void> settle();
  uint64_t unsettledBytes() const;
  /// Completes the file and gives it its name; the cache cannot be used afterwards. `displacement`: see
  /// FileFooter.
  Result<void> finishFile(uint64_t displacement);
  /// The error, once a grid could not be stored for want of memory or disk.
  Result<void> room() const;

  struct Reuse {
    /// Displacement shaders and all that they read are as they were.
    bool displacements = false;
    /// Make nothing that the old cache does not have.
    bool only = false;
  };
  /// From now on resolve() copies what `old` has, where dicing would make the same: objects are found again
  /// by all that their grids depend on. Before the first resolve().
  void takeGridsFrom(std::shared_ptr<const SceneCache> old, const Reuse& reuse);
  /// FileFooter::displacement of an opened file.
  uint64_t displacement() const;
  Segments segments() const;

  /// False: no ray will meet what is diced from now on, so how far grids deviate from what they stand for is
  /// not measured (GridRecord::deviation stays 0). Nobody may trace or save such grids.
  void setMeetsRays(bool meets);

  const Skeleton& skeleton() const { return skeleton_; }
  void setDisplacer(Displacer* d) { displacer_ = d; }

  /// Dices or splits `node` if nobody has; waits if somebody is at it now. Thread-safe, lock-free once made.
  ResolvedNode resolve(NodeId node);
  /// State without making anything.
  ResolvedNode peek(NodeId node) const;
  const PatchNode& node(NodeId id) const;
  uint32_t nodeCount() const;
  const RootPatchRecord& rootOf(NodeId id) const;
  const ObjectRecord& objectOf(NodeId id) const;
  const AttributeRecord& attributesOf(NodeId id) const;
  GridView view(const GridRecord& grid) const;
  /// Start and size of the arena mapping, for Embree's shared vertex buffers. The address never changes.
  std::span<const std::byte> arena() const;

  /// Parameters of the shaded points of a diced node, in vertex order; sprites: their middles (grids: row by
  /// row, u fastest). For meshlets cell = kNone | u = vertex index is replaced by a representative (triangle,
  /// u, v). Arrays of view.vertexCount() elements.
  void vertexParameters(const GridRecord& grid, uint32_t* cell, float* u, float* v) const;

  /// Undisplaced surface at n addresses of `node`. cell may be nullptr for surface patches.
  void evaluateSurface(NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                       const SurfaceOut& out) const;
  /// Surface as diced (displaced, level 0): P interpolated inside the level-0 grid, N interpolated from
  /// stored normals when there are any, else as evaluateSurface. `node` must be a diced grid.
  void evaluateDiced(NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                     const SurfaceOut& out) const;
  /// Primitive variable `param` (one of the object's primvars) at n addresses. components = floats per
  /// element times array length; out[c] is the array of component c. Points, vectors, normals: still in
  /// object space. Strings and integers: constant or uniform only, see uniformParam(). Returns false when the
  /// type cannot be evaluated.
  bool evaluatePrimvar(NodeId node, const ParamRecord& param, size_t n, const uint32_t* cell, const float* u,
                       const float* v, float* const* out) const;
  /// Shader-visible u, v, s, t at n addresses: u and v of the primitive (PatchMesh: of the whole mesh), s and
  /// t from "st"/"s"/"t" primitive variables, else TextureCoordinates. du, dv: parameter size of one cell
  /// when diced.
  void evaluateParameters(NodeId node, size_t n, const uint32_t* cell, const float* u, const float* v,
                          float* uOut, float* vOut, float* s, float* t) const;

  /// Which parts of a diced node (kGridTrimmed) are cut away, in (u, v) of its root patch:
  /// scene_cache/trim.h.
  PatchTrim trimOf(NodeId node) const;

  CacheStatistics statistics() const;

 private:
  SceneCache();
  Result<void> checkNodes(const std::string& path, bool grids) const;
  struct Impl;
  std::unique_ptr<Impl> impl_;
  Skeleton skeleton_;
  std::string scratch_;
  Displacer* displacer_ = nullptr;
};

}  // namespace fr::cache
