// Subdivision surfaces: limit evaluation through OpenSubdiv (Far), refined lazily, once per object and
// process.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "base/math.h"
#include "scene_cache/cache.h"
#include "scene_cache/primitive_source.h"

namespace fr::cache {

/// A face-varying variable's values: how many different ones, and which one each corner of the mesh has.
struct FaceVaryingChannel {
  uint32_t values = 0;
  std::span<const uint32_t> valueOfCorner;
};

/// Control mesh as plain arrays, checked by whoever fills it (indices in range, counts consistent).
struct SubdivisionMeshData {
  SubdivisionScheme scheme = SubdivisionScheme::kCatmullClark;
  uint32_t interpolateBoundary = 0;             // as in SubdivisionSource
  uint32_t faceVaryingInterpolateBoundary = 0;  // of all channels
  bool faceVaryingPropagateCorners = false, chaikinCreases = false, smoothTriangles = false;
  uint32_t vertexCount = 0;
  uint32_t pieces = 0;  // as SubdivisionSource::pieces
  std::span<const uint32_t> faceSizes, faceVertices;
  std::span<const uint32_t> creaseVertices, cornerVertices, holes;
  std::span<const float> creaseSharpness, cornerSharpness;
  std::span<const FaceVaryingChannel> channels;
};

/// A control mesh's topology, ready to make limit patches of single faces. Thread-safe.
class SubdivisionTopology {
 public:
  /// nullptr when OpenSubdiv refuses the mesh.
  static std::shared_ptr<SubdivisionTopology> create(const SubdivisionMeshData& mesh);
  ~SubdivisionTopology();
  /// False for holes and for boundary faces of meshes without "interpolateboundary".
  bool hasLimit(uint32_t face) const;

  struct Impl;
  std::unique_ptr<Impl> impl;

 private:
  SubdivisionTopology();
};

/// A control mesh in cache space at one time, or another one, transformed (an instance of a prototype).
/// Thread-safe. Parameters are those of the root patch (SubdivisionPatch).
class SubdivisionSurface {
 public:
  Vec3 point(uint32_t patch, float u, float v) const;
  Vec3 derivatives(uint32_t patch, float u, float v, Vec3& du, Vec3& dv) const;
  bool hasPatch(uint32_t patch) const { return patch < patches.size(); }
  /// Bezier points of a patch that is a bicubic polynomial, u fastest, before `toCache`: of a quadrilateral
  /// all of whose vertices are smooth, inside and in four quadrilaterals (most of the faces of most meshes).
  /// False for all others.
  bool bezier(uint32_t patch, double (&points)[48], DMat4* toCache) const;

  uint64_t id = 0;  // unique in the process
  std::shared_ptr<const SubdivisionTopology> topology;
  std::vector<float> points;  // xyz of the control vertices
  std::span<const SubdivisionPatch> patches;
  const SubdivisionSurface* base = nullptr;
  DMat4 placement{1};  // of base
};

/// The process's control meshes, made when first needed. Thread-safe.
class SubdivisionStore {
 public:
  explicit SubdivisionStore(const Skeleton& skeleton);
  ~SubdivisionStore();
  /// Surface of an object at `time`, or nullptr when its source is damaged. Stays valid as long as the store.
  const SubdivisionSurface* surface(ObjectId object, float time);
  /// A varying, vertex, facevarying or uniform variable, rows of `width` floats, at n points of a root patch.
  bool evaluate(ObjectId object, uint32_t patch, const ParamRecord& param, std::span<const float> values,
                uint32_t width, size_t n, const float* u, const float* v, float* const* out);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace fr::cache
