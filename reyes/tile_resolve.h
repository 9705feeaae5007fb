// From what a tile's samples see and the colours of its grids to the samples of the film.
#pragma once

#include <vector>

#include "reyes/tile_hider.h"

namespace fr::reyes {

/// Film channels: R G B A Z, then `outputChannels` more. All grids marked `seen` are shaded. Compositing of a
/// sample stops when less than 1 - `opacityThreshold` of what is behind still shows. The arrays of `channels`
/// are dense: pixels of the tile row by row, samples side by side; x and y lie in [0,1) within the pixel.
struct TileColors {
  std::vector<float> x, y;
  std::vector<std::vector<float>> channels;
};
/// `midpointDepth`: depth lies half way to the second surface; RI_INFINITY without one.
void resolveTile(const TileView& view, const ShutterSpace& space, int outputChannels, float opacityThreshold,
                 bool midpointDepth, TileColors& out);

}  // namespace fr::reyes
