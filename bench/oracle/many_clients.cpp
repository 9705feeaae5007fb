#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <fstream>
#include <thread>

#include "bench/oracle/oracle_bench.h"

namespace fr::bench {
namespace {

constexpr uint32_t kBatch = 256;

struct Served {
  double raysPerSecond = 0;
  std::vector<uint64_t> batches;  // of each client
};

/// `clients` threads, each with a line of its own and `flying` blocks in flight, for a while.
Served serve(Scene& scene, int clients, int flying, double duration, const testing::RayList& rays) {
  std::vector<std::unique_ptr<RayOracle>> lines;
  for (int i = 0; i < clients; ++i) {
    lines.push_back(std::move(scene.shm->connect()).value());
    RayQuery* q = lines.back()->acquire();
    q->count = 0, q->kind = RayKind::kHitTest;
    if (!lines.back()->submit(q) || !lines.back()->wait() || !lines.back()->answered(q)) std::abort();
    lines.back()->release(q);
  }
  Served out;
  out.batches.resize(size_t(clients));
  std::atomic<bool> stop{false};
  std::vector<std::thread> workers;
  const double t0 = seconds();
  for (int c = 0; c < clients; ++c)
    workers.emplace_back([&, c] {
      RayOracle& line = *lines[size_t(c)];
      size_t next = size_t(c) * 1237 * kBatch;
      std::vector<RayQuery*> out_;
      const auto send = [&](RayQuery* q) {
        q->kind = RayKind::kHitTest, q->level = 1, q->count = kBatch;
        for (uint32_t i = 0; i < kBatch; ++i) testing::setRay(*q, i, rays[(next + i) % rays.size()]);
        next += kBatch;
        if (!line.submit(q)) std::abort();
      };
      for (int i = 0; i < flying; ++i) {
        out_.push_back(line.acquire());
        send(out_.back());
      }
      while (!out_.empty()) {
        if (!line.wait()) std::abort();
        for (size_t k = 0; k < out_.size(); ++k) {
          RayQuery* const q = out_[k];
          if (!line.answered(q)) continue;
          line.release(q);
          out_.erase(out_.begin() + ptrdiff_t(k--));
          if (stop.load(std::memory_order_relaxed)) continue;
          ++out.batches[size_t(c)];
          out_.push_back(line.acquire());
          send(out_.back());
        }
      }
    });
  while (seconds() - t0 < duration) ::usleep(10000);
  stop = true;
  const double t1 = seconds();
  uint64_t all = 0;
  for (auto& w : workers) w.join();
  for (uint64_t n : out.batches) all += n;
  out.raysPerSecond = double(all) * kBatch / (t1 - t0);
  return out;
}

}  // namespace

nlohmann::json benchManyClients(const Options& options) {
  Scene scene(options, processorCount());
  const auto rays = makeRays(options.rays * 4, false, RayKind::kHitTest, 11);
  std::vector<double> ratio, spread;
  double one = 0, many = 0;
  for (int repeat = 0; repeat < 3; ++repeat) {
    const Served a = serve(scene, 1, 8, 1.5, rays), b = serve(scene, 64, 2, 3.0, rays);
    const auto [least, most] = std::minmax_element(b.batches.begin(), b.batches.end());
    one = a.raysPerSecond, many = b.raysPerSecond;
    ratio.push_back(many / one);
    spread.push_back(*least ? double(*most) / double(*least) : 1e9);
  }
  fmt::print(
      "64 clients: {:.3f} Mrays/s, one client: {:.3f} Mrays/s, ratio {:.3f}; most served / least served "
      "{:.2f}\n",
      many * 1e-6, one * 1e-6, median(ratio), median(spread));
  return {{"ratioToOneClient", median(ratio)}, {"mostOverLeast", median(spread)}};
}

nlohmann::json benchIdleServer(const Options& options) {
  Scene scene(options, processorCount());
  auto line = std::move(scene.shm->connect()).value();
  if (!line->ask({})) std::abort();
  const int pid = scene.shm->processId();
  const auto ticks = [&] {  // utime + stime, as ps and top have them
    std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
    std::string all(std::istreambuf_iterator<char>(stat), {});
    unsigned long user = 0, system = 0;
    std::sscanf(all.c_str() + all.rfind(')'), ") %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user,
                &system);
    return user + system;
  };
  ::usleep(200000);
  const double p0 = processorSeconds(pid);
  const auto t0 = ticks();
  const uint64_t w0 = switches(pid).voluntary;
  ::usleep(5000000);
  const double busy = (processorSeconds(pid) - p0) / 5;
  const auto used = ticks() - t0;
  const uint64_t wakes = switches(pid).voluntary - w0;
  fmt::print("idle server with one client: {} clock ticks and {} wake-ups in 5 s, {:.4f} % of a processor\n",
             used, wakes, busy * 100);
  return {{"ticks", used}, {"wakeUps", wakes}, {"percent", busy * 100}};
}

}  // namespace fr::bench
