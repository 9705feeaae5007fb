// scenecache prune: the same cache without grids that nobody needs.
#include <fmt/format.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "base/interrupt.h"
#include "base/log.h"
#include "scene_cache/screen_extent.h"
#include "shm/file_descriptor.h"
#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"
#include "tools/scenecache/dice_all.h"

namespace fr::tools {
using namespace cache;
namespace {

struct PruneOptions {
  std::string file, output;
  std::vector<std::string> drop, keep;
  bool noRays = false, json = false, quiet = false;
};

/// Whether camera rays can meet the object's box.
bool inPicture(const Skeleton& s, const ObjectRecord& o) {
  ScreenCamera camera;
  camera.record = s.camera();
  const TransformRecord& t = s.transforms()[s.camera().worldToCamera];
  const auto* keys = reinterpret_cast<const DMat4*>(s.bytes().data() + t.matrices.offset);
  camera.worldToCamera = {keys, size_t(t.matrices.count)};
  for (int i = 0; i < 2; ++i) camera.filterRadius[i] = double(s.options().filterWidth[i]) * 0.5 + 1;
  DMat4 toWorld(1);
  toWorld[3] = DVec4(s.header().cacheOrigin, 1.0);
  const ri::Bound box{o.bound.min.x, o.bound.max.x, o.bound.min.y,
                      o.bound.max.y, o.bound.min.z, o.bound.max.z};
  return screenExtent(camera, std::span(&toWorld, 1), box).inView;
}

std::vector<bool> neededObjects(const Skeleton& s, const PruneOptions& o) {
  const auto objects = s.objects();
  std::vector<bool> needed(objects.size(), false);
  for (ObjectId i = 0; i < objects.size(); ++i) {
    const ObjectRecord& object = objects[i];
    const AttributeRecord& a = s.attributes()[object.attributes];
    const bool camera = (object.sides & kForReyes) && (a.visibility & kVisibleCamera) && inPicture(s, object);
    const bool rays =
        !o.noRays && (object.sides & kForTracer) && (a.visibility & (kVisibleReflection | kVisibleShadow));
    needed[i] = camera || rays || object.solidPlus1 != 0;
    const std::string name = objectName(s, i);
    if (!o.keep.empty()) {
      bool any = false;
      for (const std::string& pattern : o.keep) any = any || matches(pattern, name, i);
      needed[i] = needed[i] && any;
    }
    for (const std::string& pattern : o.drop) needed[i] = needed[i] && !matches(pattern, name, i);
  }
  // Instances show their prototype's vertices.
  for (ObjectId i = 0; i < objects.size(); ++i)
    if (needed[i] && objects[i].prototype != kNone) needed[objects[i].prototype] = true;
  return needed;
}

Result<shm::FileDescriptor> inMemory(std::span<const std::byte> bytes) {
  shm::FileDescriptor fd(memfd_create("fr-skeleton", MFD_CLOEXEC));
  size_t at = 0;
  while (fd && at < bytes.size()) {
    const ssize_t n = write(fd.get(), bytes.data() + at, bytes.size() - at);
    if (n <= 0) break;
    at += size_t(n);
  }
  if (!fd || at < bytes.size())
    return makeError(RiError::kNoMem, "no memory for the scene: {}", std::strerror(errno));
  return fd;
}

int prune(const PruneOptions& o) {
  if (o.quiet) setLogLevel(Severity::kError);
  const auto failed = [](const Error& e) {
    if (!interrupted()) report(e);
    return kFailed;
  };
  auto opened = SceneCache::openMapped(o.file);
  if (!opened) return failed(opened.error());
  const std::shared_ptr<const SceneCache> old(*std::move(opened));
  auto skeleton = inMemory(old->skeleton().bytes());
  if (!skeleton) return failed(skeleton.error());
  auto made = SceneCache::createInFile(skeleton->get(), o.output, {});
  if (!made) return failed(made.error());
  SceneCache& cache = **made;
  cache.takeGridsFrom(old, {true, true});
  const std::vector<bool> needed = neededObjects(cache.skeleton(), o);
  DiceAllOptions dicing;
  dicing.wanted = [&](ObjectId i) { return needed[i]; };
  dicing.title = o.output;
  dicing.progress = !o.quiet && isatty(STDERR_FILENO) != 0;
  const auto tally = diceAll(cache, dicing);
  if (!tally) return failed(tally.error());
  if (auto r = cache.finishFile(old->displacement()); !r) return failed(r.error());
  Tally before;
  for (const Tally& t : tallyAll(*old)) before += t;
  std::error_code unknown;
  const uint64_t bytes = std::filesystem::file_size(o.output, unknown),
                 bytesBefore = old->statistics().skeletonBytes + old->statistics().nodeBytes +
                               old->statistics().arenaBytes;
  const uint64_t dropped = uint64_t(std::count(needed.begin(), needed.end(), false));
  if (o.json)
    fmt::print("{}\n", nlohmann::ordered_json{{"file", o.output},
                                              {"objectsWithoutGrids", dropped},
                                              {"gridsBefore", before.grids + before.meshlets},
                                              {"grids", tally->grids + tally->meshlets},
                                              {"bytesBefore", bytesBefore},
                                              {"bytes", bytes}}
                           .dump(2));
  else if (!o.quiet)
    fmt::print("{}: {} of {} grids, {} of {}\n", o.output, tally->grids + tally->meshlets,
               before.grids + before.meshlets, bytesText(bytes), bytesText(bytesBefore));
  return kOk;
}

}  // namespace

void addPrune(CLI::App& app, Run& run) {
  auto o = std::make_shared<PruneOptions>();
  CLI::App* p = app.add_subcommand("prune", "Write the cache again without grids that nobody needs");
  p->footer(
      "Always left out: space that nothing refers to, and grids of objects that neither the camera nor any\n"
      "ray can see. The scene itself stays whole: renderers dice what they miss, and the picture is the "
      "same.");
  p->add_option("scene.fsc", o->file)->required();
  p->add_option("-o,--output", o->output, "The new file; may be the same")->required();
  p->add_option("--drop", o->drop, "Objects to leave without grids: names with * and ?, or numbers as '#12'");
  p->add_option("--keep", o->keep, "Leave all others without grids");
  p->add_flag("--no-rays", o->noRays, "No shader will ask for rays: drop what is outside the picture");
  p->add_flag("--json", o->json, "For programs");
  p->add_flag("-q,--quiet", o->quiet, "Only errors");
  p->callback([o, &run] { run = [o] { return prune(*o); }; });
}

}  // namespace fr::tools
