// scenecache verify: everything that can be checked.
#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <atomic>
#include <memory>
#include <nlohmann/json.hpp>

#include "tools/scenecache/commands.h"
#include "tools/scenecache/contents.h"

namespace fr::tools {
using namespace cache;
namespace {

bool sound(const SceneCache& c, const GridRecord& g) {
  const GridView v = c.view(g);
  const bool isGrid = g.kind == GridKind::kGrid;
  const size_t rows = isGrid ? g.nv + 1u : 1u, columns = isGrid ? g.nu + 1u : g.nu;
  for (uint32_t k = 0; k < g.keyCount; ++k) {
    const float* p =
        reinterpret_cast<const float*>(reinterpret_cast<const std::byte*>(v.positions) + k * g.keyBytes);
    for (size_t j = 0; j < rows; ++j)
      for (size_t i = 0; i < columns; ++i)
        if (!isFinite(v.placed(p + 3 * (j * g.rowStride + i)))) return false;
  }
  if (!isGrid)
    for (size_t i = 0; i < size_t(g.nv) * 3; ++i)
      if (v.indices[i] >= g.nu) return false;
  return true;
}

int verify(const std::string& path, bool quiet, bool json) {
  const auto failed = [&](const Error& e) {
    report(e);
    if (json)
      fmt::print("{}\n",
                 nlohmann::ordered_json{{"file", path}, {"sound", false}, {"error", e.message}}.dump(2));
    return kFailed;
  };
  if (auto r = SceneCache::verifyFile(path); !r) return failed(r.error());
  auto opened = SceneCache::openMapped(path);
  if (!opened) return failed(opened.error());
  const SceneCache& c = **opened;
  std::atomic<uint64_t> bad{0}, checked{0}, damaged{0};
  constexpr uint32_t kNodesAtATime = 1 << 14;
  for (uint32_t first = 0; first < c.nodeCount(); first += kNodesAtATime) {
    tbb::parallel_for(first, std::min(c.nodeCount(), first + kNodesAtATime), [&](uint32_t id) {
      const NodeState state = NodeState(c.node(id).state.load() & 3);
      const ResolvedNode n = c.peek(id);
      if (state == NodeState::kEmpty) return;
      if (n.state != state) ++damaged;
      if (n.state != NodeState::kGrid) return;
      ++checked;
      if (!sound(c, *n.grid)) ++bad;
    });
    c.letGo();
  }
  if (damaged > 0)
    return failed(makeError(RiError::kBadFile, "{}: {} patches are damaged", path, damaged.load()));
  if (bad > 0)
    return failed(
        makeError(RiError::kBadFile, "{}: {} of {} grids are damaged", path, bad.load(), checked.load()));
  if (json)
    fmt::print("{}\n", nlohmann::ordered_json{{"file", path},
                                              {"sound", true},
                                              {"objects", c.skeleton().objects().size()},
                                              {"grids", checked.load()}}
                           .dump(2));
  else if (!quiet)
    fmt::print("{}: sound ({} objects, {} grids)\n", path, c.skeleton().objects().size(), checked.load());
  return kOk;
}

}  // namespace

void addVerify(CLI::App& app, Run& run) {
  struct Options {
    std::string file;
    bool quiet = false, json = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* v = app.add_subcommand("verify", "Check all checksums, every record, every vertex");
  v->add_option("scene.fsc", o->file)->required();
  v->add_flag("-q,--quiet", o->quiet, "Only errors");
  v->add_flag("--json", o->json, "For programs");
  v->callback([o, &run] { run = [o] { return verify(o->file, o->quiet, o->json); }; });
}

}  // namespace fr::tools
