// What an object is, whatever the file that it stands in: 128-bit hashes of content instead of offsets.
#pragma once

#include <compare>

#include "scene_cache/cache.h"

namespace fr::cache {

struct ContentKey {
  uint64_t low = 0, high = 0;
  auto operator<=>(const ContentKey&) const = default;
};

/// All that the object's grids depend on but the eye, the cache origin and the shutter: source, transform,
/// the attributes that dicing reads, patches with their bounds and borders. `displacement`: also the
/// displacement shader with its parameters, and all that a shader can read of the object.
ContentKey diceContent(const Skeleton& skeleton, ObjectId object, bool displacement);
/// diceContent() with displacement, and all that the object looks like: its attribute state with shaders,
/// and its primitive variables.
ContentKey wholeContent(const Skeleton& skeleton, ObjectId object);
/// Of a transform's keys.
ContentKey transformContent(const Skeleton& skeleton, TransformId transform);
/// Of options and camera, without the frame number.
ContentKey frameContent(const Skeleton& skeleton);

}  // namespace fr::cache
