// Another cache whose grids can be taken instead of dicing them again: the last frame's, say.
#pragma once

#include <memory>
#include <vector>

#include "scene_cache/cache.h"
#include "scene_cache/dice_metric.h"

namespace fr::cache {

/// Objects are paired by content (object_content.h), so it does not matter where they stand. Thread-safe once
/// made.
class GridSource {
 public:
  GridSource(std::shared_ptr<const SceneCache> old, const SceneCache& now, const SceneCache::Reuse& reuse);

  const SceneCache& old() const { return *old_; }
  const SceneCache::Reuse& reuse() const { return reuse_; }
  /// The old node of the same rectangle of the same patch, or kNone.
  NodeId nodeFor(const PatchNode& node) const;
  /// Rates are the same, so splits and grids are.
  bool sameEye() const { return sameEye_; }
  /// Current space is the same, which displacement shaders compute in.
  bool sameCamera() const { return sameCamera_; }

 private:
  std::shared_ptr<const SceneCache> old_;
  SceneCache::Reuse reuse_;
  bool sameEye_ = false, sameCamera_ = false;
  std::vector<NodeId> roots_;  // of the old cache, by root patch of the new one
};

}  // namespace fr::cache
