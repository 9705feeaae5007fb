#include "tracer/part_builder.h"

#include <algorithm>
#include <array>
#include <bit>
#include <map>

namespace fr::tracer {

using namespace cache;

namespace {

class PartBuilder {
 public:
  PartBuilder(RTCDevice device, const SceneCache& cache, std::vector<GatheredGrid>& grids,
              uint32_t firstEntry, TracedPart& part, RaySceneStatistics& counts, CellType type)
      : device_(device),
        cache_(cache),
        grids_(grids),
        first_(firstEntry),
        part_(part),
        counts_(counts),
        type_(type) {}

  void build() {
    std::map<ClassKey, std::vector<uint32_t>> classes;
    for (uint32_t i = 0; i < grids_.size(); ++i) classes[grids_[i].key].push_back(i);
    const auto stitches = closeBorders();
    part_.descriptors.reserve(classes.size() + stitches.size());  // Embree keeps pointers into them
    for (const auto& [key, members] : classes)
      if (key.meshlet)
        attachMeshlets(key, members);
      else
        attachGrids(key, members);
    for (const auto& [key, quads] : stitches) attachStitches(key, quads);
    counts_.geometries += classes.size() + stitches.size();
  }

 private:
  void attachMeshlets(const ClassKey& key, const std::vector<uint32_t>& members) {
    auto leaves = std::make_unique<MeshletLeaves>(key.keys, key.keyBytes);
    for (uint32_t m : members) {
      const GatheredGrid& p = grids_[m];
      const SurfaceEntry& e = p.entry;
      leaves->add(first_ + m, reinterpret_cast<const std::byte*>(vertexOf(cache_, p, 0)), e.cellsU,
                  cache_.arena().data() + p.indices, e.cellsV);
      counts_.meshlets += 1;
      counts_.triangles += e.cellsV;
    }
    part_.entryOfPrimitive.emplace_back();
    attachGeometry(leaves->geometry(device_), key);
    part_.leaves.resize(part_.entryOfPrimitive.size());
    part_.leaves.back() = std::move(leaves);
  }

  void attachGrids(const ClassKey& key, const std::vector<uint32_t>& members) {
    std::vector<uint32_t>& buffer = part_.descriptors.emplace_back();
    std::vector<uint32_t>& entryOf = part_.entryOfPrimitive.emplace_back();
    uint64_t vertexEnd = 0;
    for (uint32_t m : members) {
      const GatheredGrid& p = grids_[m];
      const SurfaceEntry& e = p.entry;
      uint32_t first = p.startVertex, cellsU = e.cellsU, cellsV = e.cellsV;
      if (e.stitched) {
        first += e.inner[2] * p.rowStride + e.inner[0];
        cellsU = e.inner[1] - e.inner[0], cellsV = e.inner[3] - e.inner[2];
        if (cellsU == 0) continue;
      }
      const RTCGrid grid{first, p.rowStride, uint16_t(cellsU + 1), uint16_t(cellsV + 1)};
      const auto words = std::bit_cast<std::array<uint32_t, sizeof(RTCGrid) / 4>>(grid);
      buffer.insert(buffer.end(), words.begin(), words.end());
      entryOf.push_back(first_ + m);
      vertexEnd = std::max<uint64_t>(vertexEnd, first + uint64_t(cellsV) * p.rowStride + cellsU + 1u);
      counts_.grids += 1;
      counts_.quads += uint64_t(cellsU) * cellsV;
    }
    addGrids(key, cache_.arena().data() + key.window * kWindow, key.keyBytes, uint64_t(12) << key.level,
             vertexEnd);
  }

  /// Refines borders that no neighbour shows, by the class whose vertices the quadrilaterals share.
  std::map<ClassKey, std::vector<StitchQuad>> closeBorders() {
    std::vector<BorderedGrid> bordered(grids_.size());
    for (size_t i = 0; i < bordered.size(); ++i) {
      const GatheredGrid& p = grids_[i];
      if (p.entry.meshlet || p.entry.strip) continue;
      BorderedGrid& g = bordered[i];
      g.vertices = vertexOf(cache_, p, 0);
      g.rowStride = p.rowStride;
      g.cellsU = uint8_t(p.entry.cellsU), g.cellsV = uint8_t(p.entry.cellsV);
      g.level = uint8_t(p.key.level);
      g.kind = p.key.mask | p.key.keys << 8;
      g.open = p.open;
    }
    std::map<ClassKey, std::vector<StitchQuad>> stitches;
    for (const StitchQuad& t : stitchBorders(bordered)) {
      GatheredGrid& p = grids_[t.grid];
      p.entry.stitched = 1;
      std::copy_n(bordered[t.grid].inner, 4, p.entry.inner);
      stitches[p.key].push_back(t);
    }
    return stitches;
  }

  /// Quadrilaterals as grids of one cell, over copies of their corners.
  void attachStitches(const ClassKey& key, const std::vector<StitchQuad>& quads) {
    std::vector<uint32_t>& entryOf = part_.entryOfPrimitive.emplace_back();
    std::vector<float>& corners = part_.stitchVertices.emplace_back();
    const size_t keyFloats = quads.size() * 12;
    corners.resize(key.keys * keyFloats + 1);  // Embree loads 16 bytes for a vertex of 12
    std::vector<uint32_t>& buffer = part_.descriptors.emplace_back();
    for (size_t q = 0; q < quads.size(); ++q) {
      StitchQuad quad = quads[q];
      const GatheredGrid& p = grids_[quad.grid];
      // The rows of a grid run the same way.
      static constexpr int kOrder[4] = {0, 1, 3, 2};
      for (int c = 0; c < 4; ++c) {
        const int corner = kOrder[c];
        const uint64_t at = uint64_t(quad.j[corner]) * p.rowStride + quad.i[corner];
        for (uint32_t k = 0; k < key.keys; ++k)
          std::copy_n(vertexOf(cache_, p, at) + k * (key.keyBytes / sizeof(float)), 3,
                      &corners[k * keyFloats + q * 12 + size_t(c) * 3]);
      }
      const RTCGrid grid{uint32_t(4 * q), 2, 2, 2};
      const auto words = std::bit_cast<std::array<uint32_t, sizeof(RTCGrid) / 4>>(grid);
      buffer.insert(buffer.end(), words.begin(), words.end());
      quad.grid += first_;
      entryOf.push_back(TracedPart::kStitch | uint32_t(part_.stitches.size()));
      part_.stitches.push_back(quad);
    }
    counts_.stitchQuads += quads.size();
    addGrids(key, reinterpret_cast<const std::byte*>(corners.data()), keyFloats * sizeof(float), 12,
             4 * quads.size());
  }

  /// Hands the newest buffer of descriptors to Embree, over vertices `step` bytes apart.
  void addGrids(const ClassKey& key, const std::byte* vertices, uint64_t keyBytes, uint64_t step,
                uint64_t vertexEnd) {
    if (type_ == CellType::kQuads && key.keys == 1) return addQuads(key, vertices, step, vertexEnd);
    std::vector<uint32_t>& buffer = part_.descriptors.back();
    const size_t primitives = buffer.size() * sizeof(uint32_t) / sizeof(RTCGrid);
    buffer.resize(buffer.size() + 4);  // Embree may load past the last element

    RTCGeometry g = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_GRID);
    rtcSetGeometryTimeStepCount(g, key.keys);
    for (uint32_t k = 0; k < key.keys; ++k)
      rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, k, RTC_FORMAT_FLOAT3, vertices + k * keyBytes, 0,
                                 step, vertexEnd);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_GRID, 0, RTC_FORMAT_GRID, buffer.data(), 0, sizeof(RTCGrid),
                               primitives);
    attachGeometry(g, key);
  }

  /// The same as quadrilaterals. What is split into which triangles, and what (u,v) are in a cell, are the
  /// same.
  void addQuads(const ClassKey& key, const std::byte* vertices, uint64_t step, uint64_t vertexEnd) {
    std::vector<uint32_t>& buffer = part_.descriptors.back();
    std::vector<uint32_t>& entryOf = part_.entryOfPrimitive.back();
    std::vector<uint32_t> corners;
    std::vector<TracedPart::Cell> cells;
    for (size_t g = 0; g < entryOf.size(); ++g) {
      std::array<uint32_t, sizeof(RTCGrid) / 4> words;
      std::copy_n(&buffer[g * words.size()], words.size(), words.begin());
      const auto grid = std::bit_cast<RTCGrid>(words);
      const auto cellsU = uint16_t(grid.width - 1), cellsV = uint16_t(grid.height - 1);
      for (uint16_t j = 0; j < cellsV; ++j)
        for (uint16_t i = 0; i < cellsU; ++i) {
          const uint32_t v = grid.startVertexID + j * grid.stride + i;
          corners.insert(corners.end(), {v, v + 1, v + grid.stride + 1, v + grid.stride});
          cells.push_back({entryOf[g], i, j, cellsU, cellsV});
        }
    }
    buffer = std::move(corners);
    buffer.resize(buffer.size() + 4);  // Embree may load past the last element
    buffer.shrink_to_fit(), cells.shrink_to_fit();
    const size_t geometry = part_.entryOfPrimitive.size();
    part_.cells.resize(geometry);
    part_.cells[geometry - 1] = std::move(cells);
    entryOf.clear();

    RTCGeometry g = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_QUAD);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, vertices, 0, step, vertexEnd);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4, buffer.data(), 0,
                               4 * sizeof(uint32_t), part_.cells[geometry - 1].size());
    attachGeometry(g, key);
  }

  /// Its number in the scene is that of the newest table of entries.
  void attachGeometry(RTCGeometry g, const ClassKey& key) {
    rtcSetGeometryMask(g, key.mask);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(part_.scene, g);
    FR_CHECK(id + 1 == part_.entryOfPrimitive.size());
    rtcReleaseGeometry(g);
  }

  RTCDevice device_;
  const SceneCache& cache_;
  std::vector<GatheredGrid>& grids_;
  uint32_t first_;
  TracedPart& part_;
  RaySceneStatistics& counts_;
  CellType type_;
};

}  // namespace

RTCScene newRayScene(RTCDevice device) {
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, RTCSceneFlags(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
  return scene;
}

void buildPart(RTCDevice device, const SceneCache& cache, std::vector<GatheredGrid>& grids,
               uint32_t firstEntry, TracedPart& part, RaySceneStatistics& counts, CellType type) {
  part.scene = newRayScene(device);
  PartBuilder(device, cache, grids, firstEntry, part, counts, type).build();
}

}  // namespace fr::tracer
