// The SolidBegin blocks that are open while a world is built, and their records.
//
// RISpec 3.2, "Solids": "primitive" blocks hold the surfaces that bound a solid, the other operations hold
// blocks. A primitive (or an object instance) that stands right inside an operation is taken as a solid of
// its own. A "primitive" block that nothing encloses changes no picture, and makes no record.
#pragma once

#include <string_view>
#include <vector>

#include "scene_cache/skeleton_writer.h"

namespace fr::cache {

/// Of one world. Not thread-safe.
class SolidBlocks {
 public:
  explicit SolidBlocks(SkeletonWriter& writer) : writer_(writer) {}

  /// False when a "primitive" block is open: the new block's surfaces then count as those of the open one.
  bool begin(std::string_view operation);
  void end();
  bool open() const { return !open_.empty(); }
  /// The leaf that a primitive placed now bounds; kNone: an ordinary surface.
  SolidId leaf();
  /// Of a leaf: it lies in an odd number of subtractions.
  bool isSubtracted(SolidId leaf) const { return subtracted_[leaf]; }

  /// While it lives, everything that is placed right inside an operation bounds one solid.
  class Whole {
   public:
    explicit Whole(SolidBlocks& blocks);
    ~Whole();
    Whole(const Whole&) = delete;
    Whole& operator=(const Whole&) = delete;

   private:
    SolidBlocks& blocks_;
    bool opened_;
  };

 private:
  struct Block {
    SolidOperation operation = SolidOperation::kPrimitive;
    SolidId id = kNone;
    bool subtracted = false;
    uint32_t parts = 0;
  };
  Block add(SolidOperation operation);

  SkeletonWriter& writer_;
  std::vector<Block> open_;
  std::vector<bool> subtracted_;  // by SolidId
};

}  // namespace fr::cache
