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

namespace {

/// What compositing needs of a grid, by slot: side by side, since samples with many layers go from grid to
/// grid.
struct Source {
  const ShadedGrid::Cell* cells;  // or nullptr: values are interpolated
  bool matte, opaqueMatte;
};

/// Composites a sample's layers, front to back.
class Compositor {
 public:
  Compositor(const TileView& view, const ShutterSpace& space, int outputChannels, float opacityThreshold,
             bool midpointDepth, TileColors& out)
      : view_(view),
        space_(space),
        shader_(view, space),
        outputChannels_(size_t(outputChannels)),
        clear_(1 - opacityThreshold),
        midpointDepth_(midpointDepth),
        out_(out) {
    for (const TileGrid& g : view.grids) {
      const bool opaqueMatte = g.traits.matte && g.traits.opaque;
      const bool flat = g.shaded && !g.shaded->cells.empty();
      sources_.push_back({flat ? g.shaded->cells.data() : nullptr, g.traits.matte, opaqueMatte});
    }
  }

  void begin(size_t from, size_t to) {
    from_ = from, to_ = to;
    for (int c = 0; c < 4; ++c) through_[c] = 1, color_[c] = opacity_[c] = 0;
    first_ = true, second_ = !midpointDepth_, covered_ = false;
    depth_ = kRiInfinity;
  }
  /// False: nothing behind it shows.
  bool add(uint32_t hit, float key) {
    const Source& source = sources_[hit >> kTriangleBits];
    if (source.opaqueMatte) {
      for (float& t : through_) t = 0;
      if (first_) depth_ = space_.open().depth(key);
      first_ = false;
    } else if (source.cells) {
      composite(source.cells[(hit & kTriangleMask) >> 1], source.matte, hit, key);
    } else {
      const TileGrid& g = view_.grids[hit >> kTriangleBits];
      const HitWeights w = shader_.weights(g, hit & kTriangleMask, from_);
      ShadedGrid::Cell cell{};
      for (size_t c = 0; c < 3; ++c) {
        cell.color[c] = Shader::value(g.shaded->color, g.shaded->points, c, w);
        cell.opacity[c] =
            g.traits.opaque
                ? 1.0f
                : std::clamp(Shader::value(g.shaded->opacity, g.shaded->points, c, w), 0.0f, 1.0f);
      }
      composite(cell, source.matte, hit, key);
    }
    covered_ |= std::max({through_[0], through_[1], through_[2]}) < clear_;
    return !(covered_ && second_);
  }
  void finish() {
    if (midpointDepth_ && !second_) depth_ = kRiInfinity;
    for (size_t c = 0; c < 3; ++c) out_.channels[c][to_] = color_[c];
    out_.channels[size_t(kAlphaChannel)][to_] = (opacity_[0] + opacity_[1] + opacity_[2]) * (1.0f / 3);
    out_.channels[size_t(kDepthChannel)][to_] = depth_;
  }

 private:
  void composite(const ShadedGrid::Cell& cell, bool matte, uint32_t hit, float key) {
    if (!matte && !covered_)
      for (int c = 0; c < 4; ++c) {
        color_[c] += through_[c] * cell.color[c];
        opacity_[c] += through_[c] * cell.opacity[c];
      }
    for (int c = 0; c < 4; ++c) through_[c] *= 1 - cell.opacity[c];
    if (!first_ && second_) return;
    bool shows = false;
    for (int c = 0; c < 3; ++c) shows |= cell.opacity[c] > 0 || cell.color[c] != 0;
    if (!shows) return;
    if (!first_) {
      second_ = true;
      depth_ = 0.5f * (depth_ + space_.open().depth(key));
      return;
    }
    first_ = false;
    depth_ = space_.open().depth(key);
    if (matte || outputChannels_ == 0) return;
    const TileGrid& g = view_.grids[hit >> kTriangleBits];
    const HitWeights w = shader_.weights(g, hit & kTriangleMask, from_);
    for (size_t c = 0; c < outputChannels_; ++c)
      out_.channels[size_t(kFixedChannels) + c][to_] =
          g.shaded->outputs.empty() ? 0.0f : Shader::value(g.shaded->outputs, g.shaded->points, c, w);
  }

  const TileView& view_;
  const ShutterSpace& space_;
  const Shader shader_;
  const size_t outputChannels_;
  const float clear_;
  const bool midpointDepth_;
  TileColors& out_;
  std::vector<Source> sources_;
  size_t from_ = 0, to_ = 0;
  float through_[4], color_[4], opacity_[4], depth_ = 0;
  bool first_ = true, second_ = true, covered_ = false;
};

}  // namespace

void resolveTile(const TileView& view, const ShutterSpace& space, int outputChannels, float opacityThreshold,
                 bool midpointDepth, TileColors& out) {
  const SampleBuffer& s = view.samples;
  const PixelRect& rect = s.rect();
  const size_t spp = size_t(s.perPixel());
  const size_t n = size_t(rect.area()) * spp;
  out.x.resize(n), out.y.resize(n);
  out.channels.resize(size_t(kFixedChannels + outputChannels));
  for (auto& c : out.channels) c.assign(n, 0.0f);
  Compositor compositor(view, space, outputChannels, opacityThreshold, midpointDepth, out);
  size_t to = 0;
  for (int row = 0; row < rect.height(); ++row)
    for (int column = 0; column < rect.width(); ++column) {
      const size_t pixel = s.index(column, row);
      for (size_t from = pixel; from < pixel + spp; ++from, ++to) {
        out.x[to] = float(s.x[from] - column * kSubpixels) / float(kSubpixels);
        out.y[to] = float(s.y[from] - row * kSubpixels) / float(kSubpixels);
        compositor.begin(from, to);
        bool open = true;
        if (!view.firstLayer.empty())
          for (size_t l = view.firstLayer[from], end = view.firstLayer[from + 1]; open && l < end; ++l)
            open = compositor.add(view.layers[l].hit, view.layers[l].depth);
        if (open && s.hit[from] != kNothing) compositor.add(s.hit[from], s.depth[from]);
        compositor.finish();
      }
    }
}

}  // namespace fr::reyes
