// scenecache build: RIB to a .fsc file, with every grid.
#include <fmt/format.h>
#include <sys/resource.h>
#include <tbb/global_control.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "base/cores.h"
#include "base/interrupt.h"
#include "base/log.h"
#include "scene_cache/scene_loader.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"
#include "tools/memory_budget.h"
#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"
#include "tools/scenecache/dice_all.h"
#include "tools/scenecache/displacement.h"
#include "tools/shader_folders.h"
#include "tools/shader_traits.h"

namespace fr::tools {
using namespace cache;
namespace {

struct BuildOptions {
  std::vector<std::string> ribs;
  std::string output, scratch, memory, reuse;
  std::optional<int> frame;
  std::optional<float> rate, patchMultiplier;
  int threads = 0;
  bool quiet = false, json = false, noProgress = false;
  uint64_t budget = 0;  // bytes, 0: none
};

double processorSeconds() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  const auto seconds = [](const timeval& t) { return double(t.tv_sec) + double(t.tv_usec) * 1e-6; };
  return seconds(u.ru_utime) + seconds(u.ru_stime);
}

Result<void> buildFrame(const BuildOptions& o, const std::vector<RibInput>& inputs, const Frame& frame) {
  const auto start = std::chrono::steady_clock::now();
  const double processorStart = processorSeconds();
  auto made = SceneCache::createInFile(frame.skeletonFd(), o.output, o.scratch);
  if (!made) return std::move(made).error();
  SceneCache& cache = **made;
  ShadingSystem::Options shaders;
  shaders.shaderPath = shaderFolders({}, cache.skeleton(), inputs);
  shaders.standardShaders = standardShaderFolder();
  ShadingSystem shading(cache, shaders);  // displacement is part of dicing
  shading.loadShaders(kForReyes | kForTracer);
  cache.setDisplacer(&shading.displacer());
  ShaderLibrary::Options libraryOptions;
  libraryOptions.folders = shaders.shaderPath;
  libraryOptions.standardShaders = shaders.standardShaders;
  ShaderLibrary library(libraryOptions);
  const uint64_t displacement = displacementFingerprint(cache.skeleton(), library);

  if (!o.reuse.empty()) {
    auto old = SceneCache::openMapped(o.reuse);
    if (!old) return std::move(old).error();
    const bool same = displacement != 0 && (*old)->displacement() == displacement;
    cache.takeGridsFrom(std::shared_ptr<const SceneCache>(*std::move(old)), {same, false});
  }
  DiceAllOptions dicing;
  if (o.budget != 0) dicing.bytesHeld = std::clamp(o.budget / 8, uint64_t(8) << 20, dicing.bytesHeld);
  dicing.title = o.output;
  dicing.progress = !o.quiet && !o.noProgress && isatty(STDERR_FILENO) != 0;
  auto tally = diceAll(cache, dicing);
  cache.setDisplacer(nullptr);
  if (!tally) return std::move(tally).error();
  const CacheStatistics stats = cache.statistics();
  const double dicingSeconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (auto r = cache.finishFile(displacement); !r) return r;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::error_code unknown;
  const uint64_t fileBytes = std::filesystem::file_size(o.output, unknown);
  if (o.json) {
    const nlohmann::ordered_json d = {{"file", o.output},
                                      {"frame", frame.number()},
                                      {"objects", cache.skeleton().objects().size()},
                                      {"patches", cache.skeleton().rootPatches().size()},
                                      {"grids", tally->grids},
                                      {"meshlets", tally->meshlets},
                                      {"gridsReused", stats.gridsReused},
                                      {"gridsShared", stats.gridsShared},
                                      {"micropolygons", tally->micropolygons},
                                      {"triangles", tally->triangles},
                                      {"bytes", fileBytes},
                                      {"readSeconds", frame.counts().seconds},
                                      {"diceSeconds", dicingSeconds},
                                      {"seconds", seconds},
                                      {"processorSeconds", processorSeconds() - processorStart},
                                      {"threads", o.threads},
                                      {"peakResidentBytes", uint64_t(usage.ru_maxrss) * 1024}};
    fmt::print("{}\n", d.dump(2));
  }
  if (!o.quiet) {
    std::string reused;
    if (!o.reuse.empty()) reused = fmt::format(" ({} of {})", stats.gridsReused, o.reuse);
    fmt::print(stderr, "{}: frame {}, {} objects, {} grids{}, {:.2f} M faces, {} in {:.1f} s\n", o.output,
               frame.number(), cache.skeleton().objects().size(), tally->grids + tally->meshlets, reused,
               double(tally->faces()) / 1e6, bytesText(fileBytes), seconds);
  }
  return {};
}

int build(BuildOptions o) {
  if (o.quiet) setLogLevel(Severity::kError);
  if (!o.memory.empty()) {
    const std::optional<uint64_t> bytes = parseMemorySize(o.memory);
    if (!bytes) {
      report(makeError(RiError::kBadToken,
                       "--memory {}: a size is a number with K, M or G behind it, a mebibyte at least",
                       o.memory));
      return kUsage;
    }
    o.budget = *bytes;
  }
  if (o.threads <= 0) o.threads = availableCores();
  const tbb::global_control control(tbb::global_control::max_allowed_parallelism, size_t(o.threads));
  std::vector<RibInput> inputs;
  for (const std::string& r : o.ribs) inputs.push_back({r});
  LoadOptions options;
  options.overrides.shadingRate = o.rate;
  options.overrides.patchMultiplier = o.patchMultiplier;
  for (const std::string& rib : o.ribs) {
    std::error_code unknown;
    const std::filesystem::path file = std::filesystem::absolute(rib, unknown);
    if (rib != "-" && !unknown) options.overrides.shaderFolders.push_back(file.parent_path().string());
  }
  // Control points and tables too, then: the kernel keeps of them what is used.
  if (o.budget != 0 && o.scratch.empty()) {
    std::error_code unknown;
    o.scratch = std::filesystem::absolute(o.output, unknown).parent_path().string();
  }
  options.scratch = o.scratch;
  options.defaults.display = kDefaultDisplay;
  ShaderTraits traits = shaderTraits({}, inputs);
  options.movesPoints = std::move(traits.movesPoints), options.takesString = std::move(traits.takesString);
  std::unique_ptr<shm::Pager> pager;
  if (o.budget != 0) {
    auto started = shm::Pager::start(o.budget);
    if (!started) {
      report(started.error());
      return kFailed;
    }
    pager = *std::move(started);
  }
  if (o.frame) options.frames = std::pair(*o.frame, *o.frame);
  bool made = false, failed = false;
  int built = 0, others = 0;
  const auto onFrame = [&](Frame&& f) {
    if (made) {
      ++others;
      return !abortRequested();
    }
    made = true;
    built = f.number();
    if (auto r = buildFrame(o, inputs, f); !r) {
      if (!interrupted()) report(r.error());
      failed = true;
      return false;
    }
    return !abortRequested();
  };
  if (auto r = loadScene(inputs, options, onFrame); !r) {
    if (!interrupted()) report(r.error());
    failed = true;
  }
  if (interrupted()) {
    report({RiError::kNone, Severity::kWarning, {}, fmt::format("stopped: {} was not written", o.output)});
    return kFailed;
  }
  if (others > 0)
    report({RiError::kNone,
            Severity::kInfo,
            {},
            fmt::format("only frame {} was built; {} more can be chosen with --frame", built, others)});
  if (!made && !failed) {
    report(o.frame ? makeError(RiError::kMissingData, "no frame {} in the input", *o.frame)
                   : makeError(RiError::kMissingData, "no WorldBegin ... WorldEnd in the input"));
    failed = true;
  }
  return failed || reportCount(Severity::kError) > 0 ? kFailed : kOk;
}

constexpr const char* kMore =
    R"(The file appears under its name when it is whole: after Ctrl-C, kill -9 or on a full disk the old
file, if there was one, is still there, and nothing else; start again.

Grids are written while others are diced, into the folder of the output; memory holds an eighth of
the budget of them, at most 64 MB. With --memory or --scratch the scene before dicing (control
points, tables) and the table of patches are in files too, in the scratch folder.

--reuse finds objects again by all that their grids depend on: control points, transform, rates,
displacement. With the same camera whole objects are copied; with another one every patch is
planned anew and copied where it gets the same rows and columns. The old file may be the output.)";

}  // namespace

void addBuild(CLI::App& app, Run& run) {
  auto o = std::make_shared<BuildOptions>();
  CLI::App* b = app.add_subcommand("build", "Read RIB, dice everything, write a .fsc file");
  b->footer(kMore);
  b->add_option("scene.rib", o->ribs, "RIB files, read one after the other (- is standard input)")
      ->required();
  b->add_option("-o,--output", o->output, "The .fsc file")->required();
  b->add_option("--memory", o->memory, "Budget of memory: 512M, 2G ... Default: none");
  b->add_option("--scratch", o->scratch,
                "Folder for the scene and its table of patches meanwhile. Default: the output's");
  b->add_option("--reuse", o->reuse, "Take from this cache what would be diced the same");
  b->add_option("--frame", o->frame,
                "Number of the frame (FrameBegin) to build. Default: the first world of the input");
  b->add_option("--rate,--shading-rate", o->rate, "ShadingRate of everything, whatever the RIB says")
      ->check(CLI::PositiveNumber);
  b->add_option(
       "--patch-multiplier,--patch_multiplier", o->patchMultiplier,
       "Where the RIB has no Attribute \"render\" \"patch_multiplier\": above 1 grids are so many times "
       "finer; below 1 rays see coarser rows and columns of the same grids")
      ->check(CLI::PositiveNumber);
  b->add_option("-t,--threads", o->threads, "Default: all processors")->check(CLI::NonNegativeNumber);
  b->add_flag("--json", o->json, "Figures of the build on standard output");
  b->add_flag("--no-progress", o->noProgress, "No progress bar (there is one on terminals only)");
  b->add_flag("-q,--quiet", o->quiet, "Only errors");
  b->callback([o, &run] { run = [o] { return build(*o); }; });
}

}  // namespace fr::tools
