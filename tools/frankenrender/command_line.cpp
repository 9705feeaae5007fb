#include "tools/frankenrender/command_line.h"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cstdio>

namespace fr::tools {
namespace {

constexpr const char* kDescription =
    "Renders RIB scenes: a REYES renderer draws the frame, a ray tracer in a second process\n"
    "answers every trace, visibility, rayhittest and fulltrace of the shaders. Both share one\n"
    "tessellated scene in memory. The pictures go where the scene's Display requests say.";

constexpr const char* kFooter =
    R"(Scene files are read in order as one stream; "-" is standard input. Files after -bmrt are seen
by the ray tracer alone, files after -prman by REYES alone, files after -common by both again:

  frankenrender common.rib -bmrt reflected.rib -prman foreground.rib

A .fsc file (see `scenecache build`) stands for a whole scene, already tessellated.

Search paths besides Option "searchpath": SHADERS, TEXTURES, ARCHIVES, PROCEDURALS, DISPLAYS
(colon-separated). Shaders are also looked for beside the RIB; missing or stale .slx files are
compiled from their .sl.

Exit status: 0 rendered; 1 something failed or was replaced by a default; 2 wrong usage.

Examples:
  frankenrender scene.rib                          render
  frankenrender --res 320 180 --samples 2 2 s.rib  a quick look
  frankenrender --stats s.rib                      time, rays, grids, memory of both processes
  frankenrender --memory 1G big.rib                 a scene larger than memory
  frankenrender -o test.png s.rib                  one picture, whatever the Displays say)";

bool isSideSwitch(const std::string& a) { return a == "-bmrt" || a == "-prman" || a == "-common"; }

}  // namespace

ParsedCommandLine parseCommandLine(int argc, char** argv) {
  CommandLine c;
  c.words.assign(argv + 1, argv + argc);
  CLI::App app{kDescription, "frankenrender"};
  app.footer(kFooter);
  app.set_version_flag("--version,-V", std::string("frankenrender ") + FR_VERSION);

  bool shm = false, noProgress = false;
  std::vector<int> resolution, frames;
  std::vector<double> crop, samples;
  double shadingRate = 0, error = 0;
  std::vector<double> variance;
  std::string output;
  std::vector<std::string> common;

  auto* shmFlag =
      app.add_flag("--shm", shm, "Ray tracer in a process of its own, over shared memory (default)");
  auto* inprocFlag =
      app.add_flag("--inproc", c.inproc, "Everything in one process; the same picture, bit for bit")
          ->excludes(shmFlag);
  app.add_flag(
         "--pipe", c.pipe,
         "Ray tracer behind a pipe, as in 1998: it loads the scene for itself; RAYSERVER may say how to\n"
         "start it (default: rendrib -rayserver with the same scene). The same picture, bit for bit")
      ->excludes(shmFlag)
      ->excludes(inprocFlag);
  app.add_option("--res", resolution, "Resolution, instead of Format")
      ->expected(2)
      ->type_name("X Y")
      ->check(CLI::Range(1, 65536));
  app.add_option("--crop", crop, "Part of the frame, 0 to 1, y down")->expected(4)->type_name("X0 X1 Y0 Y1");
  app.add_option("--samples", samples, "Samples a pixel, instead of PixelSamples")
      ->expected(2)
      ->type_name("X Y")
      ->check(CLI::Range(1.0, 64.0));
  auto* errorOption =
      app.add_option(
             "--error", error,
             "Adaptive sampling: as many samples as the picture needs to have about this error (RMSE, white\n"
             "is 1), where it needs them, up to 1024 a pixel. Tells what error it has")
          ->type_name("E")
          ->check(CLI::Range(1e-6, 1.0));
  app.add_option(
         "--var", variance,
         "Adaptive sampling: MIN samples a pixel, then more, up to MAX, until the estimated variance of\n"
         "the pixel is at most V (as PixelVariance with Option \"render\" \"minsamples\" \"maxsamples\")")
      ->expected(3)
      ->type_name("V MIN MAX")
      ->excludes(errorOption);
  app.add_option("--shading-rate", shadingRate, "Micropolygon area in pixels, instead of ShadingRate")
      ->check(CLI::PositiveNumber);
  app.add_option("--frames", frames, "First and last frame to render")->expected(2)->type_name("A B");
  app.add_option("--threads", c.threads, "Threads (default: all cores)")->check(CLI::Range(1, 1024));
  app.add_option("--shaders", c.shaderPath, "Folders of shaders, colon-separated, searched first")
      ->type_name("PATH");
  app.add_option("-o,--output", output,
                 "Write one picture to this file (format by its ending) instead of the Displays")
      ->type_name("FILE");
  std::string memory;
  app.add_option(
         "--memory", memory,
         "Most that this job may hold in memory, both processes together: 512M, 2G. The scene goes to\n"
         "files in the scratch folder then, and only what is in use stays in memory")
      ->type_name("SIZE");
  app.add_option("--scratch", c.memory.scratch,
                 "Folder on a disk for scenes that do not fit into memory (default with --memory: TMPDIR,\n"
                 "/var/tmp or /tmp). Nothing stays there")
      ->type_name("DIR")
      ->check(CLI::ExistingDirectory);
  app.add_flag("--deterministic", c.deterministic,
               "The same picture, bit for bit, on every machine: rays are traced with the instructions that\n"
               "all of them have, a little slower. (On one machine it is the same anyway, whatever the\n"
               "threads, transport, memory and caches)");
  app.add_flag("--progress", c.progress, "Show a progress bar (default on a terminal)");
  app.add_flag("--no-progress", noProgress, "Show none");
  app.add_flag(
      "--resume", c.resume,
      "Keep finished buckets beside the picture (FILE.unfinished) and go on where a run with --resume was "
      "stopped or killed; scene, shaders and textures must be the same");
  app.add_flag(
      "--progressive", c.progressive,
      "Write a coarse picture of the whole frame first, then a better one, then the picture. The last "
      "is what\nthere would be without this");
  app.add_flag("--stats", c.stats, "Print statistics at the end");
  app.add_flag("--quiet", c.quiet, "Print errors only");
  app.add_option("scenes", common, "RIB files, or one .fsc")->type_name("SCENE...");

  // -bmrt and -prman are switches of the 1998 script: one dash, and they hold for the files that follow. So
  // the files are picked out here and the rest goes to the parser.
  std::vector<std::string> rest;
  uint8_t sides = cache::kForReyes | cache::kForTracer;
  int values = 0;  // arguments that belong to the option before
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    if (values > 0) {
      rest.push_back(a);
      --values;
    } else if (isSideSwitch(a)) {
      sides = a == "-bmrt"    ? uint8_t(cache::kForTracer)
              : a == "-prman" ? uint8_t(cache::kForReyes)
                              : uint8_t(cache::kForReyes | cache::kForTracer);
    } else if (a.size() > 1 && a[0] == '-') {
      rest.push_back(a);
      if (const auto* option = app.get_option_no_throw(a); option && option->get_items_expected_max() > 0)
        values = option->get_items_expected_max();
    } else {
      c.inputs.push_back({a, sides});
    }
  }
  std::reverse(rest.begin(), rest.end());
  try {
    app.parse(rest);
  } catch (const CLI::ParseError& e) {
    return {std::nullopt, app.exit(e) == 0 ? 0 : 2};
  }
  if (c.inputs.empty()) {
    if (isatty(STDIN_FILENO)) {
      std::fputs("frankenrender: no scene given; try frankenrender --help\n", stderr);
      return {std::nullopt, 2};
    }
    c.inputs.push_back({"-", cache::kForReyes | cache::kForTracer});
  }

  if (app.count("--memory") > 0) {
    const auto bytes = parseMemorySize(memory);
    if (!bytes) {
      std::fprintf(stderr,
                   "frankenrender: --memory wants a size such as 512M or 2G, at least 1M; not \"%s\"\n",
                   memory.c_str());
      return {std::nullopt, 2};
    }
    c.memory.budget = *bytes;
  }
  cache::FrameOverrides& o = c.load.overrides;
  if (!resolution.empty()) o.resolution = {resolution[0], resolution[1]};
  if (!crop.empty()) {
    if (!(crop[0] < crop[1] && crop[2] < crop[3] && crop[0] >= 0 && crop[1] <= 1 && crop[2] >= 0 &&
          crop[3] <= 1)) {
      std::fputs("frankenrender: --crop wants 0 <= X0 < X1 <= 1 and 0 <= Y0 < Y1 <= 1\n", stderr);
      return {std::nullopt, 2};
    }
    o.crop = {crop[0], crop[1], crop[2], crop[3]};
  }
  if (error > 0) c.adaptive = AdaptiveSampling::toError(error);
  if (!variance.empty()) {
    if (!(variance[0] >= 0 && variance[1] >= 1 && variance[1] <= variance[2] && variance[2] <= 4096)) {
      std::fputs("frankenrender: --var wants 0 <= V and 1 <= MIN <= MAX <= 4096\n", stderr);
      return {std::nullopt, 2};
    }
    c.adaptive = AdaptiveSampling{float(variance[0]), int(variance[1]), int(variance[2])};
  }
  c.tellError = error > 0;
  if (!samples.empty()) o.pixelSamples = {samples[0], samples[1]};
  if (shadingRate > 0) o.shadingRate = float(shadingRate);
  if (!frames.empty()) c.load.frames = {frames[0], frames[1]};
  if (app.count("--output") > 0 && output.empty()) {
    std::fputs("frankenrender: --output wants the name of a file\n", stderr);
    return {std::nullopt, 2};
  }
  if (!output.empty()) o.displays.push_back({output, "file", "rgba"});
  c.progress = !c.quiet && !noProgress && (c.progress || isatty(STDERR_FILENO));
  return {std::move(c), 0};
}

}  // namespace fr::tools
