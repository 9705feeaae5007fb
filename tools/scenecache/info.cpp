// scenecache info: what is in a cache and what it weighs.
#include <fmt/format.h>

#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {
using namespace cache;
namespace {

using nlohmann::ordered_json;

ordered_json describe(const SceneCache& cache) {
  const Skeleton& s = cache.skeleton();
  const SkeletonHeader& h = s.header();
  struct OfType {
    uint64_t objects = 0, patches = 0;
    Tally tally;
  };
  std::map<PrimitiveType, OfType> types;
  Tally t;
  const std::vector<Tally> tallies = tallyAll(cache);
  for (ObjectId i = 0; i < tallies.size(); ++i) {
    OfType& of = types[s.objects()[i].type];
    ++of.objects, of.patches += s.objects()[i].patchCount, of.tally += tallies[i];
    t += tallies[i];
  }
  ordered_json byType = ordered_json::object();
  for (const auto& [type, of] : types)
    byType[typeName(type)] = {{"objects", of.objects},
                              {"patches", of.patches},
                              {"grids", of.tally.grids},
                              {"meshlets", of.tally.meshlets},
                              {"micropolygons", of.tally.micropolygons},
                              {"triangles", of.tally.triangles},
                              {"bytes", of.tally.bytes}};
  uint64_t lights = 0;
  for (const ShaderRecord& r : s.shaders()) lights += r.kind == ShaderKind::kLight;
  const CacheStatistics stats = cache.statistics();
  const CameraRecord& c = s.camera();
  const uint64_t tables =
      h.strings.count * sizeof(StringRecord) + h.params.count * sizeof(ParamRecord) +
      h.transforms.count * sizeof(TransformRecord) + h.shaders.count * sizeof(ShaderRecord) +
      h.attributes.count * sizeof(AttributeRecord) + h.objects.count * sizeof(ObjectRecord) +
      h.rootPatches.count * sizeof(RootPatchRecord) + h.edges.count * sizeof(EdgeRecord);
  return {{"version", h.version},
          {"frame", s.options().frameNumber},
          {"resolution", {c.resolution[0], c.resolution[1]}},
          {"cacheOrigin", {h.cacheOrigin.x, h.cacheOrigin.y, h.cacheOrigin.z}},
          {"objects", s.objects().size()},
          {"types", byType},
          {"patches", s.rootPatches().size()},
          {"attributeStates", s.attributes().size()},
          {"transforms", s.transforms().size()},
          {"shaders", s.shaders().size()},
          {"lights", lights},
          {"grids", t.grids},
          {"gridsByLevels", t.levels},
          {"meshlets", t.meshlets},
          {"gridsShared", t.shared},
          {"micropolygons", t.micropolygons},
          {"triangles", t.triangles},
          {"splits", t.splits},
          {"notDiced", t.empty},
          {"bytes",
           {{"skeleton", stats.skeletonBytes},
            {"skeletonTables", tables},
            {"nodes", stats.nodeBytes},
            {"arena", stats.arenaBytes}}}};
}

void printPlain(const std::string& path, const ordered_json& d) {
  const auto number = [&](const char* key) { return d[key].get<uint64_t>(); };
  const auto& bytes = d["bytes"];
  fmt::print("{}: scene cache, format version {}, frame {}, {} x {} pixels\n\n", path, number("version"),
             d["frame"].get<int>(), d["resolution"][0].get<int>(), d["resolution"][1].get<int>());
  fmt::print("{:<22}{:>10}{:>12}{:>12}{:>14}{:>12}\n", "objects", "count", "patches", "grids", "faces",
             "bytes");
  for (const auto& [name, t] : d["types"].items()) {
    const auto of = [&t = t](const char* key) { return t[key].get<uint64_t>(); };
    fmt::print("  {:<20}{:>10}{:>12}{:>12}{:>14}{:>12}\n", name, of("objects"), of("patches"),
               of("grids") + of("meshlets"), of("micropolygons") + of("triangles"), bytesText(of("bytes")));
  }
  fmt::print("  {:<20}{:>10}{:>12}\n\n", "all", number("objects"), number("patches"));
  fmt::print("{:<22}{:>12}\n", "attribute states", number("attributeStates"));
  fmt::print("{:<22}{:>12}\n", "transforms", number("transforms"));
  fmt::print("{:<22}{:>12}  ({} lights)\n\n", "shaders", number("shaders"), number("lights"));
  fmt::print("{:<22}{:>12}  {} micropolygons\n", "grids", number("grids"), number("micropolygons"));
  fmt::print("{:<22}{:>12}  {} triangles\n", "meshlets", number("meshlets"), number("triangles"));
  if (number("gridsShared")) fmt::print("{:<22}{:>12}\n", "of instances", number("gridsShared"));
  fmt::print("{:<22}{:>12}\n", "splits", number("splits"));
  fmt::print("{:<22}{:>12}\n\n", "not diced yet", number("notDiced"));
  for (const char* part : {"skeleton", "nodes", "arena"})
    fmt::print("{:<22}{:>12}\n", part, bytesText(bytes[part].get<uint64_t>()));
  const uint64_t faces = number("micropolygons") + number("triangles");
  if (faces)
    fmt::print("{:<22}{:>12.1f}\n", "arena bytes per face",
               double(bytes["arena"].get<uint64_t>()) / double(faces));
}

int info(const std::string& path, bool json) {
  auto cache = SceneCache::openMapped(path);
  if (!cache) {
    report(cache.error());
    return kFailed;
  }
  const ordered_json d = describe(**cache);
  if (json)
    fmt::print("{}\n", d.dump(2));
  else
    printPlain(path, d);
  return kOk;
}

}  // namespace

void addInfo(CLI::App& app, Run& run) {
  struct Options {
    std::string file;
    bool json = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* i = app.add_subcommand("info", "Counts by primitive type, patches, grids, bytes per part");
  i->footer("Checks the file's tables and their checksums, not those of the grids: see verify.");
  i->add_option("scene.fsc", o->file)->required();
  i->add_flag("--json", o->json, "For programs");
  i->callback([o, &run] { run = [o] { return info(o->file, o->json); }; });
}

}  // namespace fr::tools
