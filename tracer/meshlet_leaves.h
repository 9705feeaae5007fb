// Meshlets as Embree sees them: boxes of up to eight neighbouring triangles, which are met by our own kernel
// over the vertices and indices of the cache. Internal to tracer/.
//
// A triangle of its own costs Embree some 65 bytes, and 12 of indices; boxes cost 12 a triangle. Triangles of
// a meshlet follow a Morton curve, so most of those that follow each other are near each other.
#pragma once

#include <embree3/rtcore.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/math.h"
#include "tracer/leaf_kernel.h"

namespace fr::tracer {

class MeshletLeaves {
 public:
  /// `keyBytes`: between motion keys, of which there are `keys`.
  MeshletLeaves(uint32_t keys, uint64_t keyBytes) : keys_(keys), keyBytes_(keyBytes) {}

  /// One more meshlet. Vertices, 12 bytes apart, and indices stay where they are, in memory that others may
  /// write to.
  void add(uint32_t entry, const std::byte* vertices, uint32_t vertexCount, const std::byte* indices,
           uint32_t triangleCount);
  /// A geometry over all of them, which must stay where they are. Its hits go to the filter function of the
  /// query's context, with a primID that tells the entry, and the triangle of the meshlet.
  RTCGeometry geometry(RTCDevice device);
  uint32_t entryOf(uint32_t primID) const {
    return meshlets_[leaves_[primID / kLeafTriangles].meshlet].entry;
  }
  uint32_t triangleOf(uint32_t primID) const {
    return leaves_[primID / kLeafTriangles].first + primID % kLeafTriangles;
  }
  uint64_t bytes() const {
    return meshlets_.capacity() * sizeof(Meshlet) + leaves_.capacity() * sizeof(Leaf);
  }

 private:
  struct Meshlet {
    const std::byte *vertices, *indices;
    uint32_t entry;
    uint32_t vertexCount;
  };
  struct Leaf {
    uint32_t meshlet;
    uint16_t first;  // triangle of the meshlet
    uint16_t count;
  };
  static Box3f boundOf(const LeafTriangles& triangles, uint32_t triangle);
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
  std::vector<Leaf> leaves_;
  std::vector<Box3f> bounds_;  // while adding
  std::vector<double> costs_;
  std::vector<uint16_t> lasts_;
  uint32_t keys_;
  uint64_t keyBytes_;
  MeetLeaf kernel_ = leafKernel();
};

}  // namespace fr::tracer
