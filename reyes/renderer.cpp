#include "reyes/renderer.h"

#include <fmt/format.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <system_error>
#include <thread>

#include "base/cores.h"
#include "base/interrupt.h"
#include "base/random.h"
#include "imaging/frame_journal.h"
#include "imaging/frame_request.h"
#include "imaging/tile_order.h"
#include "reyes/bucket_worker.h"

namespace fr {
namespace {

using namespace fr::reyes;

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
  work.threads = threads;
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

/// Differs between frames whose pixels may differ.
uint64_t frameIdentity(const cache::Skeleton& skeleton, const Film& film, const RenderOptions& options,
                       const std::optional<AdaptiveSampling>& adaptive,
                       const std::vector<OutputChannel>& outputs) {
  const std::span<const std::byte> scene = skeleton.bytes();
  uint64_t h = XXH3_64bits(scene.data(), scene.size());
  const PixelRect& r = film.sampledRect();
  const AdaptiveSampling none{0, 0, 0};
  const AdaptiveSampling& a = adaptive ? *adaptive : none;
  for (const int v : {r.x0, r.y0, r.x1, r.y1, film.tileSize(), int(options.seed),
                      std::bit_cast<int>(a.variance), a.minSamples, a.maxSamples})
    h = hashStep(h, uint64_t(uint32_t(v)));
  for (const OutputChannel& o : outputs)
    h = hashStep(hashStep(h, XXH3_64bits(o.variable.data(), o.variable.size())),
                 uint64_t(o.component) << 8 | uint64_t(o.rule));
  return h;
}

}  // namespace

Result<FrameStatistics> renderFrame(cache::SceneCache& cache, ShadingSystem& shading,
                                    RayOracleService* oracle, const RenderOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const cache::Skeleton& skeleton = cache.skeleton();
  const cache::CameraRecord& camera = skeleton.camera();

  const FrameGeometry geometry = frameGeometry(skeleton);
  if (geometry.crop.empty()) return makeError(RiError::kRange, "the crop window holds no pixels");
  std::vector<DisplayRequest> displays = frameDisplays(skeleton, options.picture);
  if (auto fits = checkPictureFits(geometry, displays); !fits) return fits.error();

  FrameWork work;
  resolveOutputTypes(displays, [&](std::string_view name) { return shading.outputComponents(name); });
  work.outputs = requiredOutputs(displays);
  std::vector<ChannelRule> rules(size_t(kFixedChannels) + work.outputs.size(), ChannelRule::kFiltered);
  for (size_t i = 0; i < work.outputs.size(); ++i) rules[size_t(kFixedChannels) + i] = work.outputs[i].rule;
  const DepthFilter depthFilter = frameDepthFilter(skeleton);
  rules[kDepthChannel] = depthFilter.rule;
  work.midpointDepth = depthFilter.midpoint;

  FrameScene scene;
  scene.cache = &cache;
  scene.space = ShutterSpace(camera, frameCameraKeys(skeleton), frameLens(skeleton));
  scene.lines = SightLines(camera, frameLens(skeleton));
  work.adaptive = frameAdaptiveSampling(skeleton, options.adaptive);
  if (work.adaptive && work.adaptive->pictureError > 0) {
    std::optional<Error> failed;
    work.adaptive = varianceForError(*work.adaptive, [&](const AdaptiveSampling& a) -> PixelErrors {
      RenderOptions look;
      look.threads = options.threads, look.seed = options.seed;
      look.bucketSize = kLookTileSize, look.writeDisplays = false, look.look = true;
      look.adaptive = a;
      if (failed) return {};
      auto seen = renderFrame(cache, shading, oracle, look);
      if (seen) return seen->errors;
      failed = std::move(seen).error();
      return {};
    });
    if (failed) return *failed;
  }
  scene.pattern =
      work.adaptive
          ? SamplePattern(work.adaptive->maxSamples, 1, true, options.seed,
                          {frameMoves(skeleton), frameLens(skeleton).radius > 0, work.adaptive->minSamples})
          : frameSamplePattern(skeleton, options.seed);
  scene.traits = surfaceTraits(cache, shading);
  if (work.midpointDepth)  // what lies behind the first surface is wanted too
    for (SurfaceTraits& t : scene.traits) t.opaque = false;
  // Few pixels get all samples that they may get.
  const int bucketSize = frameBucketSize(
      skeleton, options.bucketSize, work.adaptive ? 4 * work.adaptive->minSamples : scene.pattern.perPixel());
  Film film(geometry.crop, framePixelFilter(skeleton), bucketSize, rules);
  const cache::SolidForest solids(skeleton);
  scene.solids = &solids;
  const RootBins roots(cache, scene.space, scene.traits, solids, film);
  scene.roots = &roots;
  ShadedGrids shaded(film);

  std::optional<FrameOutput> output;
  if (options.writeDisplays) {
    output.emplace(geometry, std::move(displays), frameDisplaySearchPath(skeleton));
    if (skeleton.options().imager != cache::kNone)
      output->setImager([&](auto&&... pixels) { return shading.runImager(pixels...); });
    if (auto opened = output->open(); !opened) return opened.error();
    work.output = &*output;
  }

  work.scene = &scene, work.film = &film, work.shaded = &shaded;
  work.shading = &shading, work.oracle = oracle, work.options = &options;
  work.opacityThreshold = std::clamp(
      frameFloatOption(skeleton, skeleton.options().options, "limits:othreshold", 0.996f), 0.0f, 1.0f);
  work.order = hilbertOrder(film.tilesX(), film.tilesY());
  if (options.look) {
    keepTilesToLookAt(work.order);
    std::vector<bool> kept(size_t(film.tilesX()) * size_t(film.tilesY()));
    for (const int tile : work.order) kept[size_t(tile)] = true;
    for (size_t tile = 0; tile < kept.size(); ++tile)
      if (!kept[tile]) shaded.finishTile(int(tile));
  }
  std::unique_ptr<FrameJournal> journal;
  if (options.resume && output && !output->firstPath().empty()) {
    auto opened =
        FrameJournal::open(journalPath(output->firstPath()),
                           frameIdentity(skeleton, film, options, work.adaptive, work.outputs), rules.size());
    if (!opened) return opened.error();
    journal = std::move(*opened);
    for (const FilmTile& pixels : journal->takeFinished()) {
      const int tile = film.tileOfPixels(pixels.rect);
      if (tile < 0 || film.isKnown(tile)) continue;
      film.markKnown(tile);
      output->addTile(pixels);
      if (options.pixels) options.pixels(pixels);
    }
    std::erase_if(work.order, [&](int tile) {
      const bool needed = film.needsTile(tile);
      if (!needed) shaded.finishTile(tile);
      return !needed;
    });
    work.journal = journal.get();
  }
  const int cores = availableCores();
  runWorkers(work, std::clamp(options.threads > 0 ? options.threads : cores, 1, 1024));

  FrameStatistics& s = work.statistics;
  s.rootPatches = roots.count(), s.rootPatchesCulled = roots.culled();
  s.gridsShadedPeak = shaded.peak();
  s.oracleFailed = work.oracleFailed;
  s.errors.filtered(framePixelFilter(skeleton));
  if (work.stop) {
    Error stopped = makeError(RiError::kSystem, "rendering stopped after {} of {} buckets", work.tilesDone,
                              work.order.size());
    if (output && interrupted() && !work.broken)
      if (auto written = output->finishPartial(); written)
        stopped.message += fmt::format("; {} holds what is finished{}", output->firstPath(),
                                       journal ? ", and --resume goes on from there" : "");
    return stopped;
  }
  if (output)
    if (auto written = output->finish(); !written) return written.error();
  if (journal) journal->remove();
  s.wallSeconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return s;
}

}  // namespace fr
