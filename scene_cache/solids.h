// Solids of constructive geometry (SolidBegin) as both hiders resolve them: along a line.
//
// A hider collects where a line crosses the surfaces that bound the leaves of a tree, all the way to
// infinity, where nothing is inside anything: so it is known which leaves the line starts in, wherever that
// is (Roth, "Ray casting for modeling solids", 1982, does the same from the eye's side). Each crossing
// changes whether the line is inside its leaf, whatever the surface's orientation. Surfaces where the value
// of the whole tree changes are surfaces of the solid; the others do not exist.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "scene_cache/cache.h"

namespace fr::cache {

/// The trees of a skeleton. Immutable once made; thread-safe.
class SolidForest {
 public:
  SolidForest() = default;
  explicit SolidForest(const Skeleton& skeleton);

  bool empty() const { return trees_.empty(); }
  size_t treeCount() const { return trees_.size(); }
  uint32_t treeOf(SolidId solid) const { return blocks_[solid].tree; }
  /// Where the surface of the whole tree can be; cache space. Empty where parts that intersect do not meet.
  const Box3f& bound(uint32_t tree) const { return trees_[tree]; }

 private:
  friend class SolidState;
  struct Block {
    SolidOperation operation;
    bool isFirst;
    SolidId parent;
    uint32_t tree;
    uint32_t parts;
  };
  std::vector<Block> blocks_;  // by SolidId
  std::vector<Box3f> trees_;
};

/// Which leaves a point lies in, and what follows for the blocks around them. Starts outside of everything.
/// Not thread-safe.
class SolidState {
 public:
  /// `memory`: zeros, as it leaves them when it is outside of everything again; grows as needed.
  SolidState(const SolidForest& forest, std::vector<uint32_t>& memory)
      : blocks_(forest.blocks_), inside_(memory) {
    if (memory.size() < blocks_.size()) memory.resize(blocks_.size(), 0);
  }
  /// Enters or leaves a leaf. True when the value of its tree changes. Costs a step for each block around the
  /// leaf whose value changes.
  bool toggle(SolidId leaf) {
    inside_[leaf] ^= 1;
    bool entered = inside_[leaf] != 0;
    for (SolidId block = leaf; blocks_[block].parent != kNone;) {
      const SolidId parent = blocks_[block].parent;
      const bool before = holds(parent);
      if (blocks_[parent].operation != SolidOperation::kDifference)
        inside_[parent] += entered ? 1u : ~0u;
      else if (blocks_[block].isFirst)
        inside_[parent] ^= 1u;
      else
        inside_[parent] += entered ? 2u : ~1u;
      entered = holds(parent);
      if (entered == before) return false;
      block = parent;
    }
    return true;
  }

 private:
  bool holds(SolidId block) const {
    const SolidForest::Block& b = blocks_[block];
    switch (b.operation) {
      case SolidOperation::kPrimitive:
      case SolidOperation::kUnion:
        return inside_[block] != 0;
      case SolidOperation::kIntersection:
        return inside_[block] == b.parts && b.parts != 0;
      case SolidOperation::kDifference:
        return inside_[block] == 1;
    }
    return false;
  }

  const std::vector<SolidForest::Block>& blocks_;
  // Leaves: 0 or 1. Unions and intersections: parts that the point is inside of. Differences: twice that
  // number of the subtracted parts, plus 1 inside the first.
  std::vector<uint32_t>& inside_;
};

/// Where a line crosses a surface that bounds a leaf.
struct SolidCrossing {
  float distance;  // anything that grows along the line
  SolidId leaf;
  uint64_t rank;  // of surfaces in the same place: the lower one counts first
  uint32_t item;  // for the caller; also breaks ties of rank
};

/// Two crossings are in the same place when their distances differ by less than this part of them: surfaces
/// of several leaves that were modelled to coincide do so up to rounding.
inline constexpr float kSamePlace = 0x1p-18f;

/// Calls surface(const SolidCrossing&) for each crossing of the line that is a surface of the tree, in order,
/// until it returns false. `line`: all crossings of one tree, to infinity; sorted here. `state` must be
/// outside of everything, and is again afterwards. Two distances are in one place when they differ by less
/// than relative * |distance| + absolute.
template <class F>
void forEachSurface(std::span<SolidCrossing> line, SolidState& state, float relative, float absolute,
                    F&& surface) {
  const auto before = [](const SolidCrossing& a, const SolidCrossing& b) {
    return a.rank != b.rank ? a.rank < b.rank : a.item < b.item;
  };
  std::sort(line.begin(), line.end(), [&](const SolidCrossing& a, const SolidCrossing& b) {
    return a.distance != b.distance ? a.distance < b.distance : before(a, b);
  });
  // An odd number of crossings: the line starts inside that leaf. Nearly always there is none such, which the
  // crossings of each leaf tell, counted modulo 2 in one number as long as leaves have numbers close
  // together.
  uint64_t odd = 0;
  SolidId lowest = kNone, highest = 0;
  for (const SolidCrossing& c : line) {
    lowest = std::min(lowest, c.leaf), highest = std::max(highest, c.leaf);
    odd ^= uint64_t(1) << (c.leaf & 63);
  }
  if (odd != 0 || (!line.empty() && highest - lowest >= 64))
    for (const SolidCrossing& c : line) (void)state.toggle(c.leaf);
  bool goOn = true;
  for (size_t first = 0, end; first < line.size(); first = end) {
    const float reach = line[first].distance + relative * std::abs(line[first].distance) + absolute;
    // Surfaces of several leaves in one place are crossed at once. The two sides of a leaf, however close,
    // are not: thin things exist.
    const auto isNew = [&](size_t i) {
      for (size_t k = first; k < i; ++k)
        if (line[k].leaf == line[i].leaf) return false;
      return true;
    };
    for (end = first + 1; end < line.size() && line[end].distance <= reach && isNew(end);) ++end;
    std::sort(line.begin() + ptrdiff_t(first), line.begin() + ptrdiff_t(end), before);
    const SolidCrossing* changed = nullptr;
    size_t changes = 0;
    for (size_t i = first; i < end; ++i)
      if (state.toggle(line[i].leaf)) changed = &line[i], ++changes;
    if (goOn && changes % 2 != 0) goOn = surface(*changed);
  }
}

}  // namespace fr::cache
