// One thread of the frame: the samples of a tile, from camera rays to colours. Internal to tracer/.
#pragma once

#include <memory>
#include <vector>

#include "imaging/frame_output.h"
#include "imaging/sample_pattern.h"
#include "tracer/camera_rays.h"
#include "tracer/render.h"

namespace fr::tracer {

/// What compositing needs to know of an attribute state.
struct CameraSurface {
  uint32_t shadeGroup = 0;
  bool opaque = true;  // opacity is 1 wherever it is hit
  bool matte = false;
};

/// What the threads of a frame share. Immutable while tiles are traced.
struct FrameTrace {
  RayTracer* tracer = nullptr;
  CameraRays camera;
  SamplePattern pattern;                // adaptive: of maxSamples a pixel
  std::vector<CameraSurface> surfaces;  // by AttributeId
  std::vector<OutputChannel> outputs;
  std::optional<AdaptiveSampling> adaptive;
  float opacityThreshold = 0.996f;
  bool midpointDepth = false;  // DepthFilter::midpoint; no surface counts as opaque then
  uint32_t seed = 0;
};

/// Samples of a tile, pixel after pixel.
struct TracedTile {
  std::vector<int> counts;  // of each pixel; empty: all have the pattern's number
  std::vector<float> x, y;  // within the pixel
  std::vector<std::vector<float>> channels;
};

/// Not thread-safe: one per thread.
class TileTracer {
 public:
  explicit TileTracer(const FrameTrace& frame);
  ~TileTracer();
  void trace(const PixelRect& rect, TracedTile& out);
  const TraceRenderStatistics& statistics() const { return statistics_; }

 private:
  /// A sample on its way through the surfaces before it.
  struct Path {
    Ray ray;
    Hit hit;
    Color through, color, opacity;
    uint64_t seed;
    uint32_t slot;   // place in the tile's arrays
    uint32_t steps;  // surfaces met
    bool seen;       // a surface that shows was met: depth and output variables are its
    bool second;     // midpoint depth: another one was met behind it
    float depth;
  };
  struct Order {
    uint32_t group, entry, path;
    auto operator<=>(const Order&) const = default;
  };
  void begin(const PixelRect& rect, TracedTile& out);
  /// Adds sample `sample` of pixel `pixel` of the tile to those to be traced, tracing when there are enough.
  void add(const PixelRect& rect, uint32_t pixel, uint32_t sample, TracedTile& out);
  void flush(TracedTile& out);
  /// Nothing behind what the sample has met can be seen.
  bool isCovered(const Path& path) const;
  void hideBehind(Path& path, const CameraSurface& surface, const Color& color, const Color& opacity);
  void shade(size_t first, size_t end, TracedTile& out);
  PixelNoise pixelNoise(uint32_t pixel, uint32_t samples, const TracedTile& out) const;
  void compact(TracedTile& out);

  const FrameTrace& frame_;
  AnswerThread answers_;
  ShadeTask task_;
  std::unique_ptr<RayQuery> query_;
  uint32_t stride_;  // samples a pixel has room for
  std::vector<Path> paths_;
  std::vector<uint32_t> going_;
  std::vector<Order> order_;
  // ShadePoints of one batch.
  std::vector<cache::NodeId> node_;
  std::vector<uint32_t> cell_;
  std::vector<uint64_t> pointSeed_;
  std::vector<float> u_, v_, direction_[3], origin_[3], distance_, radius_, spread_, time_;
  TraceRenderStatistics statistics_;
};

}  // namespace fr::tracer
