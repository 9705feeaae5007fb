#include <fmt/format.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <new>
#include <thread>

#include "bench/oracle/oracle_bench.h"
#include "shm/channel.h"
#include "shm/channel_server.h"

namespace fr::bench {
namespace {

/// A word there and back between two processes, both spinning: the floor. The partner looks at its word only
/// while a measurement runs and sleeps otherwise.
class CacheLine {
 public:
  CacheLine() {
    void* p = ::mmap(nullptr, sizeof(Words), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    w_ = new (p) Words{};
    pid_ = ::fork();
    if (pid_ == 0) {
      for (uint32_t i = 1;; ++i) {
        while (w_->ping.value.load(std::memory_order_acquire) != i) {
          if (w_->active.value.load(std::memory_order_relaxed)) {
            shm::cpuRelax();
          } else {
            ::usleep(200);
          }
        }
        w_->pong.value.store(i, std::memory_order_release);
      }
    }
  }
  ~CacheLine() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
    ::munmap(static_cast<void*>(w_), sizeof(Words));
  }
  CacheLine(const CacheLine&) = delete;
  CacheLine& operator=(const CacheLine&) = delete;
  int pid() const { return pid_; }
  void active(bool on) { w_->active.value.store(on, std::memory_order_relaxed); }
  void trip() {
    w_->ping.value.store(++count_, std::memory_order_release);
    while (w_->pong.value.load(std::memory_order_acquire) != count_) shm::cpuRelax();
  }

 private:
  struct Words {
    shm::LonelyWord<uint32_t> ping, pong, active;
  };
  Words* w_;
  pid_t pid_;
  uint32_t count_ = 0;
};

/// Ticks of a clock that costs next to nothing to read.
uint64_t ticks() {
#if defined(__x86_64__)
  return __builtin_ia32_rdtsc();
#else
  return uint64_t(seconds() * 1e9);
#endif
}

/// The same when all that comes before has been done.
uint64_t ticksAfter() {
#if defined(__x86_64__)
  unsigned processor;
  return __builtin_ia32_rdtscp(&processor);
#else
  return ticks();
#endif
}

/// A server's end of a channel in a process of its own, as in the real one, which also adds up how long
/// tracing takes it: what is left of a round trip is the price of the mailbox.
class TimedServer : public shm::ChannelHandler {
 public:
  explicit TimedServer(RayOracle& tracing)
      : tracing_(tracing),
        server_(std::move(*shm::ChannelServer::create(*this))),
        channel_(std::move(*shm::ClientChannel::create(server_->board(), {.config = {1, 128}}))) {
    (void)*server_->add(std::move(*channel_.share()));
    void* p = ::mmap(nullptr, sizeof *traced_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    traced_ = new (p) std::atomic<uint64_t>(0);
    (void)shm::wakeCost();  // measured here rather than in both
    pid_ = ::fork();
    if (pid_ == 0) {
      server_->run();
      ::_exit(0);
    }
  }
  ~TimedServer() override {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
    ::munmap(static_cast<void*>(traced_), sizeof *traced_);
  }
  int pid() const { return pid_; }
  void ask(const SingleRayMail& m) {
    std::array<std::byte, shm::kMailBytes> answer;
    SingleAnswer a;
    const auto n = channel_.call(singleRayBytes(m), answer);
    if (!n || !readSingleAnswer(std::span(answer).first(*n), RayKind(m.ray.kind), a)) std::abort();
  }
  /// Ticks spent tracing so far.
  uint64_t traced() const { return traced_->load(std::memory_order_relaxed); }

  shm::Served serveBlock(const shm::ServedBlock&) override { return shm::Served::kFailed; }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, shm::kMailBytes> bytes) override {
    SingleRayMail m;
    if (!readSingleRay(request, m)) return -1;
    const uint64_t t0 = ticks();
    const auto a = tracing_.ask(m);
    took_ = ticksAfter() - t0;
    if (!a) return -1;
    const size_t size = singleAnswerBytes(RayKind(m.ray.kind));
    std::memcpy(bytes.data(), &*a, size);
    traced_->store(traced_->load(std::memory_order_relaxed) + took_, std::memory_order_relaxed);
    return int(size);
  }
  void channelEnded(uint64_t, void*, const Error*) override {}

 private:
  RayOracle& tracing_;
  std::unique_ptr<shm::ChannelServer> server_;
  shm::ClientChannel channel_;
  std::atomic<uint64_t>* traced_ = nullptr;
  uint64_t took_ = 0;
  pid_t pid_ = -1;
};

/// The way of 1998: two bytes and twelve floats down one pipe, seven floats up another, both sides sleeping.
class TwoPipes {
 public:
  explicit TwoPipes(RayOracle& answers) {
    int there[2], back[2];
    if (::pipe(there) != 0 || ::pipe(back) != 0) std::abort();
    pid_ = ::fork();
    if (pid_ == 0) {
      ::close(there[1]), ::close(back[0]);
      char command[2];
      float in[12];
      while (readAll(there[0], command, sizeof command) && readAll(there[0], in, sizeof in)) {
        SingleRayMail m;
        for (int c = 0; c < 3; ++c) m.ray.origin[c] = in[c], m.ray.direction[c] = in[3 + c];
        m.ray.kind = uint8_t(RayKind::kHitTest);
        const SingleAnswer a = *answers.ask(m);
        const float out[7] = {a.hitDistance, a.hitP[0], a.hitP[1], a.hitP[2],
                              a.hitN[0],     a.hitN[1], a.hitN[2]};
        if (::write(back[1], out, sizeof out) != ssize_t(sizeof out)) break;
      }
      ::_exit(0);
    }
    ::close(there[0]), ::close(back[1]);
    down_ = there[1], up_ = back[0];
  }
  ~TwoPipes() {
    ::close(down_), ::close(up_);
    ::waitpid(pid_, nullptr, 0);
  }
  TwoPipes(const TwoPipes&) = delete;
  TwoPipes& operator=(const TwoPipes&) = delete;
  int pid() const { return pid_; }
  void ask(const SingleRayMail& m) {
    float out[12] = {}, in[7];
    for (int c = 0; c < 3; ++c) out[c] = m.ray.origin[c], out[3 + c] = m.ray.direction[c];
    if (::write(down_, "bh", 2) != 2 || ::write(down_, out, sizeof out) != ssize_t(sizeof out) ||
        !readAll(up_, in, sizeof in))
      std::abort();
  }

 private:
  static bool readAll(int fd, void* to, size_t size) {
    for (size_t done = 0; done < size;) {
      const ssize_t n = ::read(fd, static_cast<char*>(to) + done, size - done);
      if (n <= 0) return false;
      done += size_t(n);
    }
    return true;
  }
  int down_, up_;
  pid_t pid_;
};

/// Nanoseconds of f() each, best of many short series: a series that nobody disturbed.
template <class F>
double quickest(int series, int length, F&& f) {
  double best = 1e9;
  for (int s = 0; s < series; ++s) {
    const double t0 = seconds();
    for (int i = 0; i < length; ++i) f(i);
    best = std::min(best, (seconds() - t0) / length);
  }
  return best * 1e9;
}

}  // namespace

nlohmann::json benchSingleRays(const Options& options) {
  if (processorCount() < 2) {
    fmt::print("single rays: needs two processors\n");
    return {};
  }
  Scene scene(options, 1);
  auto here = std::move(scene.inproc->connect()).value(), there = std::move(scene.shm->connect()).value();
  // Rays that leave the scene behind them are over at once; the others hit the outer sphere.
  std::vector<SingleRayMail> hits, misses;
  for (const auto& r : makeRays(64, false, RayKind::kHitTest, 3)) {
    hits.push_back(testing::mailOf(r, RayKind::kHitTest));
    hits.back().start = {};
    misses.push_back(hits.back());
    misses.back().ray.origin[0] += 100, misses.back().ray.direction[0] = 1;
  }
  for (int i = 0; i < 2000; ++i) {
    if (!here->ask(hits[size_t(i) % 64]) || !there->ask(hits[size_t(i) % 64])) std::abort();
  }
  TwoPipes pipes(*here);
  CacheLine line;
  TimedServer timed(*here);
  pinTo(0, 0), pinTo(scene.shm->processId(), 1), pinTo(pipes.pid(), 1), pinTo(line.pid(), 1),
      pinTo(timed.pid(), 1);
  const uint64_t tick0 = ticks();
  const double second0 = seconds();
  ::usleep(50000);
  const double nsPerTick = (seconds() - second0) * 1e9 / double(ticks() - tick0);

  nlohmann::json out;
  fmt::print("single synchronous rayhittest, ns, two processors, quickest of short series, by turns\n");
  fmt::print("  {:8} {:>10} {:>8} {:>8} {:>13} {:>7} {:>9} {:>9}\n", "rays", "cache line", "inproc",
             "mailbox", "without rays", "ratio", "pipes", "speed-up");
  for (const bool hit : {false, true}) {
    const auto& rays = hit ? hits : misses;
    std::vector<double> bare, trace, mail, pipe, ratio, over;
    // Virtual processors move about on their host, and a line costs three times as much from one second to
    // the next: what is compared is measured side by side, and the median is over the comparisons.
    const auto trips = [&] {
      line.active(true);
      const double ns = quickest(6, 200, [&](int) { line.trip(); });
      line.active(false);
      return ns;
    };
    for (int repeat = 0; repeat < 8 * options.repeats; ++repeat) {
      const double before = trips();
      double least = 1e9;
      for (int series = 0; series < 12; ++series) {
        const uint64_t traced = timed.traced();
        const double t0 = seconds();
        for (size_t i = 0; i < 64; ++i) timed.ask(rays[i]);
        const double all = (seconds() - t0) * 1e9;
        least = std::min(least, (all - double(timed.traced() - traced) * nsPerTick) / 64);
      }
      const double after = trips();
      if (std::max(before, after) < 1.2 * std::min(before, after))
        ratio.push_back(2 * least / (before + after));
      bare.push_back((before + after) / 2), over.push_back(least);
      trace.push_back(quickest(8, 64, [&](int i) { (void)here->ask(rays[size_t(i) % 64]); }));
      mail.push_back(quickest(12, 64, [&](int i) { (void)there->ask(rays[size_t(i) % 64]); }));
    }
    for (int repeat = 0; repeat < options.repeats; ++repeat)
      pipe.push_back(quickest(5, 128, [&](int i) { pipes.ask(rays[size_t(i) % 64]); }));
    fmt::print("  {:8} {:10.0f} {:8.0f} {:8.0f} {:13.0f} {:7.2f} {:9.0f} {:9.1f}\n", hit ? "hits" : "misses",
               median(bare), median(trace), median(mail), median(over), median(ratio), median(pipe),
               median(pipe) / median(mail));
    out[hit ? "hits" : "misses"] = {{"cacheLineNs", median(bare)},
                                    {"inprocNs", median(trace)},
                                    {"mailboxNs", median(mail)},
                                    {"mailboxWithoutRaysNs", median(over)},
                                    {"ratioToCacheLine", median(ratio)},
                                    {"pipeNs", median(pipe)},
                                    {"pipeOverMailbox", median(pipe) / median(mail)}};
  }
  return out;
}

}  // namespace fr::bench
