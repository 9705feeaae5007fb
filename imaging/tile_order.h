// The order in which the tiles of a frame are handed out.
#pragma once

#include <vector>

namespace fr {

/// Tiles of a width x height raster of tiles (index: row by row) along Hilbert's curve: neighbours in time
/// are neighbours on the raster, so few tiles are half finished.
std::vector<int> hilbertOrder(int width, int height);

}  // namespace fr
