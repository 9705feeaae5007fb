// scenecache: build, describe and check .fsc files.
#include <fmt/format.h>
#include <tbb/parallel_for.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <array>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <vector>

#include "base/log.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_loader.h"
#include "shading/shader_library.h"
#include "shading/shading_system.h"
#include "tools/shader_folders.h"

namespace {

using namespace fr;
using namespace fr::cache;

constexpr int kOk = 0, kFailed = 1, kUsage = 2;

constexpr const char* kIntroduction = R"(Prepare, describe and check scene caches.

A scene cache (.fsc) holds a tessellated scene: frankenrender and rendrib map it
instead of reading and dicing RIB, and start at once.)";

constexpr const char* kExamples = R"(Examples:
  scenecache build scene.rib -o scene.fsc      dice everything ahead of time
  scenecache build shot.rib --frame 12 -o shot.0012.fsc
  scenecache info scene.fsc                    what is in it and what it weighs
  scenecache info scene.fsc --json | jq .grids
  scenecache verify scene.fsc                  checksums, every record, every grid

Exit status: 0 done, 1 something is wrong with the input or the system (said on
standard error), 2 the command line could not be understood.)";

constexpr std::array<const char*, 11> kTypeNames = {
    "sphere",          "cone",        "cylinder", "hyperboloid",
    "paraboloid",      "disk",        "torus",    "bilinear patches",
    "bicubic patches", "subdivision", "meshlets"};

std::string bytesText(uint64_t n) {
  if (n < 10'000) return fmt::format("{} B", n);
  if (n < 10'000'000) return fmt::format("{:.1f} kB", double(n) / 1e3);
  if (n < 10'000'000'000) return fmt::format("{:.1f} MB", double(n) / 1e6);
  return fmt::format("{:.1f} GB", double(n) / 1e9);
}

/// One line on a terminal, rewritten a few times a second; nothing elsewhere.
class ProgressBar {
 public:
  ProgressBar(bool wanted, uint64_t total) : on_(wanted && isatty(STDERR_FILENO) != 0), total_(total) {}
  ~ProgressBar() {
    if (on_ && shown_) fmt::print(stderr, "\r\x1b[K");
  }
  /// Thread-safe.
  void step(uint64_t micropolygons) {
    const uint64_t done = done_.fetch_add(1) + 1;
    const uint64_t count = micropolygons_.fetch_add(micropolygons) + micropolygons;
    if (!on_) return;
    const std::unique_lock lock(mutex_, std::try_to_lock);
    const auto now = std::chrono::steady_clock::now();
    if (!lock || now - last_ < std::chrono::milliseconds(200)) return;
    last_ = now;
    shown_ = true;
    const int width = total_ ? int(done * 30 / total_) : 30;
    fmt::print(stderr, "\r\x1b[K[{:=<{}}{: <{}}] {}/{} patches, {:.1f} M micropolygons", "", width, "",
               30 - width, done, total_, double(count) / 1e6);
    std::fflush(stderr);
  }

 private:
  bool on_, shown_ = false;
  uint64_t total_;
  std::atomic<uint64_t> done_{0}, micropolygons_{0};
  std::mutex mutex_;
  std::chrono::steady_clock::time_point last_{};
};

/// What the nodes below one root patch are.
struct Tally {
  uint64_t grids = 0, meshlets = 0, micropolygons = 0, triangles = 0, splits = 0, empty = 0;
  Tally& operator+=(const Tally& o) {
    grids += o.grids, meshlets += o.meshlets, micropolygons += o.micropolygons, triangles += o.triangles;
    splits += o.splits, empty += o.empty;
    return *this;
  }
};

/// Walks a root patch; `make` dices what is not there yet. The depth is bounded: a damaged file must not send
/// us in circles.
Tally walk(SceneCache& cache, NodeId root, bool make) {
  constexpr int kDeepest = 64;
  Tally t;
  std::vector<std::pair<NodeId, int>> stack{{root, 0}};
  while (!stack.empty()) {
    const auto [id, depth] = stack.back();
    stack.pop_back();
    const ResolvedNode n = make ? cache.resolve(id) : cache.peek(id);
    if (n.state == NodeState::kSplit && depth < kDeepest) {
      ++t.splits;
      stack.push_back({n.children[1], depth + 1});
      stack.push_back({n.children[0], depth + 1});
    } else if (n.state == NodeState::kGrid && n.grid) {
      if (n.grid->kind == GridKind::kMeshlet)
        ++t.meshlets, t.triangles += n.grid->nv;
      else
        ++t.grids, t.micropolygons += uint64_t(n.grid->nu) * n.grid->nv;
    } else {
      ++t.empty;
    }
  }
  return t;
}

Tally walkAll(SceneCache& cache, bool make, bool quiet) {
  const uint32_t roots = uint32_t(cache.skeleton().rootPatches().size());
  ProgressBar bar(make && !quiet, roots);
  std::mutex mutex;
  Tally total;
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, roots, 16), [&](const tbb::blocked_range<uint32_t>& r) {
    Tally part;
    for (uint32_t id = r.begin(); id != r.end(); ++id) {
      const Tally t = walk(cache, id, make);
      part += t;
      bar.step(t.micropolygons + t.triangles);
    }
    const std::lock_guard lock(mutex);
    total += part;
  });
  return total;
}

int build(const std::vector<std::string>& ribs, const std::string& output, std::optional<int> frame,
          bool quiet) {
  std::vector<RibInput> inputs;
  for (const std::string& r : ribs) inputs.push_back({r});
  LoadOptions options;
  for (const std::string& rib : ribs) {
    std::error_code unknown;
    const std::filesystem::path file = std::filesystem::absolute(rib, unknown);
    if (rib != "-" && !unknown) options.overrides.shaderFolders.push_back(file.parent_path().string());
  }
  if (frame) options.frames = std::pair(*frame, *frame);
  bool made = false, failed = false;
  int built = 0, others = 0;
  const auto onFrame = [&](Frame&& f) {
    if (made) {
      ++others;
      return true;
    }
    made = true;
    built = f.number();
    auto cache = SceneCache::create(f.skeletonFd());
    if (!cache) {
      report(std::move(cache).error().context(output));
      failed = true;
      return false;
    }
    ShadingSystem::Options shaders;
    shaders.shaderPath = tools::shaderFolders({}, (*cache)->skeleton(), inputs);
    shaders.standardShaders = standardShaderFolder();
    ShadingSystem shading(**cache, shaders);  // displacement is part of dicing
    shading.loadShaders(kForReyes | kForTracer);
    (*cache)->setDisplacer(&shading.displacer());
    const Tally t = walkAll(**cache, true, quiet);
    (*cache)->setDisplacer(nullptr);
    if (auto saved = (*cache)->save(output); !saved) {
      report(std::move(saved).error());
      failed = true;
      return false;
    }
    if (!quiet)
      fmt::print(stderr, "{}: frame {}, {} objects, {} grids, {:.2f} M micropolygons\n", output, f.number(),
                 (*cache)->skeleton().objects().size(), t.grids + t.meshlets,
                 double(t.micropolygons + t.triangles) / 1e6);
    return true;
  };
  if (auto r = loadScene(inputs, options, onFrame); !r) {
    report(r.error());
    failed = true;
  }
  if (others > 0 && !quiet)
    report({RiError::kNone,
            Severity::kInfo,
            {},
            fmt::format("only frame {} was built; {} more can be chosen with --frame", built, others)});
  if (!made && !failed) {
    report(frame ? makeError(RiError::kMissingData, "no frame {} in the input", *frame)
                 : makeError(RiError::kMissingData, "no WorldBegin ... WorldEnd in the input"));
    failed = true;
  }
  return failed || reportCount(Severity::kError) > 0 ? kFailed : kOk;
}

nlohmann::ordered_json describe(SceneCache& cache) {
  using nlohmann::ordered_json;
  const Skeleton& s = cache.skeleton();
  const SkeletonHeader& h = s.header();
  ordered_json types = ordered_json::object();
  std::array<std::pair<uint64_t, uint64_t>, kTypeNames.size()> counts{};
  for (const ObjectRecord& o : s.objects())
    if (size_t(o.type) < counts.size())
      ++counts[size_t(o.type)].first, counts[size_t(o.type)].second += o.patchCount;
  for (size_t i = 0; i < counts.size(); ++i)
    if (counts[i].first) types[kTypeNames[i]] = {{"objects", counts[i].first}, {"patches", counts[i].second}};
  uint64_t lights = 0;
  for (const ShaderRecord& r : s.shaders()) lights += r.kind == ShaderKind::kLight;
  const Tally t = walkAll(cache, false, true);
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
          {"types", types},
          {"patches", s.rootPatches().size()},
          {"attributeStates", s.attributes().size()},
          {"transforms", s.transforms().size()},
          {"shaders", s.shaders().size()},
          {"lights", lights},
          {"grids", t.grids},
          {"meshlets", t.meshlets},
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

void printPlain(const std::string& path, const nlohmann::ordered_json& d) {
  const auto number = [&](const char* key) { return d[key].get<uint64_t>(); };
  const auto& bytes = d["bytes"];
  fmt::print("{}: scene cache, format version {}, frame {}, {} x {} pixels\n\n", path, number("version"),
             d["frame"].get<int>(), d["resolution"][0].get<int>(), d["resolution"][1].get<int>());
  fmt::print("{:<22}{:>12}{:>14}\n", "objects", "count", "patches");
  for (const auto& [name, t] : d["types"].items())
    fmt::print("  {:<20}{:>12}{:>14}\n", name, t["objects"].get<uint64_t>(), t["patches"].get<uint64_t>());
  fmt::print("  {:<20}{:>12}{:>14}\n\n", "all", number("objects"), number("patches"));
  fmt::print("{:<22}{:>12}\n", "attribute states", number("attributeStates"));
  fmt::print("{:<22}{:>12}\n", "transforms", number("transforms"));
  fmt::print("{:<22}{:>12}  ({} lights)\n\n", "shaders", number("shaders"), number("lights"));
  fmt::print("{:<22}{:>12}  {} micropolygons\n", "grids", number("grids"), number("micropolygons"));
  fmt::print("{:<22}{:>12}  {} triangles\n", "meshlets", number("meshlets"), number("triangles"));
  fmt::print("{:<22}{:>12}\n", "splits", number("splits"));
  fmt::print("{:<22}{:>12}\n\n", "not diced yet", number("notDiced"));
  for (const char* part : {"skeleton", "nodes", "arena"})
    fmt::print("{:<22}{:>12}\n", part, bytesText(bytes[part].get<uint64_t>()));
  const uint64_t faces = number("micropolygons") + number("triangles");
  if (faces)
    fmt::print("{:<22}{:>12.1f}\n", "arena bytes per face",
               double(bytes["arena"].get<uint64_t>()) / double(faces));
}

Result<std::unique_ptr<SceneCache>> openCache(const std::string& path) { return SceneCache::openFile(path); }

int info(const std::string& path, bool json) {
  auto cache = openCache(path);
  if (!cache) {
    report(cache.error());
    return kFailed;
  }
  const auto d = describe(**cache);
  if (json)
    fmt::print("{}\n", d.dump(2));
  else
    printPlain(path, d);
  return kOk;
}

int verify(const std::string& path, bool quiet) {
  auto cache = openCache(path);  // checksums and the whole skeleton
  if (!cache) {
    report(cache.error());
    return kFailed;
  }
  SceneCache& c = **cache;
  std::atomic<uint64_t> bad{0}, checked{0};
  tbb::parallel_for(uint32_t(0), c.nodeCount(), [&](uint32_t id) {
    const ResolvedNode n = c.peek(id);
    if (n.state != NodeState::kGrid) return;
    ++checked;
    const GridView v = n.grid ? c.view(*n.grid) : GridView{};
    bool fine = v.positions != nullptr;
    if (fine && v.record->kind == GridKind::kGrid)
      for (uint32_t j = 0; j <= v.record->nv && fine; ++j)
        for (uint32_t i = 0; i <= v.record->nu && fine; ++i) {
          fine = isFinite(v.vertex(size_t(j) * v.record->rowStride + i));
        }
    if (!fine) ++bad;
  });
  if (bad > 0) {
    report(makeError(RiError::kBadFile, "{}: {} of {} grids are damaged", path, bad.load(), checked.load()));
    return kFailed;
  }
  if (!quiet)
    fmt::print("{}: sound ({} objects, {} grids)\n", path, c.skeleton().objects().size(), checked.load());
  return kOk;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{kIntroduction};
  app.footer(kExamples);
  app.require_subcommand(1);
  bool quiet = false, json = false;
  std::vector<std::string> ribs;
  std::string output, file;
  std::optional<int> frame;

  CLI::App* b = app.add_subcommand("build", "Read RIB, dice everything, write a .fsc file");
  b->add_option("scene.rib", ribs, "RIB files, read one after the other (- is standard input)")->required();
  b->add_option("-o,--output", output,
                "The .fsc file; an existing one is replaced when the new one is complete")
      ->required();
  b->add_option("--frame", frame,
                "Number of the frame (FrameBegin) to build. Default: the first world of the input");
  b->add_flag("-q,--quiet", quiet, "Only errors");

  CLI::App* i = app.add_subcommand("info", "Counts by primitive type, patches, grids, bytes per part");
  i->add_option("scene.fsc", file)->required();
  i->add_flag("--json", json, "Machine-readable");

  CLI::App* v = app.add_subcommand("verify", "Check checksums, every record and every grid");
  v->add_option("scene.fsc", file)->required();
  v->add_flag("-q,--quiet", quiet, "Only errors");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kOk : kUsage;
  }
  setLogName("scenecache");
  if (quiet) setLogLevel(Severity::kError);
  if (b->parsed()) return build(ribs, output, frame, quiet);
  if (i->parsed()) return info(file, json);
  return verify(file, quiet);
}
