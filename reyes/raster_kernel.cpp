// Compiled once per instruction set (FR_ISA). Coverage is decided in exact arithmetic: products of 16-bit
// differences in 32 bits for micropolygons of a few pixels, doubles that hold integers for larger ones.
//
// A cell of a grid is tested as one quadrilateral: which side of the diagonal a sample lies on says which of
// the two triangles could hold it, so each sample is looked at once. What is tested are the groups of samples
// whose box the cell's box meets (SampleGroup), one vector at a time.
#include "reyes/raster_kernel.h"

#include <bit>

#include "reyes/lanes.h"
#include "reyes/raster_space.h"
#include "reyes/sample_buffer.h"

namespace fr::reyes::FR_ISA {
namespace {

using namespace fr::FR_ISA;

constexpr int kWidth = int(kLanes);

/// Largest side, in subpixel steps, of what is tested in 16-bit differences: a sample is at most this far
/// from a corner, and up to 17 pixels more where a run of samples is padded to whole vectors, less than 32
/// pixels in all.
constexpr int32_t kSmallSide = 12 * kSubpixels;

int32_t min3(int32_t a, int32_t b, int32_t c) { return a < b ? (a < c ? a : c) : (b < c ? b : c); }
int32_t max3(int32_t a, int32_t b, int32_t c) { return a > b ? (a > c ? a : c) : (b > c ? b : c); }

/// Of the two directions of an edge exactly one owns the samples that lie on it. Edge a -> b holds a sample s
/// with dx (s.y - a.y) - dy (s.x - a.x) >= bias.
template <class T>
T biasOf(T dx, T dy) {
  return dy > 0 || (dy == 0 && dx < 0) ? T(0) : T(1);
}

/// Differences of packed 16-bit coordinates.
FR_INLINE VI difference16(VI a, VI b) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_sub_epi16((__m512i)a, (__m512i)b);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_sub_epi16((__m256i)a, (__m256i)b);
#else
  return (VI)_mm_sub_epi16((__m128i)a, (__m128i)b);
#endif
}
/// The sum of the products of both 16-bit halves.
FR_INLINE VI dot16(VI a, VI b) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_madd_epi16((__m512i)a, (__m512i)b);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_madd_epi16((__m256i)a, (__m256i)b);
#else
  return (VI)_mm_madd_epi16((__m128i)a, (__m128i)b);
#endif
}
/// Where m is negative a, else b.
FR_INLINE VI pick(VI m, VI a, VI b) { return m < 0 ? a : b; }
FR_INLINE V pick(VI m, V a, V b) { return m < 0 ? a : b; }
constexpr uint32_t kAllLanes = (1u << kWidth) - 1;
FR_INLINE uint32_t firstLanes(int n) { return n >= kWidth ? kAllLanes : (1u << n) - 1; }

/// A sample on the surface at the depth that another one has there: the lower (rank, triangle) wins.
bool winsTie(const RasterTarget& target, uint32_t hit, uint32_t other) {
  if (other == hit || other == kNothing) return false;
  const uint64_t mine = target.slotRank[hit >> kTriangleBits], its = target.slotRank[other >> kTriangleBits];
  return mine < its || (mine == its && (hit & kTriangleMask) < (other & kTriangleMask));
}

/// Pixels of the tile, inclusive.
struct Pixels {
  int column0, row0, column1, row1;
  bool empty() const { return column0 > column1 || row0 > row1; }
};
Pixels pixelsOf(int32_t x0, int32_t y0, int32_t x1, int32_t y1, const RasterTarget& target) {
  Pixels p{x0 >> kSubpixelBits, y0 >> kSubpixelBits, x1 >> kSubpixelBits, y1 >> kSubpixelBits};
  if (p.column0 < 0) p.column0 = 0;
  if (p.row0 < 0) p.row0 = 0;
  if (p.column1 >= target.columns) p.column1 = target.columns - 1;
  if (p.row1 >= target.rows) p.row1 = target.rows - 1;
  return p;
}
void touch(const Pixels& p, RasterTarget& target) {
  if (p.column0 < target.column0) target.column0 = p.column0;
  if (p.column1 > target.column1) target.column1 = p.column1;
  if (p.row0 < target.row0) target.row0 = p.row0;
  if (p.row1 > target.row1) target.row1 = p.row1;
}
/// Leaves room for a vector of fragments.
FR_INLINE void makeRoom(RasterTarget& target) {
  if (target.fragmentCount + size_t(kWidth) > target.fragmentCapacity) target.drain(target);
}

// ---- small: all of a triangle, or of a cell's two

struct Corner {
  int32_t x, y;
  float key;
};

/// e(s) = dot16(d, s - base) + offset, less the bias: not negative for samples that the edge holds.
struct SmallEdge {
  VI d, offset;
  int32_t bias;
  void set(const Corner& from, const Corner& to, const Corner& base) {
    const int32_t dx = to.x - from.x, dy = to.y - from.y;
    bias = biasOf(dx, dy);
    // x in the low half, y in the high one, as in RasterTarget::xy.
    d = splatInt(int32_t(uint32_t(dx) << 16 | (uint32_t(-dy) & 0xffff)));
    offset = splatInt(dy * (from.x - base.x) - dx * (from.y - base.y) - bias);
  }
  VI at(VI s) const { return dot16(d, s) + offset; }
};

/// The triangle a, b, c of positive area; and, `kQuad`, beside it the triangle b, d, c, of positive area too.
template <bool kQuad>
class SmallFace {
 public:
  SmallFace(const Corner& a, const Corner& b, const Corner& c, const Corner& d, int32_t area, int32_t area2,
            uint32_t hit) {
    base_ = splatInt(int32_t(uint32_t(a.y) << 16 | (uint32_t(a.x) & 0xffff)));
    ab_.set(a, b, a), ca_.set(c, a, a), bc_.set(b, c, a);
    const float inverse = 1 / float(area);
    // An edge's value is the weight of the corner opposite to it.
    key_ = splat(a.key), atB_ = splat((b.key - a.key) * inverse), atC_ = splat((c.key - a.key) * inverse);
    hit_ = splatInt(int32_t(hit));
    if constexpr (kQuad) {
      bd_.set(b, d, a), dc_.set(d, c, a);
      const float inverse2 = 1 / float(area2);
      key2_ = splat(b.key), atD_ = splat((d.key - b.key) * inverse2),
      atC2_ = splat((c.key - b.key) * inverse2);
    }
  }

  /// Tests a vector of samples of which `lanes` count.
  void test(size_t first, uint32_t lanes, RasterTarget& target) const {
    const VI s = difference16(load<VI>(target.xy + first), base_);
    const VI ab = ab_.at(s), ca = ca_.at(s), bc = bc_.at(s);
    VI outside, bd = {};
    if constexpr (kQuad) {
      // The diagonal's samples belong to one of the triangles: below its bias they lie beyond it.
      bd = bd_.at(s);
      outside = pick(bc, bd | dc_.at(s), ab | ca);
    } else {
      outside = ab | ca | bc;
    }
    uint32_t inside = ~maskBits(outside) & lanes;
    if (inside == 0) return;
    V key = key_ + toFloat(ca + ca_.bias) * atB_ + toFloat(ab + ab_.bias) * atC_;
    VI hit = hit_;
    if constexpr (kQuad) {
      const V key2 = key2_ + toFloat(-(bc + bc_.bias)) * atD_ + toFloat(bd + bd_.bias) * atC2_;
      key = pick(bc, key2, key);
      hit = hit_ - (bc >> 31);
    }
    if (target.fragments) {
      inside &= ~maskBits(key > load<V>(target.depth + first));
      makeRoom(target);
      for (; inside; inside &= inside - 1) {
        const int i = std::countr_zero(inside);
        target.fragments[target.fragmentCount++] = {uint32_t(first) + uint32_t(i), uint32_t(hit[i]), key[i],
                                                    0};
      }
      return;
    }
    const V depth = load<V>(target.depth + first);
    uint32_t ties = inside & maskBits(key == depth);
    const VI nearer = ~(outside >> 31) & (key < depth);
    if (lanes == kAllLanes) {
      const VI other = load<VI>(target.hit + first);
      const V newDepth = select(nearer, key, depth);
      const VI newHit = nearer ? hit : other;
      __builtin_memcpy(target.depth + first, &newDepth, sizeof newDepth);
      __builtin_memcpy(target.hit + first, &newHit, sizeof newHit);
    } else {
      for (uint32_t m = inside & maskBits(nearer); m; m &= m - 1) {
        const int i = std::countr_zero(m);
        target.depth[first + size_t(i)] = key[i], target.hit[first + size_t(i)] = uint32_t(hit[i]);
      }
    }
    for (; ties; ties &= ties - 1) {
      const int i = std::countr_zero(ties);
      uint32_t& other = target.hit[first + size_t(i)];
      if (winsTie(target, uint32_t(hit[i]), other)) other = uint32_t(hit[i]);
    }
  }

 private:
  SmallEdge ab_, ca_, bc_, bd_, dc_;
  VI base_, hit_;
  V key_, atB_, atC_, key2_, atD_, atC2_;
};

template <bool kQuad>
void drawSmall(const SmallFace<kQuad>& face, const Pixels& p, int32_t x0, int32_t y0, int32_t x1, int32_t y1,
               RasterTarget& target) {
  if (target.groupSize != kWidth) {
    for (int row = p.row0; row <= p.row1; ++row) {
      const size_t first = size_t(row) * size_t(target.rowStride) + size_t(p.column0 * target.perPixel);
      const int n = (p.column1 - p.column0 + 1) * target.perPixel;
      for (int i = 0; i < n; i += kWidth) face.test(first + size_t(i), firstLanes(n - i), target);
    }
    return;
  }
  const SampleGroup* g = target.groups;
  for (int k = 0; k < target.perPixel; k += kWidth, ++g) {
    int column0 = (x0 - g->x1 + kSubpixels - 1) >> kSubpixelBits, column1 = (x1 - g->x0) >> kSubpixelBits;
    int row0 = (y0 - g->y1 + kSubpixels - 1) >> kSubpixelBits, row1 = (y1 - g->y0) >> kSubpixelBits;
    if (column0 < p.column0) column0 = p.column0;
    if (column1 > p.column1) column1 = p.column1;
    if (row0 < p.row0) row0 = p.row0;
    if (row1 > p.row1) row1 = p.row1;
    for (int row = row0; row <= row1; ++row) {
      size_t at = size_t(row) * size_t(target.rowStride) + size_t(column0 * target.perPixel + k);
      for (int column = column0; column <= column1; ++column, at += size_t(target.perPixel))
        face.test(at, kAllLanes, target);
    }
  }
}

/// The quadrilateral a b d c: triangles a b c and b d c, both small and of areas of one sign; `hit` is that
/// of the first, and one more that of the second.
void drawQuad(const Corner& a, const Corner& b, const Corner& c, const Corner& d, int32_t area, int32_t area2,
              const Pixels& p, int32_t x0, int32_t y0, int32_t x1, int32_t y1, uint32_t hit, int cullSign,
              RasterTarget& target) {
  // Seen from behind it has its other two corners the other way round.
  const bool behind = area < 0;
  if (behind ? cullSign < 0 : cullSign > 0) return;
  target.trianglesTested += 2;
  touch(p, target);
  const SmallFace<true> face(a, behind ? c : b, behind ? b : c, d, behind ? -area : area,
                             behind ? -area2 : area2, hit);
  drawSmall(face, p, x0, y0, x1, y1, target);
}

// ---- large: triangles in doubles

struct Edge {
  double dx, dy, bias;
  int32_t x, y;
  Edge(const Corner& a, const Corner& b)
      : dx(double(b.x) - a.x), dy(double(b.y) - a.y), bias(biasOf(dx, dy)), x(a.x), y(a.y) {}
  double at(int32_t px, int32_t py) const { return dx * (double(py) - y) - dy * (double(px) - x); }
};

/// A triangle of positive area.
void drawLarge(const Corner& a, const Corner& b, const Corner& c, float area, const Pixels& p, uint32_t hit,
               RasterTarget& target) {
  const Edge e0(a, b), e1(b, c), e2(c, a);
  const float inverse = 1 / area;
  const float k0 = a.key, k1 = (b.key - k0) * inverse, k2 = (c.key - k0) * inverse;
  for (int row = p.row0; row <= p.row1; ++row) {
    const size_t first = size_t(row) * size_t(target.rowStride) + size_t(p.column0 * target.perPixel);
    const size_t n = size_t((p.column1 - p.column0 + 1) * target.perPixel);
    for (size_t i = first; i < first + n; ++i) {
      const double w0 = e0.at(target.x[i], target.y[i]), w1 = e1.at(target.x[i], target.y[i]),
                   w2 = e2.at(target.x[i], target.y[i]);
      if (!(w0 >= e0.bias && w1 >= e1.bias && w2 >= e2.bias)) continue;
      const float key = k0 + float(w2) * k1 + float(w0) * k2;
      if (target.fragments) {
        if (!(key <= target.depth[i])) continue;
        makeRoom(target);
        target.fragments[target.fragmentCount++] = {uint32_t(i), hit, key, 0};
      } else if (key < target.depth[i]) {
        target.depth[i] = key, target.hit[i] = hit;
      } else if (key == target.depth[i] && winsTie(target, hit, target.hit[i])) {
        target.hit[i] = hit;
      }
    }
  }
}

int64_t areaOf(const Corner& a, const Corner& b, const Corner& c) {
  return int64_t(b.x - a.x) * int64_t(c.y - a.y) - int64_t(b.y - a.y) * int64_t(c.x - a.x);
}

/// Any triangle.
void drawTriangle(Corner a, Corner b, Corner c, uint32_t hit, int cullSign, RasterTarget& target) {
  const int32_t x0 = min3(a.x, b.x, c.x), x1 = max3(a.x, b.x, c.x);
  const int32_t y0 = min3(a.y, b.y, c.y), y1 = max3(a.y, b.y, c.y);
  const Pixels p = pixelsOf(x0, y0, x1, y1, target);
  if (p.empty()) return;
  int64_t area = areaOf(a, b, c);
  if (area == 0 || (area < 0 ? cullSign < 0 : cullSign > 0)) return;
  if (area < 0) {
    const Corner other = b;
    b = c, c = other, area = -area;
  }
  ++target.trianglesTested;
  touch(p, target);
  if (x1 - x0 < kSmallSide && y1 - y0 < kSmallSide)
    drawSmall(SmallFace<false>(a, b, c, a, int32_t(area), 0, hit), p, x0, y0, x1, y1, target);
  else
    drawLarge(a, b, c, float(area), p, hit, target);
}

/// Boxes and areas of some cells of a row of a grid.
struct CellRow {
  static constexpr uint32_t kMost = 16;
  int32_t x0[kMost], y0[kMost], x1[kMost], y1[kMost], area[kMost], area2[kMost];
};

/// The `count` cells from vertex v on, `stride` vertices a row. Areas of cells that are not small are of no
/// use.
void measureCells(const RasterTriangles& in, size_t v, size_t stride, uint32_t count, CellRow& row) {
  const int32_t* __restrict x = in.x + v;
  const int32_t* __restrict y = in.y + v;
  const int32_t* __restrict x2 = x + stride;
  const int32_t* __restrict y2 = y + stride;
  for (uint32_t i = 0; i < count; ++i) {
    const int32_t ax = x[i], bx = x[i + 1], cx = x2[i], dx = x2[i + 1];
    const int32_t ay = y[i], by = y[i + 1], cy = y2[i], dy = y2[i + 1];
    const int32_t lowX = ax < bx ? ax : bx, lowX2 = cx < dx ? cx : dx;
    const int32_t lowY = ay < by ? ay : by, lowY2 = cy < dy ? cy : dy;
    const int32_t highX = ax > bx ? ax : bx, highX2 = cx > dx ? cx : dx;
    const int32_t highY = ay > by ? ay : by, highY2 = cy > dy ? cy : dy;
    row.x0[i] = lowX < lowX2 ? lowX : lowX2, row.y0[i] = lowY < lowY2 ? lowY : lowY2;
    row.x1[i] = highX > highX2 ? highX : highX2, row.y1[i] = highY > highY2 ? highY : highY2;
    // Unsigned: large cells overflow.
    const auto cross = [](int32_t px, int32_t py, int32_t qx, int32_t qy) {
      return int32_t(uint32_t(px) * uint32_t(qy) - uint32_t(py) * uint32_t(qx));
    };
    row.area[i] = cross(bx - ax, by - ay, cx - ax, cy - ay);
    row.area2[i] = cross(dx - bx, dy - by, cx - bx, cy - by);
  }
}

/// Cell (i, j) of a grid; `cell` its number.
void drawCell(const RasterTriangles& in, const CellRow& row, uint32_t k, uint32_t i, uint32_t j,
              uint32_t cell, RasterTarget& target) {
  const int32_t x0 = row.x0[k], y0 = row.y0[k], x1 = row.x1[k], y1 = row.y1[k];
  const uint32_t stride = uint32_t(in.nu) + 1, a = j * stride + i, b = a + 1, c = a + stride, d = c + 1;
  const auto corner = [&](uint32_t v) { return Corner{in.x[v], in.y[v], in.key[v]}; };
  const auto isSkipped = [&](uint32_t p, uint32_t q, uint32_t r) {
    return in.skip && (in.skip[p] | in.skip[q] | in.skip[r]);
  };
  const uint32_t hit = in.slot << kTriangleBits | 2 * cell;
  const int32_t area = row.area[k], area2 = row.area2[k];
  const Pixels p = pixelsOf(x0, y0, x1, y1, target);
  const bool isOneQuad = x1 - x0 < kSmallSide && y1 - y0 < kSmallSide &&
                         ((area > 0 && area2 > 0) || (area < 0 && area2 < 0)) && !isSkipped(a, b, c) &&
                         !isSkipped(b, d, c);
  if (isOneQuad) {
    drawQuad(corner(a), corner(b), corner(c), corner(d), area, area2, p, x0, y0, x1, y1, hit, in.cullSign,
             target);
    return;
  }
  if (!isSkipped(a, b, c)) drawTriangle(corner(a), corner(b), corner(c), hit, in.cullSign, target);
  if (!isSkipped(b, d, c)) drawTriangle(corner(b), corner(d), corner(c), hit + 1, in.cullSign, target);
}

void drawGrid(const RasterTriangles& in, RasterTarget& target) {
  const auto columns = uint32_t(in.nu), stride = columns + 1;
  const int32_t right = target.columns << kSubpixelBits, bottom = target.rows << kSubpixelBits;
  CellRow row;
  uint32_t cell = 0;
  for (uint32_t j = 0; j < uint32_t(in.nv); ++j)
    for (uint32_t first = 0; first < columns; first += CellRow::kMost) {
      const uint32_t count = columns - first < CellRow::kMost ? columns - first : CellRow::kMost;
      measureCells(in, size_t(j) * stride + first, stride, count, row);
      for (uint32_t k = 0; k < count; ++k, ++cell) {
        if (row.x1[k] < 0 || row.y1[k] < 0 || row.x0[k] >= right || row.y0[k] >= bottom) continue;
        drawCell(in, row, k, first + k, j, cell, target);
      }
    }
}

/// Triangles n and n + 1 of a list as one quadrilateral, if that is what they make: a b c, d c b of a ribbon,
/// or a b c, a c d of a polygon. False: they are not drawn.
bool drawPair(const RasterTriangles& in, uint32_t n, RasterTarget& target) {
  if (n + 1 >= in.triangleCount || in.ids) return false;
  const uint8_t* i = in.indices + 3 * n;
  uint32_t v[4];
  if (i[4] == i[2] && i[5] == i[1])
    v[0] = i[0], v[1] = i[1], v[2] = i[2], v[3] = i[3];
  else if (i[3] == i[0] && i[4] == i[2])
    v[0] = i[1], v[1] = i[2], v[2] = i[0], v[3] = i[5];
  else
    return false;
  if (in.skip && (in.skip[v[0]] | in.skip[v[1]] | in.skip[v[2]] | in.skip[v[3]])) return false;
  const auto corner = [&](uint32_t k) { return Corner{in.x[k], in.y[k], in.key[k]}; };
  const Corner a = corner(v[0]), b = corner(v[1]), c = corner(v[2]), d = corner(v[3]);
  const int32_t x0 = min3(a.x, b.x, c.x < d.x ? c.x : d.x), x1 = max3(a.x, b.x, c.x > d.x ? c.x : d.x);
  const int32_t y0 = min3(a.y, b.y, c.y < d.y ? c.y : d.y), y1 = max3(a.y, b.y, c.y > d.y ? c.y : d.y);
  if (x1 - x0 >= kSmallSide || y1 - y0 >= kSmallSide) return false;
  const Pixels p = pixelsOf(x0, y0, x1, y1, target);
  if (p.empty()) return true;
  const auto area = int32_t(areaOf(a, b, c)), area2 = int32_t(areaOf(b, d, c));
  if (area == 0 || area2 == 0 || (area < 0) != (area2 < 0)) return false;
  drawQuad(a, b, c, d, area, area2, p, x0, y0, x1, y1, in.slot << kTriangleBits | n, in.cullSign, target);
  return true;
}

}  // namespace

void rasterise(const RasterTriangles& in, RasterTarget& target) {
  if (!in.indices) return drawGrid(in, target);
  for (uint32_t n = 0; n < in.triangleCount; ++n) {
    if (drawPair(in, n, target)) {
      ++n;
      continue;
    }
    const uint32_t v[3] = {in.indices[3 * n], in.indices[3 * n + 1], in.indices[3 * n + 2]};
    if (in.skip && (in.skip[v[0]] | in.skip[v[1]] | in.skip[v[2]])) continue;
    const auto corner = [&](uint32_t i) { return Corner{in.x[i], in.y[i], in.key[i]}; };
    const uint32_t hit = in.slot << kTriangleBits | (in.ids ? in.ids[n] : n);
    drawTriangle(corner(v[0]), corner(v[1]), corner(v[2]), hit, in.cullSign, target);
  }
}

}  // namespace fr::reyes::FR_ISA
