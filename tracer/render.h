// A renderer by rays alone: primary rays through the samples of every pixel, over the grids of the scene
// cache.
//
// The second hider beside the REYES one. It shares with it what is not hiding: the cache, the shading engine,
// the places of samples, filters and displays. Per tile: camera rays find their nearest surfaces, hits are
// sorted by shader and surface and shaded in batches, and samples whose surfaces let something through go on
// behind them. The image is the same, bit for bit, for any number of threads and any tile size.
#pragma once

#include <functional>
#include <optional>

#include "base/error.h"
#include "imaging/adaptive_sampling.h"
#include "imaging/film.h"
#include "scene_cache/cache.h"
#include "shading/shading_system.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

struct TraceRenderOptions {
  int threads = 0;   // 0: one per core
  int tileSize = 0;  // pixels a side; 0: Option "limits" "bucketsize", else 32
  uint32_t seed = 0;
  /// Where objects have no Attribute "render" "patch_multiplier": 1 traces the grids as they are diced.
  float patchMultiplier = 1;
  /// Empty: PixelSamples.
  std::optional<AdaptiveSampling> adaptive;
  bool writeDisplays = true;  // false: only `pixels` gets the image
  std::string picture;        // not empty: a file instead of the displays, as of frameDisplays()
  bool keepExisting =
      false;  // displays whose file exists are left out; nothing is rendered when none is left
  /// Called with every finished tile, before exposure, by one thread at a time: R G B A Z, then the displays'
  /// output variables.
  std::function<void(const FilmTile&)> pixels;
  /// Called with what traces the rays before the first of them, and with nullptr before it is gone.
  std::function<void(RayTracer*)> onTracer;
  /// Fraction of the tiles that are finished, in (0, 1]; by one thread at a time.
  std::function<void(double)> progress;
};

/// Sums over all threads; seconds are thread seconds except wallSeconds.
struct TraceRenderStatistics {
  uint64_t tiles = 0, samples = 0, cameraRays = 0, hits = 0, shadeBatches = 0, raysAsked = 0;
  uint64_t pixels = 0, fewestSamples = 0, mostSamples = 0;  // a pixel
  PixelErrors errors;                                       // adaptive sampling alone
  TracerStatistics tracer;
  double traceSeconds = 0, shadeSeconds = 0, answerSeconds = 0, filterAndWriteSeconds = 0, wallSeconds = 0;

  TraceRenderStatistics& operator+=(const TraceRenderStatistics& o);
};

/// Renders and writes the frame's displays. Shaders must be loaded (ShadingSystem::loadShaders(kForTracer))
/// and the displacer set; objects made for the ray tracer are seen. Errors: nothing could be rendered or a
/// display failed (all of them reported).
Result<TraceRenderStatistics> renderFrame(cache::SceneCache& cache, ShadingSystem& shading,
                                          const TraceRenderOptions& options);

}  // namespace fr::tracer
