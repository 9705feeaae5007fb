// Speed of the RIB reader: bytes of text per second, one thread.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iterator>

#include "ri/lexer.h"
#include "ri/reader.h"
#include "ri/rib_writer.h"

namespace fr::ri {
namespace {

// A displaced sphere as one PointsPolygons, written as exporters do: up to six decimals, four lines per face
// or so.
const std::string& meshText() {
  static const std::string& text = *[] {
    constexpr int kU = 500, kV = 400;
    auto* s = new std::string("WorldBegin\nPointsPolygons [");
    auto out = std::back_inserter(*s);
    for (int i = 0; i < kU * (kV - 1); ++i) fmt::format_to(out, "4{}", i % 24 == 23 ? '\n' : ' ');
    *s += "]\n[";
    for (int j = 0; j + 1 < kV; ++j) {
      for (int i = 0; i < kU; ++i) {
        const int k = (i + 1) % kU;
        fmt::format_to(out, "{} {} {} {}\n", j * kU + i, j * kU + k, (j + 1) * kU + k, (j + 1) * kU + i);
      }
    }
    *s += "]\n\"P\" [";
    for (int j = 0; j < kV; ++j) {
      for (int i = 0; i < kU; ++i) {
        const double u = 6.283185307 * i / kU, v = 3.141592653 * j / (kV - 1);
        const double r = 1 + 0.1 * std::sin(7 * u) * std::sin(9 * v);
        fmt::format_to(out, "{:.6g} {:.6g} {:.6g}\n", r * std::cos(u) * std::sin(v),
                       r * std::sin(u) * std::sin(v), r * std::cos(v));
      }
    }
    *s += "]\nWorldEnd\n";
    return s;
  }();
  return text;
}

void readText(benchmark::State& state, const std::string& text) {
  for (auto _ : state) {
    NullRenderer none;
    Reader reader(none);
    if (!reader.readBuffer(text).ok()) state.SkipWithError("unreadable");
  }
  state.SetBytesProcessed(int64_t(state.iterations()) * int64_t(text.size()));
}

void BM_ReadMesh(benchmark::State& state) { readText(state, meshText()); }
BENCHMARK(BM_ReadMesh)->Unit(benchmark::kMillisecond);

// Many small requests: what an exporter writes per object.
void BM_ReadSmallRequests(benchmark::State& state) {
  std::string text = "WorldBegin\n";
  for (int i = 0; i < 20000; ++i) {
    text += fmt::format(
        "AttributeBegin\nAttribute \"identifier\" \"name\" [\"object{}\"]\nTranslate {} 0 {}\nColor [1 0.5 "
        "0]\n"
        "Surface \"plastic\" \"Ka\" [1] \"Kd\" [0.5]\nSphere 1 -1 1 360\nAttributeEnd\n",
        i, i * 0.25, i * 0.5);
  }
  text += "WorldEnd\n";
  readText(state, text);
}
BENCHMARK(BM_ReadSmallRequests)->Unit(benchmark::kMillisecond);

// The same as binary RIB, and a cloud of points: one long array of floats, which is what 1 GB/s is asked of.
std::string binaryOf(const std::string& text) {
  std::string out;
  RibWriterOptions options;
  options.binary = true;
  RibWriter writer([&](std::string_view piece) { out += piece; }, options);
  Reader reader(writer);
  if (!reader.readBuffer(text).ok()) return {};
  writer.flush();
  return out;
}
void BM_ReadBinaryMesh(benchmark::State& state) { readText(state, binaryOf(meshText())); }
BENCHMARK(BM_ReadBinaryMesh)->Unit(benchmark::kMillisecond);
void BM_ReadBinaryFloats(benchmark::State& state) {
  const std::string& all = meshText();
  readText(state, binaryOf("WorldBegin\nPoints " + all.substr(all.find("\"P\" "))));
}
BENCHMARK(BM_ReadBinaryFloats)->Unit(benchmark::kMillisecond);

void BM_FloatArray(benchmark::State& state) {
  const std::string& all = meshText();
  const std::string text = all.substr(all.find("\"P\" ") + 4);
  std::vector<float> values;
  for (auto _ : state) {
    Result<std::unique_ptr<Input>> input = openMemory(text);
    Lexer lexer(std::move(*input), "bench");
    lexer.advance();
    values.clear();
    if (!lexer.readNumbers(values)) state.SkipWithError("unreadable");
  }
  state.SetBytesProcessed(int64_t(state.iterations()) * int64_t(text.size()));
  state.SetItemsProcessed(int64_t(state.iterations()) * int64_t(values.size()));
}
BENCHMARK(BM_FloatArray)->Unit(benchmark::kMillisecond);

// A file of the user's: FRANKENRENDER_BENCH_RIB=scene.rib ri_bench --benchmark_filter=UserFile. Bytes are
// those on disk (compressed ones for gzip).
void BM_UserFile(benchmark::State& state) {
  const char* path = std::getenv("FRANKENRENDER_BENCH_RIB");
  if (!path) return state.SkipWithError("FRANKENRENDER_BENCH_RIB is not set");
  for (auto _ : state) {
    NullRenderer none;
    Reader reader(none);
    if (!reader.readFile(path).ok()) return state.SkipWithError("unreadable");
  }
  state.SetBytesProcessed(int64_t(state.iterations()) * int64_t(std::filesystem::file_size(path)));
}
BENCHMARK(BM_UserFile)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace fr::ri

BENCHMARK_MAIN();
