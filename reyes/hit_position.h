// Where a sample sees the corners of a triangle that was drawn.
#pragma once

#include "reyes/tile_hider.h"

namespace fr::reyes {

/// Vertices `v` of grid `g` on the raster of `view`'s tile, as its sample `sample` sees them: at its time,
/// from its place on the lens. False when one of them was clipped or is not a number: then there are no such
/// positions.
inline bool seenCorners(const TileGrid& g, const TileView& view, const ShutterSpace& space, size_t sample,
                        const uint32_t v[3], BlurPoint out[3]) {
  if (g.blurred.any()) {
    if (g.blurred.state[v[0]] | g.blurred.state[v[1]] | g.blurred.state[v[2]]) return false;
    const SampleBuffer& s = view.samples;
    const BlurFaces faces = g.blurred.faces(space, s.rect());
    for (int i = 0; i < 3; ++i)
      out[i] = blurVertex(faces, v[i], s.time[sample], s.lensX[sample], s.lensY[sample]);
    return true;
  }
  const ProjectedGrid& p = g.projected;
  if (p.state[v[0]] | p.state[v[1]] | p.state[v[2]]) return false;
  for (int i = 0; i < 3; ++i) out[i] = {p.x[v[i]], p.y[v[i]], p.key[v[i]]};
  return true;
}

/// Weights of the corners at the sample, in perspective; equal ones for a triangle without area.
inline void cornerWeights(const BlurPoint corner[3], bool perspective, double x, double y, double weight[3]) {
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    const BlurPoint &a = corner[(i + 1) % 3], &b = corner[(i + 2) % 3];
    weight[i] = double(b.x - a.x) * (y - a.y) - double(b.y - a.y) * (x - a.x);
    if (perspective) weight[i] *= double(corner[i].key);
    sum += weight[i];
  }
  for (int i = 0; i < 3; ++i) weight[i] = sum != 0 ? weight[i] / sum : 1.0 / 3;
}

}  // namespace fr::reyes
