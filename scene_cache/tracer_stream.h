// The ray tracer's stream of files, when it has files of its own.
//
// "frankenrender common.rib -bmrt tracer.rib -prman reyes.rib" means two streams, as it did when two programs
// read them: REYES reads common.rib and reyes.rib, the tracer common.rib and tracer.rib, each with a graphics
// state of its own. Both streams are read side by side, world by world; what the tracer's own files add goes
// into the same skeleton.
#pragma once

#include <memory>
#include <span>

#include "scene_cache/scene_builder.h"

namespace fr::cache {

/// Reads the tracer's stream on a thread of its own that runs only while fill() waits for it: the two
/// streams take turns, so that the result does not depend on timing.
class TracerStream : public WorldFiller {
 public:
  /// All inputs; those that the tracer does not see are left out. `standardInput`: what "-" holds. Borrowed.
  TracerStream(std::span<const RibInput> inputs, const LoadOptions& options,
               const ri::StateRenderer::PathLists& standardPaths, const std::string& standardInput);
  /// Reads the rest of the files over.
  ~TracerStream() override;
  TracerStream(const TracerStream&) = delete;
  TracerStream& operator=(const TracerStream&) = delete;

  void fill(SkeletonWriter* writer, FrameCounts* counts) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace fr::cache
