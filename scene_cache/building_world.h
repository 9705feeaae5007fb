// The world that a SceneBuilder is building. Internal to scene_builder*.cpp.
#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <tuple>
#include <vector>

#include "scene_cache/dice_metric.h"
#include "scene_cache/scene_builder.h"
#include "scene_cache/solid_blocks.h"

namespace fr::cache {

/// What is known of a retained object once one instance of it stands in the world.
struct SceneBuilder::Retained {
  ri::MovingPrimitivePtr first;  ///< of its shapes: tells it from a later object at the same address
  Box3d bound;                   ///< object space, roughly
  uint64_t faces = 0;
  struct Part {
    ObjectId prototype;
    size_t shape;
  };
  using Key = std::tuple<float, float, bool>;  // rate, flatness, sense of trim curves
  std::map<Key, std::vector<Part>> prototypes;
};

/// Where primitives go: into a skeleton of this builder's own, or of the image's stream.
struct SceneBuilder::World {
  World(SkeletonWriter& w, FrameCounts& c, const ri::GraphicsState& state, bool cameraMirrored,
        const LoadOptions& options)
      : writer(w),
        counts(c),
        records(w, state, cameraMirrored, {options.overrides.shadingRate, options.overrides.patchMultiplier},
                options.movesPoints, options.takesString),
        solids(w) {}
  SkeletonWriter& writer;
  FrameCounts& counts;
  AttributeRecords records;
  SolidBlocks solids;
  std::map<const ri::RetainedObject*, Retained> retained;
  std::optional<DiceEye> eye;
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
