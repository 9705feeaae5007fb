// The limits of the ray oracle: what its transports cost over answering in the asking thread.
//
// oracle_bench [--json=FILE] [--only=throughput|single|clients|idle] [--rays=N] [--patches=N] [--repeats=N]
// [--width=W]
//
//   throughput  W client threads that wait while their rays fly and W server threads, against W threads that
//   answer
//               themselves, on the same W processors, by turns: medians of ratios. Batches of 256 and 1024.
//   single      one synchronous question through the mailbox, both sides spinning, against a bare cache line
//               there and back between two processes on the same two processors, and against two pipes.
//   clients     64 clients at once against one: throughput, and how evenly they are served.
//   idle        processor time of a server that nobody asks.
//
// A table for people; --json for programs. Every section runs in a process of its own with its own affinity.
// The scene is a sphere of patches^2 grids of 256 quads inside another, traced at stride 2. Fixed seeds.
#include <fmt/format.h>
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <functional>

#include "bench/oracle/oracle_bench.h"

namespace {

using namespace fr::bench;
using nlohmann::json;

/// Runs `section` in a forked process and returns what it returns; null when it died.
json runApart(const std::function<json()>& section) {
  int ends[2];
  if (::pipe(ends) != 0) return {};
  std::fflush(stdout);
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::close(ends[0]);
    const std::string text = section().dump();
    std::fflush(stdout);
    for (size_t done = 0; done < text.size();) {
      const ssize_t n = ::write(ends[1], text.data() + done, text.size() - done);
      if (n <= 0) ::_exit(1);
      done += size_t(n);
    }
    ::_exit(0);
  }
  ::close(ends[1]);
  std::string text;
  char buffer[4096];
  for (ssize_t n; (n = ::read(ends[0], buffer, sizeof buffer)) > 0;) text.append(buffer, size_t(n));
  ::close(ends[0]);
  ::waitpid(pid, nullptr, 0);
  return json::parse(text, nullptr, false);
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  std::string file, only;
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    if (a.starts_with("--rays=")) {
      options.rays = std::stoul(a.substr(7));
    } else if (a.starts_with("--patches=")) {
      options.patches = uint32_t(std::stoul(a.substr(10)));
    } else if (a.starts_with("--repeats=")) {
      options.repeats = std::stoi(a.substr(10));
    } else if (a.starts_with("--width=")) {
      options.width = std::stoi(a.substr(8));
    } else if (a.starts_with("--json=")) {
      file = a.substr(7);
    } else if (a.starts_with("--only=")) {
      only = a.substr(7);
    } else {
      fmt::print(stderr,
                 "usage: oracle_bench [--json=FILE] [--only=throughput|single|clients|idle] [--rays=65536] "
                 "[--patches=64] [--repeats=7] [--width=W]\n");
      return 2;
    }
  }
  json all;
  all["processors"] = processorCount();
  all["scheduler"] = ::sched_getscheduler(0) == SCHED_OTHER ? "other" : "realtime";
  const auto wanted = [&](const char* name) { return only.empty() || only == name; };
  if (wanted("throughput")) {
    for (int width = 1; width <= processorCount(); width *= 2) {
      if (options.width && width != options.width) continue;
      all["throughput"].push_back(runApart([&] { return benchThroughput(options, width); }));
    }
  }
  if (wanted("single")) all["single"] = runApart([&] { return benchSingleRays(options); });
  if (wanted("clients")) all["clients"] = runApart([&] { return benchManyClients(options); });
  if (wanted("idle")) all["idle"] = runApart([&] { return benchIdleServer(options); });
  if (!file.empty()) {
    std::ofstream out(file);
    out << all.dump(2) << '\n';
    if (!out) {
      fmt::print(stderr, "oracle_bench: cannot write {}\n", file);
      return 1;
    }
  }
  return 0;
}
