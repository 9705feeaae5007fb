// Rays per second through the transports of the ray oracle.
//
// oracle_bench [--rays=N] [--patches=N] [--threads=N]
// A table: transport, question, coherence, batch size, Mrays/s, and the ratio to the in-process oracle with
// the same batches. Fixed seeds. The scene is a sphere of patches^2 grids of 256 quads inside another.
#include <fmt/format.h>

#include <chrono>
#include <cstring>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "shading/shading_system.h"
#include "tracer/inproc_oracle.h"
#include "tracer/shm_oracle.h"
#include "tracer/testing/ray_batches.h"

namespace {

using namespace fr;
using Clock = std::chrono::steady_clock;

testing::RayList makeRays(size_t n, bool coherent, RayKind kind, uint32_t seed) {
  std::mt19937 g(seed);
  const auto r = [&] { return float(g() >> 8) * 0x1p-24f; };
  testing::RayList rays(n);
  const size_t side = size_t(std::sqrt(double(n)));
  for (size_t i = 0; i < n; ++i) {
    testing::RayItem& ray = rays[i];
    ray = {};
    if (coherent) {
      ray.origin = {0, 0, -3};
      ray.direction = Vec3(float(i % side) / float(side) - 0.5f, float(i / side) / float(side) - 0.5f, 1);
    } else {
      ray.origin = Vec3(r(), r(), r()) * 4.0f - 2.0f;
      ray.direction = Vec3(r(), r(), r()) * 4.0f - 2.0f - ray.origin;
    }
    if (kind == RayKind::kVisibility) ray.direction *= 3.0f;
    ray.node = cache::kNone;
    ray.seed = i;
  }
  return rays;
}

/// Seconds to ask all rays through one line, as many blocks in flight as it has.
double ask(RayOracle& line, const testing::RayList& rays, RayKind kind, uint32_t batch) {
  const auto start = Clock::now();
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
    q->kind = kind, q->level = 1, q->label = 0;
    q->count = uint32_t(std::min<size_t>(batch, rays.size() - first));
    for (uint32_t i = 0; i < q->count; ++i) testing::setRay(*q, i, rays[first + i]);
    if (!line.submit(q)) std::abort();
    flying.push_back(q);
  }
  while (!flying.empty()) land();
  return std::chrono::duration<double>(Clock::now() - start).count();
}

}  // namespace

int main(int argc, char** argv) {
  size_t count = 200000;
  uint32_t patches = 64;
  int threads = 1;
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    if (a.starts_with("--rays="))
      count = std::stoul(a.substr(7));
    else if (a.starts_with("--patches="))
      patches = uint32_t(std::stoul(a.substr(10)));
    else if (a.starts_with("--threads="))
      threads = std::stoi(a.substr(10));
    else {
      fmt::print(stderr, "usage: oracle_bench [--rays=200000] [--patches=64] [--threads=1]\n");
      return 2;
    }
  }
  testing::AnalyticScene scene;
  testing::AnalyticShape ball{.radius = 1, .patchesU = patches, .patchesV = patches};
  scene.add(ball, {.castsShadows = cache::CastsShadows::kOpaque});
  ball.radius = 4, ball.inward = 1;
  scene.add(ball, {.castsShadows = cache::CastsShadows::kOpaque});
  auto cache = scene.finish();
  ShadingSystem shading(*cache, {});
  tracer::InprocOracleService inproc(*cache, shading, {});
  tracer::ShmOracleService::Options options;
  options.program = std::string(FR_BINARY_DIR) + "/tests/tracer_analytic_server";
  options.threads = threads;
  tracer::ShmOracleService shm(*cache, options);

  fmt::print("{} client and {} server thread(s), {} rays a line, 2 x {} quads at stride 2\n", threads,
             threads, count, uint64_t(patches) * patches * 64);
  fmt::print("{:10} {:12} {:10} {:>6} {:>9} {:>7}\n", "transport", "question", "rays", "batch", "Mrays/s",
             "ratio");
  std::map<std::string, double> yardstick;
  for (RayOracleService* service :
       {static_cast<RayOracleService*>(&inproc), static_cast<RayOracleService*>(&shm)})
    for (RayKind kind : {RayKind::kHitTest, RayKind::kVisibility})
      for (bool coherent : {true, false})
        for (uint32_t batch : {1u, 16u, 256u, 1024u}) {
          const auto rays = makeRays(batch == 1 ? count / 4 : count, coherent, kind, 7);
          double best = 0;
          for (int repeat = 0; repeat < 3; ++repeat) {
            std::vector<std::unique_ptr<RayOracle>> lines;
            for (int t = 0; t < threads; ++t) {
              lines.push_back(std::move(service->connect()).value());
              ask(*lines.back(), testing::RayList(rays.begin(), rays.begin() + 1000), kind, 100);
            }
            const auto start = Clock::now();
            std::vector<std::thread> workers;
            workers.reserve(size_t(threads));
            for (int t = 0; t < threads; ++t)
              workers.emplace_back([&, t] { ask(*lines[size_t(t)], rays, kind, batch); });
            for (auto& w : workers) w.join();
            const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
            best = std::max(best, double(rays.size()) * threads / seconds * 1e-6);
          }
          const std::string key =
              fmt::format("{:12} {:10} {:6}", kind == RayKind::kHitTest ? "rayhittest" : "visibility",
                          coherent ? "coherent" : "incoherent", batch);
          const bool first = service == &inproc;
          if (first) yardstick[key] = best;
          fmt::print("{:10} {} {:9.3f} {:7.2f}\n", first ? "inproc" : "shm", key, best,
                     best / yardstick[key]);
        }
  const auto s = inproc.statistics();
  fmt::print("scene: {} quads traced, {:.2f} bytes of tree and {:.2f} of records each; built in {:.3f} s\n",
             s.quads, double(s.embreeBytes) / double(s.quads), double(s.recordBytes) / double(s.quads),
             s.buildSeconds);
  return 0;
}
