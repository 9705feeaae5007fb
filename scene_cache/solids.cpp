#include "scene_cache/solids.h"

namespace fr::cache {
namespace {

Box3f common(const Box3f& a, const Box3f& b) {
  Box3f r;
  r.min = glm::max(a.min, b.min), r.max = glm::min(a.max, b.max);
  return r.empty() ? Box3f() : r;
}

}  // namespace

SolidForest::SolidForest(const Skeleton& skeleton) {
  const auto records = skeleton.solids();
  blocks_.reserve(records.size());
  for (const SolidRecord& r : records) {
    Block b{r.operation, r.isFirst != 0, r.parent, uint32_t(trees_.size()), 0};
    if (r.parent == kNone)
      trees_.emplace_back();
    else
      b.tree = blocks_[r.parent].tree, ++blocks_[r.parent].parts;
    blocks_.push_back(b);
  }
  std::vector<Box3f> bounds(blocks_.size());
  for (const ObjectRecord& o : skeleton.objects())
    if (const SolidId leaf = solidOf(o); leaf != kNone) bounds[leaf].extend(o.bound);
  // Children stand behind their parents. A parent's bound is empty until its first part comes.
  std::vector<bool> met(blocks_.size(), false);
  for (size_t i = blocks_.size(); i-- > 0;) {
    const Block& b = blocks_[i];
    if (b.parent == kNone) {
      trees_[b.tree] = bounds[i];
      continue;
    }
    Box3f& to = bounds[b.parent];
    switch (blocks_[b.parent].operation) {
      case SolidOperation::kPrimitive:
      case SolidOperation::kUnion:
        to.extend(bounds[i]);
        break;
      case SolidOperation::kIntersection:
        to = met[b.parent] ? common(to, bounds[i]) : bounds[i];
        break;
      case SolidOperation::kDifference:
        if (b.isFirst) to = bounds[i];
        break;
    }
    met[b.parent] = true;
  }
}

}  // namespace fr::cache
