// The imaging options of a frame, read from the scene cache: the same for every renderer.
#pragma once

#include "imaging/frame_output.h"
#include "imaging/pixel_filter.h"
#include "imaging/sample_pattern.h"
#include "scene_cache/cache.h"

namespace fr {

/// Resolution, crop, and the metadata that every image gets (worldtocamera, worldtoscreen as RISpec writes
/// matrices, software).
FrameGeometry frameGeometry(const cache::Skeleton& skeleton);
/// RiPixelFilter. An unknown name is reported and becomes the default, gaussian 2 2.
PixelFilter framePixelFilter(const cache::Skeleton& skeleton);
/// RiPixelSamples and the hider's jitter. `seed`: of the positions. Times and lens positions are there when
/// something moves while the shutter is open, and when the lens has a size.
SamplePattern frameSamplePattern(const cache::Skeleton& skeleton, uint32_t seed);
/// Whether the camera or any object moves while the shutter is open.
bool frameMoves(const cache::Skeleton& skeleton);
/// Cache space to camera space at equally spaced times, shutter open to close; one matrix when the camera
/// stands still. In between, renderers blend two of them entry by entry: positions in camera space then move
/// straight from key to key, as those of grids do.
std::vector<DMat4> frameCameraKeys(const cache::Skeleton& skeleton);
/// The thin lens of RiDepthOfField, at camera space z = 0.
struct FrameLens {
  double radius = 0;         // camera space; 0: pinhole
  double focalDistance = 1;  // camera z of what is sharp
};
/// The lens has a diameter of focallength / fstop, so a point at depth z has a circle of confusion of
/// diameter / focal distance * |1 - focal distance / z| on the plane z = 1: RISpec's formula.
FrameLens frameLens(const cache::Skeleton& skeleton);
/// Pixels a side of a tile: `asked`, or (0) Option "limits" "bucketsize", else 32; less when a tile would
/// hold so many samples that its buffers leave the processor's cache.
int frameBucketSize(const cache::Skeleton& skeleton, int asked, int samplesPerPixel);
/// First number of an option, hider parameter ... of that name, or `otherwise`.
float frameFloatOption(const cache::Skeleton& skeleton, cache::Slice list, const char* name, float otherwise);
/// The frame's displays with their quantisers and exposures. `picture`: a file for colour and alpha instead
/// of them, but for depth files, which later frames may need as shadow maps; empty: none.
std::vector<DisplayRequest> frameDisplays(const cache::Skeleton& skeleton, const std::string& picture = {});
/// The hider's "depthfilter": how the samples of a pixel make its depth.
struct DepthFilter {
  ChannelRule rule = ChannelRule::kMinimum;
  /// Each sample's depth is half way between the first two surfaces it meets; RI_INFINITY when there is no
  /// second. For shadow maps: Woo, "The Shadow Depth Map Revisited", Graphics Gems III, 1992.
  bool midpoint = false;
};
/// "min" (default), "max", "average", "midpoint"; others are reported.
DepthFilter frameDepthFilter(const cache::Skeleton& skeleton);
/// Leaves out the displays whose file exists already, with a message for each.
void dropExistingDisplays(std::vector<DisplayRequest>& displays, const std::vector<std::string>& searchPath);
/// displaySearchPath() of Option "searchpath" "display".
std::vector<std::string> frameDisplaySearchPath(const cache::Skeleton& skeleton);

}  // namespace fr
