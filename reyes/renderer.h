// Renders a frame of the scene cache from its camera: the REYES way, with visibility decided before shading.
//
// Per bucket: root patches are resolved to grids front to back, micropolygons are drawn onto jittered
// samples, and what lies behind is neither diced nor drawn. Only then are the grids that samples see shaded,
// each once per frame, several at a time per thread when shaders wait for rays. The image is the same, bit
// for bit, for any number of threads and any bucket size.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "base/error.h"
#include "imaging/adaptive_sampling.h"
#include "imaging/film.h"
#include "oracle/ray_oracle.h"
#include "scene_cache/cache.h"
#include "shading/shading_system.h"

namespace fr {

struct RenderOptions {
  int threads = 0;     // 0: one per core
  int bucketSize = 0;  // pixels a side; 0: Option "limits" "bucketsize", else 32
  uint32_t seed = 0;   // of sample positions and shaders
  /// Empty: PixelSamples, or what the RIB's PixelVariance asks for.
  std::optional<AdaptiveSampling> adaptive;
  bool writeDisplays = true;  // false: only `pixels` gets the image
  std::string picture;        // not empty: a file instead of the displays, as of frameDisplays()
  /// Renders some tiles alone, to see how noisy they are: nothing is written or told, the statistics are all.
  bool look = false;
  /// Keeps finished pixels beside the first display's picture while it is rendered, and goes on where an
  /// earlier run with the same scene was stopped or killed. Shaders and textures must not have changed.
  bool resume = false;
  /// Called with every finished tile, before exposure, by one thread at a time: R G B A Z, then the displays'
  /// output variables.
  std::function<void(const FilmTile&)> pixels;
  /// Fraction of the buckets that are finished, in (0, 1]; by one thread at a time.
  std::function<void(double)> progress;
};

/// Sums over all threads; seconds are thread seconds except wallSeconds.
struct FrameStatistics {
  uint64_t buckets = 0, samples = 0;
  uint64_t pixels = 0, fewestSamples = 0, mostSamples = 0;  // a pixel
  PixelErrors errors;                                       // adaptive sampling alone
  uint64_t rootPatches = 0, rootPatchesCulled = 0;
  uint64_t nodesCulledOutside = 0, nodesCulledBucket = 0, nodesCulledHidden = 0, nodesSplit = 0,
           nodesLost = 0;
  uint64_t gridsDrawn = 0, gridsCulledHidden = 0, gridsCulledBucket = 0;
  uint64_t gridsShaded = 0, pointsShaded = 0, gridsShadedPeak = 0;  // peak: held at the same time
  uint64_t pointsVisible = 0;  // of those shaded: corners of what samples saw
  uint64_t micropolygonsTested = 0, fragments = 0;
  uint64_t raysAsked = 0, rayBatches = 0;
  bool oracleFailed = false;
  double resolveSeconds = 0, hideSeconds = 0, shadeSeconds = 0, oracleWaitSeconds = 0, otherWaitSeconds = 0;
  double compositeSeconds = 0, filterAndWriteSeconds = 0, wallSeconds = 0;
};

/// Renders and writes the frame's displays. `oracle` may be nullptr: rays then miss, with one warning.
/// Shaders must be loaded (ShadingSystem::loadShaders). Errors: nothing could be rendered or a display failed
/// (all of them reported), or interrupted(): the displays then hold what was finished. A failing oracle is
/// reported once, and the frame is finished with rays that miss.
Result<FrameStatistics> renderFrame(cache::SceneCache& cache, ShadingSystem& shading,
                                    RayOracleService* oracle, const RenderOptions& options);

}  // namespace fr
