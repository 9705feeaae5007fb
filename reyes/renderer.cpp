#include "reyes/renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <system_error>
#include <thread>

#include "imaging/frame_request.h"
#include "reyes/bucket_worker.h"

namespace fr {
namespace {

using namespace fr::reyes;

constexpr int kDefaultBucketSize = 32;
/// Buckets are made smaller when they would hold more samples than this: the buffers of a bucket should stay
/// in the cache.
constexpr long long kMostSamplesPerBucket = 1 << 16;
constexpr int kSmallestBucket = 8;
constexpr float kMostSamples = 128;  // per axis

int bucketSizeOf(const cache::Skeleton& skeleton, int asked, int samplesPerPixel) {
  int size = asked;
  if (size <= 0) {
    const cache::ParamRecord* p = skeleton.find(skeleton.options().options, "limits:bucketsize");
    size = kDefaultBucketSize;
    if (p)
      if (const auto values = skeleton.integers(*p); !values.empty() && values[0] > 0) size = values[0];
  }
  size = std::clamp(size, 1, 512);
  while (size > kSmallestBucket &&
         static_cast<long long>(size) * size * samplesPerPixel > kMostSamplesPerBucket)
    size /= 2;
  return size;
}

float floatOption(const cache::Skeleton& skeleton, cache::Slice list, const char* name, float otherwise) {
  const cache::ParamRecord* p = skeleton.find(list, name);
  if (!p) return otherwise;
  if (const auto f = skeleton.floats(*p); !f.empty()) return f[0];
  if (const auto i = skeleton.integers(*p); !i.empty()) return float(i[0]);
  return otherwise;
}

SamplePattern patternOf(const cache::Skeleton& skeleton, uint32_t seed) {
  const cache::OptionsRecord& o = skeleton.options();
  const auto axis = [](float n) {
    return std::isfinite(n) ? int(std::lround(std::clamp(n, 1.0f, kMostSamples))) : 2;
  };
  float jitter = 1;
  for (const char* name : {"jitter", "hider:jitter"})
    jitter = floatOption(skeleton, o.hiderParams, name, jitter);
  return SamplePattern(axis(o.pixelSamples[0]), axis(o.pixelSamples[1]), jitter != 0, seed);
}

/// Tiles along Hilbert's curve: neighbours in time are neighbours on the raster, so few tiles are half
/// finished.
std::vector<int> hilbertOrder(int width, int height) {
  std::vector<int> order;
  order.reserve(size_t(width) * size_t(height));
  const int bits = log2Ceil(std::max(width, height));
  for (uint64_t d = 0; d < uint64_t(1) << (2 * bits); ++d) {
    uint32_t x = 0, y = 0;
    uint64_t t = d;
    for (uint32_t s = 1; s < 1u << bits; s *= 2) {
      const uint32_t rx = 1u & uint32_t(t / 2), ry = 1u & uint32_t(t ^ rx);
      if (ry == 0) {
        if (rx == 1) x = s - 1 - x, y = s - 1 - y;
        std::swap(x, y);
      }
      x += s * rx, y += s * ry;
      t /= 4;
    }
    if (int(x) < width && int(y) < height) order.push_back(int(y) * width + int(x));
  }
  return order;
}

void warnOfMissingFeatures(const cache::CameraRecord& camera) {
  if (camera.dof[0] < 1e30f && camera.dof[1] > 0)
    reportOnce("depth of field", Error{RiError::kUnimplemented,
                                       Severity::kWarning,
                                       {},
                                       "depth of field is not rendered yet: everything is sharp"});
}

/// Threads of the frame; the calling one is the first.
void runWorkers(FrameWork& work, int threads) {
  const auto body = [&work] {
    try {
      BucketWorker(work).run();
    } catch (const std::bad_alloc&) {
      report(makeError(RiError::kNoMem, "out of memory while rendering"));
      work.stop = true, work.broken = true;
      work.signal();
    }
  };
  std::vector<std::thread> pool;
  for (int i = 1; i < threads; ++i) {
    try {
      pool.emplace_back(body);
    } catch (const std::system_error& e) {
      reportWarning(RiError::kSystem, "only {} of {} threads could be started: {}", i, threads, e.what());
      break;
    }
  }
  body();
  for (std::thread& t : pool) t.join();
}

}  // namespace

Result<FrameStatistics> renderFrame(cache::SceneCache& cache, ShadingSystem& shading,
                                    RayOracleService* oracle, const RenderOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const cache::Skeleton& skeleton = cache.skeleton();
  const cache::CameraRecord& camera = skeleton.camera();
  warnOfMissingFeatures(camera);

  const FrameGeometry geometry = frameGeometry(skeleton);
  if (geometry.crop.empty()) return makeError(RiError::kRange, "the crop window holds no pixels");
  std::vector<DisplayRequest> displays = frameDisplays(skeleton);

  FrameWork work;
  work.outputs = requiredOutputs(displays);
  std::vector<ChannelRule> rules(size_t(kFixedChannels) + work.outputs.size(), ChannelRule::kFiltered);
  rules[kDepthChannel] = ChannelRule::kMinimum;

  FrameScene scene;
  scene.cache = &cache;
  scene.space = RasterSpace(camera, skeleton.cacheToCamera(camera.shutter[0]));
  scene.pattern = patternOf(skeleton, options.seed);
  scene.traits = surfaceTraits(cache, shading);
  const int bucketSize = bucketSizeOf(skeleton, options.bucketSize, scene.pattern.perPixel());
  Film film(geometry.crop, framePixelFilter(skeleton), bucketSize, rules);
  const RootBins roots(cache, scene.space, scene.traits, film);
  scene.roots = &roots;
  ShadedGrids shaded(film);

  std::optional<FrameOutput> output;
  std::mutex imagerMutex;
  if (options.writeDisplays) {
    output.emplace(geometry, std::move(displays), frameDisplaySearchPath(skeleton));
    if (skeleton.options().imager != cache::kNone)
      output->setImager([&](size_t n, const float* x, const float* y, float* const color[3], float* alpha) {
        std::vector<float> opacity[3];
        for (auto& o : opacity) o.assign(alpha, alpha + n);
        float* const planes[3] = {opacity[0].data(), opacity[1].data(), opacity[2].data()};
        const std::lock_guard lock(imagerMutex);
        return shading.runImager(n, x, y, color, planes, alpha);
      });
    if (auto opened = output->open(); !opened) return opened.error();
    work.output = &*output;
  }

  work.scene = &scene, work.film = &film, work.shaded = &shaded;
  work.shading = &shading, work.oracle = oracle, work.options = &options;
  work.opacityThreshold =
      std::clamp(floatOption(skeleton, skeleton.options().options, "limits:othreshold", 0.996f), 0.0f, 1.0f);
  work.order = hilbertOrder(film.tilesX(), film.tilesY());
  const int cores = std::max(1, int(std::thread::hardware_concurrency()));
  runWorkers(work, std::clamp(options.threads > 0 ? options.threads : cores, 1, 1024));

  FrameStatistics& s = work.statistics;
  s.rootPatches = roots.count(), s.rootPatchesCulled = roots.culled();
  s.gridsShadedPeak = shaded.peak();
  s.oracleFailed = work.oracleFailed;
  if (work.stop)
    return makeError(RiError::kSystem, "rendering stopped after {} of {} buckets", work.tilesDone,
                     work.order.size());
  if (output)
    if (auto written = output->finish(); !written) return written.error();
  s.wallSeconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return s;
}

}  // namespace fr
