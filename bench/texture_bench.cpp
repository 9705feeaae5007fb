// Nanoseconds per texture lookup: a shader's batch through the virtual machine and the texture module, beside
// the same lookups by a plain loop over OpenImageIO.
#include <OpenImageIO/imageio.h>
#include <OpenImageIO/texture.h>
#include <benchmark/benchmark.h>
#include <unistd.h>

#include <filesystem>

#include "shading/machine_fixture.h"
#include "shading/texture_library.h"

namespace fr {
namespace {

/// A texture of 1024 x 1024 pixels, made once.
const std::string& textureFile() {
  static const std::string name = [] {
    const std::string base =
        (std::filesystem::temp_directory_path() / ("fr_texture_bench." + std::to_string(::getpid())))
            .string();
    constexpr int n = 1024;
    std::vector<uint8_t> texels;
    for (int k = 0; k < n * n * 3; ++k) texels.push_back(uint8_t((k * 2654435761u) >> 24));
    const auto out = OIIO::ImageOutput::create("tiff");
    out->open(base + ".tif", OIIO::ImageSpec(n, n, 3, OIIO::TypeDesc::UINT8));
    out->write_image(OIIO::TypeDesc::UINT8, texels.data());
    out->close();
    TextureRequest r;
    r.pictures = {base + ".tif"}, r.texture = base + ".tx", r.sWrap = r.tWrap = "periodic";
    if (const auto made = makeTexture(r); !made) report(made.error());
    std::filesystem::remove(base + ".tif");
    return base + ".tx";
  }();
  return name;
}

// What the shader asks, in the shader's words and in numbers.
constexpr float kOffset = 0.2f, kScale = 0.1f;

void perLookup(benchmark::State& state, uint32_t points) {
  state.counters["seconds/lookup"] = benchmark::Counter(
      double(points), benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void batch(benchmark::State& state) {
  const uint32_t n = uint32_t(state.range(0)), nu = n >= 1024 ? 31 : n >= 256 ? 15 : n >= 64 ? 7 : 3;
  static TextureLibrary library({});
  MachineFixture f(nu, n / (nu + 1) - 1);
  f.host.library = &library;
  DerivativeStencil stencil;
  gridStencil(stencil, nu, n / (nu + 1) - 1, f.lanes, 1.0f / float(nu), 1.0f / float(nu));
  f.batch.stencil = &stencil;
  const auto shader = f.shader("surface t() { Ci = color texture(\"" + textureFile() +
                               "\", .2 + .1 * s, .2 + .1 * t); Oi = 1; }");
  if (!shader) return state.SkipWithError(f.error.c_str());
  for (auto _ : state) {
    f.run(*shader);
    benchmark::DoNotOptimize(f.Ci(0));
  }
  perLookup(state, f.count);
}

void openImageIo(benchmark::State& state) {
  const uint32_t n = uint32_t(state.range(0)),
                 nu = n >= 1024  ? 31
                      : n >= 256 ? 15
                      : n >= 64  ? 7
                                 : 3,
                 nv = n / (nu + 1) - 1;
  static OIIO::TextureSystem* const system = OIIO::TextureSystem::create(false);
  auto* const thread = system->get_perthread_info();
  auto* const handle = system->get_texture_handle(OIIO::ustring(textureFile()));
  OIIO::TextureOpt options;
  options.interpmode = OIIO::TextureOpt::InterpBilinear;
  const float ds = kScale / float(nu), dt = kScale / float(nv);
  std::vector<float> results(n * 3);
  for (auto _ : state) {
    for (uint32_t i = 0; i < n; ++i)
      system->texture(handle, thread, options, kOffset + kScale * float(i % (nu + 1)) / float(nu),
                      kOffset + kScale * float(i / (nu + 1)) / float(nv), ds, 0, 0, dt, 3,
                      results.data() + 3 * i);
    benchmark::DoNotOptimize(results.data());
  }
  perLookup(state, n);
}

BENCHMARK(batch)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);
BENCHMARK(openImageIo)->Arg(16)->Arg(64)->Arg(256)->Arg(1024);

}  // namespace
}  // namespace fr

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks();
  std::filesystem::remove(fr::textureFile());
  return 0;
}
