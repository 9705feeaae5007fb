#include "tools/frankenrender/frame_report.h"

#include <fmt/format.h>

#include <iterator>

namespace fr::tools {
namespace {

std::string mebibytes(uint64_t bytes) { return fmt::format("{:.1f} MiB", double(bytes) / 1048576.0); }

class Lines {
 public:
  template <class... Args>
  void line(std::string_view name, fmt::format_string<Args...> f, Args&&... args) {
    fmt::format_to(std::back_inserter(text_), "  {:<22} {}\n", name,
                   fmt::format(f, std::forward<Args>(args)...));
  }
  void title(std::string_view t) { fmt::format_to(std::back_inserter(text_), "{}\n", t); }
  std::string take() { return std::move(text_); }

 private:
  std::string text_;
};

}  // namespace

void FrameReport::takeMemory() {
  if (auto m = shm::processMemory(0); m.ok()) rendererMemory = *m;
  if (tracerProcess != 0)
    if (auto m = shm::processMemory(tracerProcess); m.ok()) tracerMemory = *m;
}

std::string FrameReport::text(int frameNumber) const {
  Lines out;
  out.title(fmt::format("frame {}", frameNumber));
  out.title(" time (seconds; sums over threads but for the first two)");
  if (load) out.line("read scene", "{:.3f}", load->seconds);
  out.line("render, wall clock", "{:.3f}", frame.wallSeconds);
  out.line("dice", "{:.3f}", frame.resolveSeconds);
  out.line("hide", "{:.3f}", frame.hideSeconds);
  out.line("shade", "{:.3f}", frame.shadeSeconds);
  out.line("wait for ray tracer", "{:.3f}", frame.oracleWaitSeconds);
  out.line("composite", "{:.3f}", frame.compositeSeconds);
  out.line("filter and write", "{:.3f}", frame.filterAndWriteSeconds);
  out.line("compile shaders", "{:.3f}  ({} loaded, {} compiled)", shading.compileSeconds,
           shading.shadersLoaded, shading.shadersCompiled);
  if (shading.textureFiles > 0)
    out.line("textures", "{} files, {} lookups, {} read, {} held", shading.textureFiles,
             shading.textureLookups, mebibytes(shading.textureBytesRead), mebibytes(shading.textureMemory));
  out.title(" geometry");
  if (load)
    out.line("primitives", "{}{}", load->primitives,
             load->dropped ? fmt::format("  ({} could not be used)", load->dropped) : std::string());
  if (load && load->instances > 0)
    out.line("instances", "{}  ({} share grids)", load->instances, load->sharedInstances);
  if (load && load->procedurals + load->proceduralsUnopened > 0)
    out.line("procedurals", "{} expanded, {} never opened", load->procedurals, load->proceduralsUnopened);
  if (load && load->outOfBound + load->otherDetail > 0)
    out.line("left out", "{} outside the frame by their Bound, {} for another detail", load->outOfBound,
             load->otherDetail);
  out.line("root patches", "{}  ({} outside the frame)", frame.rootPatches, frame.rootPatchesCulled);
  out.line("patches culled", "{} outside, {} hidden", frame.nodesCulledOutside, frame.nodesCulledHidden);
  out.line("grids diced", "{}  ({} micropolygons, {} splits)", cache.gridsDiced, cache.micropolygonsDiced,
           cache.nodesSplit);
  if (cache.gridsShared > 0) out.line("grids shared", "{}", cache.gridsShared);
  out.line("grids drawn", "{}  ({} hidden)", frame.gridsDrawn, frame.gridsCulledHidden);
  out.line("grids shaded", "{}  ({} points, {} of which show; at most {} held)", frame.gridsShaded,
           frame.pointsShaded, frame.pointsVisible, frame.gridsShadedPeak);
  out.line("samples", "{}  ({} micropolygons tested, {} transparent fragments)", frame.samples,
           frame.micropolygonsTested, frame.fragments);
  if (frame.errors.values > 0)
    out.line("samples a pixel", "{:.1f}, {} to {}; estimated error (RMSE) {:.2g}",
             double(frame.samples) / double(frame.pixels), frame.fewestSamples, frame.mostSamples,
             frame.errors.rmse());
  if (shading.lanesTotal > 0)
    out.line("shader lanes active", "{:.1f} %",
             100.0 * double(shading.lanesActive) / double(shading.lanesTotal));

  out.title(" rays");
  if (!oracleAsked) {
    out.line("none", "no live shader can ask for rays: no ray tracer was started");
  } else if (!tracer && frame.rayBatches > 0) {
    out.line("unknown", "the ray tracer has ended: its numbers are lost");
  } else if (!tracer || tracer->batches == 0) {
    out.line("none", "no shader asked: no ray tracer was started");
  } else {
    static constexpr const char* kKinds[] = {"trace", "visibility", "rayhittest", "fulltrace"};
    for (int k = 0; k < 4; ++k)
      if (tracer->rays[k] || tracer->nestedRays[k])
        out.line(kKinds[k], "{} from REYES, {} from shaders at hits", tracer->rays[k], tracer->nestedRays[k]);
    out.line("batches", "{}  ({:.0f} rays each)", frame.rayBatches,
             frame.rayBatches ? double(frame.raysAsked) / double(frame.rayBatches) : 0.0);
    out.line("hits shaded", "{}", tracer->hitsShaded);
    out.line("ray scene", "{} grids, {} meshlets, {} quads, {} triangles", tracer->grids, tracer->meshlets,
             tracer->quads, tracer->triangles);
    if (tracer->clusters > 0)
      out.line("clusters", "{}, {} met by rays; {} trees built, {} given back", tracer->clusters,
               tracer->clustersDiced, tracer->treesBuilt, tracer->treesFreed);
    out.line("build", "{:.3f} s dicing, {:.3f} s BVH", tracer->resolveSeconds, tracer->buildSeconds);
    out.line("answering", "{:.3f} thread seconds", tracer->answerSeconds);
  }
  if (tracerRestarts > 0)
    out.line("tracers that died", "{}  (the numbers of rays are those of the last one)", tracerRestarts);

  out.title(" memory");
  out.line("scene cache (shared)", "{} skeleton, {} nodes, {} grids", mebibytes(cache.skeletonBytes),
           mebibytes(cache.nodeBytes), mebibytes(cache.arenaBytes));
  if (tracer && tracer->batches > 0)
    out.line("BVH", "{}  (peak {}), {} records", mebibytes(tracer->embreeBytes),
             mebibytes(tracer->embreePeakBytes), mebibytes(tracer->recordBytes));
  uint64_t total = 0;
  const auto process = [&](const char* name, const std::optional<shm::ProcessMemory>& m) {
    if (!m) return;
    total += m->pss;
    out.line(name, "PSS {}, private {}, shared {}", mebibytes(m->pss), mebibytes(m->privateBytes),
             mebibytes(m->sharedBytes));
  };
  process("REYES process", rendererMemory);
  process("ray tracer process", tracerMemory);
  out.line("both (PSS)", "{}", mebibytes(total));
  if (pager)
    out.line("budget", "{}; at most {} held, {} let go", mebibytes(pager->budget), mebibytes(pager->peak),
             mebibytes(pager->letGo));
  return out.take();
}

}  // namespace fr::tools
