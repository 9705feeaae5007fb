#include <dirent.h>
#include <sched.h>
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <random>

#include "bench/oracle/oracle_bench.h"

namespace fr::bench {
namespace {

double clockSeconds(clockid_t clock) {
  timespec t{};
  ::clock_gettime(clock, &t);
  return double(t.tv_sec) + 1e-9 * double(t.tv_nsec);
}

std::vector<int> startProcessors() {
  cpu_set_t set;
  CPU_ZERO(&set);
  std::vector<int> list;
  if (::sched_getaffinity(0, sizeof set, &set) == 0) {
    for (int i = 0; i < CPU_SETSIZE; ++i) {
      if (CPU_ISSET(i, &set)) list.push_back(i);
    }
  }
  return list;
}
const std::vector<int> gProcessors = startProcessors();

/// Calls f(tid) for every thread of a process.
template <class F>
void forThreads(int pid, F&& f) {
  const std::string folder = "/proc/" + (pid ? std::to_string(pid) : std::string("self")) + "/task";
  DIR* d = ::opendir(folder.c_str());
  if (!d) return;
  while (const dirent* e = ::readdir(d)) {
    if (const int tid = std::atoi(e->d_name); tid > 0) f(tid, folder);
  }
  ::closedir(d);
}

}  // namespace

Scene::Scene(const Options& options, int serverThreads) {
  testing::AnalyticScene scene;
  testing::AnalyticShape ball{.radius = 1, .patchesU = options.patches, .patchesV = options.patches};
  scene.add(ball, {.castsShadows = cache::CastsShadows::kOpaque});
  ball.radius = 4, ball.inward = 1;
  scene.add(ball, {.castsShadows = cache::CastsShadows::kOpaque});
  cache = scene.finish();
  shading = std::make_unique<ShadingSystem>(*cache, ShadingSystem::Options{});
  tracer::RayTracerOptions ray;
  ray.scene.threads = serverThreads;
  inproc = std::make_unique<tracer::InprocOracleService>(*cache, *shading, ray);
  tracer::ShmOracleService::Options o;
  o.program = std::string(FR_BINARY_DIR) + "/tests/tracer_analytic_server";
  o.threads = serverThreads;
  shm = std::make_unique<tracer::ShmOracleService>(*cache, o);
}

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

const char* nameOf(RayKind kind) {
  static constexpr const char* kNames[] = {"trace", "visibility", "rayhittest", "fulltrace"};
  return kNames[int(kind)];
}

double seconds() { return clockSeconds(CLOCK_MONOTONIC); }
double processorSeconds() { return clockSeconds(CLOCK_PROCESS_CPUTIME_ID); }

double processorSeconds(int pid) {
  clockid_t clock;
  return ::clock_getcpuclockid(pid, &clock) == 0 ? clockSeconds(clock) : 0;
}

Switches switches(int pid) {
  Switches all;
  if (pid == 0) {  // with those threads that have ended
    rusage used{};
    ::getrusage(RUSAGE_SELF, &used);
    return {uint64_t(used.ru_nvcsw), uint64_t(used.ru_nivcsw)};
  }
  forThreads(pid, [&](int tid, const std::string& folder) {
    std::ifstream status(folder + "/" + std::to_string(tid) + "/status");
    for (std::string line; std::getline(status, line);) {
      unsigned long n = 0;
      if (std::sscanf(line.c_str(), "voluntary_ctxt_switches: %lu", &n) == 1) all.voluntary += n;
      if (std::sscanf(line.c_str(), "nonvoluntary_ctxt_switches: %lu", &n) == 1) all.forced += n;
    }
  });
  return all;
}

int processorCount() { return int(gProcessors.size()); }

void useProcessors(int n) {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (int i = 0; i < std::min(n, processorCount()); ++i) CPU_SET(gProcessors[size_t(i)], &set);
  ::sched_setaffinity(0, sizeof set, &set);
}

void pinTo(int pid, int i) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(gProcessors[size_t(i) % gProcessors.size()], &set);
  forThreads(pid, [&](int tid, const std::string&) { ::sched_setaffinity(tid, sizeof set, &set); });
}

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::nth_element(v.begin(), v.begin() + ptrdiff_t(v.size() / 2), v.end());
  return v[v.size() / 2];
}

}  // namespace fr::bench
