// Nanoseconds per point of the virtual machine: standard shaders under one point light, by batch size.
#include <benchmark/benchmark.h>

#include <fstream>
#include <sstream>

#include "shading/machine_fixture.h"

namespace fr {
namespace {

std::string standardShader(const std::string& name) {
  std::ifstream file(std::string(FR_SHADER_DIR) + "/" + name + ".sl");
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

void shade(benchmark::State& state, const std::string& source) {
  MachineFixture f;
  f.includePaths = {FR_SHADER_DIR};
  const uint32_t n = uint32_t(state.range(0));
  const uint32_t nu = n >= 1024 ? 31 : n >= 256 ? 15 : n >= 64 ? 7 : 3;
  f.resize(nu, n / (nu + 1) - 1);
  DerivativeStencil stencil;
  gridStencil(stencil, nu, n / (nu + 1) - 1, f.lanes, 1.0f / float(nu), 1.0f / float(nu));
  f.batch.stencil = &stencil;
  f.shaderToCurrent[3] = DVec4(0.3, 0.4, -2, 1);
  const auto light = f.shader(standardShader("pointlight"));
  const auto surface = f.shader(source);
  if (!light || !surface) {
    state.SkipWithError(f.error.c_str());
    return;
  }
  for (auto _ : state) {
    f.run(*surface, {light.get()});
    benchmark::DoNotOptimize(f.Ci(0));
  }
  state.counters["seconds/point"] = benchmark::Counter(
      double(f.count), benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

const char* kNoise =
    "surface turbulence(float octaves = 6) { float i, r = 0, a = 1; point Q = 4 * P;"
    " for (i = 0; i < octaves; i += 1) { r += a * abs(2 * noise(Q) - 1); a *= .5; Q *= 2; } Ci = r; Oi = 1; "
    "}";

void plastic(benchmark::State& s) { shade(s, standardShader("plastic")); }
void matte(benchmark::State& s) { shade(s, standardShader("matte")); }
void constant(benchmark::State& s) { shade(s, standardShader("constant")); }
void mirror(benchmark::State& s) { shade(s, standardShader("mirror")); }
void turbulence(benchmark::State& s) { shade(s, kNoise); }
BENCHMARK(constant)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);
BENCHMARK(matte)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);
BENCHMARK(plastic)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);
BENCHMARK(mirror)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);
BENCHMARK(turbulence)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);

}  // namespace
}  // namespace fr

BENCHMARK_MAIN();
