#include "tools/rendrib/render.h"

#include <fmt/format.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <mutex>
#include <thread>

#include "base/cores.h"
#include "base/isa.h"
#include "base/log.h"
#include "shading/shader_library.h"
#include "tools/rendrib/command_line.h"
#include "tools/rendrib/trace_report.h"
#include "tools/shader_folders.h"
#include "tools/shader_traits.h"
#include "tools/texture_requests.h"

namespace fr::tools {
namespace {

void say(std::string message) { report(Error{RiError::kNone, Severity::kInfo, {}, std::move(message)}); }

/// Lines for queue managers: one a percent.
class ProgressLines {
 public:
  explicit ProgressLines(bool enabled) : enabled_(enabled) {}
  /// Called by one thread at a time.
  void update(double fraction) {
    const int percent = std::clamp(int(fraction * 100), 0, 100);
    if (!enabled_ || percent <= last_) return;
    last_ = percent;
    fmt::print("R90000 {}%\n", percent);
    std::fflush(stdout);
  }

 private:
  bool enabled_;
  int last_ = -1;
};

Result<void> renderScene(const RendribCommandLine& c, const MemoryBudget& memory, cache::SceneCache& cache,
                         TraceReport& report) {
  const cache::Skeleton& skeleton = cache.skeleton();
  const int frameNumber = skeleton.options().frameNumber;
  ShadingSystem::Options shadingOptions;
  shadingOptions.shaderPath = shaderFolders(c.shaderPath, skeleton, c.inputs);
  shadingOptions.standardShaders = standardShaderFolder();
  shadingOptions.textureKilobytes = textureKilobytes(c.memory);
  ShadingSystem shading(cache, shadingOptions);
  shading.loadShaders(cache::kForTracer);
  cache.setDisplacer(&shading.displacer());

  const cache::CameraRecord& camera = skeleton.camera();
  if (c.verbose)
    say(fmt::format("frame {}: {} x {} pixels, {} objects", frameNumber, camera.resolution[0],
                    camera.resolution[1], skeleton.objects().size()));
  std::mutex tracing;
  tracer::RayTracer* tracer = nullptr;  // under the mutex
  const BudgetOfJob budget(memory, {{}, [&](uint64_t wanted) {
                                      const std::lock_guard lock(tracing);
                                      return tracer ? tracer->giveBack(wanted) : uint64_t(0);
                                    }});
  tracer::TraceRenderOptions options;
  options.threads = c.threads;
  options.patchMultiplier = c.patchMultiplier;
  options.adaptive = c.adaptive;
  options.keepExisting = c.safe;
  // RIB has been read with it.
  if (!c.load.overrides.displays.empty()) options.picture = c.load.overrides.displays.front().name;
  options.onTracer = [&](tracer::RayTracer* t) {
    const std::lock_guard lock(tracing);
    tracer = t;
  };
  ProgressLines progress(c.progressLines);
  progress.update(0);
  options.progress = [&](double fraction) { progress.update(fraction); };
  Result<tracer::TraceRenderStatistics> rendered = tracer::renderFrame(cache, shading, options);
  report.shading = shading.statistics();
  report.cache = cache.statistics();
  if (memory.pager()) report.pager = memory.pager()->statistics();
  cache.setDisplacer(nullptr);
  if (!rendered.ok()) return std::move(rendered).error();
  report.frame = *rendered;
  progress.update(1);
  if (c.verbose)
    say(fmt::format("frame {}: {} in {:.2f} s", frameNumber,
                    rendered->tiles ? "rendered" : "every picture exists, nothing rendered",
                    rendered->wallSeconds));
  return {};
}

bool isCacheFile(const std::string& path) { return std::filesystem::path(path).extension() == ".fsc"; }

void warnOfIgnoredOptions(const RendribCommandLine& c, bool cacheFile) {
  if (c.window) say("-d: there is no window here: the pictures go to files");
  if (c.radiosity)
    reportWarning(RiError::kUnimplemented, "-radio: radiosity is not implemented; rendering without it");
  const cache::FrameOverrides& o = c.load.overrides;
  if (cacheFile && (o.crop || c.load.frames || c.load.defaults.resolution || c.load.defaults.pixelSamples))
    reportWarning(
        RiError::kNone,
        "a .fsc holds one frame with its camera: -res, -samples, -crop and -frames do not change it");
}

int runScenes(RendribCommandLine c) {
  if (c.deterministic) beDeterministic();
  const int threads = c.threads > 0 ? c.threads : availableCores();
  const tbb::global_control control(tbb::global_control::max_allowed_parallelism, size_t(threads));

  const auto cacheFile = std::find_if(c.inputs.begin(), c.inputs.end(),
                                      [](const cache::RibInput& i) { return isCacheFile(i.path); });
  const bool hasCacheFile = cacheFile != c.inputs.end();
  if (hasCacheFile) {
    const std::string path = cacheFile->path;
    std::erase_if(c.inputs, [](const cache::RibInput& i) {
      return std::filesystem::path(i.path).filename() == ".rendribrc";  // says nothing to a finished scene
    });
    if (c.inputs.size() != 1) {
      report(makeError(RiError::kBadFile, "{}: a .fsc file is a whole scene: give it alone", path));
      return 2;
    }
  }
  warnOfIgnoredOptions(c, hasCacheFile);

  const auto memory = MemoryBudget::hold(c.memory);
  if (!memory) {
    report(memory.error());
    return 1;
  }
  int frames = 0;
  bool failed = false;
  // Loading goes on after a frame that failed: one bad frame does not lose the others.
  const auto renderOne = [&](Result<std::unique_ptr<cache::SceneCache>> opened,
                             const cache::FrameCounts* counts) {
    TraceReport trace;
    if (counts) trace.load = *counts;
    ++frames;
    if (!opened.ok()) {
      report(opened.error());
      failed = true;
      return;
    }
    if (Result<void> r = renderScene(c, *memory, **opened, trace); !r.ok()) {
      report(r.error());
      failed = true;
    } else if (c.stats) {
      std::fputs(trace.text((*opened)->skeleton().options().frameNumber).c_str(), stdout);
    }
  };

  if (hasCacheFile) {
    if (c.verbose) say(fmt::format("opening {}", c.inputs[0].path));
    renderOne(cache::SceneCache::openFile(c.inputs[0].path, memory->folder()), nullptr);
  } else {
    if (c.verbose)
      for (const cache::RibInput& i : c.inputs)
        say(fmt::format("reading {}", i.path == "-" ? "standard input" : i.path));
    c.load.defaults.display = cache::kDefaultDisplay;
    c.load.scratch = memory->folder();
    c.load.makeTexture = makeRequestedTexture;
    ShaderTraits traits = shaderTraits(c.shaderPath, c.inputs);
    c.load.asksRays = std::move(traits.asksRays), c.load.movesPoints = std::move(traits.movesPoints);
    c.load.takesString = std::move(traits.takesString);
    const Result<void> loaded = cache::loadScene(c.inputs, c.load, [&](cache::Frame&& frame) {
      renderOne(cache::SceneCache::create(frame.skeletonFd(), memory->folder()), &frame.counts());
      return !abortRequested();
    });
    if (!loaded.ok()) {
      report(loaded.error());
      failed = true;
    } else if (frames == 0) {
      reportWarning(RiError::kNone, "{}: nothing was rendered", cache::noWorldFound(c.load));
      failed = true;
    }
  }
  return failed || reportCount(Severity::kError) > 0 ? 1 : 0;
}

}  // namespace

int runRendrib(int argc, char** argv) {
  ParsedRendribCommandLine parsed = parseRendribCommandLine(argc, argv);
  if (!parsed.run) return parsed.exitCode;
  setLogLevel(parsed.run->silent ? Severity::kError : Severity::kInfo);
  const bool beep = parsed.run->beep;
  const int status = runScenes(std::move(*parsed.run));
  if (beep) std::fputs("\a", stderr);
  return status;
}

}  // namespace fr::tools
