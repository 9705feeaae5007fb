// A grid's vertices over the shutter, and the drawing of its micropolygons where they reach through the near
// plane.
#pragma once

#include <vector>

#include "reyes/blur_kernel.h"
#include "reyes/grid_projection.h"

namespace fr::reyes {

/// Vertices at equally spaced keys, before the projection: BlurFaces points into it.
struct BlurredGrid {
  int keys = 0;  // 0: the grid is not blurred
  size_t vertexCount = 0;
  std::vector<float> xw, yw, z;       // by key, then by vertex
  std::vector<float> x0, y0, x1, y1;  // by vertex: bounds over the shutter and the lens, pixels
  std::vector<uint8_t> state;         // VertexState
  bool anyClipped = false;
  RasterBounds bounds{};

  bool any() const { return keys > 0; }
  /// A view for the kernel on a tile; `indices` and counts are the caller's to fill.
  BlurFaces faces(const ShutterSpace& space, const PixelRect& tile) const;
};

/// Most keys of a blurred grid.
inline constexpr int kMaxBlurKeys = 33;

/// Projects a grid whose positions (as for projectGrid()) have `positionKeys` keys, `keyStride` floats apart,
/// over the shutter. When grid and camera both move, keys are taken at all of both's times (as far as
/// kMaxBlurKeys reaches).
void projectBlurred(const ShutterSpace& space, const float* positions, int positionKeys, size_t keyStride,
                    int columns, int rows, size_t rowStride, BlurredGrid& out);

/// Draws the faces that the kernel leaves out, as far as their vertices are numbers: for every sample of the
/// tile, its triangle at that time, cut at the near plane. hit(sample, triangle, key) is called for each
/// sample that sees one. Cold path.
template <class Hit>
void drawBlurredClipped(const BlurredGrid& grid, const ShutterSpace& space, const BlurFaces& faces,
                        const BlurSamples& samples, const RasterTarget& target, Hit&& hit);

// ---- implementation
// -------------------------------------------------------------------------------------------

/// Pixels of a tile of columns x rows, inclusive, where triangle `v` may be seen at any time from anywhere on
/// the lens: the rest cannot see it. Empty: column0 > column1.
struct PixelBox {
  int column0, row0, column1, row1;
};
PixelBox clippedTriangleBox(const BlurFaces& faces, float nearDepth, const uint32_t v[3], int columns,
                            int rows);

/// Whether the sample at (x, y) (subpixel steps) sees triangle `v` at its time and lens position, and its
/// depth key.
bool seesClippedTriangle(const BlurFaces& faces, float nearDepth, const uint32_t v[3], int32_t x, int32_t y,
                         float time, float lensX, float lensY, float* key);

template <class Hit>
void drawBlurredClipped(const BlurredGrid& grid, const ShutterSpace& space, const BlurFaces& faces,
                        const BlurSamples& samples, const RasterTarget& target, Hit&& hit) {
  const uint32_t triangles = faces.indices ? faces.faceCount : 2 * faces.faceCount;
  for (uint32_t t = 0; t < triangles; ++t) {
    uint32_t v[3];
    uint8_t states = 0;
    if (faces.indices) {
      for (uint32_t i = 0; i < 3; ++i) v[i] = faces.indices[3 * t + i];
    } else {
      // The kernel leaves out whole cells.
      gridTriangle(faces.nu, t ^ 1, v);
      for (uint32_t i : v) states = uint8_t(states | grid.state[i]);
      gridTriangle(faces.nu, t, v);
    }
    uint8_t own = 0;
    for (uint32_t i : v) own = uint8_t(own | grid.state[i]);
    if ((states | own) == kVertexDrawn || (own & kVertexInvalid)) continue;
    const PixelBox box = clippedTriangleBox(faces, space.open().near(), v, target.columns, target.rows);
    for (int row = box.row0; row <= box.row1; ++row)
      for (int i = box.column0 * target.perPixel; i < (box.column1 + 1) * target.perPixel; ++i) {
        const auto s = uint32_t(row * target.rowStride + i);
        float key;
        if (seesClippedTriangle(faces, space.open().near(), v, target.x[s], target.y[s], samples.time[s],
                                samples.lensX[s], samples.lensY[s], &key))
          hit(s, t, key);
      }
  }
}

}  // namespace fr::reyes
