#include "tools/frankenrender/job.h"

#include <fmt/format.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <thread>

#include "base/cores.h"
#include "base/interrupt.h"
#include "base/isa.h"
#include "base/log.h"
#include "oracle/ray_client.h"
#include "reyes/renderer.h"
#include "scene_cache/cache.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"
#include "tools/frankenrender/frame_report.h"
#include "tools/frankenrender/progress_bar.h"
#include "tools/shader_folders.h"
#include "tools/shader_traits.h"
#include "tools/texture_requests.h"
#include "tracer/inproc_oracle.h"
#include "tracer/pipe_oracle.h"
#include "tracer/shm_oracle.h"

namespace fr::tools {
namespace {

/// How --pipe starts its ray server: RAYSERVER as in 1998, else our own over the same frame.
Result<std::vector<std::string>> rayServerCommand(const CommandLine& c, int frame, int threads) {
  if (const char* given = std::getenv("RAYSERVER"); given && *given) return splitCommandLine(given);
  for (const cache::RibInput& i : c.inputs)
    if (i.path == "-")
      return makeError(RiError::kBadFile,
                       "--pipe: the ray server reads the scene too, so it cannot come from standard input");
  std::vector<std::string> words{(std::filesystem::read_symlink("/proc/self/exe").parent_path() / "rendrib"),
                                 "-rayserver", "-silent", "-threads", std::to_string(threads)};
  // A .fsc is one frame, whatever its number.
  if (!(c.inputs.size() == 1 && std::filesystem::path(c.inputs[0].path).extension() == ".fsc"))
    words.insert(words.end(), {"-frames", std::to_string(frame), std::to_string(frame)});
  words.push_back("-frankenrender");
  words.insert(words.end(), c.words.begin(), c.words.end());
  return words;
}

Result<void> renderScene(const CommandLine& c, const MemoryBudget& memory, cache::SceneCache& cache,
                         FrameReport& report) {
  const int threads = c.threads > 0 ? c.threads : availableCores();
  ShadingSystem::Options shadingOptions;
  shadingOptions.shaderPath = shaderFolders(c.shaderPath, cache.skeleton(), c.inputs);
  shadingOptions.standardShaders = standardShaderFolder();
  shadingOptions.textureKilobytes = textureKilobytes(c.memory);

  ShadingSystem shading(cache, shadingOptions);
  shading.loadShaders(cache::kForReyes);
  cache.setDisplacer(&shading.displacer());

  // The oracle exists only if a live shader can ask; even then its process starts with the first question.
  std::unique_ptr<ShadingSystem> hitShading;
  std::unique_ptr<tracer::InprocOracleService> inproc;
  std::unique_ptr<tracer::ShmOracleService> shm;
  std::unique_ptr<tracer::PipeOracleService> pipe;
  RayOracleService* oracle = nullptr;
  cache.setMeetsRays(shading.canAskRays());
  if (shading.canAskRays()) {
    if (c.inproc) {
      ShadingSystem::Options hitOptions = shadingOptions;
      hitOptions.tracerSide = true;
      hitShading = std::make_unique<ShadingSystem>(cache, hitOptions);
      hitShading->loadShaders(cache::kForTracer);
      tracer::RayTracerOptions options;
      options.scene.threads = threads;
      inproc = std::make_unique<tracer::InprocOracleService>(cache, *hitShading, options);
      oracle = inproc.get();
    } else if (c.pipe) {
      auto command = rayServerCommand(c, cache.skeleton().options().frameNumber, threads);
      if (!command) return std::move(command).error();
      pipe = std::make_unique<tracer::PipeOracleService>(
          cache, tracer::PipeOracleService::Options{std::move(command).value()});
      oracle = pipe.get();
    } else {
      tracer::ShmOracleService::Options options;
      options.threads = threads;
      options.shaderPath = shadingOptions.shaderPath;
      options.standardShaders = shadingOptions.standardShaders;
      options.memoryBudget = c.memory.budget;
      shm = std::make_unique<tracer::ShmOracleService>(cache, options);
      oracle = shm.get();
    }
  }

  const BudgetOfJob budget(
      memory, {[&] { return shm ? pid_t(shm->processId()) : pid_t(0); },
               [&](uint64_t wanted) { return inproc ? inproc->giveBack(wanted) : uint64_t(0); }});
  RenderOptions options;
  options.threads = threads;
  options.resume = c.resume;
  options.adaptive = c.adaptive;
  // RIB has been read with it.
  if (!c.load.overrides.displays.empty()) options.picture = c.load.overrides.displays.front().name;
  ProgressBar bar(c.progress, fmt::format("frame {}", cache.skeleton().options().frameNumber));
  options.progress = [&](double fraction) { bar.update(fraction); };
  Result<FrameStatistics> rendered = renderFrame(cache, shading, oracle, options);
  if (c.stats) {
    report.shading = shading.statistics();
    report.cache = cache.statistics();
    if (rendered.ok()) report.frame = *rendered;
    if (inproc) report.tracer = inproc->statistics();
    if (pipe) {
      report.tracer = pipe->statistics();
      report.tracerProcess = pipe->processId();
    }
    if (shm) {
      report.tracer = shm->statistics();
      report.tracerProcess = shm->processId();
      report.tracerRestarts = shm->restarts();
    }
    if (memory.pager()) report.pager = memory.pager()->statistics();
    report.oracleAsked = oracle != nullptr;
    report.takeMemory();
  }
  cache.setDisplacer(nullptr);
  if (!rendered.ok()) return std::move(rendered).error();
  if (c.tellError && rendered->pixels > 0)
    logMessage(Severity::kInfo,
               fmt::format("estimated error of the picture (RMSE): {:.2g}; {:.1f} samples a pixel",
                           rendered->errors.rmse(), double(rendered->samples) / double(rendered->pixels)));
  if (rendered->oracleFailed)
    return makeError(RiError::kSystem, "the frame was finished without its ray tracer");
  return {};
}

bool isCacheFile(const std::string& path) { return std::filesystem::path(path).extension() == ".fsc"; }

/// --progressive: the passes before the last, each with an eighth of the points of the next (of ShadingRate
/// 1).
struct CoarsePass {
  float shadingRate;
  double pixelSamples;
};
constexpr CoarsePass kCoarsePasses[] = {{64, 1}, {8, 2}};

/// The job of a coarse pass. What the last pass says is not said before.
CommandLine coarsePass(const CommandLine& c, const CoarsePass& pass) {
  CommandLine coarse = c;
  cache::FrameOverrides& o = coarse.load.overrides;
  o.shadingRate = std::max(pass.shadingRate, o.shadingRate.value_or(0));
  const auto samples = o.pixelSamples.value_or(std::array{pass.pixelSamples, pass.pixelSamples});
  o.pixelSamples = {std::min(samples[0], pass.pixelSamples), std::min(samples[1], pass.pixelSamples)};
  coarse.adaptive.reset();
  coarse.tellError = coarse.stats = coarse.resume = coarse.progressive = false;
  return coarse;
}

/// Whether the scene can be read several times, and diced differently each time.
bool canBeRefined(const CommandLine& c) {
  return std::all_of(c.inputs.begin(), c.inputs.end(), [](const cache::RibInput& i) {
    std::error_code none;
    return !isCacheFile(i.path) && std::filesystem::is_regular_file(i.path, none);
  });
}

/// Renders all frames. Returns whether all was well.
bool renderFrames(const CommandLine& c, const MemoryBudget& memory) {
  int frames = 0;
  bool failed = false;
  // Loading goes on after a frame that failed: one bad frame does not lose the others.
  const auto renderOne = [&](Result<std::unique_ptr<cache::SceneCache>> opened,
                             const cache::FrameCounts* counts) {
    FrameReport report;
    if (counts) report.load = *counts;
    ++frames;
    if (!opened.ok()) {
      fr::report(opened.error());
      failed = true;
      return;
    }
    if (Result<void> r = renderScene(c, memory, **opened, report); !r.ok()) {
      fr::report(r.error());
      failed = true;
    }
    if (c.stats) std::fputs(report.text((*opened)->skeleton().options().frameNumber).c_str(), stdout);
  };

  if (c.inputs.size() == 1 && isCacheFile(c.inputs[0].path)) {
    const cache::FrameOverrides& o = c.load.overrides;
    if (o.resolution || o.crop || o.pixelSamples || o.shadingRate || c.load.frames)
      reportWarning(
          RiError::kNone,
          "a .fsc holds one frame with its camera, diced: --res, --crop, --samples, --shading-rate and "
          "--frames do not change it");
    renderOne(cache::SceneCache::openFile(c.inputs[0].path, memory.folder()), nullptr);
  } else {
    cache::LoadOptions load = c.load;
    load.defaults.display = cache::kDefaultDisplay;
    load.scratch = memory.folder();
    load.makeTexture = makeRequestedTexture;
    ShaderTraits traits = shaderTraits(c.shaderPath, c.inputs);
    load.asksRays = std::move(traits.asksRays), load.movesPoints = std::move(traits.movesPoints);
    load.takesString = std::move(traits.takesString);
    const Result<void> loaded = cache::loadScene(c.inputs, load, [&](cache::Frame&& frame) {
      renderOne(cache::SceneCache::create(frame.skeletonFd(), memory.folder()), &frame.counts());
      return !abortRequested();
    });
    if (!loaded.ok()) {
      // A frame that the user stopped has said so.
      if (!interrupted() || !failed) report(loaded.error());
      failed = true;
    } else if (frames == 0) {
      reportWarning(RiError::kNone, "{}: nothing was rendered", cache::noWorldFound(c.load));
      failed = true;
    }
  }
  return !failed;
}

}  // namespace

int runJob(const CommandLine& c) {
  if (c.deterministic) beDeterministic();
  setLogLevel(c.quiet ? Severity::kError : Severity::kInfo);
  const int threads = c.threads > 0 ? c.threads : availableCores();
  const tbb::global_control control(tbb::global_control::max_allowed_parallelism, size_t(threads));
  if (c.inputs.size() > 1)
    for (const cache::RibInput& input : c.inputs) {
      if (!isCacheFile(input.path)) continue;
      report(makeError(RiError::kBadFile, "{}: a .fsc file is a whole scene: give it alone", input.path));
      return 2;
    }
  const auto memory = MemoryBudget::hold(c.memory);
  if (!memory) {
    report(memory.error());
    return 1;
  }
  bool good = true;
  if (c.progressive && !canBeRefined(c))
    reportWarning(RiError::kNone,
                  "--progressive needs RIB files that can be read more than once: rendered in one pass");
  else if (c.progressive)
    for (const CoarsePass& pass : kCoarsePasses)
      if (good && !abortRequested()) good = renderFrames(coarsePass(c, pass), *memory);
  if (good && !abortRequested()) good = renderFrames(c, *memory);
  if (interrupted()) return 130;  // as shells have it for Ctrl-C
  return !good || reportCount(Severity::kError) > 0 ? 1 : 0;
}

}  // namespace fr::tools
