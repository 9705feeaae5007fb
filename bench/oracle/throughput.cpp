#include <fmt/format.h>

#include <thread>

#include "bench/oracle/oracle_bench.h"

namespace fr::bench {
namespace {

/// Asks all rays through one line, as many blocks in flight as it has.
void ask(RayOracle& line, const testing::RayList& rays, RayKind kind, uint32_t batch) {
  std::vector<RayQuery*> flying;
  const auto land = [&] {
    if (!line.wait()) std::abort();
    for (size_t k = 0; k < flying.size();) {
      if (line.answered(flying[k])) {
        line.release(flying[k]);
        flying[k] = flying.back();
        flying.pop_back();
      } else {
        ++k;
      }
    }
  };
  for (size_t first = 0; first < rays.size(); first += batch) {
    RayQuery* q;
    while (!(q = line.acquire())) land();
    q->kind = kind, q->level = 1;
    q->count = uint32_t(std::min<size_t>(batch, rays.size() - first));
    for (uint32_t i = 0; i < q->count; ++i) testing::setRay(*q, i, rays[first + i]);
    if (!line.submit(q)) std::abort();
    flying.push_back(q);
  }
  while (!flying.empty()) land();
}

struct Cost {
  double wall, processor, switches;
};

/// All lines at once, each from its own thread.
Cost askAll(std::vector<std::unique_ptr<RayOracle>>& lines, const testing::RayList& rays, RayKind kind,
            uint32_t batch, int serverPid) {
  const auto switchesSoFar = [&] {
    const Switches ours = switches(0), its = serverPid ? switches(serverPid) : Switches{};
    return double(ours.voluntary + ours.forced + its.voluntary + its.forced);
  };
  const double s0 = switchesSoFar(), p0 = processorSeconds() + (serverPid ? processorSeconds(serverPid) : 0),
               t0 = seconds();
  std::vector<std::thread> workers;
  for (auto& line : lines) workers.emplace_back([&] { ask(*line, rays, kind, batch); });
  for (auto& w : workers) w.join();
  const double t1 = seconds();
  return {t1 - t0, processorSeconds() + (serverPid ? processorSeconds(serverPid) : 0) - p0,
          switchesSoFar() - s0};
}

}  // namespace

nlohmann::json benchThroughput(const Options& options, int width) {
  useProcessors(width);
  Scene scene(options, width);
  std::vector<std::unique_ptr<RayOracle>> here, there;
  const auto warm = makeRays(2000, true, RayKind::kHitTest, 1);
  for (int i = 0; i < width; ++i) {
    here.push_back(std::move(scene.inproc->connect()).value());
    there.push_back(std::move(scene.shm->connect()).value());
    ask(*here.back(), warm, RayKind::kHitTest, 100);
    ask(*there.back(), warm, RayKind::kHitTest, 100);
  }
  const int pid = scene.shm->processId();
  fmt::print(
      "throughput, {} client and {} server thread(s) on {} processor(s), against {} thread(s) inproc\n",
      width, width, width, width);
  fmt::print("  {:10} {:10} {:>5} {:>12} {:>9} {:>7} {:>10} {:>10} {:>15}\n", "question", "rays", "batch",
             "inproc Mr/s", "shm Mr/s", "ratio", "best ratio", "processors", "switches/block");
  nlohmann::json out;
  out["width"] = width;
  for (RayKind kind : {RayKind::kHitTest, RayKind::kVisibility})
    for (bool coherent : {true, false}) {
      const auto rays = makeRays(options.rays, coherent, kind, 7);
      for (uint32_t batch : {256u, 1024u}) {
        std::vector<double> ratio, processorRatio, inproc, shm, switchesPerBlock;
        for (int repeat = 0; repeat < options.repeats; ++repeat) {
          const Cost a = askAll(here, rays, kind, batch, 0), b = askAll(there, rays, kind, batch, pid);
          const double megarays = double(rays.size()) * width * 1e-6;
          ratio.push_back(a.wall / b.wall);
          processorRatio.push_back(a.processor / b.processor);
          inproc.push_back(megarays / a.wall), shm.push_back(megarays / b.wall);
          switchesPerBlock.push_back(b.switches / (double(rays.size()) * width / batch));
        }
        nlohmann::json row{{"question", nameOf(kind)},
                           {"rays", coherent ? "coherent" : "incoherent"},
                           {"batch", batch},
                           {"inprocMegarays", median(inproc)},
                           {"shmMegarays", median(shm)},
                           {"ratio", median(ratio)},
                           {"bestRatio", *std::max_element(shm.begin(), shm.end()) /
                                             *std::max_element(inproc.begin(), inproc.end())},
                           {"processorRatio", median(processorRatio)},
                           {"switchesPerBlock", median(switchesPerBlock)}};
        fmt::print("  {:10} {:10} {:5} {:12.3f} {:9.3f} {:7.3f} {:10.3f} {:10.3f} {:15.2f}\n", nameOf(kind),
                   coherent ? "coherent" : "incoherent", batch, median(inproc), median(shm), median(ratio),
                   row["bestRatio"].get<double>(), median(processorRatio), median(switchesPerBlock));
        out["rows"].push_back(std::move(row));
      }
    }
  return out;
}

}  // namespace fr::bench
