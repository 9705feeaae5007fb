// Up to eight neighbouring triangles of a meshlet against a ray: the leaf of the trees over meshlets.
//
// Vertices are projected along the ray to a plane, each for itself and always in the same way, and what a ray
// meets is decided there without rounding errors (Woop, Benthin, Wald, "Watertight Ray/Triangle
// Intersection", JCGT 2(1), 2013). So a ray that is aimed at an edge or a vertex of a closed mesh meets at
// least one of the triangles around it, whichever leaves they are in. The same bits on every instruction set.
#pragma once

#include <cstdint>

namespace fr::tracer {

inline constexpr uint32_t kLeafTriangles = 8;

struct LeafRay {
  float origin[3], direction[3];
  float near, far;  // hits are beyond the one, and not beyond the other
};

struct LeafTriangles {
  const float* vertices;         // 12 bytes apart; 16 are read
  const float* later = nullptr;  // of the next motion key; nullptr: nothing moves
  float part = 0;                // between the two
  uint32_t vertexCount = 0;
  const uint8_t* indices;  // three a triangle; those that name no vertex are read as the first vertex
  uint32_t count;          // 1..kLeafTriangles
};

struct LeafHits {
  uint32_t mask;  // of the triangles that are met; the rest is of those alone
  alignas(32) float distance[kLeafTriangles];
  alignas(32) float u[kLeafTriangles], v[kLeafTriangles];  // weights of the second and third corner
  alignas(32) float normal[3][kLeafTriangles];             // (second - first) x (third - first)
};

using MeetLeaf = void (*)(const LeafRay& ray, const LeafTriangles& triangles, LeafHits& hits);
/// For this machine.
MeetLeaf leafKernel();

namespace sse4 {
void meetLeaf(const LeafRay& ray, const LeafTriangles& triangles, LeafHits& hits);
}
namespace avx2 {
void meetLeaf(const LeafRay& ray, const LeafTriangles& triangles, LeafHits& hits);
}
namespace avx512 {
void meetLeaf(const LeafRay& ray, const LeafTriangles& triangles, LeafHits& hits);
}

}  // namespace fr::tracer
