#include "tracer/render.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <mutex>
#include <new>
#include <thread>

#include "base/cores.h"
#include "imaging/frame_request.h"
#include "imaging/tile_order.h"
#include "tracer/tile_tracer.h"

namespace fr::tracer {
namespace {

std::vector<CameraSurface> cameraSurfaces(const cache::SceneCache& cache, const ShadingSystem& shading) {
  std::vector<CameraSurface> all;
  const auto attributes = cache.skeleton().attributes();
  for (cache::AttributeId i = 0; i < attributes.size(); ++i)
    all.push_back({0, true, (attributes[i].flags & cache::kMatte) != 0});
  // Only the states of objects that rays see have shaders.
  for (const cache::ObjectRecord& o : cache.skeleton().objects()) {
    if (!(o.sides & cache::kForTracer)) continue;
    all[o.attributes].opaque = shading.isOpaque(o.attributes);
    all[o.attributes].shadeGroup = shading.shadeGroup(o.attributes);
  }
  return all;
}

/// Tiles handed out to threads, and what comes back.
struct Frame {
  Frame(const FrameTrace& t, const TraceRenderOptions& o, Film& f, FrameOutput* out)
      : trace(t), options(o), film(f), output(out), order(hilbertOrder(f.tilesX(), f.tilesY())) {}

  const FrameTrace& trace;
  const TraceRenderOptions& options;
  Film& film;
  FrameOutput* output;
  std::vector<int> order;
  std::atomic<size_t> next{0};
  std::atomic<bool> stop{false};
  std::mutex mutex;  // guards all below and the callbacks
  TraceRenderStatistics statistics;
  size_t tilesDone = 0;

  void work() {
    TileTracer tracer(trace);
    TracedTile tile;
    std::vector<const float*> channels;
    double filterSeconds = 0;
    for (size_t i; !stop.load(std::memory_order_relaxed) && (i = next.fetch_add(1)) < order.size();) {
      tracer.trace(film.tileRect(order[i]), tile);
      const auto start = std::chrono::steady_clock::now();
      channels.clear();
      for (const auto& c : tile.channels) channels.push_back(c.data());
      const TileSamples samples{trace.pattern.perPixel(), tile.counts.empty() ? nullptr : tile.counts.data(),
                                tile.x.data(), tile.y.data(), channels.data()};
      film.addTile(order[i], samples, [this](FilmTile&& pixels) {
        if (options.pixels) {
          const std::lock_guard lock(mutex);
          options.pixels(pixels);
        }
        if (output) output->addTile(pixels);
      });
      filterSeconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
      if (abortRequested()) stop = true;
      const std::lock_guard lock(mutex);
      ++tilesDone;
      if (options.progress) options.progress(double(tilesDone) / double(order.size()));
    }
    const std::lock_guard lock(mutex);
    statistics += tracer.statistics();
    statistics.filterAndWriteSeconds += filterSeconds;
  }

  void run(int threads, int cores) {
    const auto body = [this](int) {
      try {
        work();
      } catch (const std::bad_alloc&) {
        report(makeError(RiError::kNoMem, "out of memory while rendering"));
        stop = true;
      }
    };
    // Each body hands out tiles to itself until none is left; one that starts late finds none.
    tbb::task_arena arena(std::min(threads, cores));  // oneTBB has no more workers
    arena.execute([&] { tbb::parallel_for(0, threads, body, tbb::simple_partitioner()); });
  }
};

}  // namespace

TraceRenderStatistics& TraceRenderStatistics::operator+=(const TraceRenderStatistics& o) {
  fewestSamples = tiles == 0     ? o.fewestSamples
                  : o.tiles == 0 ? fewestSamples
                                 : std::min(fewestSamples, o.fewestSamples);
  mostSamples = std::max(mostSamples, o.mostSamples);
  tiles += o.tiles, samples += o.samples, cameraRays += o.cameraRays, hits += o.hits;
  shadeBatches += o.shadeBatches, raysAsked += o.raysAsked, pixels += o.pixels;
  errors += o.errors;
  tracer += o.tracer;
  traceSeconds += o.traceSeconds, shadeSeconds += o.shadeSeconds, answerSeconds += o.answerSeconds;
  filterAndWriteSeconds += o.filterAndWriteSeconds, wallSeconds += o.wallSeconds;
  return *this;
}

Result<TraceRenderStatistics> renderFrame(cache::SceneCache& cache, ShadingSystem& shading,
                                          const TraceRenderOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const cache::Skeleton& skeleton = cache.skeleton();
  const cache::CameraRecord& camera = skeleton.camera();

  const FrameGeometry geometry = frameGeometry(skeleton);
  if (geometry.crop.empty()) return makeError(RiError::kRange, "the crop window holds no pixels");
  std::vector<DisplayRequest> displays = frameDisplays(skeleton, options.picture);
  if (auto fits = checkPictureFits(geometry, displays); !fits) return fits.error();
  const std::vector<std::string> displayPath = frameDisplaySearchPath(skeleton);
  if (options.writeDisplays && options.keepExisting && !displays.empty()) {
    dropExistingDisplays(displays, displayPath);
    if (displays.empty()) return TraceRenderStatistics{};
  }

  const int cores = availableCores();
  const int threads = std::clamp(options.threads > 0 ? options.threads : cores, 1, 1024);
  RayTracerOptions tracerOptions;
  tracerOptions.scene = {options.patchMultiplier, threads, true};
  RayTracer tracer(cache, shading, tracerOptions);
  struct Announced {
    const TraceRenderOptions& options;
    ~Announced() {
      if (options.onTracer) options.onTracer(nullptr);
    }
  } announced{options};
  if (options.onTracer) options.onTracer(&tracer);

  FrameTrace trace;
  trace.tracer = &tracer;
  trace.camera = CameraRays(camera, frameCameraKeys(skeleton), frameLens(skeleton));
  if (const Ray r = trace.camera.ray(0, 0); !isFinite(r.direction) || !isFinite(r.origin))
    return makeError(RiError::kMath, "the camera's transformation or projection cannot be inverted");
  trace.adaptive = frameAdaptiveSampling(skeleton, options.adaptive);
  trace.pattern =
      trace.adaptive
          ? SamplePattern(trace.adaptive->maxSamples, 1, true, options.seed,
                          {frameMoves(skeleton), frameLens(skeleton).radius > 0, trace.adaptive->minSamples})
          : frameSamplePattern(skeleton, options.seed);
  trace.surfaces = cameraSurfaces(cache, shading);
  trace.midpointDepth = frameDepthFilter(skeleton).midpoint;
  if (trace.midpointDepth)  // what lies behind the first surface is wanted too
    for (CameraSurface& s : trace.surfaces) s.opaque = false;
  resolveOutputTypes(displays, [&](std::string_view name) { return shading.outputComponents(name); });
  trace.outputs = requiredOutputs(displays);
  trace.opacityThreshold = std::clamp(
      frameFloatOption(skeleton, skeleton.options().options, "limits:othreshold", 0.996f), 0.0f, 1.0f);
  trace.seed = options.seed;

  std::vector<ChannelRule> rules(size_t(kFixedChannels) + trace.outputs.size(), ChannelRule::kFiltered);
  for (size_t i = 0; i < trace.outputs.size(); ++i) rules[size_t(kFixedChannels) + i] = trace.outputs[i].rule;
  rules[kDepthChannel] = frameDepthFilter(skeleton).rule;
  Film film(geometry.crop, framePixelFilter(skeleton),
            frameBucketSize(skeleton, options.tileSize, trace.pattern.perPixel()), rules);

  std::optional<FrameOutput> output;
  if (options.writeDisplays) {
    output.emplace(geometry, std::move(displays), displayPath);
    if (skeleton.options().imager != cache::kNone)
      output->setImager([&](auto&&... pixels) { return shading.runImager(pixels...); });
    if (auto opened = output->open(); !opened) return opened.error();
  }
  // Everything that rays can meet is diced and sorted now. An error was reported.
  if (auto ready = tracer.prepare(); !ready)
    return makeError(RiError::kSystem, "nothing can be traced: {}", ready.error().message);

  if (trace.adaptive && trace.adaptive->pictureError > 0) {
    TraceRenderOptions quiet;
    trace.adaptive = varianceForError(*trace.adaptive, [&](const AdaptiveSampling& a) {
      trace.adaptive = a;
      Film some(geometry.crop, framePixelFilter(skeleton), kLookTileSize, rules);
      Frame look(trace, quiet, some, nullptr);
      keepTilesToLookAt(look.order);
      look.run(threads, cores);
      look.statistics.errors.filtered(framePixelFilter(skeleton));
      return look.statistics.errors;
    });
  }
  Frame frame(trace, options, film, output ? &*output : nullptr);
  frame.run(threads, cores);
  if (frame.stop)
    return makeError(RiError::kSystem, "rendering stopped after {} of {} tiles", frame.tilesDone,
                     frame.order.size());
  if (output)
    if (auto written = output->finish(); !written) return written.error();
  TraceRenderStatistics& s = frame.statistics;
  s.errors.filtered(framePixelFilter(skeleton));
  s.tracer = tracer.statistics();
  s.wallSeconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return s;
}

}  // namespace fr::tracer
