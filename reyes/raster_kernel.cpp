// Compiled once per instruction set (FR_ISA). Coverage is decided in exact arithmetic: 32-bit integers for
// triangles of a few pixels, doubles that hold integers for larger ones.
#include "reyes/raster_kernel.h"

#include "reyes/raster_space.h"
#include "reyes/sample_buffer.h"

namespace fr::reyes::FR_ISA {
namespace {

/// Largest side, in subpixel steps, of triangles drawn in int32: the products of an edge (16 pixels) and the
/// distance of a sample from a vertex (16 pixels, and 17 more for the padding of runs) stay below 2^30.
constexpr int32_t kSmallSide = 16 * kSubpixels;

/// Edge a -> b of a triangle with positive area: e(p) >= 0 inside.
template <class T>
struct Edge {
  T dx, dy, bias;
  int32_t x, y;
  Edge(int32_t ax, int32_t ay, int32_t bx, int32_t by) : dx(T(bx - ax)), dy(T(by - ay)), x(ax), y(ay) {
    // Of the two directions of an edge exactly one owns the samples that lie on it.
    const bool owns = dy > 0 || (dy == 0 && dx < 0);
    bias = owns ? T(0) : T(1);
  }
  T at(int32_t px, int32_t py) const { return dx * T(py - y) - dy * T(px - x); }
};

int32_t min3(int32_t a, int32_t b, int32_t c) { return a < b ? (a < c ? a : c) : (b < c ? b : c); }
int32_t max3(int32_t a, int32_t b, int32_t c) { return a > b ? (a > c ? a : c) : (b > c ? b : c); }

struct Triangle {
  int32_t x[3], y[3];
  float key[3];
  uint32_t hit;
  int column0, column1, row0, row1;
  float area;
};

template <class T>
void draw(const Triangle& t, RasterTarget& target) {
  const Edge<T> e0(t.x[0], t.y[0], t.x[1], t.y[1]);
  const Edge<T> e1(t.x[1], t.y[1], t.x[2], t.y[2]);
  const Edge<T> e2(t.x[2], t.y[2], t.x[0], t.y[0]);
  const float inverse = 1 / t.area;
  // e2 is the weight of vertex 1, e0 that of vertex 2.
  const float k0 = t.key[0], k1 = (t.key[1] - k0) * inverse, k2 = (t.key[2] - k0) * inverse;
  const uint32_t hit = t.hit;
  for (int row = t.row0; row <= t.row1; ++row) {
    const size_t first = size_t(row) * size_t(target.rowStride) + size_t(t.column0 * target.perPixel);
    int n = (t.column1 - t.column0 + 1) * target.perPixel;
    const int32_t* __restrict px = target.x + first;
    const int32_t* __restrict py = target.y + first;
    float* __restrict depth = target.depth + first;
    uint32_t* __restrict hits = target.hit + first;
    if (target.fragments) {
      for (int i = 0; i < n; ++i) {
        const T w0 = e0.at(px[i], py[i]), w1 = e1.at(px[i], py[i]), w2 = e2.at(px[i], py[i]);
        if (!(w0 >= e0.bias && w1 >= e1.bias && w2 >= e2.bias)) continue;
        const float k = k0 + float(w2) * k1 + float(w0) * k2;
        if (k <= depth[i])
          target.fragments[target.fragmentCount++] = {uint32_t(first) + uint32_t(i), hit, k, 0};
      }
      continue;
    }
    n = (n + 7) & ~7;  // the samples behind the run are real ones or can be hit by nothing
    int ties = 0;
    for (int i = 0; i < n; ++i) {
      const T w0 = e0.at(px[i], py[i]), w1 = e1.at(px[i], py[i]), w2 = e2.at(px[i], py[i]);
      const bool inside = (w0 >= e0.bias) & (w1 >= e1.bias) & (w2 >= e2.bias);
      const float k = k0 + float(w2) * k1 + float(w0) * k2;
      const float old = depth[i];
      const uint32_t oldHit = hits[i];
      const bool nearer = inside & (k < old);
      ties |= int(inside & (k == old));
      depth[i] = nearer ? k : old;
      hits[i] = nearer ? hit : oldHit;
    }
    if (!ties) continue;
    for (int i = 0; i < n; ++i) {
      const T w0 = e0.at(px[i], py[i]), w1 = e1.at(px[i], py[i]), w2 = e2.at(px[i], py[i]);
      if (!(w0 >= e0.bias && w1 >= e1.bias && w2 >= e2.bias)) continue;
      const float k = k0 + float(w2) * k1 + float(w0) * k2;
      if (k != depth[i] || hits[i] == hit || hits[i] == kNothing) continue;
      const uint64_t mine = target.slotRank[hit >> kTriangleBits],
                     other = target.slotRank[hits[i] >> kTriangleBits];
      if (mine < other || (mine == other && (hit & kTriangleMask) < (hits[i] & kTriangleMask))) hits[i] = hit;
    }
  }
}

}  // namespace

uint32_t rasterise(const RasterTriangles& in, uint32_t first, RasterTarget& target) {
  for (uint32_t n = first; n < in.triangleCount; ++n) {
    uint32_t v[3];
    if (in.indices)
      v[0] = in.indices[3 * n], v[1] = in.indices[3 * n + 1], v[2] = in.indices[3 * n + 2];
    else
      gridTriangle(in.nu, n, v);
    if (in.skip && (in.skip[v[0]] | in.skip[v[1]] | in.skip[v[2]])) continue;
    Triangle t;
    for (int i = 0; i < 3; ++i) t.x[i] = in.x[v[i]], t.y[i] = in.y[v[i]], t.key[i] = in.key[v[i]];
    const int32_t x0 = min3(t.x[0], t.x[1], t.x[2]), x1 = max3(t.x[0], t.x[1], t.x[2]);
    const int32_t y0 = min3(t.y[0], t.y[1], t.y[2]), y1 = max3(t.y[0], t.y[1], t.y[2]);
    t.column0 = x0 >> kSubpixelBits, t.column1 = x1 >> kSubpixelBits;
    t.row0 = y0 >> kSubpixelBits, t.row1 = y1 >> kSubpixelBits;
    if (t.column0 < 0) t.column0 = 0;
    if (t.row0 < 0) t.row0 = 0;
    if (t.column1 >= target.columns) t.column1 = target.columns - 1;
    if (t.row1 >= target.rows) t.row1 = target.rows - 1;
    if (t.column0 > t.column1 || t.row0 > t.row1) continue;
    const int64_t area = int64_t(t.x[1] - t.x[0]) * int64_t(t.y[2] - t.y[0]) -
                         int64_t(t.y[1] - t.y[0]) * int64_t(t.x[2] - t.x[0]);
    if (area == 0) continue;
    if (area < 0) {
      if (in.cullSign < 0) continue;
      const int32_t sx = t.x[1], sy = t.y[1];
      const float sk = t.key[1];
      t.x[1] = t.x[2], t.y[1] = t.y[2], t.key[1] = t.key[2];
      t.x[2] = sx, t.y[2] = sy, t.key[2] = sk;
    } else if (in.cullSign > 0) {
      continue;
    }
    t.area = float(area < 0 ? -area : area);
    t.hit = in.slot << kTriangleBits | (in.ids ? in.ids[n] : n);
    if (target.fragments) {
      const size_t most =
          size_t(t.column1 - t.column0 + 1) * size_t(t.row1 - t.row0 + 1) * size_t(target.perPixel);
      if (target.fragmentCount + most > target.fragmentCapacity) return n;
    }
    ++target.trianglesTested;
    if (t.column0 < target.column0) target.column0 = t.column0;
    if (t.column1 > target.column1) target.column1 = t.column1;
    if (t.row0 < target.row0) target.row0 = t.row0;
    if (t.row1 > target.row1) target.row1 = t.row1;
    if (x1 - x0 < kSmallSide && y1 - y0 < kSmallSide)
      draw<int32_t>(t, target);
    else
      draw<double>(t, target);
  }
  return in.triangleCount;
}

}  // namespace fr::reyes::FR_ISA
