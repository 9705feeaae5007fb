// shadow(): percentage-closer filtering (Reeves, Salesin, Cook, "Rendering Antialiased Shadows with Depth
// Maps", SIGGRAPH 1987) over maps of camera-space depth.
//
// A small region is summed exactly, texel by texel, weighted by what the region covers of each; a large one
// is sampled at jittered places. A texel is compared with the receiver's own plane above it, so that a flat
// receiver does not shadow itself: a texel holds the smallest depth of its pixel, so half a texel's slope is
// the bias that is needed.
#include <algorithm>
#include <cstring>

#include "shading/textures/texture_cache.h"

namespace fr::textures {
namespace {

/// Regions up to this many texels are summed exactly.
constexpr int kMostExactTexels = 64;
constexpr int kMostSamples = 1024;
/// Steepest receiver, as the tangent of its angle to the map's picture plane: beyond it the plane says
/// nothing.
constexpr float kSteepest = 20;

struct Matrix {
  double m[16];
  Matrix operator*(const Matrix& o) const {
    Matrix r{};
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j)
        for (int k = 0; k < 4; ++k) r.m[i * 4 + j] += m[i * 4 + k] * o.m[k * 4 + j];
    return r;
  }
};
Matrix fromFloats(const float* f) {
  Matrix r;
  std::copy(f, f + 16, r.m);
  return r;
}

uint64_t mix(uint64_t x) {
  x ^= x >> 30, x *= 0xbf58476d1ce4e5b9ull;
  x ^= x >> 27, x *= 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}
/// The next of a stream of numbers in [0, 1).
float nextUnit(uint64_t& state) {
  state += 0x9e3779b97f4a7c15ull;
  return float(mix(state) >> 40) * (1.0f / 16777216.0f);
}

/// The tiles that the points of one call touch: points of a batch lie close together. Held until the call
/// ends.
class Tiles {
 public:
  explicit Tiles(FrTextureFile& file) : file_(file), thread_(file.textures->images->get_perthread_info()) {}
  ~Tiles() {
    for (Entry& e : entries_)
      if (e.tile) file_.textures->images->release_tile(e.tile);
  }
  Tiles(const Tiles&) = delete;
  Tiles& operator=(const Tiles&) = delete;
  bool failed() const { return failed_; }

  float depth(int x, int y) {
    const int column = x / file_.tileWidth, row = y / file_.tileHeight;
    Entry& e = entries_[size_t(column & 3) + 4 * size_t(row & 3)];
    if (e.column != column || e.row != row) load(e, column, row);
    if (!e.floats) return 1e38f;
    return e.floats[size_t(y - e.y0) * e.stride + size_t(x - e.x0)];
  }

 private:
  struct Entry {
    int column = -1, row = -1;
    OIIO::ImageCache::Tile* tile = nullptr;
    const float* floats = nullptr;
    int x0 = 0, y0 = 0;
    size_t stride = 0;
  };
  void load(Entry& e, int column, int row) {
    OIIO::ImageCache& images = *file_.textures->images;
    if (e.tile) images.release_tile(e.tile);
    e = {};
    e.column = column, e.row = row;
    const int c = file_.depthChannel;
    e.tile = images.get_tile(file_.image, thread_, 0, 0, column * file_.tileWidth, row * file_.tileHeight, 0,
                             c, c + 1);
    OIIO::TypeDesc format;
    const void* const texels = e.tile ? images.tile_pixels(e.tile, format) : nullptr;
    if (!texels || format != OIIO::TypeDesc::FLOAT) {
      failed_ = true;
      return;
    }
    const OIIO::ROI roi = images.tile_roi(e.tile);
    e.floats = static_cast<const float*>(texels);
    e.x0 = roi.xbegin, e.y0 = roi.ybegin;
    e.stride = size_t(roi.width()) * size_t(std::max(1, roi.nchannels()));
  }

  FrTextureFile& file_;
  OIIO::ImageCache::Perthread* thread_;
  Entry entries_[16];
  bool failed_ = false;
};

/// A map's camera, from current space to texels and depth.
struct Camera {
  Camera(const FrTextureFile& file, const double* currentToWorld)
      : width(file.info.width), height(file.info.height) {
    Matrix current{};
    if (currentToWorld)
      std::copy(currentToWorld, currentToWorld + 16, current.m);
    else
      for (int k = 0; k < 4; ++k) current.m[k * 5] = 1;
    toCamera = current * fromFloats(file.info.worldToCamera);
    toScreen = current * fromFloats(file.info.worldToScreen);
  }
  /// False: behind the camera.
  bool project(const double p[3], float& x, float& y, float& z) const {
    const auto row = [&](const Matrix& m, int c) {
      return p[0] * m.m[c] + p[1] * m.m[4 + c] + p[2] * m.m[8 + c] + m.m[12 + c];
    };
    const double w = row(toScreen, 3);
    if (!(w > 1e-20)) return false;
    x = float((0.5 + 0.5 * row(toScreen, 0) / w) * width);
    y = float((0.5 - 0.5 * row(toScreen, 1) / w) * height);
    z = float(row(toCamera, 2));
    return std::isfinite(x) && std::isfinite(y) && std::isfinite(z);
  }
  Matrix toCamera, toScreen;
  double width, height;
};

/// The receiver around a point: depth and its change from texel to texel.
struct Receiver {
  float x = 0, y = 0, z = 0;
  float slopeX = 0, slopeY = 0;
  float depthAt(float px, float py) const { return z + slopeX * (px - x) + slopeY * (py - y); }
};

struct Region {
  float x0, x1, y0, y1;  // texels
};

template <class Closer>
float exactFraction(const Region& r, int width, int height, Tiles& tiles, const Closer& closer) {
  const int x0 = int(std::floor(r.x0)), x1 = int(std::ceil(r.x1)), y0 = int(std::floor(r.y0)),
            y1 = int(std::ceil(r.y1));
  float dark = 0, all = 0;
  for (int y = y0; y < y1; ++y) {
    const float covered = std::min(r.y1, float(y + 1)) - std::max(r.y0, float(y));
    for (int x = x0; x < x1; ++x) {
      const float weight = covered * (std::min(r.x1, float(x + 1)) - std::max(r.x0, float(x)));
      all += weight;
      // Outside of the map nothing is in the way.
      if (x < 0 || y < 0 || x >= width || y >= height) continue;
      if (closer(tiles.depth(x, y), float(x) + 0.5f, float(y) + 0.5f)) dark += weight;
    }
  }
  return all > 0 ? dark / all : 0.0f;
}

template <class Closer>
float sampledFraction(const Region& r, int width, int height, int samples, uint64_t& random, Tiles& tiles,
                      const Closer& closer) {
  const int columns = std::max(1, int(std::sqrt(float(samples)))), rows = std::max(1, samples / columns);
  int dark = 0;
  for (int k = 0; k < columns * rows; ++k) {
    const float u = (float(k % columns) + nextUnit(random)) / float(columns);
    const float v = (float(k / columns) + nextUnit(random)) / float(rows);
    const int x = int(std::floor(r.x0 + u * (r.x1 - r.x0))), y = int(std::floor(r.y0 + v * (r.y1 - r.y0)));
    if (x < 0 || y < 0 || x >= width || y >= height) continue;
    if (closer(tiles.depth(x, y), float(x) + 0.5f, float(y) + 0.5f)) ++dark;
  }
  return float(dark) / float(columns * rows);
}

/// The corners of a light as those of a patch; two are a line, three the corner between two sides.
struct Source {
  Source(const FrTextureCall& call, uint32_t lane) : count(call.sourceCount) {
    for (int k = 0; k < count; ++k)
      for (int c = 0; c < 3; ++c) corner[k][c] = double(at(call.source[k][c], lane));
    for (int c = 0; c < 3; ++c) {
      if (count == 1) corner[1][c] = corner[0][c];
      if (count == 3) corner[3][c] = corner[1][c] + corner[2][c] - corner[0][c];
    }
    if (count < 3)
      for (int k = 0; k < 2; ++k) std::copy(corner[k], corner[k] + 3, corner[k + 2]);
    // Given around, the last two change places: the better parallelogram is meant.
    const auto bend = [&](int a, int b) {
      double sum = 0;
      for (int c = 0; c < 3; ++c) {
        const double d = corner[0][c] + corner[a][c] - corner[1][c] - corner[b][c];
        sum += d * d;
      }
      return sum;
    };
    if (count == 4 && bend(2, 3) < bend(3, 2)) std::swap(corner[2], corner[3]);
  }
  void place(double u, double v, double p[3]) const {
    for (int c = 0; c < 3; ++c)
      p[c] = (1 - v) * ((1 - u) * corner[0][c] + u * corner[1][c]) +
             v * ((1 - u) * corner[2][c] + u * corner[3][c]);
  }
  int count;
  double corner[4][3];
};

/// How much of an area light a point does not see: lines to places on it are followed through what the map
/// knows. A line is stopped where it comes out of the front of something: what is behind that front is not
/// known, so a line that leaves it at a side passes.
float hiddenFraction(const Source& source, const double p[3], float bias, int samples, const Camera& camera,
                     int width, int height, uint64_t& random, Tiles& tiles) {
  constexpr int kSteps = 24;
  const int columns = std::max(1, int(std::sqrt(float(samples)))), rows = std::max(1, samples / columns);
  int dark = 0;
  for (int k = 0; k < columns * rows; ++k) {
    double to[3];
    source.place((double(k % columns) + double(nextUnit(random))) / columns,
                 (double(k / columns) + double(nextUnit(random))) / rows, to);
    const double shift = double(nextUnit(random));
    bool behind = false, stopped = false;
    float last = 0;
    for (int step = 0; step < kSteps && !stopped; ++step) {
      const double t = (step + shift) / kSteps;
      double q[3];
      for (int c = 0; c < 3; ++c) q[c] = p[c] + t * (to[c] - p[c]);
      float x, y, z;
      if (!camera.project(q, x, y, z) || x < 0 || y < 0 || x >= float(width) || y >= float(height)) {
        behind = false;
        break;
      }
      const float front = tiles.depth(int(x), int(y));
      const bool now = front < z - bias;
      stopped = behind && !now && front < last;
      behind = now, last = z;
    }
    if (stopped || behind) ++dark;
  }
  return float(dark) / float(columns * rows);
}

}  // namespace

std::string lookUpShadow(FrTextureFile& file, const FrTextureCall& call) {
  if (!file.info.hasCamera) return "it holds no camera matrices: it is no shadow map";
  const Camera camera(file, call.currentToWorld);
  Tiles tiles(file);
  const int width = file.info.width, height = file.info.height;
  const int samples = std::clamp(call.samples, 1, kMostSamples);
  const float sWidth = std::max(0.0f, bounded(call.sWidth, 1e6f)),
              tWidth = std::max(0.0f, bounded(call.tWidth, 1e6f));
  uint64_t count = 0;
  for (uint32_t i = 0; i < call.lanes; ++i) {
    if (call.active && !call.active[i]) continue;
    ++count;
    float& result = call.result[i];
    result = -1;
    double p[3];
    for (int c = 0; c < 3; ++c) p[c] = double(at(call.place[c], i));
    Receiver r;
    if (!camera.project(p, r.x, r.y, r.z) || r.x < 0 || r.y < 0 || r.x >= float(width) ||
        r.y >= float(height))
      continue;
    float change[2][3] = {};  // x, y, z for one step in u and in v
    for (int k = 0; k < 2; ++k) {
      double q[3];
      for (int c = 0; c < 3; ++c) q[c] = p[c] + double(at(k == 0 ? call.placeDx[c] : call.placeDy[c], i));
      float x, y, z;
      if (!camera.project(q, x, y, z)) continue;
      change[k][0] = bounded(x - r.x, 1e6f), change[k][1] = bounded(y - r.y, 1e6f);
      change[k][2] = bounded(z - r.z, 1e18f);
    }
    const float det = change[0][0] * change[1][1] - change[0][1] * change[1][0];
    // How much of the map's picture plane one texel is, at this depth.
    const double w = (p[0] * camera.toScreen.m[3] + p[1] * camera.toScreen.m[7] +
                      p[2] * camera.toScreen.m[11] + camera.toScreen.m[15]);
    const double xScale =
        std::sqrt(camera.toScreen.m[0] * camera.toScreen.m[0] + camera.toScreen.m[4] * camera.toScreen.m[4] +
                  camera.toScreen.m[8] * camera.toScreen.m[8]);
    const float texel = float(2 * w / (std::max(xScale, 1e-20) * width));
    if (std::fabs(det) > 1e-12f) {
      r.slopeX = (change[0][2] * change[1][1] - change[1][2] * change[0][1]) / det;
      r.slopeY = (change[1][2] * change[0][0] - change[0][2] * change[1][0]) / det;
      const float steep = std::max(std::fabs(r.slopeX), std::fabs(r.slopeY)), most = kSteepest * texel;
      if (steep > most) r.slopeX *= most / steep, r.slopeY *= most / steep;
    }
    float reachX = (std::fabs(change[0][0]) + std::fabs(change[1][0])) * sWidth;
    float reachY = (std::fabs(change[0][1]) + std::fabs(change[1][1])) * tWidth;
    reachX += std::max(0.0f, boundedChange(at(call.sBlur, i))) * float(width);
    reachY += std::max(0.0f, boundedChange(at(call.tBlur, i))) * float(height);
    // Never less than a texel: shadows of magnified texels have ramps for edges.
    reachX = std::clamp(reachX, 1.0f, 2.0f * float(width)),
    reachY = std::clamp(reachY, 1.0f, 2.0f * float(height));
    const Region region{r.x - 0.5f * reachX, r.x + 0.5f * reachX, r.y - 0.5f * reachY, r.y + 0.5f * reachY};

    uint64_t random = mix((call.seed ? call.seed[i] : 0) + 0x9e3779b97f4a7c15ull);
    const float given = call.bias.data ? at(call.bias, i) : -1.0f;
    const bool automatic = !(given >= 0) && call.biasHigh < 0;
    const float slopeBias =
        automatic ? 0.5f * (std::fabs(r.slopeX) + std::fabs(r.slopeY)) + 0.5f * texel + 1e-5f * std::fabs(r.z)
                  : 0.0f;
    if (call.sourceCount > 0) {
      const float bias = given >= 0 ? given : automatic ? slopeBias : call.biasHigh;
      result = hiddenFraction(Source(call, i), p, bias, samples, camera, width, height, random, tiles);
      continue;
    }
    const auto closer = [&](float depth, float x, float y) {
      float bias = slopeBias;
      if (given >= 0)
        bias = given;
      else if (!automatic)
        bias = call.biasLow + (call.biasHigh - call.biasLow) * nextUnit(random);
      return depth < r.depthAt(x, y) - bias;
    };
    result = (reachX + 2) * (reachY + 2) <= float(kMostExactTexels)
                 ? exactFraction(region, width, height, tiles, closer)
                 : sampledFraction(region, width, height, samples, random, tiles, closer);
  }
  file.textures->lookups.fetch_add(count, std::memory_order_relaxed);
  if (!tiles.failed()) return "";
  const std::string why = file.textures->images->geterror();
  return why.empty() ? "it holds no depths as floats: make it with mkmip -shadow" : why;
}

}  // namespace fr::textures
