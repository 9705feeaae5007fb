// What dicing, hiding and filtering cost beside plain loops over the same data, on one thread, by turns.
//   stage_bench [--seconds 1]
// A plain loop is what one would write first, as well as one would: no virtual calls, no allocation, floats
// in arrays that the compiler may vectorise, nothing checked. Shading beside code by hand is shading_bench's,
// rays beside Embree alone are oracle_bench's.
#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include "base/error.h"
#include "imaging/film.h"
#include "reyes/grid_projection.h"
#include "reyes/sample_buffer.h"
#include "ri/reader.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_builder.h"

namespace {

using namespace fr;

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Prints the least time an item of both, which run by turns for about `seconds`; each call handles `items`.
void compare(const char* stage, const char* unit, double items, double seconds,
             const std::function<void()>& ours, const std::function<void()>& plain) {
  double best[2] = {1e30, 1e30};
  ours(), plain();
  for (const double end = now() + seconds; now() < end;)
    for (int k = 0; k < 2; ++k) {
      const double start = now();
      (k == 0 ? ours : plain)();
      best[k] = std::min(best[k], now() - start);
    }
  fmt::print("{:28} {:8.1f} {:8.1f}   million {} a second, ours and plain; ours takes {:.2f} of the time\n",
             stage, items / best[0] * 1e-6, items / best[1] * 1e-6, unit, best[0] / best[1]);
}

// ---- dicing

/// side x side patches that cover the picture, each bent in its own way.
using Controls = std::array<Vec3, 16>;
std::vector<Controls> patches(int side) {
  std::vector<Controls> all;
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      Controls c;
      for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i) {
          const float u = (float(x) + float(i) / 3) / float(side),
                      v = (float(y) + float(j) / 3) / float(side);
          c[size_t(4 * j + i)] = {3.4f * u - 1.7f, 2.6f * v - 1.3f,
                                  0.1f * std::sin(9 * u + float(i)) * std::cos(8 * v + float(j))};
        }
      all.push_back(c);
    }
  return all;
}

std::string ribOf(const std::vector<Controls>& all) {
  std::string rib =
      "Format 640 480 1 PixelSamples 4 4 ShadingRate 1 Projection \"perspective\" \"fov\" [40] Translate 0 0 "
      "4 "
      "WorldBegin Basis \"bezier\" 3 \"bezier\" 3\n";
  for (const Controls& c : all) {
    rib += "Patch \"bicubic\" \"P\" [";
    for (const Vec3& p : c) rib += fmt::format("{} {} {} ", p.x, p.y, p.z);
    rib += "]\n";
  }
  return rib + "WorldEnd\n";
}

[[noreturn]] void stop(const Error& e) {
  report(e);
  std::exit(1);
}

cache::Frame frameOf(const std::string& rib) {
  cache::Frame frame;
  cache::SceneBuilder builder({}, [&](cache::Frame&& f) { return frame = std::move(f), true; }, {});
  ri::Reader reader(builder);
  if (auto r = reader.readBuffer(rib, "stage_bench.rib"); !r) stop(r.error());
  builder.finish();
  return frame;
}

std::unique_ptr<cache::SceneCache> open(const cache::Frame& frame) {
  auto made = cache::SceneCache::create(frame.skeletonFd());
  if (!made) stop(made.error());
  return std::move(*made);
}

void visit(cache::SceneCache& c, cache::NodeId id,
           const std::function<void(cache::NodeId, const cache::GridRecord&)>& f) {
  const cache::ResolvedNode n = c.resolve(id);
  if (n.state == cache::NodeState::kSplit)
    for (const cache::NodeId child : n.children) visit(c, child, f);
  else if (n.state == cache::NodeState::kGrid)
    f(id, *n.grid);
}

/// A grid of the patch with this number.
struct Piece {
  size_t patch;
  int nu, nv;
};

/// Positions of a grid over a Bezier patch: curves in v first, then points along u.
void plainDice(const Controls& c, const Piece& p, float* to) {
  const auto bernstein = [](float t) {
    const float s = 1 - t;
    return std::array{s * s * s, 3 * s * s * t, 3 * s * t * t, t * t * t};
  };
  std::array<std::array<float, 4>, cache::kMaxGridSide + 1> alongU;
  for (int i = 0; i <= p.nu; ++i) alongU[size_t(i)] = bernstein(float(i) / float(p.nu));
  for (int j = 0; j <= p.nv; ++j) {
    const auto v = bernstein(float(j) / float(p.nv));
    Vec3 row[4];
    for (size_t i = 0; i < 4; ++i)
      row[i] = v[0] * c[i] + v[1] * c[4 + i] + v[2] * c[8 + i] + v[3] * c[12 + i];
    for (int i = 0; i <= p.nu; ++i) {
      const auto& u = alongU[size_t(i)];
      const Vec3 q = u[0] * row[0] + u[1] * row[1] + u[2] * row[2] + u[3] * row[3];
      *to++ = q.x, *to++ = q.y, *to++ = q.z;
    }
  }
}

// ---- hiding

/// A tile, and the grids that are seen in it.
struct HideTile {
  PixelRect rect{304, 224, 336, 256};
  std::vector<cache::GridView> grids;
};

/// Each micropolygon against all samples of the pixels that its box touches, in floating point.
void plainHide(const HideTile& tile, const reyes::RasterSpace& space, const reyes::SampleBuffer& samples,
               std::vector<float>& depth, std::vector<uint32_t>& hit) {
  std::array<float, (cache::kMaxGridSide + 1) * (cache::kMaxGridSide + 1)> x, y, z;
  const float scale = 1.0f / kSubpixels;
  std::fill(depth.begin(), depth.end(), kInfinity);
  for (size_t g = 0; g < tile.grids.size(); ++g) {
    const cache::GridView& view = tile.grids[g];
    const int nu = view.record->nu, nv = view.record->nv;
    for (int j = 0; j <= nv; ++j)
      for (int i = 0; i <= nu; ++i) {
        const Vec4 h = space.homogeneous(view.vertex(size_t(j) * view.record->rowStride + size_t(i)));
        const size_t k = size_t(j * (nu + 1) + i);
        x[k] = h.x / h.z - float(tile.rect.x0), y[k] = h.y / h.z - float(tile.rect.y0), z[k] = space.key(h.w);
      }
    for (int j = 0; j < nv; ++j)
      for (int i = 0; i < nu; ++i) {
        const size_t a = size_t(j * (nu + 1) + i),
                     corner[4] = {a, a + 1, a + size_t(nu) + 2, a + size_t(nu) + 1};
        float x0 = x[a], x1 = x0, y0 = y[a], y1 = y0;
        for (const size_t c : corner)
          x0 = std::min(x0, x[c]), x1 = std::max(x1, x[c]), y0 = std::min(y0, y[c]), y1 = std::max(y1, y[c]);
        const int column0 = std::max(0, int(std::floor(x0))), column1 = std::min(31, int(std::floor(x1)));
        const int row0 = std::max(0, int(std::floor(y0))), row1 = std::min(31, int(std::floor(y1)));
        // Mean plane of the four corners; edges as half planes.
        const float area = (x[corner[2]] - x[a]) * (y[corner[3]] - y[corner[1]]) -
                           (x[corner[3]] - x[corner[1]]) * (y[corner[2]] - y[a]);
        const float sign = area < 0 ? -1.0f : 1.0f,
                    mean = 0.25f * (z[a] + z[corner[1]] + z[corner[2]] + z[corner[3]]);
        for (int r = row0; r <= row1; ++r)
          for (int c = column0; c <= column1; ++c) {
            const size_t first = samples.index(c, r), end = first + size_t(samples.perPixel());
            for (size_t s = first; s < end; ++s) {
              const float sx = float(samples.x[s]) * scale, sy = float(samples.y[s]) * scale;
              bool inside = true;
              for (int e = 0; e < 4; ++e) {
                const size_t p = corner[e], q = corner[(e + 1) & 3];
                inside &= sign * ((x[q] - x[p]) * (sy - y[p]) - (y[q] - y[p]) * (sx - x[p])) >= 0;
              }
              if (inside && mean < depth[s])
                depth[s] = mean, hit[s] = uint32_t(g << reyes::kTriangleBits | a);
            }
          }
      }
  }
}

void ourHide(const HideTile& tile, const reyes::RasterSpace& space, const SamplePattern& pattern,
             reyes::SampleBuffer& samples, reyes::ProjectedGrid& projected,
             const std::vector<uint64_t>& ranks) {
  samples.reset(tile.rect, pattern, space.farKey());
  reyes::RasterTarget target;
  target.columns = tile.rect.width(), target.rows = tile.rect.height();
  target.perPixel = samples.perPixel(), target.rowStride = samples.rowStride();
  target.x = samples.x.data(), target.y = samples.y.data(), target.xy = samples.xy.data();
  target.groups = samples.groups().empty() ? nullptr : samples.groups().data();
  target.groupSize = reyes::rasterWidth();
  target.depth = samples.depth.data(), target.hit = samples.hit.data(), target.slotRank = ranks.data();
  const reyes::RasterFunction draw = reyes::rasterFunction();
  for (size_t g = 0; g < tile.grids.size(); ++g) {
    const cache::GridView& view = tile.grids[g];
    reyes::projectGrid(space, view.positions, view.record->nu + 1, view.record->nv + 1,
                       view.record->rowStride, tile.rect, projected);
    reyes::RasterTriangles t;
    t.x = projected.x.data(), t.y = projected.y.data(), t.key = projected.key.data();
    t.nu = view.record->nu, t.nv = view.record->nv, t.slot = uint32_t(g);
    t.triangleCount = uint32_t(2 * t.nu * t.nv);
    draw(t, target);
  }
}

// ---- filtering

/// Every sample to the pixels around its own; weights of both directions are computed, not looked up.
void plainFilter(const PixelFilter& filter, int side, int perPixel, const std::vector<float>& x,
                 const std::vector<float>& y, const std::vector<std::vector<float>>& channels,
                 std::vector<float>& sums) {
  const int reach = filter.xReach(), row = side + 2 * reach, n = int(channels.size());
  std::fill(sums.begin(), sums.end(), 0.0f);
  for (int py = 0; py < side; ++py)
    for (int px = 0; px < side; ++px)
      for (int k = 0; k < perPixel; ++k) {
        const size_t s = size_t((py * side + px) * perPixel + k);
        for (int dy = -reach; dy <= reach; ++dy)
          for (int dx = -reach; dx <= reach; ++dx) {
            const float w = filter.evaluate(x[s] - 0.5f - float(dx), y[s] - 0.5f - float(dy));
            float* to = sums.data() + size_t(((py + reach + dy) * row + px + reach + dx) * (n + 1));
            for (int c = 0; c < n; ++c) to[c] += w * channels[size_t(c)][s];
            to[n] += w;
          }
      }
}

}  // namespace

int main(int argc, char** argv) {
  double seconds = 1;
  if (argc == 3 && std::strcmp(argv[1], "--seconds") == 0) seconds = std::atof(argv[2]);
  if ((argc != 1 && argc != 3) || !(seconds > 0)) {
    fmt::print(stderr, "stage_bench [--seconds 1]\n");
    return 2;
  }

  const std::vector<Controls> all = patches(12);
  const cache::Frame frame = frameOf(ribOf(all));
  std::vector<Piece> pieces;
  double micropolygons = 0;
  const auto cache = open(frame);
  const auto& skeleton = cache->skeleton();
  HideTile tile;
  const reyes::RasterSpace space(skeleton.camera(), skeleton.cacheToCamera(0));
  for (cache::NodeId root = 0; root < skeleton.rootPatches().size(); ++root)
    visit(*cache, root, [&](cache::NodeId, const cache::GridRecord& g) {
      pieces.push_back({root, int(g.nu), int(g.nv)});
      micropolygons += double(g.nu) * g.nv;
      if (space.bounds(g.bound).overlaps(tile.rect)) tile.grids.push_back(cache->view(g));
    });

  std::vector<float> positions;
  for (const bool meetsRays : {false, true})
    compare(
        meetsRays ? "dice, deviations measured" : "dice (bicubic patches)", "micropolygons", micropolygons,
        seconds,
        [&] {
          const auto fresh = open(frame);
          fresh->setMeetsRays(meetsRays);
          for (cache::NodeId root = 0; root < skeleton.rootPatches().size(); ++root)
            visit(*fresh, root, [](cache::NodeId, const cache::GridRecord&) {});
        },
        [&] {
          positions.clear();
          for (const Piece& p : pieces) {
            const size_t at = positions.size();
            positions.resize(at + size_t(3 * (p.nu + 1) * (p.nv + 1)));
            plainDice(all[p.patch], p, positions.data() + at);
          }
        });

  const SamplePattern pattern(4, 4, true, 0);
  reyes::SampleBuffer samples;
  reyes::ProjectedGrid projected;
  std::vector<uint64_t> ranks(tile.grids.size());
  for (size_t i = 0; i < ranks.size(); ++i) ranks[i] = i;
  double drawn = 0;
  for (const auto& g : tile.grids) drawn += double(g.record->nu) * g.record->nv;
  samples.reset(tile.rect, pattern, space.farKey());
  std::vector<float> depth(samples.size());
  std::vector<uint32_t> hit(samples.size());
  compare(
      "project and hide", "micropolygons", drawn, seconds,
      [&] { ourHide(tile, space, pattern, samples, projected, ranks); },
      [&] { plainHide(tile, space, samples, depth, hit); });

  constexpr int kSide = 32, kPerPixel = 16, kChannels = 5;
  const PixelFilter filter(FilterKind::kGaussian, 2, 2);
  const size_t count = size_t(kSide * kSide * kPerPixel);
  std::vector<float> x(count), y(count);
  std::vector<std::vector<float>> channels(kChannels, std::vector<float>(count));
  for (size_t s = 0; s < count; ++s) {
    x[s] = float(pattern.offsets()[s % pattern.offsets().size()].x) / kSubpixels;
    y[s] = float(pattern.offsets()[s % pattern.offsets().size()].y) / kSubpixels;
    for (auto& c : channels) c[s] = std::sin(float(s) * 0.1f);
  }
  std::vector<const float*> pointers;
  for (const auto& c : channels) pointers.push_back(c.data());
  TileSamples in;
  in.samplesPerPixel = kPerPixel, in.x = x.data(), in.y = y.data(), in.channels = pointers.data();
  constexpr int kTiles = 16;  // of a film: neighbours wait for each other
  std::vector<float> sums(size_t((kSide + 4) * (kSide + 4) * (kChannels + 1)));
  compare(
      "filter (gaussian 2 x 2)", "samples", double(count) * kTiles, seconds,
      [&] {
        const int reach = filter.xReach();
        Film film({reach, reach, 4 * kSide - reach, 4 * kSide - reach}, filter, kSide,
                  std::vector<ChannelRule>(kChannels, ChannelRule::kFiltered));
        for (int t = 0; t < film.tileCount(); ++t) film.addTile(t, in, [](FilmTile&&) {});
      },
      [&] {
        for (int t = 0; t < kTiles; ++t) plainFilter(filter, kSide, kPerPixel, x, y, channels, sums);
      });
  return 0;
}
