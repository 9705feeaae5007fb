// Rasterisation of micropolygons that move, or that are seen through a lens: each sample sees a micropolygon
// where it is at the sample's time, from the sample's place on the lens.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "reyes/raster_kernel.h"
#include "reyes/raster_space.h"

namespace fr::reyes {

/// Samples of one number within their pixels: where their times and lens positions lie, over the whole tile.
struct SlotRange {
  float time0 = 0, time1 = 0, lensX0 = 0, lensX1 = 0, lensY0 = 0, lensY1 = 0;
};

/// A sample that may see a face.
struct BlurPair {
  uint32_t sample, face;
};
inline constexpr size_t kMostBlurPairs = 1 << 15;
/// Of a grid's vertices; its faces are as many as triangles have numbers.
inline constexpr size_t kMostBlurVertices = 1100;

/// A tile's samples, as the kernel reads them beside its RasterTarget; see SampleBuffer.
struct BlurSamples {
  const float* time = nullptr;
  const float* lensX = nullptr;
  const float* lensY = nullptr;
  const SlotRange* slots = nullptr;  // as many as samples a pixel
  // Scratch: room for all samples of the tile and 16 more; for kMostBlurPairs.
  uint32_t* candidates = nullptr;
  BlurPair* pairs = nullptr;
  uint32_t* sorted = nullptr;
};

/// Faces over one set of vertices: cells of a grid (two triangles each, split as RasterTriangles), or an
/// indexed list of triangles. Vertex v at key k: element k * vertexCount + v.
struct BlurFaces {
  const float* xw = nullptr;  // raster position times w, pixels
  const float* yw = nullptr;
  const float* z = nullptr;  // camera depth; w = z in perspective, else 1
  size_t vertexCount = 0;
  int keys = 1;  // equally spaced over the shutter
  bool perspective = true;
  LensShift lens;
  int originX = 0, originY = 0;   // the tile's corner, pixels
  const uint8_t* skip = nullptr;  // per vertex: faces that use it are drawn elsewhere
  int nu = 0, nv = 0;
  const uint8_t* indices = nullptr;
  uint32_t faceCount = 0;
  uint32_t slot = 0;
  int cullSign = 0;  // as in RasterTriangles
};

struct BlurPoint {
  int32_t x, y;  // subpixel steps from the tile's corner
  float key;
};

/// Where a vertex is seen: its position blended between two keys, then projected and moved by the lens. The
/// one formula for coverage and for interpolation.
inline BlurPoint blurPoint(const BlurFaces& f, float xw, float yw, float z, float lensX, float lensY) {
  const float inverse = f.perspective ? 1 / z : 1.0f;
  const float key = f.perspective ? -inverse : z;
  const float x = xw * inverse + f.lens.x(lensX, key), y = yw * inverse + f.lens.y(lensY, key);
  return {int32_t(std::rint(x * float(kSubpixels))) - f.originX * kSubpixels,
          int32_t(std::rint(y * float(kSubpixels))) - f.originY * kSubpixels, key};
}
/// The key before `time` (of keys > 1) and the weight of the next.
inline int blurKey(int keys, float time, float* weight) {
  const float at = time * float(keys - 1);
  int k = int(at);
  k = k < keys - 2 ? k : keys - 2;
  *weight = at - float(k);
  return k;
}
inline BlurPoint blurVertex(const BlurFaces& f, uint32_t v, float time, float lensX, float lensY) {
  if (f.keys == 1) return blurPoint(f, f.xw[v], f.yw[v], f.z[v], lensX, lensY);
  float t;
  const size_t a = size_t(blurKey(f.keys, time, &t)) * f.vertexCount + v, b = a + f.vertexCount;
  return blurPoint(f, f.xw[a] + t * (f.xw[b] - f.xw[a]), f.yw[a] + t * (f.yw[b] - f.yw[a]),
                   f.z[a] + t * (f.z[b] - f.z[a]), lensX, lensY);
}

/// Draws faces. Coverage is exact for every sample, as in RasterFunction.
using BlurFunction = void (*)(const BlurFaces&, const BlurSamples&, RasterTarget&);
BlurFunction blurFunction();

namespace sse4 {
void drawBlurred(const BlurFaces&, const BlurSamples&, RasterTarget&);
}
namespace avx2 {
void drawBlurred(const BlurFaces&, const BlurSamples&, RasterTarget&);
}
namespace avx512 {
void drawBlurred(const BlurFaces&, const BlurSamples&, RasterTarget&);
}

}  // namespace fr::reyes
