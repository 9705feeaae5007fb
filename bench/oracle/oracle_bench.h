// What the transports of the ray oracle cost, as ratios within one run. See main.cpp.
#pragma once

#include <nlohmann/json.hpp>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "shading/shading_system.h"
#include "tracer/inproc_oracle.h"
#include "tracer/shm_oracle.h"
#include "tracer/testing/ray_batches.h"

namespace fr::bench {

struct Options {
  uint32_t patches = 64;  // of each of the two spheres, squared; 64 quads a patch at stride 2
  size_t rays = 65536;    // of one measurement of one line
  int width = 0;          // of throughput; 0: 1, 2, 4 ... as far as there are processors
  int repeats = 7;        // measurements of each transport, by turns
};

/// A sphere of grids inside another, both opaque; and the two services over it.
struct Scene {
  std::unique_ptr<cache::SceneCache> cache;
  std::unique_ptr<ShadingSystem> shading;
  std::unique_ptr<tracer::InprocOracleService> inproc;
  std::unique_ptr<tracer::ShmOracleService> shm;

  Scene(const Options& options, int serverThreads);
};

testing::RayList makeRays(size_t n, bool coherent, RayKind kind, uint32_t seed);
const char* nameOf(RayKind kind);

double seconds();
/// Processor time of this process, and of another (0 when it is gone), in seconds.
double processorSeconds();
double processorSeconds(int pid);
/// How often threads of a process (0: this one) gave up their processor, and how often it was taken from
/// them.
struct Switches {
  uint64_t voluntary = 0, forced = 0;
};
Switches switches(int pid);
/// Keeps this process and what it starts from now on on the first `n` processors that it has.
void useProcessors(int n);
/// Keeps every thread of a process (0: this one) on the i-th processor that this process had at its start.
void pinTo(int pid, int i);
int processorCount();

double median(std::vector<double> values);

nlohmann::json benchThroughput(const Options& options, int width);
nlohmann::json benchSingleRays(const Options& options);
nlohmann::json benchManyClients(const Options& options);
nlohmann::json benchIdleServer(const Options& options);

}  // namespace fr::bench
