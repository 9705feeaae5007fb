// Bytes a micropolygon by primitive type, and the limits of the machine. bench/memory/run.py runs it.
#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string_view>
#include <vector>

#include "bench/memory/cost.h"

namespace {

using Clock = std::chrono::steady_clock;
double since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

nlohmann::ordered_json bytesByType() {
  auto rows = nlohmann::ordered_json::array();
  for (const fr::bench::MemoryCase& m : fr::bench::memoryCases()) {
    const fr::bench::MemoryCost full = fr::bench::memoryCost(m.rib, 1),
                                half = fr::bench::memoryCost(m.rib, 0.5f);
    rows.push_back({{"name", m.name},
                    {"face", m.irregular ? "triangle" : "micropolygon"},
                    {"goal", m.goal},
                    {"faces", full.faces},
                    {"facesAGrid", full.facesAGrid},
                    {"scene", full.scene},
                    {"nodes", full.nodes},
                    {"vertices", full.vertices},
                    {"tree", full.tree},
                    {"records", full.records},
                    {"all", full.all()},
                    {"allAtHalf", half.all()},
                    {"embree", fr::bench::embreeTriangles(m.rib, false)},
                    {"embreeCompact", fr::bench::embreeTriangles(m.rib, true)}});
  }
  return rows;
}

/// Of memory larger than the caches, and of a file that is on the disk in the end.
nlohmann::ordered_json machineLimits(const std::string& folder) {
  constexpr size_t kBytes = size_t(256) << 20;
  const std::vector<char> from(kBytes, 1);
  std::vector<char> to(kBytes, 2);
  double copy = 0;
  for (int i = 0; i < 5; ++i) {
    const auto start = Clock::now();
    std::memcpy(to.data(), from.data(), kBytes);
    asm volatile("" : : "r"(to.data()) : "memory");
    copy = std::max(copy, double(kBytes) / since(start));
  }
  const int fd = open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (fd < 0) return {{"error", std::strerror(errno)}};
  constexpr int kTimes = 4;
  const auto start = Clock::now();
  for (int i = 0; i < kTimes; ++i)
    for (size_t at = 0; at < kBytes;) {
      const ssize_t n = write(fd, to.data() + at, std::min<size_t>(kBytes - at, 4 << 20));
      if (n <= 0) return {{"error", std::strerror(errno)}};
      at += size_t(n);
    }
  fsync(fd);
  const double disk = double(kBytes) * kTimes / since(start);
  close(fd);
  return {{"copyBytesPerSecond", copy}, {"diskBytesPerSecond", disk}};
}

}  // namespace

int main(int argc, char** argv) {
  const std::string_view what = argc > 1 ? argv[1] : "";
  if (what == "bytes") {
    fmt::print("{}\n", bytesByType().dump(1));
  } else if (what == "limits" && argc > 2) {
    fmt::print("{}\n", machineLimits(argv[2]).dump(1));
  } else {
    fmt::print(stderr, "memory_bench bytes | memory_bench limits FOLDER\n");
    return 2;
  }
  return 0;
}
