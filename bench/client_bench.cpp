// What a ray costs another program: through the C library (single and in batches) and through the shadeop,
// over shared memory and over a pipe. The scene is one polygon, so that almost nothing is tracing.
//
//   client_bench [rays]     prints nanoseconds a ray, the median of five runs, and the spread
#include <dlfcn.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "frankenray/frankenray.h"

namespace {

using Clock = std::chrono::steady_clock;

void measure(const char* what, long rays, const std::function<bool(long)>& run) {
  if (!run(std::max(1L, rays / 10))) {
    std::printf("%-44s failed\n", what);
    return;
  }
  std::vector<double> ns;
  for (int i = 0; i < 5; ++i) {
    const auto begin = Clock::now();
    if (!run(rays)) return;
    ns.push_back(double(std::chrono::nanoseconds(Clock::now() - begin).count()) / double(rays));
  }
  std::sort(ns.begin(), ns.end());
  std::printf("%-44s %10.0f ns  (%.0f ... %.0f)\n", what, ns[2], ns.front(), ns.back());
  std::fflush(stdout);
}

void library(const std::string& scene, int transport, long rays) {
  frankenray_session* const session = frankenray_create();
  frankenray_options options = FRANKENRAY_OPTIONS_INIT;
  options.transport = transport;
  if (frankenray_start(session, &options, scene.c_str()) != FRANKENRAY_OK) {
    std::fprintf(stderr, "%s\n", frankenray_error_text(session));
    std::exit(1);
  }
  frankenray_line* const line = frankenray_line_open(session);
  const char* const name = transport == FRANKENRAY_PIPE ? "pipe" : "shm";
  const long singles = transport == FRANKENRAY_PIPE ? rays / 20 : rays;
  measure((std::string(name) + ", library, one ray").c_str(), singles, [&](long n) {
    const double from[3] = {0, 0, 0}, to[3] = {0, 0, 1};
    float color[3];
    for (long i = 0; i < n; ++i)
      if (frankenray_visibility(line, from, to, color) != FRANKENRAY_OK) return false;
    return true;
  });
  measure((std::string(name) + ", library, batches of 16384").c_str(), 16 * rays, [&](long n) {
    constexpr size_t kBatch = 16384;
    static std::vector<double> from(3 * kBatch), to(3 * kBatch, 1.0);
    static std::vector<float> color(3 * kBatch);
    frankenray_rays r = FRANKENRAY_RAYS_INIT;
    r.kind = FRANKENRAY_VISIBILITY, r.count = kBatch;
    r.origin = {from.data(), from.data() + 1, from.data() + 2, 3};
    r.target = {to.data(), to.data() + 1, to.data() + 2, 3};
    frankenray_answers a = FRANKENRAY_ANSWERS_INIT;
    a.color = {color.data(), color.data() + 1, color.data() + 2, 3};
    for (long done = 0; done < n; done += long(kBatch))
      if (frankenray_answer(line, &r, &a) != FRANKENRAY_OK) return false;
    return true;
  });
  frankenray_line_close(line);
  frankenray_close(session);
}

void shadeop(const std::string& command, const char* transport, long rays) {
  setenv("RAYSERVER", command.c_str(), 1);
  setenv("RAYSERVER_TRANSPORT", transport, 1);
  void* const dso = dlopen(FR_BINARY_DIR "/lib/frankenrender/shadeops/rayserver.so", RTLD_NOW | RTLD_LOCAL);
  if (!dso) return;
  using Function = int (*)(void*, int, void**);
  const auto visibility = reinterpret_cast<Function>(dlsym(dso, "rayserver_visibility"));
  const auto zero = reinterpret_cast<Function>(dlsym(dso, "rayserver_zero"));
  const auto init = reinterpret_cast<void* (*)(int, void*)>(dlsym(dso, "rayserver_init"));
  const auto shutdown = reinterpret_cast<void (*)(void*)>(dlsym(dso, "rayserver_shutdown"));
  init(0, nullptr);
  float result[3], from[3] = {0, 0, 0}, to[3] = {0, 0, 1};
  void* argv[] = {result, from, to};
  const auto calls = [&](Function f) {
    return [&, f](long n) {
      for (long i = 0; i < n; ++i) f(nullptr, 3, argv);
      return true;
    };
  };
  measure((std::string(transport) + ", shadeop visibility()").c_str(),
          std::string(transport) == "pipe" ? rays / 20 : rays, calls(visibility));
  if (std::string(transport) == "shm") measure("an empty shadeop", 100 * rays, calls(zero));
  shutdown(nullptr);
}

}  // namespace

int main(int argc, char** argv) {
  const long rays = argc > 1 ? std::max(100L, std::atol(argv[1])) : 100000;
  std::string folder = "/tmp/client-bench-XXXXXX";
  if (!mkdtemp(folder.data())) return 1;
  const std::string scene = folder + "/scene.rib", program = FR_BINARY_DIR "/bin/rendrib";
  std::ofstream(scene) << "Projection \"perspective\"\nTranslate 0 0 10\nWorldBegin\n"
                          "Polygon \"P\" [-1 -1 2  -1 1 2  1 1 2  1 -1 2]\nWorldEnd\n";
  setenv("FRANKENRAY_RENDRIB", program.c_str(), 1);
  for (const int transport : {FRANKENRAY_SHARED_MEMORY, FRANKENRAY_PIPE}) library(scene, transport, rays);
  for (const char* transport : {"shm", "pipe"}) shadeop(program + " -rayserver " + scene, transport, rays);
  unlink(scene.c_str());
  rmdir(folder.c_str());
  return 0;
}
