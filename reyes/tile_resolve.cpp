#include "reyes/tile_resolve.h"

#include <algorithm>

#include "imaging/frame_output.h"
#include "reyes/hit_position.h"

namespace fr::reyes {
namespace {

/// Weights of a hit's three vertices.
struct HitWeights {
  uint32_t v[3];
  uint32_t fourth;  // fourth corner of a flat cell, or v[0]
  float w[4];
};

class Shader {
 public:
  Shader(const TileView& view, const ShutterSpace& space) : view_(view), space_(space) {}

  /// Flat ("constant"): the mean over the corners of the micropolygon, that is, its colour at the centre.
  /// Smooth: linear between the vertices, in perspective.
  HitWeights weights(const TileGrid& g, uint32_t triangle, size_t sample) const {
    HitWeights r{};
    const cache::GridRecord& record = *g.record;
    const bool meshlet = record.kind == cache::GridKind::kMeshlet;
    if (meshlet) {
      const uint8_t* i = g.indices + 3 * triangle;
      r.v[0] = i[0], r.v[1] = i[1], r.v[2] = i[2];
    } else {
      gridTriangle(record.nu, triangle, r.v);
    }
    if (record.flags & cache::kGridSprites) {
      r.v[0] = r.v[1] = r.v[2] = r.fourth = triangle / (record.rowStride - 2);
      r.w[0] = 1;
      return r;
    }
    r.fourth = r.v[0];
    BlurPoint corner[3];
    const bool drawn = g.traits.smooth && seenCorners(g, view_, space_, sample, r.v, corner);
    if (!drawn) {
      if (meshlet) {
        r.w[0] = r.w[1] = r.w[2] = 1.0f / 3;
      } else {
        const uint32_t stride = uint32_t(record.nu) + 1, vertex = r.v[0];
        const uint32_t first = triangle & 1 ? vertex - 1 : vertex;
        r.v[0] = first, r.v[1] = first + 1, r.v[2] = first + stride, r.fourth = first + stride + 1;
        r.w[0] = r.w[1] = r.w[2] = r.w[3] = 0.25f;
      }
      return r;
    }
    double weight[3];
    cornerWeights(corner, space_.open().perspective(), view_.samples.x[sample], view_.samples.y[sample],
                  weight);
    for (int i = 0; i < 3; ++i) r.w[i] = float(weight[i]);
    return r;
  }

  static float value(const std::vector<float>& planes, size_t points, size_t component, const HitWeights& w) {
    const float* p = planes.data() + component * points;
    return w.w[0] * p[w.v[0]] + w.w[1] * p[w.v[1]] + w.w[2] * p[w.v[2]] + w.w[3] * p[w.fourth];
  }

 private:
  const TileView& view_;
  const ShutterSpace& space_;
};

}  // namespace

void resolveTile(const TileView& view, const ShutterSpace& space, int outputChannels, float opacityThreshold,
                 bool midpointDepth, TileColors& out) {
  const SampleBuffer& s = view.samples;
  const PixelRect& rect = s.rect();
  const int spp = s.perPixel();
  const size_t n = size_t(rect.area()) * size_t(spp);
  const size_t channels = size_t(kFixedChannels + outputChannels);
  out.x.resize(n), out.y.resize(n);
  out.channels.resize(channels);
  for (auto& c : out.channels) c.assign(n, 0.0f);
  const Shader shader(view, space);
  std::vector<Fragment> layers;

  size_t to = 0;
  for (int row = 0; row < rect.height(); ++row)
    for (int column = 0; column < rect.width(); ++column)
      for (int i = 0; i < spp; ++i, ++to) {
        const size_t from = s.index(column, row) + size_t(i);
        out.x[to] = float(s.x[from] - column * kSubpixels) / float(kSubpixels);
        out.y[to] = float(s.y[from] - row * kSubpixels) / float(kSubpixels);
        layers.clear();
        if (!view.firstFragment.empty()) {
          for (uint32_t f = view.firstFragment[from]; f != kNothing; f = view.fragments[f].next)
            layers.push_back(view.fragments[f]);
          std::sort(layers.begin(), layers.end(), [&](const Fragment& a, const Fragment& b) {
            if (a.depth != b.depth) return a.depth < b.depth;
            const uint64_t ra = view.ranks[a.hit >> kTriangleBits], rb = view.ranks[b.hit >> kTriangleBits];
            return ra != rb ? ra < rb : (a.hit & kTriangleMask) < (b.hit & kTriangleMask);
          });
        }
        if (s.hit[from] != kNothing) layers.push_back({uint32_t(from), s.hit[from], s.depth[from], 0});

        float through[3] = {1, 1, 1}, color[3] = {}, opacity[3] = {};
        bool first = true, second = !midpointDepth, covered = false;
        float depth = kRiInfinity;
        for (const Fragment& layer : layers) {
          const TileGrid& g = view.grids[layer.hit >> kTriangleBits];
          const bool opaqueMatte = g.traits.matte && g.traits.opaque;
          if (!opaqueMatte) {
            const ShadedGrid& shaded = *g.shaded;
            const uint32_t triangle = layer.hit & kTriangleMask;
            ShadedGrid::Cell cell;
            HitWeights w;
            bool weighed = false;
            const auto weigh = [&] {
              if (!weighed) w = shader.weights(g, triangle, from);
              weighed = true;
            };
            if (!shaded.cells.empty()) {
              cell = shaded.cells[triangle >> 1];
            } else {
              weigh();
              for (size_t c = 0; c < 3; ++c) {
                cell.color[c] = Shader::value(shaded.color, shaded.points, c, w);
                cell.opacity[c] =
                    g.traits.opaque
                        ? 1.0f
                        : std::clamp(Shader::value(shaded.opacity, shaded.points, c, w), 0.0f, 1.0f);
              }
            }
            bool shows = false;
            for (size_t c = 0; c < 3; ++c) {
              const float o = cell.opacity[c], v = cell.color[c];
              shows |= o > 0 || v != 0;
              if (!g.traits.matte && !covered) {
                color[c] += through[c] * v;
                opacity[c] += through[c] * o;
              }
              through[c] *= 1 - o;
            }
            if (shows && !first && !second) {
              second = true;
              depth = 0.5f * (depth + space.open().depth(layer.depth));
            }
            if (shows && first) {
              first = false;
              depth = space.open().depth(layer.depth);
              if (!g.traits.matte && outputChannels > 0) {
                weigh();
                for (size_t c = 0; c < size_t(outputChannels); ++c)
                  out.channels[size_t(kFixedChannels) + c][to] =
                      shaded.outputs.empty() ? 0.0f : Shader::value(shaded.outputs, shaded.points, c, w);
              }
            }
          } else {
            through[0] = through[1] = through[2] = 0;
            if (first) depth = space.open().depth(layer.depth);
            first = false;
          }
          covered |= std::max({through[0], through[1], through[2]}) < 1 - opacityThreshold;
          if (covered && second) break;
        }
        if (midpointDepth && !second) depth = kRiInfinity;
        for (size_t c = 0; c < 3; ++c) out.channels[c][to] = color[c];
        out.channels[size_t(kAlphaChannel)][to] = (opacity[0] + opacity[1] + opacity[2]) * (1.0f / 3);
        out.channels[size_t(kDepthChannel)][to] = depth;
      }
}

}  // namespace fr::reyes
