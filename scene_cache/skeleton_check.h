// The validation of a skeleton: everything that open() guarantees to its callers.
#pragma once

#include <span>

#include "base/error.h"
#include "scene_cache/format.h"

namespace fr::cache {

/// Checks `bytes` from the magic number to the last index. On success every range of the header lies inside
/// the first totalBytes bytes and is aligned, every id in every record is in range or kNone where that is
/// allowed, strings of parameters exist, motion times ascend, matrices and camera are finite. Cost: one pass
/// over the tables and the string parameters; bulk data (floats) is not read unless `verifyChecksum`.
/// Allocates nothing.
Result<void> checkSkeleton(std::span<const std::byte> bytes, bool verifyChecksum);

/// Largest image side that a camera may ask for.
inline constexpr int32_t kMaxResolution = 1 << 18;
/// Samples along one side of a pixel, and pixels along one side of a filter.
inline constexpr float kMaxPixelSamples = 128;
inline constexpr float kMaxFilterWidth = 64;
/// Most motion keys of a transform or a primitive.
inline constexpr uint64_t kMaxKeys = 4096;

}  // namespace fr::cache
