// Clusters of small triangles.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/math.h"
#include "scene_cache/primitive_source.h"

namespace fr::cache {

struct MeshTriangle {
  std::array<uint32_t, 3> vertex;  // index of the position
  std::array<uint32_t, 3> corner;  // index of facevarying values, already merged where values are equal
  uint32_t face;
};

struct Meshlets {
  std::vector<MeshletRecord> records;
  std::vector<uint32_t> vertices, corners, faces;
  std::vector<uint8_t> triangles;
};

/// Sorts the triangles along a Morton curve of their centres and cuts the sequence into meshlets of at most
/// kMaxMeshletVertices vertices and kMaxMeshletTriangles triangles. A vertex is shared within a meshlet when
/// position and corner are the same. `points`: cache space; keepCorners, keepFaces: whether the result needs
/// those arrays.
Meshlets buildMeshlets(std::vector<MeshTriangle> triangles, std::span<const Vec3> points, bool keepCorners,
                       bool keepFaces);

}  // namespace fr::cache
