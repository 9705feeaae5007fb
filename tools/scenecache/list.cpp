// scenecache ls: a line an object.
#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {
using namespace cache;
namespace {

struct ListOptions {
  std::string file;
  std::vector<std::string> objects;
  bool json = false;
};

int list(const ListOptions& o) {
  auto opened = SceneCache::openMapped(o.file);
  if (!opened) {
    report(opened.error());
    return kFailed;
  }
  const SceneCache& c = **opened;
  const Skeleton& s = c.skeleton();
  const std::vector<Tally> tallies = tallyAll(c);
  auto all = nlohmann::ordered_json::array();
  if (!o.json)
    fmt::print("{:>6}  {:<24} {:<16}{:>9}{:>9}  {:<30}{:>12}{:>11}\n", "number", "name", "type", "patches",
               "grids", "with 1, 2, 3, 4, 5 levels", "faces", "bytes");
  bool any = o.objects.empty();
  for (ObjectId i = 0; i < tallies.size(); ++i) {
    const ObjectRecord& record = s.objects()[i];
    const Tally& t = tallies[i];
    const std::string name = objectName(s, i);
    bool wanted = o.objects.empty();
    for (const std::string& pattern : o.objects) wanted = wanted || matches(pattern, name, i);
    if (!wanted) continue;
    any = true;
    if (o.json) {
      nlohmann::ordered_json j = {{"number", i},
                                  {"name", name},
                                  {"type", typeName(record.type)},
                                  {"file", s.string(record.locationFile)},
                                  {"line", record.locationLine},
                                  {"patches", record.patchCount},
                                  {"grids", t.grids},
                                  {"gridsByLevels", t.levels},
                                  {"meshlets", t.meshlets},
                                  {"gridsShared", t.shared},
                                  {"micropolygons", t.micropolygons},
                                  {"triangles", t.triangles},
                                  {"notDiced", t.empty},
                                  {"bytes", t.bytes}};
      if (record.prototype != kNone) j["prototype"] = record.prototype;
      all.push_back(std::move(j));
    } else {
      fmt::print("{:>6}  {:<24} {:<16}{:>9}{:>9}  {:<30}{:>12}{:>11}{}\n", i, name, typeName(record.type),
                 record.patchCount, t.grids + t.meshlets, fmt::format("{}", fmt::join(t.levels, ", ")),
                 t.faces(), bytesText(t.bytes), record.prototype != kNone ? "  instance" : "");
    }
  }
  if (o.json) fmt::print("{}\n", all.dump(2));
  if (any) return kOk;
  report(makeError(RiError::kMissingData, "{}: no object has this name or number", o.file));
  return kFailed;
}

}  // namespace

void addList(CLI::App& app, Run& run) {
  auto o = std::make_shared<ListOptions>();
  CLI::App* l = app.add_subcommand("ls", "Objects: name, type, patches, grids by level, faces, bytes");
  l->footer(
      "A grid has one level more each time that its rows and columns can be halved: 5 levels are 16 x 16\n"
      "cells or a multiple of 16 in both directions. Objects without a name (Attribute \"identifier\" "
      "\"name\")\n"
      "are called by their place in the RIB.");
  l->add_option("scene.fsc", o->file)->required();
  l->add_option("--object", o->objects, "Only these: names with * and ?, or numbers as '#12'");
  l->add_flag("--json", o->json, "For programs");
  l->callback([o, &run] { run = [o] { return list(*o); }; });
}

}  // namespace fr::tools
