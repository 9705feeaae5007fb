// raystat: what the ray servers of this user are doing.
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "oracle/server_watch.h"
#include "shm/memory_info.h"
#include "shm/named_socket.h"

namespace {

using namespace fr;
using Clock = std::chrono::steady_clock;

constexpr const char* kFooter =
    R"(Columns, per second: rays asked by clients, by kind; rays asked by shaders at hits. Then: rays in a block;
blocks that waited behind each block when it was taken; clients and their channels; the part of the threads' time
that went into answering blocks; grids that rays use and the part found in the scene cache; memory (PSS) of the
process, of the scene and of the acceleration structure.

Watching costs the server nothing: it counts in shared memory, and raystat reads it there.

Examples:
  raystat teapots            every second, until the server ends or Ctrl-C
  raystat --once --json 4711)";

/// One server between two readings.
struct Watched {
  ServerWatch watch;
  RayServerNumbers before;
  Clock::time_point at = Clock::now();
  bool alive = true;
};

struct Reading {
  RayServerNumbers now, delta;
  double seconds = 1;
  uint64_t memory = 0;

  double rate(Counter c) const { return double(delta[c]) / seconds; }
  double nested() const {
    return rate(Counter::kNestedTrace) + rate(Counter::kNestedVisibility) + rate(Counter::kNestedHitTest) +
           rate(Counter::kNestedFullTrace);
  }
  static double ratio(uint64_t a, uint64_t b) { return b ? double(a) / double(b) : 0; }
  double fill() const { return ratio(delta[Counter::kBlockRays], delta[Counter::kBlocks]); }
  double queue() const { return ratio(delta[Counter::kWaiting], delta[Counter::kBlocks]); }
  double busy() const {
    return double(delta[Counter::kBusyNanoseconds]) * 1e-9 / seconds /
           std::max(1.0, double(now[Gauge::kThreads]));
  }
  double cacheHits() const {
    const uint64_t used = now[Gauge::kGridsUsed], diced = std::min(used, now[Gauge::kGridsDiced]);
    return used ? double(used - diced) / double(used) : 0;
  }
};

Reading take(Watched& w, bool sinceStart) {
  Reading r;
  const Clock::time_point t = Clock::now();
  r.now = w.watch.counters.read();
  r.delta = r.now;
  if (sinceStart) {
    timespec boot{};
    ::clock_gettime(CLOCK_BOOTTIME, &boot);
    r.seconds = double(boot.tv_sec) + double(boot.tv_nsec) * 1e-9 - double(r.now[Gauge::kStarted]) * 1e-9;
  } else {
    r.seconds = std::chrono::duration<double>(t - w.at).count();
    for (uint32_t c = 0; c < kCounterCount; ++c)
      r.delta.counter[c] = r.now.counter[c] - std::min(r.now.counter[c], w.before.counter[c]);
  }
  r.seconds = std::max(r.seconds, 1e-6);
  w.before = r.now;
  w.at = t;
  w.alive = w.watch.socket.alive();
  if (auto m = shm::processMemory(w.watch.processId); m.ok()) r.memory = m->pss;
  return r;
}

std::string count(double n) {
  if (n >= 1e9) return fmt::format("{:.2f}G", n * 1e-9);
  if (n >= 1e6) return fmt::format("{:.2f}M", n * 1e-6);
  if (n >= 1e4) return fmt::format("{:.1f}k", n * 1e-3);
  return fmt::format("{:.0f}", n);
}
std::string mebibytes(uint64_t bytes) { return fmt::format("{:.1f}M", double(bytes) / 1048576.0); }

constexpr const char* kHead =
    "server               pid  trace/s   vis/s   hit/s  full/s nested/s   fill queue clients chan  busy     "
    "grids "
    "cached    mem  scene   tree\n";

void print(const Watched& w, const Reading& r) {
  fmt::print(
      "{:<16} {:>7} {:>8} {:>7} {:>7} {:>7} {:>8} {:>6.1f} {:>5.1f} {:>7} {:>4} {:>4.0f}% {:>9} {:>5.0f}% "
      "{:>6} {:>6} {:>6}{}\n",
      w.watch.name, w.watch.processId, count(r.rate(Counter::kTrace)), count(r.rate(Counter::kVisibility)),
      count(r.rate(Counter::kHitTest)), count(r.rate(Counter::kFullTrace)), count(r.nested()), r.fill(),
      r.queue(), r.now[Gauge::kClients], r.now[Gauge::kChannels], 100 * r.busy(), r.now[Gauge::kGridsUsed],
      100 * r.cacheHits(), mebibytes(r.memory), mebibytes(r.now[Gauge::kSceneBytes]),
      mebibytes(r.now[Gauge::kTreeBytes]),
      !w.alive               ? "  ended"
      : r.now[Gauge::kReady] ? ""
                             : "  loading");
}

nlohmann::json toJson(const Watched& w, const Reading& r) {
  const auto total = [&](Counter c) { return r.now[c]; };
  return {{"name", w.watch.name},
          {"pid", w.watch.processId},
          {"alive", w.alive},
          {"ready", r.now[Gauge::kReady] != 0},
          {"seconds", r.seconds},
          {"rates",
           {{"trace", r.rate(Counter::kTrace)},
            {"visibility", r.rate(Counter::kVisibility)},
            {"rayhittest", r.rate(Counter::kHitTest)},
            {"fulltrace", r.rate(Counter::kFullTrace)},
            {"nested", r.nested()}}},
          {"totals",
           {{"trace", total(Counter::kTrace)},
            {"visibility", total(Counter::kVisibility)},
            {"rayhittest", total(Counter::kHitTest)},
            {"fulltrace", total(Counter::kFullTrace)},
            {"blocks", total(Counter::kBlocks)},
            {"blockRays", total(Counter::kBlockRays)},
            {"singles", total(Counter::kSingles)},
            {"pipeQueries", total(Counter::kPipeQueries)},
            {"pipeFrames", total(Counter::kPipeFrames)},
            {"intersections", total(Counter::kIntersections)},
            {"rejected", total(Counter::kRejected)},
            {"hitsShaded", total(Counter::kHitsShaded)}}},
          {"batchFill", r.fill()},
          {"queueDepth", r.queue()},
          {"busy", r.busy()},
          {"threads", r.now[Gauge::kThreads]},
          {"clients", r.now[Gauge::kClients]},
          {"clientsEver", r.now[Gauge::kClientsEver]},
          {"channels", r.now[Gauge::kChannels]},
          {"grids", r.now[Gauge::kGridsUsed]},
          {"gridsDiced", r.now[Gauge::kGridsDiced]},
          {"cacheHits", r.cacheHits()},
          {"memory", r.memory},
          {"sceneBytes", r.now[Gauge::kSceneBytes]},
          {"treeBytes", r.now[Gauge::kTreeBytes]},
          {"recordBytes", r.now[Gauge::kRecordBytes]}};
}

}  // namespace

int main(int argc, char** argv) {
  std::string which;
  bool all = false, once = false, json = false;
  double interval = 1;
  CLI::App app{"Shows what running ray servers (rendrib -rayserver) are doing.", "raystat"};
  app.footer(kFooter);
  app.set_version_flag("--version,-V", "raystat (frankenrender) " FR_VERSION);
  auto* server = app.add_option("server", which, "Name or process id of a ray server")->type_name("PID|NAME");
  app.add_flag("--all", all, "All ray servers of this user")->excludes(server);
  app.add_flag("--once", once, "One reading, with averages since the server's start");
  app.add_flag("--json", json, "One JSON array for each reading");
  app.add_option("--interval", interval, "Seconds between readings (default 1)")
      ->check(CLI::Range(0.01, 3600.0));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (which.empty() && !all) {
    std::fputs("raystat: which server? Give its name or process id, or --all\n", stderr);
    return 2;
  }

  std::vector<Watched> watched;
  const auto add = [&](Result<ServerWatch> w) {
    if (!w.ok()) return fr::report(w.error());
    watched.push_back({std::move(w).value(), {}, Clock::now(), true});
    watched.back().before = watched.back().watch.counters.read();
  };
  if (all) {
    for (const std::string& name : shm::listSocketNames()) add(watchServer(name));
    if (watched.empty() && reportCount(Severity::kError) == 0)
      std::fputs("raystat: no ray server is running\n", stderr);
  } else {
    int pid = 0;
    const auto [end, error] = std::from_chars(which.data(), which.data() + which.size(), pid);
    if (error == std::errc() && end == which.data() + which.size())
      add(watchServerProcess(pid));
    else
      add(watchServer(which));
  }
  if (watched.empty()) return 1;

  for (int round = 0;; ++round) {
    if (!once) ::usleep(useconds_t(interval * 1e6));
    nlohmann::json list = nlohmann::json::array();
    if (!json && round % 20 == 0) std::fputs(kHead, stdout);
    for (Watched& w : watched) {
      const Reading r = take(w, once);
      if (json)
        list.push_back(toJson(w, r));
      else
        print(w, r);
    }
    if (json) fmt::print("{}\n", list.dump());
    std::fflush(stdout);
    std::erase_if(watched, [](const Watched& w) { return !w.alive; });
    if (once || watched.empty()) return 0;
  }
}
