// Solids on a tile: from all crossings of a tree of solids with the lines of sight to the surfaces that show.
//
// Nothing that bounds a solid hides anything until the whole tree has been drawn. What then shows of it is
// treated as any other surface: opaque parts go into the depth buffer, others become fragments.
#pragma once

#include <algorithm>
#include <vector>

#include "reyes/frame_scene.h"
#include "reyes/raster_kernel.h"
#include "reyes/sample_buffer.h"
#include "scene_cache/solids.h"

namespace fr::reyes {

struct TileView;

/// One per thread.
class TileSolids {
 public:
  explicit TileSolids(const cache::SolidForest& forest) : state_(forest, inside_) {}
  TileSolids(const TileSolids&) = delete;
  TileSolids& operator=(const TileSolids&) = delete;

  /// Starts a tile: no roots.
  void begin();
  /// A root patch of a tree may cover the tile.
  void addRoot(uint32_t tree, cache::NodeId node) { roots_.push_back({tree, node}); }
  /// Calls f(tree) once for each tree that has roots.
  template <class F>
  void forTrees(F&& f) {
    std::stable_sort(roots_.begin(), roots_.end(),
                     [](const Root& a, const Root& b) { return a.tree < b.tree; });
    for (size_t i = 0; i < roots_.size(); ++i)
      if (i == 0 || roots_[i - 1].tree != roots_[i].tree) f(roots_[i].tree);
  }
  /// Calls f(node) for the roots of a tree; after forTrees().
  template <class F>
  void forRoots(uint32_t tree, F&& f) const {
    const auto first = std::lower_bound(roots_.begin(), roots_.end(), tree,
                                        [](const Root& r, uint32_t t) { return r.tree < t; });
    for (auto r = first; r != roots_.end() && r->tree == tree; ++r) f(r->node);
  }

  /// Where the crossings of the tree that is being drawn are gathered, and the depth that limits them: none,
  /// for what lies behind the far plane counts too.
  std::vector<Fragment>& crossings() { return crossings_; }
  float* unlimited(size_t samples);
  /// Puts the surfaces of the tree into the view, and forgets its crossings. True: opaque ones among them.
  bool resolve(TileView& view);
  uint64_t crossingsResolved() const { return resolved_; }

 private:
  struct Root {
    uint32_t tree;
    cache::NodeId node;
  };
  std::vector<uint32_t> inside_;
  cache::SolidState state_;
  std::vector<Root> roots_;
  std::vector<Fragment> crossings_;
  std::vector<float> unlimited_;
  std::vector<uint32_t> first_;  // by sample
  std::vector<cache::SolidCrossing> line_;
  uint64_t resolved_ = 0;
};

}  // namespace fr::reyes
