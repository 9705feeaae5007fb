// The world that a SceneBuilder is building. Internal to scene_builder*.cpp.
#pragma once

#include <chrono>

#include "scene_cache/scene_builder.h"
#include "scene_cache/solid_blocks.h"

namespace fr::cache {

/// Where primitives go: into a skeleton of this builder's own, or of the image's stream.
struct SceneBuilder::World {
  World(SkeletonWriter& w, FrameCounts& c, const ri::GraphicsState& state, bool cameraMirrored,
        const LoadOptions& options)
      : writer(w), counts(c), records(w, state, cameraMirrored, options.overrides.shadingRate), solids(w) {}
  SkeletonWriter& writer;
  FrameCounts& counts;
  AttributeRecords records;
  SolidBlocks solids;
};
/// A world that becomes a frame here.
struct SceneBuilder::OwnWorld {
  explicit OwnWorld(SkeletonWriter w) : writer(std::move(w)) {}
  SkeletonWriter writer;
  FrameCounts counts;
  int number = 0;
  std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();
};

}  // namespace fr::cache
