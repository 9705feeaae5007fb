// The imaging options of a frame, read from the scene cache: the same for every renderer.
#pragma once

#include "imaging/frame_output.h"
#include "imaging/pixel_filter.h"
#include "scene_cache/cache.h"

namespace fr {

/// Resolution, crop, and the metadata that every image gets (worldtocamera, worldtoscreen as RISpec writes
/// matrices, software).
FrameGeometry frameGeometry(const cache::Skeleton& skeleton);
/// RiPixelFilter. An unknown name is reported and becomes the default, gaussian 2 2.
PixelFilter framePixelFilter(const cache::Skeleton& skeleton);
/// The frame's displays with their quantisers and exposures.
std::vector<DisplayRequest> frameDisplays(const cache::Skeleton& skeleton);
/// displaySearchPath() of Option "searchpath" "display".
std::vector<std::string> frameDisplaySearchPath(const cache::Skeleton& skeleton);

}  // namespace fr
