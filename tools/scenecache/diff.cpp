// scenecache diff: what differs between two caches.
#include <fmt/format.h>

#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "scene_cache/object_content.h"
#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {
using namespace cache;
namespace {

constexpr int kDiffer = 1, kTrouble = 2;  // as diff(1) has it

struct Change {
  std::string name, what;
  uint64_t before = 0, after = 0;  // bytes
};
struct Difference {
  std::vector<std::string> frame;
  std::vector<Change> added, removed, changed;
  uint64_t same = 0, bytes[2] = {};
  bool any() const { return !frame.empty() || !added.empty() || !removed.empty() || !changed.empty(); }
};

std::vector<std::string> compareFrames(const Skeleton& a, const Skeleton& b) {
  std::vector<std::string> r;
  const CameraRecord &c = a.camera(), &d = b.camera();
  const OptionsRecord &o = a.options(), &p = b.options();
  const auto say = [&](bool differs, const char* what) {
    if (differs) r.emplace_back(what);
  };
  const auto differ = [](const float* x, const float* y, int n) { return !std::equal(x, x + n, y); };
  say(o.frameNumber != p.frameNumber, "frame number");
  say(c.resolution[0] != d.resolution[0] || c.resolution[1] != d.resolution[1], "resolution");
  say(transformContent(a, c.worldToCamera) != transformContent(b, d.worldToCamera), "camera position");
  say(c.projection != d.projection || c.fov != d.fov || differ(c.screenWindow, d.screenWindow, 4),
      "projection");
  say(differ(c.clipping, d.clipping, 2), "clipping");
  say(differ(c.shutter, d.shutter, 2), "shutter");
  say(differ(c.dof, d.dof, 3), "depth of field");
  say(differ(c.cropWindow, d.cropWindow, 4), "crop window");
  say(differ(o.pixelSamples, p.pixelSamples, 2), "pixel samples");
  say(a.header().cacheOrigin != b.header().cacheOrigin, "cache origin");
  if (r.empty() && frameContent(a) != frameContent(b)) r.emplace_back("options");
  return r;
}

Difference compare(const SceneCache& a, const SceneCache& b) {
  const Skeleton &s = a.skeleton(), &t = b.skeleton();
  Difference d;
  d.frame = compareFrames(s, t);
  const std::vector<Tally> before = tallyAll(a), after = tallyAll(b);
  for (const Tally& x : before) d.bytes[0] += x.bytes;
  for (const Tally& x : after) d.bytes[1] += x.bytes;
  // Equal ones first, wherever they stand; then by name; what is left has come or gone.
  std::map<ContentKey, std::vector<ObjectId>> byContent;
  std::map<std::string, std::vector<ObjectId>> byName;
  for (ObjectId i = ObjectId(s.objects().size()); i-- > 0;) byContent[wholeContent(s, i)].push_back(i);
  std::vector<bool> known(s.objects().size(), false);
  std::vector<ObjectId> left;
  for (ObjectId i = 0; i < t.objects().size(); ++i) {
    auto& same = byContent[wholeContent(t, i)];
    if (same.empty()) {
      left.push_back(i);
    } else {
      known[same.back()] = true;
      same.pop_back();
      ++d.same;
    }
  }
  for (ObjectId i = ObjectId(s.objects().size()); i-- > 0;)
    if (!known[i]) byName[objectName(s, i)].push_back(i);
  for (const ObjectId i : left) {
    const std::string name = objectName(t, i);
    auto& old = byName[name];
    if (old.empty()) {
      d.added.push_back({name, typeName(t.objects()[i].type), 0, after[i].bytes});
      continue;
    }
    const ObjectId was = old.back();
    old.pop_back();
    known[was] = true;
    const bool shape = diceContent(s, was, true) != diceContent(t, i, true);
    d.changed.push_back({name, shape ? "shape" : "look", before[was].bytes, after[i].bytes});
  }
  for (ObjectId i = 0; i < s.objects().size(); ++i)
    if (!known[i]) d.removed.push_back({objectName(s, i), typeName(s.objects()[i].type), before[i].bytes, 0});
  return d;
}

nlohmann::ordered_json json(const std::vector<Change>& list) {
  auto all = nlohmann::ordered_json::array();
  for (const Change& c : list)
    all.push_back({{"name", c.name}, {"what", c.what}, {"bytesBefore", c.before}, {"bytesAfter", c.after}});
  return all;
}

int diff(const std::string& first, const std::string& second, bool asJson) {
  std::unique_ptr<SceneCache> caches[2];
  for (int i = 0; i < 2; ++i) {
    auto opened = SceneCache::openMapped(i == 0 ? first : second);
    if (!opened) {
      report(opened.error());
      return kTrouble;
    }
    caches[i] = *std::move(opened);
  }
  const Difference d = compare(*caches[0], *caches[1]);
  if (asJson) {
    fmt::print("{}\n", nlohmann::ordered_json{{"frame", d.frame},
                                              {"added", json(d.added)},
                                              {"removed", json(d.removed)},
                                              {"changed", json(d.changed)},
                                              {"same", d.same},
                                              {"bytesBefore", d.bytes[0]},
                                              {"bytesAfter", d.bytes[1]}}
                           .dump(2));
  } else if (d.any()) {
    for (const std::string& what : d.frame) fmt::print("frame: {}\n", what);
    for (const Change& c : d.removed) fmt::print("- {} ({}, {})\n", c.name, c.what, bytesText(c.before));
    for (const Change& c : d.added) fmt::print("+ {} ({}, {})\n", c.name, c.what, bytesText(c.after));
    for (const Change& c : d.changed)
      fmt::print("~ {} ({}, {} -> {})\n", c.name, c.what, bytesText(c.before), bytesText(c.after));
    fmt::print("{} objects are the same; grids {} -> {}\n", d.same, bytesText(d.bytes[0]),
               bytesText(d.bytes[1]));
  }
  return d.any() ? kDiffer : kOk;
}

}  // namespace

void addDiff(CLI::App& app, Run& run) {
  struct Options {
    std::string first, second;
    bool json = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* d = app.add_subcommand("diff", "Compare two caches: frame, objects, bytes");
  d->footer(
      "Objects are compared by content, wherever they stand in the files: control points, transforms,\n"
      "attributes, shaders, primitive variables. \"~\" have the same name and another content (shape: their\n"
      "grids are other ones; look: only what shaders see). Exit status: 0 the same, 1 different, 2 trouble.");
  d->add_option("old.fsc", o->first)->required();
  d->add_option("new.fsc", o->second)->required();
  d->add_flag("--json", o->json, "For programs");
  d->callback([o, &run] { run = [o] { return diff(o->first, o->second, o->json); }; });
}

}  // namespace fr::tools
