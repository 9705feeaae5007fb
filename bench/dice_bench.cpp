// Loads RIB files, dices every patch of the first world on one thread, and says what that cost.
//   dice_bench scene.rib...
#include <fmt/core.h>

#include <chrono>
#include <vector>

#include "base/error.h"
#include "scene_cache/cache.h"
#include "scene_cache/scene_loader.h"

namespace {

double seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

struct Totals {
  uint64_t grids = 0, meshlets = 0, micropolygons = 0, vertices = 0, splits = 0, absent = 0;
};

void dice(fr::cache::SceneCache& cache, fr::cache::NodeId id, Totals& t) {
  const auto r = cache.resolve(id);
  if (r.state == fr::cache::NodeState::kSplit) {
    ++t.splits;
    dice(cache, r.children[0], t);
    dice(cache, r.children[1], t);
  } else if (r.state == fr::cache::NodeState::kGrid) {
    const bool meshlet = r.grid->kind == fr::cache::GridKind::kMeshlet;
    ++(meshlet ? t.meshlets : t.grids);
    t.micropolygons += meshlet ? r.grid->nv : uint64_t(r.grid->nu) * r.grid->nv;
    t.vertices += cache.view(*r.grid).vertexCount();
  } else {
    ++t.absent;
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<fr::cache::RibInput> inputs;
  for (int i = 1; i < argc; ++i) inputs.push_back({argv[i]});
  const double start = seconds();
  const auto loaded = fr::cache::loadScene(inputs, {}, [&](fr::cache::Frame&& frame) {
    const double built = seconds();
    auto opened = fr::cache::SceneCache::create(frame.skeletonFd());
    if (!opened) return fr::report(opened.error()), false;
    fr::cache::SceneCache& cache = **opened;
    Totals t;
    const double before = seconds();
    const uint32_t roots = cache.nodeCount();
    for (fr::cache::NodeId id = 0; id < roots; ++id) dice(cache, id, t);
    const double spent = seconds() - before;
    const auto s = cache.statistics();
    const double n = double(std::max<uint64_t>(1, t.micropolygons));
    fmt::print("read and built      {:10.3f} s, of which the world {:.3f} s\n", built - start,
               frame.counts().seconds);
    fmt::print("root patches        {:10}\n", roots);
    fmt::print("splits              {:10}\n", t.splits);
    fmt::print("grids, meshlets     {:10} {}\n", t.grids, t.meshlets);
    fmt::print("absent              {:10}\n", t.absent);
    fmt::print("micropolygons       {:10}  ({:.1f} a grid)\n", t.micropolygons,
               n / double(std::max<uint64_t>(1, t.grids + t.meshlets)));
    fmt::print("dicing              {:10.3f} s, {:.2f} million micropolygons a second\n", spent,
               n / spent * 1e-6);
    fmt::print("bytes a micropolygon{:10.2f} = grids {:.2f} + nodes {:.2f} + skeleton {:.2f}\n",
               double(s.arenaBytes + s.nodeBytes + s.skeletonBytes) / n, double(s.arenaBytes) / n,
               double(s.nodeBytes) / n, double(s.skeletonBytes) / n);
    return false;
  });
  if (!loaded) {
    fr::report(loaded.error());
    return 1;
  }
  return 0;
}
