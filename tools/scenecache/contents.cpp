#include "tools/scenecache/contents.h"

#include <fmt/format.h>
#include <fnmatch.h>

namespace fr::tools {
using namespace cache;

std::string bytesText(uint64_t n) {
  if (n < 10'000) return fmt::format("{} B", n);
  if (n < 10'000'000) return fmt::format("{:.1f} kB", double(n) / 1e3);
  if (n < 10'000'000'000) return fmt::format("{:.1f} MB", double(n) / 1e6);
  return fmt::format("{:.1f} GB", double(n) / 1e9);
}

const char* typeName(PrimitiveType type) {
  static constexpr std::array<const char*, 14> kNames = {
      "sphere",   "cone",  "cylinder",         "hyperboloid",     "paraboloid",
      "disk",     "torus", "bilinear patches", "bicubic patches", "subdivision",
      "meshlets", "nurbs", "points",           "curves"};
  return size_t(type) < kNames.size() ? kNames[size_t(type)] : "unknown";
}

std::string objectName(const Skeleton& s, ObjectId id) {
  const ObjectRecord& o = s.objects()[id];
  const std::string_view name = s.string(s.attributes()[o.attributes].name);
  if (!name.empty()) return std::string(name);
  return fmt::format("{}:{}", s.string(o.locationFile), o.locationLine);
}

bool matches(const std::string& pattern, const std::string& name, ObjectId object) {
  return fnmatch(pattern.c_str(), name.c_str(), 0) == 0 || pattern == fmt::format("#{}", object);
}

Tally& Tally::operator+=(const Tally& o) {
  grids += o.grids, meshlets += o.meshlets, micropolygons += o.micropolygons, triangles += o.triangles;
  splits += o.splits, empty += o.empty, shared += o.shared, bytes += o.bytes;
  for (size_t i = 0; i < levels.size(); ++i) levels[i] += o.levels[i];
  return *this;
}

void Tally::add(const ResolvedNode& n) {
  bytes += sizeof(PatchNode);
  if (n.state == NodeState::kSplit) {
    ++splits;
  } else if (n.state != NodeState::kGrid || !n.grid) {
    ++empty;
  } else {
    const GridRecord& g = *n.grid;
    const bool isMeshlet = g.kind == GridKind::kMeshlet;
    const uint64_t vertices = isMeshlet ? g.nu : uint64_t(g.nu + 1u) * (g.nv + 1u);
    if (isMeshlet) {
      ++meshlets, triangles += g.nv;
    } else {
      ++grids, micropolygons += uint64_t(g.nu) * g.nv;
      ++levels[std::min<size_t>(g.levels, kLevels) - 1];
    }
    bytes += sizeof(GridRecord);
    if (g.placement) {
      ++shared, bytes += 12 * sizeof(float);
    } else {
      const uint64_t points = isMeshlet ? vertices : uint64_t(g.rowStride) * g.nv + g.nu + 1u;
      bytes += g.keyCount * points * 12 + (g.normals ? vertices * sizeof(uint32_t) : 0) +
               (isMeshlet ? g.nv * 3u : 0u);
    }
  }
}

Tally tallyOf(const SceneCache& c, ObjectId object) {
  const ObjectRecord& o = c.skeleton().objects()[object];
  Tally t;
  std::vector<NodeId> stack;
  for (uint32_t i = 0; i < o.patchCount; ++i) {
    stack.push_back(o.firstPatch + i);
    while (!stack.empty()) {
      const ResolvedNode n = c.peek(stack.back());
      stack.pop_back();
      t.add(n);
      if (n.state == NodeState::kSplit) stack.insert(stack.end(), {n.children[1], n.children[0]});
    }
  }
  return t;
}

std::vector<Tally> tallyAll(const SceneCache& c) {
  constexpr uint64_t kBytesHeld = uint64_t(64) << 20;
  std::vector<Tally> all;
  uint64_t held = 0;
  for (ObjectId i = 0; i < c.skeleton().objects().size(); ++i) {
    all.push_back(tallyOf(c, i));
    if ((held += all.back().bytes) < kBytesHeld) continue;
    c.letGo();
    held = 0;
  }
  return all;
}

}  // namespace fr::tools
