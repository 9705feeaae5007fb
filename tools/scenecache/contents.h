// What stands in a scene cache, in words and numbers.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "scene_cache/cache.h"

namespace fr::tools {

std::string bytesText(uint64_t bytes);
const char* typeName(cache::PrimitiveType type);
/// "identifier:name", where the RIB gave one; else its place, "scene.rib:12".
std::string objectName(const cache::Skeleton& skeleton, cache::ObjectId object);
/// Whether an object's name, or its number as "#12", matches a pattern of the shell.
bool matches(const std::string& pattern, const std::string& name, cache::ObjectId object);

/// What the nodes below some root patches are.
struct Tally {
  uint64_t grids = 0, meshlets = 0, micropolygons = 0, triangles = 0, splits = 0, empty = 0;
  uint64_t shared = 0;                            // grids and meshlets whose vertices are a prototype's
  uint64_t bytes = 0;                             // nodes, records, vertices
  std::array<uint64_t, cache::kLevels> levels{};  // grids by their number of levels
  Tally& operator+=(const Tally& o);
  uint64_t faces() const { return micropolygons + triangles; }
  void add(const cache::ResolvedNode& node);
};

/// Of one object. Never dices.
Tally tallyOf(const cache::SceneCache& cache, cache::ObjectId object);
/// Of all, by object; lets go of a mapped file's pages as it goes.
std::vector<Tally> tallyAll(const cache::SceneCache& cache);

/// Every diced node below a root patch. f(NodeId, const GridRecord&).
template <class F>
void forEachGrid(const cache::SceneCache& c, cache::NodeId root, F&& f) {
  std::vector<cache::NodeId> stack{root};
  while (!stack.empty()) {
    const cache::NodeId id = stack.back();
    stack.pop_back();
    const cache::ResolvedNode n = c.peek(id);
    if (n.state == cache::NodeState::kSplit) {
      stack.push_back(n.children[1]);
      stack.push_back(n.children[0]);
    } else if (n.state == cache::NodeState::kGrid && n.grid) {
      f(id, *n.grid);
    }
  }
}

}  // namespace fr::tools
