// What ObjectRecord::source holds for each PrimitiveType: one record of the types below. Arrays are absolute
// ranges of the skeleton. Range::count is in elements. Nothing in here has been checked by Skeleton::open():
// use sourceRecord() and sourceArray(), and clamp indices.
#pragma once

#include <cstring>
#include <span>

#include "scene_cache/cache.h"
#include "scene_cache/format.h"

namespace fr::cache {

/// Positions of a primitive at its deformation keys: keyCount runs of perKey points of `components` floats
/// (3, or 4 for "Pw"), object space.
struct SourcePositions {
  Range times;   // float, keyCount, ascending; empty when keyCount is 1
  Range values;  // float
  uint32_t keyCount;
  uint32_t components;
  uint64_t perKey;
};

/// The seven quadrics.
struct QuadricSource {
  Range times;
  Range params;  // double[8] a key, quadric.h
  uint32_t keyCount;
  uint32_t pad;
};

/// Patch and PatchMesh. Geometry values u fastest.
struct PatchMeshSource {
  SourcePositions positions;
  uint32_t nu, nv;  // geometry values
  uint32_t patchesU, patchesV;
  uint32_t stepU, stepV;
  uint32_t wrapU, wrapV;         // 0 or 1
  float basisU[16], basisV[16];  // bicubic
  uint32_t heightField;
  uint32_t separate;  // 1: patches side by side in u that share nothing, each with parameters from 0 to 1
};

/// A large face of a polygon or polygon mesh as a bilinear patch: corners (0,0) (1,0) (0,1) (1,1).
/// Triangles: the last two corners are the same.
struct PolygonPatch {
  uint32_t vertex[4];  // index of the position and of varying and vertex variables
  uint32_t corner[4];  // index of facevarying variables
  uint32_t face;       // index of uniform variables
};
struct PolygonSource {
  SourcePositions positions;
  Range patches;  // PolygonPatch, one a root patch
  float
      undicedEdge;  // micropolygons: edges up to this length stay whole, as in the meshlets of the same mesh
  uint32_t pad;
};

/// A cluster of small faces.
struct MeshletRecord {
  uint64_t firstVertex;    // into vertices and corners
  uint64_t firstTriangle;  // into triangles (times 3) and faces
  uint32_t vertexCount;
  uint32_t triangleCount;
};
struct MeshletSource {
  SourcePositions positions;
  Range meshlets;   // MeshletRecord, one a root patch
  Range vertices;   // uint32: index of the position
  Range corners;    // uint32: index of facevarying variables; empty when there are none
  Range triangles;  // uint8[3]: vertices within the meshlet
  Range faces;      // uint32: face of each triangle, for uniform variables; empty when there are none
};

enum class SubdivisionScheme : uint32_t { kCatmullClark, kLoop, kBilinear };
/// One root patch: a quad of the control mesh, a quarter-like piece of another face, or a triangle (Loop).
struct SubdivisionPatch {
  uint32_t face;
  uint32_t corner;  // piece within the face: its corner (0,0) is this vertex of the face
};
struct SubdivisionSource {
  SourcePositions positions;
  SubdivisionScheme scheme;
  uint32_t interpolateBoundary;             // 0 none, 1 edges and corners, 2 edges only
  uint32_t faceVaryingInterpolateBoundary;  // 0 linear, 1 edges and corners, 2 edges only, 3 always sharp
  uint32_t faceVaryingPropagateCorners;     // 0 or 1
  uint32_t chaikinCreases;                  // 0 or 1
  uint32_t smoothTriangles;                 // 0 or 1
  uint32_t pieces;                          // 1: every quad face is cut in four, as other faces are
  uint32_t pad;
  Range faceSizes;        // uint32
  Range faceVertices;     // uint32
  Range creaseVertices;   // uint32, two an edge
  Range creaseSharpness;  // float
  Range cornerVertices;   // uint32
  Range cornerSharpness;  // float
  Range holes;            // uint32
  Range patches;          // SubdivisionPatch, one a root patch
};

/// A non-empty knot interval of a NuPatch, cut to the patch's range.
struct NurbsSpan {
  double low, high;         // parameter range
  uint32_t segment;         // knot interval, empty ones counted: index of uniform and varying variables
  float segLow, segHigh;    // the part of that interval, 0..1
  float unitLow, unitHigh;  // the part of the patch's range, 0..1: the shader's u
  uint32_t pad;
};
/// A straight piece of a trim loop.
struct TrimEdge {
  float u0, v0, u1, v1;
};
/// NuPatch as rational Bezier patches. Positions and vertex variables: orderU x orderV values a face, u
/// fastest, faces u fastest.
struct NurbsSource {
  SourcePositions positions;
  uint32_t orderU, orderV;  // of the Bezier patches: 4, or what the NuPatch had when that was more
  uint32_t spansU, spansV;
  uint32_t segmentsU, segmentsV;
  Range spanU, spanV;       // NurbsSpan
  Range trimEdges;          // TrimEdge, by band; those that cross several bands stand in each
  Range trimBands;          // uint32, first edge of each band of v and one more; empty: not trimmed
  float trimLow, trimHigh;  // of v
  uint32_t trimOutside;     // 1: what lies outside of the loops is cut away
  uint32_t pad;
};
inline constexpr uint32_t kMaxBezierOrder = 32;

/// Points, sorted in space and cut into clusters.
struct PointCluster {
  uint64_t first;  // into order
  uint32_t count;
  uint32_t sides;  // of the polygons that stand for disks
};
struct PointsSource {
  SourcePositions positions;
  Range widths;    // float, one or one a point; object space
  Range order;     // uint32, index of the point
  Range clusters;  // PointCluster, one a root patch
};

/// One of the curves of a Curves.
struct CurveRecord {
  uint32_t firstVertex;  // into positions and vertex variables
  uint32_t vertexCount;
  uint32_t firstVarying;  // into varying variables
  uint32_t segments;
};
/// A piece of one curve's ribbon: rows [firstRow, firstRow + rows] and columns of its cells.
struct CurvePiece {
  uint32_t curve;
  uint32_t firstRow;  // rows count along the whole curve, `steps` a segment
  uint16_t steps;
  uint16_t rows;
  uint16_t columns;      // cells across, of this piece
  uint16_t firstColumn;  // of allColumns
  uint16_t allColumns;
  uint16_t firstVertex, firstTriangle;  // within the meshlet
  uint16_t pad;
};
struct CurveCluster {
  uint64_t firstPiece;
  uint32_t pieceCount;
  uint16_t vertexCount, triangleCount;
};
struct CurvesSource {
  SourcePositions positions;
  float basis[16];  // of cubic curves
  uint32_t cubic, periodic, step;
  uint32_t pad;
  Range curves;    // CurveRecord
  Range pieces;    // CurvePiece
  Range clusters;  // CurveCluster, one a root patch
};

static_assert(isRecord<NurbsSource> && isRecord<PointsSource> && isRecord<CurvesSource>);
static_assert(isRecord<QuadricSource> && isRecord<PatchMeshSource> && isRecord<PolygonSource> &&
              isRecord<MeshletSource> && isRecord<SubdivisionSource>);

/// The elements of a range, or nothing when it does not lie inside the skeleton or is misaligned.
template <class T>
std::span<const T> sourceArray(const Skeleton& s, const Range& r) {
  const auto bytes = s.bytes();
  if (r.count == 0 || r.offset % alignof(T) != 0 || r.offset > bytes.size() ||
      r.count > (bytes.size() - r.offset) / sizeof(T))
    return {};
  return {reinterpret_cast<const T*>(bytes.data() + r.offset), size_t(r.count)};
}
/// The record of an object's source, or nullptr.
template <class T>
const T* sourceRecord(const Skeleton& s, const ObjectRecord& o) {
  if (o.source.count < sizeof(T)) return nullptr;
  const auto a = sourceArray<T>(s, Range{o.source.offset, 1});
  return a.empty() ? nullptr : a.data();
}

}  // namespace fr::cache
