#include "tools/scenecache/dice_all.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <chrono>
#include <cmath>

#include "base/interrupt.h"
#include "tools/frankenrender/progress_bar.h"

namespace fr::tools {
using namespace cache;
namespace {

/// Nodes that are made at a time: enough for all threads, few enough to stop and look at the budget after
/// each.
constexpr size_t kWave = 1024;

}  // namespace

Result<Tally> diceAll(SceneCache& cache, const DiceAllOptions& options) {
  const Skeleton& s = cache.skeleton();
  const uint32_t roots = uint32_t(s.rootPatches().size());
  ProgressBar bar(options.progress, options.title);
  const auto start = std::chrono::steady_clock::now();
  Tally total;
  double done = 0;  // root patches; parts of them by their area
  uint32_t next = 0;
  std::vector<NodeId> waiting, wave;
  std::vector<ResolvedNode> made;
  while (next < roots || !waiting.empty()) {
    // What was begun comes first, so that an object's grids stand together.
    wave.clear();
    while (wave.size() < kWave && !waiting.empty()) wave.push_back(waiting.back()), waiting.pop_back();
    for (; wave.size() < kWave && next < roots; ++next) {
      if (!options.wanted || options.wanted(s.rootPatches()[next].object)) {
        wave.push_back(next);
      } else {
        done += 1;
        total.bytes += sizeof(PatchNode), ++total.empty;
      }
    }
    made.resize(wave.size());
    tbb::parallel_for(size_t(0), wave.size(), [&](size_t i) { made[i] = cache.resolve(wave[i]); });
    for (size_t i = wave.size(); i-- > 0;) {
      total.add(made[i]);
      if (made[i].state == NodeState::kSplit) {
        waiting.insert(waiting.end(), {made[i].children[1], made[i].children[0]});
      } else {
        const PatchNode& n = cache.node(wave[i]);
        done += std::ldexp(1.0, -(n.du + n.dv));
      }
    }
    if (abortRequested()) return makeError(RiError::kNone, "stopped");
    if (auto r = cache.room(); !r) return std::move(r).error();
    if (cache.unsettledBytes() >= options.bytesHeld)
      if (auto r = cache.settle(); !r) return std::move(r).error();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    bar.update(roots ? done / roots : 1,
               fmt::format("{:.1f} M faces, {:.1f} M/s", double(total.faces()) * 1e-6,
                           double(total.faces()) * 1e-6 / std::max(seconds, 1e-3)));
  }
  return total;
}

}  // namespace fr::tools
