// Meshlets as Embree sees them: boxes of up to eight neighbouring triangles, which are met by our own kernel
// over the vertices and indices of the cache. Internal to tracer/.
//
// A triangle of its own costs Embree some 65 bytes, and 12 of indices; a box costs 8 a triangle. Triangles
// of a meshlet follow a Morton curve, so those that follow each other are near each other.
#pragma once

#include <embree3/rtcore.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "tracer/leaf_kernel.h"

namespace fr::tracer {

class MeshletLeaves {
 public:
  /// `keyBytes`: between motion keys, of which there are `keys`.
  MeshletLeaves(uint32_t keys, uint64_t keyBytes) : keys_(keys), keyBytes_(keyBytes) {}

  /// One more meshlet; returns the number of its first triangle, the others follow. Vertices, 12 bytes apart,
  /// and indices stay where they are, in memory that others may write to.
  uint32_t add(uint32_t entry, const std::byte* vertices, uint32_t vertexCount, const std::byte* indices,
               uint32_t triangleCount);
  uint32_t triangleCount() const { return uint32_t(meshletOfLeaf_.size()) * kLeafTriangles; }
  uint32_t entryOf(uint32_t triangle) const {
    return meshlets_[meshletOfLeaf_[triangle / kLeafTriangles]].entry;
  }
  /// A geometry over all of them, which must stay where they are. Its hits go to the filter function of the
  /// query's context with primID the number of the triangle.
  RTCGeometry geometry(RTCDevice device);
  uint64_t bytes() const {
    return meshlets_.capacity() * sizeof(Meshlet) + meshletOfLeaf_.capacity() * sizeof(uint32_t);
  }

 private:
  struct Meshlet {
    const std::byte *vertices, *indices;
    uint32_t entry, firstLeaf;
    uint16_t vertexCount, triangleCount;
  };
  static void bounds(const RTCBoundsFunctionArguments* a);
  static void intersect(const RTCIntersectFunctionNArguments* a);
  static void occluded(const RTCOccludedFunctionNArguments* a);
  /// The triangles of a leaf between motion keys `key` and the next.
  LeafTriangles leaf(uint32_t number, uint32_t key) const;
  LeafTriangles leafAt(uint32_t number, float time) const;
  /// Offers the ray's hits with a leaf to the context's filter: each becomes the far end of the ray, unless
  /// it is refused. True: one was taken. `any`: one is enough.
  bool meet(RTCIntersectContext* context, RTCRay& ray, uint32_t number, uint32_t geometryId, bool any) const;

  std::vector<Meshlet> meshlets_;
  std::vector<uint32_t> meshletOfLeaf_;
  uint32_t keys_;
  uint64_t keyBytes_;
  MeetLeaf kernel_ = leafKernel();
};

}  // namespace fr::tracer
