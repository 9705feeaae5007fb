#include "scene_cache/meshlet_builder.h"

#include <algorithm>

#include "scene_cache/morton.h"

namespace fr::cache {
Meshlets buildMeshlets(std::vector<MeshTriangle> triangles, std::span<const Vec3> points, bool keepCorners,
                       bool keepFaces) {
  Meshlets m;
  Box3f box;
  uint32_t mostCorner = 0;
  for (const MeshTriangle& t : triangles) {
    for (int i = 0; i < 3; ++i) {
      box.extend(points[t.vertex[size_t(i)]]);
      mostCorner = std::max(mostCorner, t.corner[size_t(i)]);
    }
  }
  std::vector<std::pair<uint64_t, uint32_t>> order(triangles.size());
  for (size_t i = 0; i < triangles.size(); ++i) {
    const auto& v = triangles[i].vertex;
    const Vec3 c = ((points[v[0]] + points[v[1]] + points[v[2]]) * (1.0f / 3));
    order[i] = {mortonCode(c, box), uint32_t(i)};
  }
  std::sort(order.begin(), order.end());  // equal places: by index

  // Which meshlet used a vertex (or a corner) last, and as what.
  const size_t keys = keepCorners ? size_t(mostCorner) + 1 : points.size();
  std::vector<uint32_t> usedBy(keys, kNone);
  std::vector<uint8_t> local(keys);
  m.triangles.reserve(triangles.size() * 3);
  m.vertices.reserve(triangles.size() * 2 / 3);
  if (keepFaces) m.faces.reserve(triangles.size());
  const auto open = [&] { m.records.push_back({m.vertices.size(), m.triangles.size() / 3, 0, 0}); };
  for (const auto& [code, index] : order) {
    const MeshTriangle& t = triangles[index];
    const auto keyOf = [&](size_t i) { return keepCorners ? t.corner[i] : t.vertex[i]; };
    uint32_t fresh = 0;
    if (!m.records.empty()) {
      for (size_t i = 0; i < 3; ++i) fresh += usedBy[keyOf(i)] != m.records.size() - 1;
    }
    if (m.records.empty() || m.records.back().vertexCount + fresh > uint32_t(kMaxMeshletVertices) ||
        m.records.back().triangleCount == uint32_t(kMaxMeshletTriangles))
      open();
    MeshletRecord& r = m.records.back();
    const uint32_t id = uint32_t(m.records.size() - 1);
    for (size_t i = 0; i < 3; ++i) {
      const uint32_t key = keyOf(i);
      if (usedBy[key] != id) {
        usedBy[key] = id;
        local[key] = uint8_t(r.vertexCount++);
        m.vertices.push_back(t.vertex[i]);
        if (keepCorners) m.corners.push_back(t.corner[i]);
      }
      m.triangles.push_back(local[key]);
    }
    if (keepFaces) m.faces.push_back(t.face);
    ++r.triangleCount;
  }
  return m;
}

}  // namespace fr::cache
