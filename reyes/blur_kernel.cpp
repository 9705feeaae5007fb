// Compiled once per instruction set (FR_ISA).
//
// A face that sweeps over many pixels would be tested against many samples that see it elsewhere. So its
// place is bounded for each sample number ("slot") alone: the samples of one slot are close to each other in
// time, or on the lens (SampleDimensions), so their bounds are small (compare Akenine-Möller et al.,
// "Stochastic Rasterization using Time-Continuous Triangles", 2007). What is left is tested sixteen samples
// at a time.
#include "reyes/blur_kernel.h"

#include <algorithm>
#include <bit>

#include "reyes/sample_buffer.h"
#include "shading/simd.h"

namespace fr::reyes::FR_ISA {
namespace {

using namespace fr::FR_ISA;

constexpr int kWidth = int(kLanes);
/// As in raster_kernel.cpp: triangles with sides below this are tested in int32.
constexpr int32_t kSmallSide = 16 * kSubpixels;
/// Faces whose bounds hold no more pixels than this are tested against all samples there.
constexpr int kFewPixels = 6;
/// From so many samples on it pays to look where they see the middle of the face first.
constexpr size_t kManyCandidates = 32;
constexpr int kMostKeys = 33;

template <class T>
inline T load(const void* from) {
  T v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
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
/// Bit i: lane i.
inline uint32_t maskBits(VI m) {
#if defined(FR_ISA_avx512)
  return uint32_t(_mm512_movepi32_mask((__m512i)m));
#elif defined(FR_ISA_avx2)
  return uint32_t(_mm256_movemask_ps((__m256)m));
#else
  return uint32_t(_mm_movemask_ps((__m128)m));
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

inline VI smaller(VI a, VI b) { return a < b ? a : b; }
inline VI larger(VI a, VI b) { return a > b ? a : b; }

class Drawing {
 public:
  Drawing(const BlurFaces& f, const BlurSamples& s, RasterTarget& t) : faces_(f), samples_(s), target_(t) {}

  /// False: no room for the fragments.
  bool draw(uint32_t face) {
    uint32_t v[4];
    corners_ = faces_.indices ? 3 : 4;
    if (faces_.indices) {
      for (uint32_t i = 0; i < 3; ++i) v[i] = faces_.indices[3 * face + i];
    } else {
      const auto columns = uint32_t(faces_.nu), stride = columns + 1;
      v[0] = face / columns * stride + face % columns;
      v[1] = v[0] + 1, v[2] = v[0] + stride, v[3] = v[2] + 1;
    }
    float x0 = faces_.x0[v[0]], y0 = faces_.y0[v[0]], x1 = faces_.x1[v[0]], y1 = faces_.y1[v[0]];
    uint8_t skip = faces_.skip[v[0]];
    for (int c = 1; c < corners_; ++c) {
      x0 = std::min(x0, faces_.x0[v[c]]), x1 = std::max(x1, faces_.x1[v[c]]);
      y0 = std::min(y0, faces_.y0[v[c]]), y1 = std::max(y1, faces_.y1[v[c]]);
      skip = uint8_t(skip | faces_.skip[v[c]]);
    }
    if (skip) return true;
    const Box box = pixels(x0, y0, x1, y1);
    if (box.empty()) return true;
    for (int c = 0; c < corners_; ++c)
      for (int k = 0; k < faces_.keys; ++k) {
        const size_t at = size_t(k) * faces_.vertexCount + v[c];
        corner_[c].xw[k] = faces_.xw[at], corner_[c].yw[k] = faces_.yw[at], corner_[c].z[k] = faces_.z[at];
      }
    size_t candidates = 0;
    if (box.pixels() <= kFewPixels || target_.perPixel == 1) {
      for (int row = box.row0; row <= box.row1; ++row) {
        const auto first = uint32_t(row * target_.rowStride + box.column0 * target_.perPixel);
        const auto n = uint32_t((box.column1 - box.column0 + 1) * target_.perPixel);
        for (uint32_t i = 0; i < n; ++i) samples_.candidates[candidates++] = first + i;
      }
    } else {
      for (int slot = 0; slot < target_.perPixel; slot += kWidth)
        candidates = addSlots(slot, box, candidates);
    }
    if (candidates > kManyCandidates) candidates = keepNear(candidates);
    if (candidates == 0) return true;
    if (target_.fragments && target_.fragmentCount + 2 * candidates > target_.fragmentCapacity) return false;
    ++target_.trianglesTested;
    test(face, candidates);
    return true;
  }

 private:
  struct Box {
    int column0, row0, column1, row1;
    bool empty() const { return column0 > column1 || row0 > row1; }
    int pixels() const { return (column1 - column0 + 1) * (row1 - row0 + 1); }
  };
  /// Pixels of the tile that raster bounds touch.
  Box pixels(float x0, float y0, float x1, float y1) const {
    constexpr float kSlack = 2.0f / kSubpixels;  // positions are rounded to steps
    const auto clamped = [](float v, int most) {
      // Written so that NaN ends outside.
      return v >= 0 ? (v < float(most) ? int(v) : most) : -1;
    };
    return {std::max(0, clamped(x0 - kSlack - float(faces_.originX), target_.columns)),
            std::max(0, clamped(y0 - kSlack - float(faces_.originY), target_.rows)),
            std::min(target_.columns - 1, clamped(x1 + kSlack - float(faces_.originX), target_.columns)),
            std::min(target_.rows - 1, clamped(y1 + kSlack - float(faces_.originY), target_.rows))};
  }

  Samples samplesAt(VI index) const {
    return {gather(samples_.time, index), gather(samples_.lensX, index), gather(samples_.lensY, index)};
  }

  /// Collects the samples of slots [slot, slot + kWidth) that may see the face.
  size_t addSlots(int slot, const Box& box, size_t candidates) {
    V from, to, lx0, lx1, ly0, ly1;
    for (int i = 0; i < kWidth; ++i) {
      const SlotRange& r = samples_.slots[std::min(slot + i, target_.perPixel - 1)];
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
      for (int i = 0; i < kWidth; ++i) probes = std::max(probes, within[i] + 2);
    }
    for (int p = 0; p < probes; ++p) {
      V time = from;
      if (p > 0) time = p == probes - 1 ? to : vmin(toFloat(toInt(from * float(last)) + p) / float(last), to);
      for (int c = 0; c < corners_; ++c) {
        const Blended b = blend(corner_[c], faces_.keys, time);
        V x = b.xw, y = b.yw, key = b.z;
        if (faces_.perspective) {
          const V inverse = 1.0f / b.z;
          key = -inverse, x = x * inverse, y = y * inverse;
        }
        const V shiftX = faces_.lens.x0 + faces_.lens.x1 * key,
                shiftY = faces_.lens.y0 + faces_.lens.y1 * key;
        x0 = vmin(x0, x + vmin(lx0 * shiftX, lx1 * shiftX)),
        x1 = vmax(x1, x + vmax(lx0 * shiftX, lx1 * shiftX));
        y0 = vmin(y0, y + vmin(ly0 * shiftY, ly1 * shiftY)),
        y1 = vmax(y1, y + vmax(ly0 * shiftY, ly1 * shiftY));
      }
    }
    for (int i = 0; i < kWidth && slot + i < target_.perPixel; ++i) {
      Box b = pixels(x0[i], y0[i], x1[i], y1[i]);
      b = {std::max(b.column0, box.column0), std::max(b.row0, box.row0), std::min(b.column1, box.column1),
           std::min(b.row1, box.row1)};
      for (int row = b.row0; row <= b.row1; ++row)
        for (int column = b.column0; column <= b.column1; ++column)
          samples_.candidates[candidates++] =
              uint32_t(row * target_.rowStride + column * target_.perPixel + slot + i);
    }
    return candidates;
  }

  /// The face's middle, and how far, at most, a corner is seen from it at any time, from anywhere on the lens
  /// (pixels).
  ///
  /// Between keys 0 and 1, a point whose depths are z0 and z1 is seen at (1 - s) r0 + s r1, its depth key
  /// likewise, where s = t z1 / ((1 - t) z0 + t z1). So a corner c is off the middle m by no more than at the
  /// keys, plus |s_c - s_m| times the middle's own way; and |s_c - s_m| <= |q_c - q_m| / (4 min q) with q =
  /// z1 / z0.
  void findMiddle(float* radiusX, float* radiusY) {
    const float share = 1.0f / float(corners_);
    float* xw = middle_.xw;
    float* yw = middle_.yw;
    float* z = middle_.z;
    *radiusX = *radiusY = 0;
    float lastX = 0, lastY = 0, lastKey = 0, dx0 = 0, dy0 = 0, dk0 = 0;
    for (int k = 0; k < faces_.keys; ++k) {
      xw[k] = yw[k] = z[k] = 0;
      for (int c = 0; c < corners_; ++c)
        xw[k] += share * corner_[c].xw[k], yw[k] += share * corner_[c].yw[k], z[k] += share * corner_[c].z[k];
      const auto seen = [&](float x, float y, float depth, float out[3]) {
        const float inverse = faces_.perspective ? 1 / depth : 1.0f;
        out[0] = x * inverse, out[1] = y * inverse, out[2] = faces_.perspective ? -inverse : depth;
      };
      float m[3];
      seen(xw[k], yw[k], z[k], m);
      float dx = 0, dy = 0, dk = 0, spread = 0;
      for (int c = 0; c < corners_; ++c) {
        float p[3];
        seen(corner_[c].xw[k], corner_[c].yw[k], corner_[c].z[k], p);
        dx = std::max(dx, std::abs(p[0] - m[0])), dy = std::max(dy, std::abs(p[1] - m[1]));
        dk = std::max(dk, std::abs(p[2] - m[2]));
        if (k > 0 && faces_.perspective) {
          const float q = corner_[c].z[k] / corner_[c].z[k - 1], qm = z[k] / z[k - 1];
          spread = std::max(spread, std::abs(q - qm) / (4 * std::min(q, qm)));
        }
      }
      const float wayX = k > 0 ? std::abs(m[0] - lastX) : 0, wayY = k > 0 ? std::abs(m[1] - lastY) : 0;
      const float wayKey = k > 0 ? std::abs(m[2] - lastKey) : 0;
      const float keys = std::max(dk, dk0) + spread * wayKey;
      *radiusX = std::max(*radiusX, std::max(dx, dx0) + spread * wayX + std::abs(faces_.lens.x1) * keys);
      *radiusY = std::max(*radiusY, std::max(dy, dy0) + spread * wayY + std::abs(faces_.lens.y1) * keys);
      lastX = m[0], lastY = m[1], lastKey = m[2], dx0 = dx, dy0 = dy, dk0 = dk;
    }
  }

  /// Fills the last vector of candidates with copies of the first.
  void pad(size_t candidates) {
    for (size_t i = candidates; i % size_t(kWidth) != 0; ++i) samples_.candidates[i] = samples_.candidates[0];
  }
  static uint32_t firstLanes(size_t n) { return n >= size_t(kWidth) ? ~0u : (1u << n) - 1; }

  /// Leaves out samples that see the middle of the face farther away than the face reaches.
  size_t keepNear(size_t candidates) {
    float radiusX, radiusY;
    findMiddle(&radiusX, &radiusY);
    constexpr float kSlack = 4;  // steps: what rounding adds, and a little of the radius
    const float rx = radiusX * (1.001f * kSubpixels) + kSlack, ry = radiusY * (1.001f * kSubpixels) + kSlack;
    pad(candidates);
    size_t kept = 0;
    for (size_t first = 0; first < candidates; first += size_t(kWidth)) {
      const VI index = load<VI>(samples_.candidates + first);
      const Seen m = see(faces_, middle_, samplesAt(index));
      const V dx = vabs(toFloat(m.x - gather(target_.x, index))),
              dy = vabs(toFloat(m.y - gather(target_.y, index)));
      uint32_t near = maskBits((dx <= rx) & (dy <= ry)) & firstLanes(candidates - first);
      for (; near; near &= near - 1) samples_.candidates[kept++] = uint32_t(index[std::countr_zero(near)]);
    }
    return kept;
  }

  void test(uint32_t face, size_t candidates) {
    pad(candidates);
    for (size_t first = 0; first < candidates; first += size_t(kWidth)) {
      const VI index = load<VI>(samples_.candidates + first);
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
        uint32_t hits = maskBits(inside) & firstLanes(candidates - first);
        for (; hits; hits &= hits - 1) {
          const int i = std::countr_zero(hits);
          hit(uint32_t(index[i]), faces_.slot << kTriangleBits | triangle, key[i]);
        }
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

  const BlurFaces& faces_;
  const BlurSamples& samples_;
  RasterTarget& target_;
  int corners_ = 4;  // of a face
  Track corner_[4];
  Track middle_;
};

}  // namespace

uint32_t drawBlurred(const BlurFaces& faces, uint32_t first, const BlurSamples& samples,
                     RasterTarget& target) {
  Drawing drawing(faces, samples, target);
  for (uint32_t face = first; face < faces.faceCount; ++face)
    if (!drawing.draw(face)) return face;
  return faces.faceCount;
}

}  // namespace fr::reyes::FR_ISA
