// What a patch_multiplier costs and gives, for every kind of surface: how far the traced facets are from the
// true surface, bytes, seconds to build, rays a second. Prints a table.
//
//   level_bench [--rays N] [--rate R]
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "tests/stability/traced_model.h"

namespace fr {
namespace {

using Clock = std::chrono::steady_clock;
double secondsSince(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }

/// Random rays between points of a ball around the model, as diffuse reflection would send them.
void measure(const test::Model& m, size_t rays) {
  test::TracedModel model(m);
  for (const float multiplier : {1.0f, 0.5f, 0.25f, 0.125f}) {
    const auto scene = model.trace(multiplier);
    if (!scene) return;
    const auto s = scene->statistics();
    test::Counted random(1);
    double worst = 0, squares = 0, size = 0;
    size_t hits = 0;
    const size_t errorRays = std::min<size_t>(rays, 100'000);
    for (size_t i = 0; i < errorRays; ++i) {
      tracer::Ray r;
      r.origin = model.inside, r.direction = random.direction();
      const tracer::Hit hit = scene->closest(r);
      if (!hit.any()) continue;
      float p[3], n[3];
      cache::SurfaceOut out;
      for (int c = 0; c < 3; ++c) out.P[c] = p + c, out.Ng[c] = n + c;
      const tracer::SurfaceEntry& e = scene->entry(hit.entry);
      model.cache().evaluateSurface(e.node, 1, &hit.cell, &hit.u, &hit.v, out);
      const Vec3 at = r.origin + hit.distance * r.direction;
      const double off = std::abs(double(glm::dot(Vec3(p[0], p[1], p[2]) - at, Vec3(n[0], n[1], n[2]))));
      worst = std::max(worst, off), squares += off * off, ++hits;
      size = std::max(size, double(hit.distance));
    }
    // Rays a second, one thread.
    test::Counted start(2);
    const auto begin = Clock::now();
    size_t any = 0;
    for (size_t i = 0; i < rays; ++i) {
      tracer::Ray r;
      r.origin = model.inside + float(size) * 1.2f * start.direction();
      r.direction =
          glm::normalize(model.inside + float(size) * 0.8f * start() * start.direction() - r.origin);
      any += scene->closest(r).any();
    }
    const double seconds = secondsSince(begin);
    fmt::print("| {:16} | {:5} | {:9.2e} | {:9.2e} | {:7} | {:9.1f} | {:7.2f} | {:5.2f} |\n", m.name,
               multiplier, worst / size, std::sqrt(squares / double(std::max<size_t>(1, hits))) / size,
               s.quads + s.triangles, double(s.embreeBytes + s.recordBytes) / 1024, 1000 * s.buildSeconds,
               double(rays) / seconds * 1e-6);
    std::fflush(stdout);
    if (any == 0) fmt::print("no ray hit anything\n");
  }
}

}  // namespace
}  // namespace fr

int main(int argc, char** argv) {
  size_t rays = 1'000'000;
  double rate = 0;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (!std::strcmp(argv[i], "--rays")) rays = size_t(std::max(1.0, std::atof(argv[i + 1])));
    if (!std::strcmp(argv[i], "--rate")) rate = std::atof(argv[i + 1]);
  }
  fmt::print(
      "| surface | patch_multiplier | worst error | RMS error | facets | KiB | build, ms | M rays/s |\n");
  fmt::print("|---|---:|---:|---:|---:|---:|---:|---:|\n");
  for (fr::test::Model m : fr::test::closedModels()) {
    if (m.bumps > 0) continue;  // the true surface is the displaced one, which has no closed form
    if (rate > 0) m.shadingRate = rate;
    fr::measure(m, rays);
  }
}
