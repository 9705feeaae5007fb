#include "tools/rendrib/trace_report.h"

#include <fmt/format.h>

#include <iterator>

#include "shm/memory_info.h"

namespace fr::tools {
namespace {

std::string mebibytes(uint64_t bytes) { return fmt::format("{:.1f} MiB", double(bytes) / 1048576.0); }

}  // namespace

std::string TraceReport::text(int frameNumber) const {
  std::string text = fmt::format("frame {}\n", frameNumber);
  const auto line = [&](std::string_view name, const std::string& value) {
    fmt::format_to(std::back_inserter(text), "  {:<22} {}\n", name, value);
  };
  const tracer::TracerStatistics& t = frame.tracer;
  text += " time (seconds; sums over threads but for the first four)\n";
  if (load) line("read scene", fmt::format("{:.3f}", load->seconds));
  line("render, wall clock", fmt::format("{:.3f}", frame.wallSeconds));
  line("dice", fmt::format("{:.3f}", t.resolveSeconds));
  line("build BVH", fmt::format("{:.3f}", t.buildSeconds));
  line("trace camera rays", fmt::format("{:.3f}", frame.traceSeconds));
  line("shade camera hits", fmt::format("{:.3f}", frame.shadeSeconds));
  line("answer shaders' rays", fmt::format("{:.3f}", frame.answerSeconds));
  line("filter and write", fmt::format("{:.3f}", frame.filterAndWriteSeconds));
  line("compile shaders", fmt::format("{:.3f}  ({} loaded, {} compiled)", shading.compileSeconds,
                                      shading.shadersLoaded, shading.shadersCompiled));
  if (shading.textureFiles > 0)
    line("textures",
         fmt::format("{} files, {} lookups, {:.1f} MiB read, {:.1f} MiB held", shading.textureFiles,
                     shading.textureLookups, double(shading.textureBytesRead) / 1048576,
                     double(shading.textureMemory) / 1048576));
  text += " geometry\n";
  if (load)
    line("primitives",
         fmt::format("{}{}", load->primitives,
                     load->dropped ? fmt::format("  ({} could not be used)", load->dropped) : std::string()));
  if (load && load->instances > 0)
    line("instances", fmt::format("{}  ({} share grids)", load->instances, load->sharedInstances));
  if (load && load->procedurals + load->proceduralsUnopened > 0)
    line("procedurals",
         fmt::format("{} expanded, {} never opened", load->procedurals, load->proceduralsUnopened));
  if (load && load->outOfBound + load->otherDetail > 0)
    line("left out", fmt::format("{} outside the frame by their Bound, {} for another detail",
                                 load->outOfBound, load->otherDetail));
  line("grids diced", fmt::format("{}  ({} micropolygons)", cache.gridsDiced, cache.micropolygonsDiced));
  line("ray scene", fmt::format("{} grids, {} meshlets, {} quads, {} triangles", t.grids, t.meshlets, t.quads,
                                t.triangles));
  text += " samples and rays\n";
  line("pixels sampled", fmt::format("{}  ({:.2f} samples each, {} to {})", frame.pixels,
                                     frame.pixels ? double(frame.samples) / double(frame.pixels) : 0.0,
                                     frame.fewestSamples, frame.mostSamples));
  if (frame.errors.values > 0) line("estimated error (RMSE)", fmt::format("{:.2g}", frame.errors.rmse()));
  line("camera rays",
       fmt::format("{}  ({} hits shaded in {} batches)", frame.cameraRays, frame.hits, frame.shadeBatches));
  static constexpr const char* kKinds[] = {"trace", "visibility", "rayhittest", "fulltrace"};
  for (int k = 0; k < 4; ++k)
    if (t.rays[k] || t.nestedRays[k])
      line(kKinds[k],
           fmt::format("{} from camera hits, {} from shaders at other hits", t.rays[k], t.nestedRays[k]));
  if (t.hitsShaded) line("other hits shaded", fmt::format("{}", t.hitsShaded));
  text += " memory\n";
  line("scene cache", fmt::format("{} skeleton, {} nodes, {} grids", mebibytes(cache.skeletonBytes),
                                  mebibytes(cache.nodeBytes), mebibytes(cache.arenaBytes)));
  line("BVH", fmt::format("{}  (peak {}), {} records", mebibytes(t.embreeBytes), mebibytes(t.embreePeakBytes),
                          mebibytes(t.recordBytes)));
  if (auto m = shm::processMemory(0); m.ok())
    line("process", fmt::format("PSS {}, private {}", mebibytes(m->pss), mebibytes(m->privateBytes)));
  if (pager)
    line("budget", fmt::format("{}; at most {} held, {} let go", mebibytes(pager->budget),
                               mebibytes(pager->peak), mebibytes(pager->letGo)));
  return text;
}

}  // namespace fr::tools
