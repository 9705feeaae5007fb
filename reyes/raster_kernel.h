// Rasterisation of a grid's micropolygons onto a tile's samples.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fr::reyes {

/// A hit on a surface that is not known to be opaque.
struct Fragment {
  uint32_t sample;
  uint32_t hit;
  float depth;
  uint32_t next;  // next fragment of the sample; set by the owner of the list
};

/// Where some samples of every pixel of a tile lie: inclusive bounds within the pixel, subpixel steps.
struct SampleGroup {
  int32_t x0, y0, x1, y1;
};

/// Where triangles are drawn: views of a SampleBuffer and of the tile's tables.
struct RasterTarget {
  int columns = 0, rows = 0, perPixel = 0, rowStride = 0;
  const int32_t* x = nullptr;
  const int32_t* y = nullptr;
  const uint32_t* xy = nullptr;  // x and y again, modulo 2^16: x in the low half
  /// Samples [k groupSize, (k + 1) groupSize) of each pixel are group k. Kernels whose vectors have another
  /// size do not use them.
  const SampleGroup* groups = nullptr;
  int groupSize = 0;
  float* depth = nullptr;
  uint32_t* hit = nullptr;
  /// Rank of the grid in each slot: of two hits at the same depth the lower (rank, triangle) wins, whichever
  /// came first.
  const uint64_t* slotRank = nullptr;
  /// Fragments go here when set (and depth is only read). When there is not room for a vector more, drain()
  /// takes them and sets fragmentCount to 0; what is left at the end is the caller's.
  Fragment* fragments = nullptr;
  size_t fragmentCapacity = 0, fragmentCount = 0;
  void (*drain)(RasterTarget&) = nullptr;
  void* drainTo = nullptr;
  /// Pixels touched so far, inclusive.
  int column0 = 1 << 30, row0 = 1 << 30, column1 = -1, row1 = -1;
  uint64_t trianglesTested = 0;
};

/// Triangles over one set of vertices. Positions in subpixel steps from the tile's corner.
struct RasterTriangles {
  const int32_t* x = nullptr;
  const int32_t* y = nullptr;
  const float* key = nullptr;
  const uint8_t* skip =
      nullptr;  // per vertex: triangles that use it are left out (they are clipped elsewhere)
  // A grid of cells, each split into triangles 2 cell and 2 cell + 1 along the diagonal (1,0)-(0,1); or an
  // indexed list.
  int nu = 0, nv = 0;
  const uint8_t* indices = nullptr;
  const uint32_t* ids = nullptr;  // triangle numbers of an indexed list, nullptr: 0, 1, 2...
  uint32_t triangleCount = 0;
  uint32_t slot = 0;
  int cullSign = 0;  // triangles of this orientation (sign of the raster area, y down) are left out; 0: none
};

/// Vertex indices of triangle `t` of a grid of nu x nv cells.
inline void gridTriangle(int nu, uint32_t t, uint32_t out[3]) {
  const uint32_t cell = t >> 1, columns = uint32_t(nu), stride = columns + 1;
  const uint32_t a = cell / columns * stride + cell % columns;
  out[0] = t & 1 ? a + 1 : a;
  out[1] = t & 1 ? a + stride + 1 : a + 1;
  out[2] = a + stride;
}

/// Draws triangles. Coverage is exact: samples on a shared edge belong to one of its two triangles.
using RasterFunction = void (*)(const RasterTriangles&, RasterTarget&);
RasterFunction rasterFunction();
/// Samples in a vector of that function: the size of the groups that it uses.
int rasterWidth();

namespace sse4 {
void rasterise(const RasterTriangles&, RasterTarget&);
}
namespace avx2 {
void rasterise(const RasterTriangles&, RasterTarget&);
}
namespace avx512 {
void rasterise(const RasterTriangles&, RasterTarget&);
}

}  // namespace fr::reyes
