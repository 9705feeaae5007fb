#include "scene_cache/solid_blocks.h"

namespace fr::cache {
namespace {

SolidOperation operationOf(std::string_view name) {
  if (name == "union") return SolidOperation::kUnion;
  if (name == "intersection") return SolidOperation::kIntersection;
  if (name == "difference") return SolidOperation::kDifference;
  return SolidOperation::kPrimitive;
}

}  // namespace

/// Adds the record of a block inside the innermost open one, which is an operation if there is one.
SolidBlocks::Block SolidBlocks::add(SolidOperation operation) {
  Block block{operation, kNone, false, 0};
  SolidRecord record{operation, kNone, 1, 0};
  if (!open_.empty()) {
    Block& parent = open_.back();
    record.parent = parent.id;
    record.isFirst = parent.parts++ == 0;
    block.subtracted =
        parent.subtracted != (parent.operation == SolidOperation::kDifference && !record.isFirst);
  }
  block.id = writer_.addSolid(record);
  if (block.id == kNone) return block;
  subtracted_.resize(size_t(block.id) + 1);
  subtracted_[block.id] = block.subtracted;
  return block;
}

bool SolidBlocks::begin(std::string_view name) {
  const SolidOperation operation = operationOf(name);
  if (open_.empty() && operation == SolidOperation::kPrimitive) {
    open_.emplace_back();
    return true;
  }
  if (!open_.empty() && open_.back().operation == SolidOperation::kPrimitive) {
    open_.push_back(Block(open_.back()));
    return false;
  }
  const Block block = add(operation);
  open_.push_back(block);
  return true;
}

void SolidBlocks::end() {
  if (!open_.empty()) open_.pop_back();
}

SolidId SolidBlocks::leaf() {
  if (open_.empty()) return kNone;
  if (open_.back().operation == SolidOperation::kPrimitive) return open_.back().id;
  return add(SolidOperation::kPrimitive).id;
}

SolidBlocks::Whole::Whole(SolidBlocks& blocks) : blocks_(blocks) {
  opened_ = !blocks.open_.empty() && blocks.open_.back().operation != SolidOperation::kPrimitive;
  if (!opened_) return;
  const Block block = blocks.add(SolidOperation::kPrimitive);
  blocks.open_.push_back(block);
}
SolidBlocks::Whole::~Whole() {
  if (opened_) blocks_.end();
}

}  // namespace fr::cache
