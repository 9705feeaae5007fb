// Compiled once per instruction set (FR_ISA).
//
// A face that sweeps over many pixels would be tested against many samples that see it elsewhere. So samples
// are brought to faces, not faces to samples. All faces of a grid move nearly alike, and lie nearly as deep:
// relative to the middle of the grid, wherever a sample sees that, each face keeps to a small box. A sample
// is looked up once for the whole grid, by its place relative to the middle, in a table of these boxes, and
// tested against the faces it finds there, a vector of samples at a time.
//
// Which samples are looked up: the middle's place is bounded for each sample number ("slot") alone; the
// samples of one slot are close to each other in time, or on the lens (SampleDimensions), so these bounds are
// small (compare Akenine-Möller et al., "Stochastic Rasterization using Time-Continuous Triangles", 2007).
#include "reyes/blur_kernel.h"

#include <algorithm>
#include <bit>

#include "reyes/lanes.h"
#include "reyes/sample_buffer.h"

namespace fr::reyes::FR_ISA {
namespace {

using namespace fr::FR_ISA;

constexpr int kWidth = int(kLanes);
/// As in raster_kernel.cpp: triangles with sides below this are tested in int32.
constexpr int32_t kSmallSide = 16 * kSubpixels;
constexpr int kMostKeys = 33;

inline V gather(const float* base, VI index) {
#if defined(FR_ISA_avx512)
  return (V)_mm512_mask_i32gather_ps(_mm512_setzero_ps(), 0xffff, (__m512i)index, base, 4);
#elif defined(FR_ISA_avx2)
  return (V)_mm256_i32gather_ps(base, (__m256i)index, 4);
#else
  V v;
  for (int i = 0; i < kWidth; ++i) v[i] = base[index[i]];
  return v;
#endif
}
inline VI gather(const int32_t* base, VI index) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_mask_i32gather_epi32(_mm512_setzero_si512(), 0xffff, (__m512i)index, base, 4);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_i32gather_epi32(base, (__m256i)index, 4);
#else
  VI v;
  for (int i = 0; i < kWidth; ++i) v[i] = base[index[i]];
  return v;
#endif
}
/// Rounds to nearest, as std::rint.
inline VI nearestInt(V x) {
#if defined(FR_ISA_avx512)
  return (VI)_mm512_maskz_cvtps_epi32(0xffff, (__m512)x);
#elif defined(FR_ISA_avx2)
  return (VI)_mm256_cvtps_epi32((__m256)x);
#else
  return (VI)_mm_cvtps_epi32((__m128)x);
#endif
}
/// A place at all keys.
struct Track {
  float xw[kMostKeys], yw[kMostKeys], z[kMostKeys];
};

/// Some samples.
struct Samples {
  V time, lensX, lensY;
};

/// What BlurPoint is for one sample.
struct Seen {
  VI x, y;
  V key;
};

/// A track's position before the projection, at the samples' times: as blurVertex().
struct Blended {
  V xw, yw, z;
};
inline Blended blend(const Track& track, int keys, V time) {
  if (keys == 1) return {splat(track.xw[0]), splat(track.yw[0]), splat(track.z[0])};
  const V at = time * float(keys - 1);
  if (keys == 2)
    return {track.xw[0] + at * (track.xw[1] - track.xw[0]), track.yw[0] + at * (track.yw[1] - track.yw[0]),
            track.z[0] + at * (track.z[1] - track.z[0])};
  VI k = toInt(at);
  k = k < keys - 2 ? k : splatInt(keys - 2);
  const V t = at - toFloat(k);
  const auto between = [&](const float* values) {
    const V a = gather(values, k), b = gather(values + 1, k);
    return a + t * (b - a);
  };
  return {between(track.xw), between(track.yw), between(track.z)};
}

/// As blurPoint(), bit for bit.
inline Seen see(const BlurFaces& f, const Track& track, const Samples& s) {
  const Blended p = blend(track, f.keys, s.time);
  V x = p.xw, y = p.yw, key = p.z;
  if (f.perspective) {
    const V inverse = 1.0f / p.z;
    key = -inverse, x = p.xw * inverse, y = p.yw * inverse;
  } else {
    x = p.xw * splat(1.0f), y = p.yw * splat(1.0f);
  }
  x = x + s.lensX * (f.lens.x0 + f.lens.x1 * key);
  y = y + s.lensY * (f.lens.y0 + f.lens.y1 * key);
  return {nearestInt(x * float(kSubpixels)) - f.originX * kSubpixels,
          nearestInt(y * float(kSubpixels)) - f.originY * kSubpixels, key};
}

/// Which samples lie in a small triangle, and its depth key there. Exact.
inline VI testSmall(Seen a, Seen b, Seen c, VI x, VI y, int cullSign, V* keyOut) {
  VI px = x - a.x, py = y - a.y;
  // It cannot hold a sample this far from its corner; the products below stay in range.
  const VI near = (px < kSmallSide) & (px > -kSmallSide) & (py < kSmallSide) & (py > -kSmallSide);
  px = px & near, py = py & near;
  VI area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
  const VI swap = area < 0;
  const VI bx = swap ? c.x : b.x, by = swap ? c.y : b.y, cx = swap ? b.x : c.x, cy = swap ? b.y : c.y;
  const V bk = swap ? c.key : b.key, ck = swap ? b.key : c.key;
  area = swap ? -area : area;
  // Edge p -> q holds samples with d.x * s.y - d.y * s.x >= bias, as Edge in raster_kernel.cpp.
  const VI d0x = bx - a.x, d0y = by - a.y, d1x = cx - bx, d1y = cy - by, d2x = a.x - cx, d2y = a.y - cy;
  const VI w0 = d0x * py - d0y * px;
  const VI w1 = d1x * (py - d0y) - d1y * (px - d0x);
  const VI w2 = d2x * (py + d2y) - d2y * (px + d2x);
  // The bias is 1 (here -1: a lane mask) for edges that own no sample that lies on them.
  const auto unowned = [](VI dx, VI dy) { return ~((dy > 0) | ((dy == 0) & (dx < 0))); };
  VI inside = near & (area != 0) & (w0 + unowned(d0x, d0y) >= 0) & (w1 + unowned(d1x, d1y) >= 0) &
              (w2 + unowned(d2x, d2y) >= 0);
  if (cullSign != 0) inside = inside & (cullSign < 0 ? ~swap : swap);
  const V inverse = 1.0f / toFloat(area);
  *keyOut = a.key + toFloat(w2) * ((bk - a.key) * inverse) + toFloat(w0) * ((ck - a.key) * inverse);
  return inside;
}

/// The same for triangles of any size: cold.
__attribute__((noinline)) VI testLarge(const Seen& a, const Seen& b, const Seen& c, VI x, VI y, int cullSign,
                                       V* keyOut) {
  VI inside = {};
  for (int i = 0; i < kWidth; ++i) {
    double px[3] = {double(a.x[i]), double(b.x[i]), double(c.x[i])};
    double py[3] = {double(a.y[i]), double(b.y[i]), double(c.y[i])};
    float key[3] = {a.key[i], b.key[i], c.key[i]};
    double area = (px[1] - px[0]) * (py[2] - py[0]) - (py[1] - py[0]) * (px[2] - px[0]);
    if (area == 0 || (area < 0 ? cullSign < 0 : cullSign > 0)) continue;
    if (area < 0) std::swap(px[1], px[2]), std::swap(py[1], py[2]), std::swap(key[1], key[2]), area = -area;
    double w[3];
    bool in = true;
    for (int e = 0; e < 3; ++e) {
      const double dx = px[(e + 1) % 3] - px[e], dy = py[(e + 1) % 3] - py[e];
      w[e] = dx * (double(y[i]) - py[e]) - dy * (double(x[i]) - px[e]);
      in = in && w[e] >= (dy > 0 || (dy == 0 && dx < 0) ? 0 : 1);
    }
    if (!in) continue;
    inside[i] = -1;
    const float inverse = 1 / float(area);
    (*keyOut)[i] =
        key[0] + float(w[2]) * ((key[1] - key[0]) * inverse) + float(w[0]) * ((key[2] - key[0]) * inverse);
  }
  return inside;
}

template <class T>
inline T smaller(T a, T b) {
  return a < b ? a : b;
}
template <class T>
inline T larger(T a, T b) {
  return a > b ? a : b;
}

class Drawing {
 public:
  Drawing(const BlurFaces& f, const BlurSamples& s, RasterTarget& t) : faces_(f), samples_(s), target_(t) {}

  void draw() {
    if (!findMiddle()) return;
    boundVertices();
    boundFaces();
    if (!(all_.x0 <= all_.x1)) return;
    fillTable();
    size_t candidates = 0;
    for (int slot = 0; slot < target_.perPixel; slot += kWidth) candidates = addSlots(slot, candidates);
    lookUp(candidates);
    testPairs();
  }

 private:
  /// Relative to the middle, pixels.
  struct Box {
    float x0, y0, x1, y1;
    static Box empty() { return {kInfinity, kInfinity, -kInfinity, -kInfinity}; }
    void add(const Box& o) {
      x0 = o.x0 < x0 ? o.x0 : x0, y0 = o.y0 < y0 ? o.y0 : y0;
      x1 = o.x1 > x1 ? o.x1 : x1, y1 = o.y1 > y1 ? o.y1 : y1;
    }
  };
  struct Pixels {
    int column0, row0, column1, row1;
  };

  /// The mean of the vertices, key by key. False: there is nothing to draw.
  bool findMiddle() {
    const size_t n = faces_.vertexCount;
    size_t drawn = 0;
    for (size_t v = 0; v < n; ++v) drawn += faces_.skip[v] == 0;
    if (drawn == 0) return false;
    const float share = 1.0f / float(drawn);
    nearest_ = kInfinity;
    for (int k = 0; k < faces_.keys; ++k) {
      float x = 0, y = 0, z = 0;
      for (size_t v = 0, at = size_t(k) * n; v < n; ++v, ++at) {
        if (faces_.skip[v]) continue;
        x += faces_.xw[at], y += faces_.yw[at], z += faces_.z[at];
        nearest_ = faces_.z[at] < nearest_ ? faces_.z[at] : nearest_;
      }
      middle_.xw[k] = x * share, middle_.yw[k] = y * share, middle_.z[k] = z * share;
    }
    // Keys are rounded, and interpolated.
    nearest_ = faces_.perspective ? -1 / nearest_ : nearest_;
    nearest_ -= 4e-6f * (nearest_ < 0 ? -nearest_ : nearest_);
    return true;
  }

  struct OnRaster {
    float x, y, key;
  };
  OnRaster onRaster(float xw, float yw, float z) const {
    const float inverse = faces_.perspective ? 1 / z : 1.0f;
    return {xw * inverse, yw * inverse, faces_.perspective ? -inverse : z};
  }
  static float size(float a) { return a < 0 ? -a : a; }

  /// Where each vertex is seen relative to the middle, at any time, from anywhere on the lens.
  ///
  /// Between keys 0 and 1, a point whose depths are z0 and z1 is seen at (1 - s) r0 + s r1, its depth key
  /// likewise, where s = t z1 / ((1 - t) z0 + t z1). So what a vertex v is off the middle m lies between what
  /// it is at both keys, give or take |s_v - s_m| times the middle's own way; and |s_v - s_m| <= |q_v - q_m|
  /// / (4 min q) with q = z1 / z0.
  void boundVertices() {
    const size_t n = faces_.vertexCount;
    for (size_t v = 0; v < n; ++v) vertex_[v] = Box::empty();
    OnRaster last{};
    for (int k = 0; k < faces_.keys; ++k) {
      const OnRaster m = onRaster(middle_.xw[k], middle_.yw[k], middle_.z[k]);
      const float wayX = k > 0 ? size(m.x - last.x) : 0, wayY = k > 0 ? size(m.y - last.y) : 0;
      const float wayKey = k > 0 ? size(m.key - last.key) : 0;
      const float qm = k > 0 ? middle_.z[k] / middle_.z[k - 1] : 1;
      for (size_t v = 0, at = size_t(k) * n; v < n; ++v, ++at) {
        if (faces_.skip[v]) continue;
        const OnRaster p = onRaster(faces_.xw[at], faces_.yw[at], faces_.z[at]);
        float spread = 0;
        if (k > 0 && faces_.perspective) {
          const float q = faces_.z[at] / faces_.z[at - n];
          spread = size(q - qm) / (4 * (q < qm ? q : qm));
        }
        // The lens moves what lies deeper by another distance; and depths differ at the key before, too.
        const float depth = size(p.key - m.key);
        const float keys = larger(depth, k > 0 ? depth_[v] : 0) + spread * wayKey;
        depth_[v] = depth;
        const float moreX = spread * wayX + size(faces_.lens.x1) * keys,
                    moreY = spread * wayY + size(faces_.lens.y1) * keys;
        const float dx = p.x - m.x, dy = p.y - m.y;
        Box box{dx - moreX, dy - moreY, dx + moreX, dy + moreY};
        // What the key before was off counts with this key's more, as the way between them is the same.
        if (k > 0) {
          const Box& old = off_[v];
          box.add({old.x0 - moreX, old.y0 - moreY, old.x1 + moreX, old.y1 + moreY});
        }
        off_[v] = {dx, dy, dx, dy};
        vertex_[v].add(box);
      }
      last = m;
    }
  }

  void cornersOf(uint32_t face, uint32_t v[4]) const {
    if (faces_.indices) {
      for (uint32_t i = 0; i < 3; ++i) v[i] = faces_.indices[3 * face + i];
    } else {
      const auto columns = uint32_t(faces_.nu), stride = columns + 1;
      v[0] = face / columns * stride + face % columns;
      v[1] = v[0] + 1, v[2] = v[0] + stride, v[3] = v[2] + 1;
    }
  }

  void boundFaces() {
    corners_ = faces_.indices ? 3 : 4;
    all_ = Box::empty();
    float width = 0, height = 0;
    uint32_t drawn = 0;
    for (uint32_t f = 0; f < faces_.faceCount; ++f) {
      uint32_t v[4];
      cornersOf(f, v);
      Box box = Box::empty();
      uint8_t skip = 0;
      for (int c = 0; c < corners_; ++c) box.add(vertex_[v[c]]), skip = uint8_t(skip | faces_.skip[v[c]]);
      face_[f] = Box::empty();
      if (skip || !(box.x1 - box.x0 < kInfinity) || !(box.y1 - box.y0 < kInfinity)) continue;
      // Both ends are rounded to steps, and a little for the rounding of the bounds themselves.
      const float slackX = 4.0f / kSubpixels + 0.001f * (box.x1 - box.x0),
                  slackY = 4.0f / kSubpixels + 0.001f * (box.y1 - box.y0);
      face_[f] = {box.x0 - slackX, box.y0 - slackY, box.x1 + slackX, box.y1 + slackY};
      all_.add(face_[f]);
      width += face_[f].x1 - face_[f].x0, height += face_[f].y1 - face_[f].y0, ++drawn;
    }
    if (drawn == 0) return;
    const auto cells = [&](float all, float sum) {
      const float n = all * float(drawn) / sum;
      return n < 1 ? 1 : n < float(kMostCells) ? int(n) : kMostCells;
    };
    cellsX_ = cells(all_.x1 - all_.x0, width), cellsY_ = cells(all_.y1 - all_.y0, height);
  }

  /// Cells of the table that a face's box touches.
  Pixels cellsOf(const Box& b) const {
    const auto cell = [](float at, int count) {
      return at > 0 ? (at < float(count) ? int(at) : count - 1) : 0;
    };
    return {cell((b.x0 - all_.x0) * perCellX_, cellsX_), cell((b.y0 - all_.y0) * perCellY_, cellsY_),
            cell((b.x1 - all_.x0) * perCellX_, cellsX_), cell((b.y1 - all_.y0) * perCellY_, cellsY_)};
  }
  template <class F>
  void forCells(F&& f) const {
    for (uint32_t face = 0; face < faces_.faceCount; ++face) {
      if (!(face_[face].x0 <= face_[face].x1)) continue;
      const Pixels c = cellsOf(face_[face]);
      for (int row = c.row0; row <= c.row1; ++row)
        for (int column = c.column0; column <= c.column1; ++column) f(row * cellsX_ + column, face);
    }
  }
  /// Which faces lie in which cell: those of cell c at [firstInCell_[c], firstInCell_[c + 1]).
  void fillTable() {
    for (;;) {
      perCellX_ = float(cellsX_) / (all_.x1 - all_.x0), perCellY_ = float(cellsY_) / (all_.y1 - all_.y0);
      const int cells = cellsX_ * cellsY_;
      for (int i = 0; i <= cells; ++i) firstInCell_[i] = 0;
      uint32_t entries = 0;
      forCells([&](int cell, uint32_t) { ++firstInCell_[cell + 1], ++entries; });
      if (entries <= kMostEntries) {
        for (int i = 0; i < cells; ++i) firstInCell_[i + 1] += firstInCell_[i];
        uint32_t next[kMostCells * kMostCells];
        for (int i = 0; i < cells; ++i) next[i] = firstInCell_[i];
        forCells([&](int cell, uint32_t face) { inCell_[next[cell]++] = uint16_t(face); });
        return;
      }
      // Large faces between small ones. In a single cell there is room for all.
      cellsX_ = (cellsX_ + 1) / 2, cellsY_ = (cellsY_ + 1) / 2;
    }
  }

  Samples samplesAt(VI index) const {
    return {gather(samples_.time, index), gather(samples_.lensX, index), gather(samples_.lensY, index)};
  }

  /// Collects the samples of slots [slot, slot + kWidth) that may see a face.
  size_t addSlots(int slot, size_t candidates) {
    V from, to, lx0, lx1, ly0, ly1;
    for (int i = 0; i < kWidth; ++i) {
      const SlotRange& r = samples_.slots[slot + i < target_.perPixel ? slot + i : target_.perPixel - 1];
      from[i] = r.time0, to[i] = r.time1;
      lx0[i] = r.lensX0, lx1[i] = r.lensX1, ly0[i] = r.lensY0, ly1[i] = r.lensY1;
    }
    V x0 = splat(kInfinity), y0 = x0, x1 = splat(-kInfinity), y1 = x1;
    // Between two keys what moves stays between its ends; so both ends of a slot's time and the keys within
    // bound it.
    const int last = faces_.keys - 1;
    int probes = last == 0 ? 1 : 2;
    if (last > 1) {
      const VI within = toInt(to * float(last)) - toInt(from * float(last));
      for (int i = 0; i < kWidth; ++i) probes = within[i] + 2 > probes ? within[i] + 2 : probes;
    }
    for (int p = 0; p < probes; ++p) {
      V time = from;
      if (p > 0) time = p == probes - 1 ? to : vmin(toFloat(toInt(from * float(last)) + p) / float(last), to);
      const Blended b = blend(middle_, faces_.keys, time);
      V x = b.xw, y = b.yw, key = b.z;
      if (faces_.perspective) {
        const V inverse = 1.0f / b.z;
        key = -inverse, x = x * inverse, y = y * inverse;
      }
      const V shiftX = faces_.lens.x0 + faces_.lens.x1 * key, shiftY = faces_.lens.y0 + faces_.lens.y1 * key;
      x0 = vmin(x0, x + vmin(lx0 * shiftX, lx1 * shiftX)),
      x1 = vmax(x1, x + vmax(lx0 * shiftX, lx1 * shiftX));
      y0 = vmin(y0, y + vmin(ly0 * shiftY, ly1 * shiftY)),
      y1 = vmax(y1, y + vmax(ly0 * shiftY, ly1 * shiftY));
    }
    for (int i = 0; i < kWidth && slot + i < target_.perPixel; ++i) {
      const Pixels p = pixels(x0[i] + all_.x0, y0[i] + all_.y0, x1[i] + all_.x1, y1[i] + all_.y1);
      for (int row = p.row0; row <= p.row1; ++row) {
        auto at = uint32_t(row * target_.rowStride + p.column0 * target_.perPixel + slot + i);
        for (int column = p.column0; column <= p.column1; ++column, at += uint32_t(target_.perPixel))
          samples_.candidates[candidates++] = at;
      }
    }
    return candidates;
  }
  /// Pixels of the tile that raster bounds touch.
  Pixels pixels(float x0, float y0, float x1, float y1) const {
    constexpr float kSlack = 2.0f / kSubpixels;  // positions are rounded to steps
    const auto clamped = [](float v, int most) {
      // Written so that NaN ends outside.
      return v >= 0 ? (v < float(most) ? int(v) : most) : -1;
    };
    const int column0 = clamped(x0 - kSlack - float(faces_.originX), target_.columns);
    const int row0 = clamped(y0 - kSlack - float(faces_.originY), target_.rows);
    const int column1 = clamped(x1 + kSlack - float(faces_.originX), target_.columns);
    const int row1 = clamped(y1 + kSlack - float(faces_.originY), target_.rows);
    return {column0 < 0 ? 0 : column0, row0 < 0 ? 0 : row0,
            column1 < target_.columns ? column1 : target_.columns - 1,
            row1 < target_.rows ? row1 : target_.rows - 1};
  }

  /// Finds the faces whose boxes hold the samples.
  void lookUp(size_t candidates) {
    // The last vector is filled with copies, which do not count.
    for (size_t i = candidates; i % size_t(kWidth) != 0; ++i) samples_.candidates[i] = samples_.candidates[0];
    for (size_t first = 0; first < candidates; first += size_t(kWidth)) {
      const VI index = load<VI>(samples_.candidates + first);
      const Seen m = see(faces_, middle_, samplesAt(index));
      const V dx = toFloat(gather(target_.x, index) - m.x) * (1.0f / kSubpixels),
              dy = toFloat(gather(target_.y, index) - m.y) * (1.0f / kSubpixels);
      uint32_t mask = maskBits((dx >= all_.x0) & (dx <= all_.x1) & (dy >= all_.y0) & (dy <= all_.y1) &
                               (gather(target_.depth, index) >= nearest_));
      if (candidates - first < size_t(kWidth)) mask &= (1u << (candidates - first)) - 1;
      if (mask == 0) continue;
      VI column = toInt((dx - all_.x0) * perCellX_), row = toInt((dy - all_.y0) * perCellY_);
      column = column < cellsX_ - 1 ? column : splatInt(cellsX_ - 1);
      row = row < cellsY_ - 1 ? row : splatInt(cellsY_ - 1);
      const VI cell = row * cellsX_ + column;
      for (; mask; mask &= mask - 1) {
        const int i = std::countr_zero(mask);
        const float x = dx[i], y = dy[i];
        const uint32_t end = firstInCell_[cell[i] + 1];
        if (pairs_ + (end - firstInCell_[cell[i]]) > kMostBlurPairs) testPairs();
        for (uint32_t e = firstInCell_[cell[i]]; e < end; ++e) {
          const uint32_t face = inCell_[e];
          const Box& b = face_[face];
          samples_.pairs[pairs_] = {uint32_t(index[i]), face};
          pairs_ += (x >= b.x0) & (x <= b.x1) & (y >= b.y0) & (y <= b.y1);
        }
      }
    }
  }

  /// Tests the pairs that were found, face by face.
  void testPairs() {
    if (pairs_ == 0) return;
    for (uint32_t f = 0; f <= faces_.faceCount; ++f) firstPair_[f] = 0;
    for (size_t i = 0; i < pairs_; ++i) ++firstPair_[samples_.pairs[i].face];
    for (uint32_t f = 0, sum = 0; f <= faces_.faceCount; ++f) {
      const uint32_t count = firstPair_[f];
      firstPair_[f] = sum, sum += count;
    }
    for (size_t i = 0; i < pairs_; ++i)
      samples_.sorted[firstPair_[samples_.pairs[i].face]++] = samples_.pairs[i].sample;
    // firstPair_[f] is now where the next face begins.
    for (uint32_t f = 0, begin = 0; f < faces_.faceCount; begin = firstPair_[f], ++f)
      if (firstPair_[f] > begin) testFace(f, samples_.sorted + begin, firstPair_[f] - begin);
    pairs_ = 0;
  }

  void testFace(uint32_t face, const uint32_t* samples, size_t count) {
    ++target_.trianglesTested;
    uint32_t v[4];
    cornersOf(face, v);
    for (int c = 0; c < corners_; ++c)
      for (int k = 0; k < faces_.keys; ++k) {
        const size_t at = size_t(k) * faces_.vertexCount + v[c];
        corner_[c].xw[k] = faces_.xw[at], corner_[c].yw[k] = faces_.yw[at], corner_[c].z[k] = faces_.z[at];
      }
    for (size_t first = 0; first < count; first += size_t(kWidth)) {
      VI index;
      uint32_t lanes = ~0u;
      if (count - first >= size_t(kWidth)) {
        index = load<VI>(samples + first);
      } else {
        lanes = (1u << (count - first)) - 1;
        index = splatInt(int32_t(samples[first]));
        for (size_t i = 1; first + i < count; ++i) index[i] = int32_t(samples[first + i]);
      }
      test(face, index, lanes);
    }
  }

  void test(uint32_t face, VI index, uint32_t lanes) {
    const Samples s = samplesAt(index);
    const VI x = gather(target_.x, index), y = gather(target_.y, index);
    Seen seen[4];
    seen[0] = see(faces_, corner_[0], s);
    VI x0 = seen[0].x, x1 = x0, y0 = seen[0].y, y1 = y0;
    for (int c = 1; c < corners_; ++c) {
      seen[c] = see(faces_, corner_[c], s);
      x0 = smaller(x0, seen[c].x), x1 = larger(x1, seen[c].x);
      y0 = smaller(y0, seen[c].y), y1 = larger(y1, seen[c].y);
    }
    const bool small = !anyLane((x1 - x0 >= kSmallSide) | (y1 - y0 >= kSmallSide));
    for (int t = 0; t < corners_ - 2; ++t) {
      // (0, 1, 2) and (1, 3, 2), as gridTriangle().
      const Seen &a = seen[t], &b = seen[t ? 3 : 1], &c = seen[2];
      V key = {};
      const VI inside = small ? testSmall(a, b, c, x, y, faces_.cullSign, &key)
                              : testLarge(a, b, c, x, y, faces_.cullSign, &key);
      const uint32_t triangle = corners_ == 3 ? face : 2 * face + uint32_t(t);
      uint32_t hits = maskBits(inside) & lanes;
      if (target_.fragments && target_.fragmentCount + size_t(kWidth) > target_.fragmentCapacity)
        target_.drain(target_);
      for (; hits; hits &= hits - 1) {
        const int i = std::countr_zero(hits);
        hit(uint32_t(index[i]), faces_.slot << kTriangleBits | triangle, key[i]);
      }
    }
  }

  void hit(uint32_t sample, uint32_t hit, float key) {
    float& depth = target_.depth[sample];
    if (target_.fragments) {
      if (key <= depth) target_.fragments[target_.fragmentCount++] = {sample, hit, key, 0};
      return;
    }
    uint32_t& other = target_.hit[sample];
    if (key < depth) {
      depth = key, other = hit;
    } else if (key == depth && other != kNothing && other != hit) {
      const uint64_t mine = target_.slotRank[hit >> kTriangleBits],
                     its = target_.slotRank[other >> kTriangleBits];
      if (mine < its || (mine == its && (hit & kTriangleMask) < (other & kTriangleMask))) other = hit;
    }
  }

  static constexpr int kMostCells = 24;  // of the table, each way
  static constexpr uint32_t kMostFaces = 1u << kTriangleBits, kMostEntries = 8 * kMostFaces;

  const BlurFaces& faces_;
  const BlurSamples& samples_;
  RasterTarget& target_;
  int corners_ = 4;  // of a face
  Track corner_[4];
  Track middle_;
  float nearest_ = 0;  // key
  Box all_;
  int cellsX_ = 1, cellsY_ = 1;
  float perCellX_ = 1, perCellY_ = 1;
  size_t pairs_ = 0;
  Box vertex_[kMostBlurVertices], off_[kMostBlurVertices], face_[kMostFaces];
  float depth_[kMostBlurVertices];
  uint32_t firstInCell_[kMostCells * kMostCells + 1], firstPair_[kMostFaces + 1];
  uint16_t inCell_[kMostEntries];
};

}  // namespace

void drawBlurred(const BlurFaces& faces, const BlurSamples& samples, RasterTarget& target) {
  Drawing(faces, samples, target).draw();
}

}  // namespace fr::reyes::FR_ISA
