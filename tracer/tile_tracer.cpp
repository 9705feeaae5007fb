#include "tracer/tile_tracer.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/random.h"

namespace fr::tracer {
namespace {

using Clock = std::chrono::steady_clock;

class Timer {
 public:
  explicit Timer(double& sum) : sum_(sum), start_(Clock::now()) {}
  ~Timer() { sum_ += std::chrono::duration<double>(Clock::now() - start_).count(); }
  Timer(const Timer&) = delete;
  Timer& operator=(const Timer&) = delete;

 private:
  double& sum_;
  Clock::time_point start_;
};

/// Samples traced together: many, so that the hits of each shader fill its batches; few enough for the cache.
constexpr size_t kMostPaths = 8192;
/// No sample passes more surfaces than this.
constexpr uint32_t kMaxSteps = 4096;

}  // namespace

TileTracer::TileTracer(const FrameTrace& frame)
    : frame_(frame),
      answers_(*frame.tracer),
      task_(frame.tracer->shading()),
      query_(std::make_unique<RayQuery>()),
      stride_(uint32_t(frame.pattern.perPixel())) {
  paths_.reserve(kMostPaths);
  for (auto* a : {&u_, &v_, &distance_, &radius_, &spread_, &time_}) a->resize(kMaxShadePoints);
  for (int c = 0; c < 3; ++c) direction_[c].resize(kMaxShadePoints), origin_[c].resize(kMaxShadePoints);
  node_.resize(kMaxShadePoints), cell_.resize(kMaxShadePoints), pointSeed_.resize(kMaxShadePoints);
}
TileTracer::~TileTracer() = default;

void TileTracer::begin(const PixelRect& rect, TracedTile& out) {
  const size_t n = size_t(rect.area()) * stride_;
  out.counts.clear();
  out.x.assign(n, 0.0f), out.y.assign(n, 0.0f);
  out.channels.resize(size_t(kFixedChannels) + frame_.outputs.size());
  for (auto& c : out.channels) c.assign(n, 0.0f);
}

void TileTracer::trace(const PixelRect& rect, TracedTile& out) {
  begin(rect, out);
  const auto pixels = uint32_t(rect.area());
  ++statistics_.tiles, statistics_.pixels += pixels;
  if (!frame_.adaptive) {
    for (uint32_t p = 0; p < pixels; ++p)
      for (uint32_t s = 0; s < stride_; ++s) add(rect, p, s, out);
    flush(out);
    statistics_.fewestSamples = statistics_.mostSamples = stride_;
    return;
  }
  const AdaptiveSampling& a = *frame_.adaptive;
  out.counts.assign(pixels, 0);
  std::vector<uint32_t> noisy(pixels);
  for (uint32_t p = 0; p < pixels; ++p) noisy[p] = p;
  for (auto have = 0u, want = uint32_t(a.minSamples); !noisy.empty();
       have = want, want = std::min(2 * want, stride_)) {
    for (uint32_t p : noisy) {
      for (uint32_t s = have; s < want; ++s) add(rect, p, s, out);
      out.counts[p] = int(want);
    }
    flush(out);
    if (want >= stride_) break;
    std::erase_if(noisy, [&](uint32_t p) { return pixelNoise(p, want, out).variance() <= a.variance; });
  }
  const auto [fewest, most] = std::minmax_element(out.counts.begin(), out.counts.end());
  const bool first = statistics_.tiles == 1;
  statistics_.fewestSamples =
      first ? uint64_t(*fewest) : std::min(statistics_.fewestSamples, uint64_t(*fewest));
  statistics_.mostSamples = std::max(statistics_.mostSamples, uint64_t(*most));
  for (uint32_t p = 0; p < pixels; ++p) statistics_.errors.add(pixelNoise(p, uint32_t(out.counts[p]), out));
  compact(out);
}

PixelNoise TileTracer::pixelNoise(uint32_t pixel, uint32_t samples, const TracedTile& out) const {
  PixelNoise noise;
  for (uint32_t i = 0; i < samples; ++i) {
    if (i == (samples + 1) / 2) noise.mark();
    float value[PixelNoise::kChannels];
    for (size_t c = 0; c < PixelNoise::kChannels; ++c)
      value[c] = out.channels[c][size_t(pixel) * stride_ + i];
    noise.add(value);
  }
  return noise;
}

/// Closes the gaps behind pixels that have fewer samples than there is room for.
void TileTracer::compact(TracedTile& out) {
  size_t to = 0;
  for (size_t p = 0; p < out.counts.size(); ++p)
    for (size_t i = 0; i < size_t(out.counts[p]); ++i, ++to) {
      const size_t from = p * stride_ + i;
      out.x[to] = out.x[from], out.y[to] = out.y[from];
      for (auto& c : out.channels) c[to] = c[from];
    }
}

void TileTracer::add(const PixelRect& rect, uint32_t pixel, uint32_t sample, TracedTile& out) {
  const int px = rect.x0 + int(pixel) % rect.width(), py = rect.y0 + int(pixel) / rect.width();
  const size_t index = frame_.pattern.first(px, py) + sample;
  const SamplePattern::Offset at = frame_.pattern.offsets()[index];
  const double x = double(at.x) / kSubpixels, y = double(at.y) / kSubpixels;
  Path& p = paths_.emplace_back();
  p.ray = frame_.pattern.blurs().empty() ? frame_.camera.ray(px + x, py + y)
                                         : frame_.camera.ray(px + x, py + y, frame_.pattern.blurs()[index]);
  p.ray.chance = frame_.pattern.chance(index);
  p.through = Color(1), p.color = p.opacity = Color(0);
  p.seed = hashStep(hashStep(hashStep(frame_.seed, uint64_t(uint32_t(px)) << 32 | uint32_t(py)), sample),
                    0xca3e7a);
  p.slot = pixel * stride_ + sample;
  p.steps = 0, p.seen = p.second = false, p.depth = kRiInfinity;
  out.x[p.slot] = float(x), out.y[p.slot] = float(y);
  ++statistics_.samples;
  if (paths_.size() == kMostPaths) flush(out);
}

void TileTracer::flush(TracedTile& out) {
  const RayScene* scene = frame_.tracer->scene();
  going_.resize(paths_.size());
  for (uint32_t i = 0; i < going_.size(); ++i) going_[i] = i;
  while (scene && !going_.empty()) {
    order_.clear();
    {
      const Timer timer(statistics_.traceSeconds);
      for (uint32_t i : going_) {
        Path& p = paths_[i];
        p.hit = scene->closest(p.ray);
        ++p.steps;
        if (!p.hit.any()) continue;
        const SurfaceEntry& e = scene->entry(p.hit.entry);
        const CameraSurface& s = frame_.surfaces[e.attributes];
        if (s.matte && s.opaque)  // no shader has to run: it hides, and has no colour
          hideBehind(p, s, Color(0), Color(1));
        else
          order_.push_back({s.shadeGroup, p.hit.entry, i});
      }
      statistics_.cameraRays += going_.size(), statistics_.hits += order_.size();
    }
    std::sort(order_.begin(), order_.end());
    for (size_t first = 0, end; first < order_.size(); first = end) {
      end = first;
      while (end < order_.size() && end - first < kMaxShadePoints && order_[end].group == order_[first].group)
        ++end;
      shade(first, end, out);
    }
    going_.clear();
    for (const Order& o : order_) {
      Path& p = paths_[o.path];
      if ((isCovered(p) && (p.second || !frame_.midpointDepth)) || p.steps >= kMaxSteps) continue;
      scene->stepBehind(p.ray, p.hit);
      going_.push_back(o.path);
    }
  }
  for (const Path& p : paths_) {
    for (size_t c = 0; c < 3; ++c) out.channels[c][p.slot] = p.color[int(c)];
    out.channels[size_t(kAlphaChannel)][p.slot] = (p.opacity.x + p.opacity.y + p.opacity.z) * (1.0f / 3);
    out.channels[size_t(kDepthChannel)][p.slot] = frame_.midpointDepth && !p.second ? kRiInfinity : p.depth;
  }
  paths_.clear();
}

bool TileTracer::isCovered(const Path& p) const {
  return std::max({p.through.x, p.through.y, p.through.z}) < 1 - frame_.opacityThreshold;
}

/// Puts a surface behind what the sample has met.
void TileTracer::hideBehind(Path& p, const CameraSurface& surface, const Color& color, const Color& opacity) {
  if (!surface.matte && !isCovered(p)) {
    p.color += p.through * color;
    p.opacity += p.through * opacity;
  }
  p.through *= Color(1) - opacity;
  const bool shows = color != Color(0) || std::max({opacity.x, opacity.y, opacity.z}) > 0;
  if (p.seen && shows && frame_.midpointDepth && !p.second) {
    p.second = true;
    p.depth = 0.5f * (p.depth + frame_.camera.depth(p.ray, p.hit.distance));
  }
  if (p.seen || !shows) return;
  p.seen = true;
  p.depth = frame_.camera.depth(p.ray, p.hit.distance);
}

void TileTracer::shade(size_t first, size_t end, TracedTile& out) {
  const RayScene* scene = frame_.tracer->scene();
  const size_t n = end - first;
  for (size_t k = 0; k < n; ++k) {
    const Path& p = paths_[order_[first + k].path];
    node_[k] = scene->entry(p.hit.entry).node;
    cell_[k] = p.hit.cell;
    u_[k] = p.hit.u, v_[k] = p.hit.v;
    for (int c = 0; c < 3; ++c) direction_[c][k] = p.ray.direction[c], origin_[c][k] = p.ray.origin[c];
    // Orthographic: I has no length, as on grids.
    distance_[k] = frame_.camera.perspective() ? p.hit.distance : 1.0f;
    spread_[k] = frame_.camera.footprintSpread(p.ray);
    radius_[k] = frame_.camera.footprintRadius() + spread_[k] * p.hit.distance;
    time_[k] = p.ray.time;
    pointSeed_[k] = hashStep(p.seed, p.steps);
  }
  ShadePoints points;
  points.topology = ShadePoints::Topology::kHits;
  points.count = n;
  points.node = node_.data(), points.cell = cell_.data(), points.u = u_.data(), points.v = v_.data();
  for (int c = 0; c < 3; ++c)
    points.direction[c] = direction_[c].data(), points.origin[c] = origin_[c].data();
  points.distance = distance_.data(), points.radius = radius_.data(), points.spread = spread_.data();
  points.time = time_.data(), points.seed = pointSeed_.data();
  points.level = 0;

  const auto start = Clock::now();
  double answering = 0;
  task_.begin(points);
  while (task_.run() == ShadeTask::Status::kNeedsRays) {
    task_.writeRays(*query_);
    statistics_.raysAsked += query_->count;
    {
      const Timer timer(answering);
      answers_.answer(*query_);
    }
    task_.readAnswers(*query_);
  }
  statistics_.answerSeconds += answering;
  statistics_.shadeSeconds += std::chrono::duration<double>(Clock::now() - start).count() - answering;
  ++statistics_.shadeBatches;

  const auto at = [&](const float* values, size_t k) {
    return values && std::isfinite(values[k]) ? values[k] : 0.0f;
  };
  for (size_t k = 0; k < n; ++k) {
    Path& p = paths_[order_[first + k].path];
    const CameraSurface& s = frame_.surfaces[scene->entry(p.hit.entry).attributes];
    Color color, opacity(1);
    for (int c = 0; c < 3; ++c) {
      color[c] = at(task_.color(c), k);
      if (!s.opaque) opacity[c] = std::clamp(at(task_.opacity(c), k), 0.0f, 1.0f);
    }
    const bool before = p.seen;
    hideBehind(p, s, color, opacity);
    if (before || !p.seen || s.matte) order_[first + k].group = cache::kNone;  // output variables are not its
  }
  for (size_t o = 0; o < frame_.outputs.size(); ++o) {
    const float* values = task_.output(frame_.outputs[o].variable, frame_.outputs[o].component);
    if (!values)
      reportOnce("no output " + frame_.outputs[o].variable,
                 Error{RiError::kMissingData,
                       Severity::kWarning,
                       {},
                       fmt::format("some surface shaders have no output variable \"{}\": 0 there",
                                   frame_.outputs[o].variable)});
    for (size_t k = 0; values && k < n; ++k)
      if (order_[first + k].group != cache::kNone)
        out.channels[size_t(kFixedChannels) + o][paths_[order_[first + k].path].slot] = at(values, k);
  }
}

}  // namespace fr::tracer
