// What a round trip between two processes costs, by each way there is. The server is a forked child, as it is
// in a renderer; wall time on an idle machine is what counts (--benchmark_repetitions=5 shows the spread).
//
//   CacheLine   a word there and back, both sides spinning: the floor
//   Mailbox     ClientChannel::call, 48 bytes there and back
//   Block/n     one block of n bytes submitted and waited for; the server touches its first line only
//   BlocksInFlight/k  k blocks of 64 KiB in flight; time per block
//   Pipe        one byte through a pipe there and back: how the ray servers of the nineties talked
#include <benchmark/benchmark.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <functional>
#include <new>
#include <thread>
#include <vector>

#include "shm/channel.h"
#include "shm/channel_server.h"

namespace {

using namespace fr::shm;

/// A forked process that is killed at the end.
class Child {
 public:
  explicit Child(const std::function<void()>& f) : pid_(::fork()) {
    if (pid_ == 0) {
      f();
      ::_exit(0);
    }
  }
  ~Child() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

 private:
  pid_t pid_;
};

class Echo : public ChannelHandler {
 public:
  Served serveBlock(const ServedBlock& block) override {
    block.bytes[0] = std::byte(uint8_t(block.bytes[0]) + 1);
    return Served::kDone;
  }
  int serveMail(uint64_t, void*, std::span<const std::byte> request,
                std::span<std::byte, kMailBytes> answer) override {
    std::memcpy(answer.data(), request.data(), request.size());
    return int(request.size());
  }
  void channelEnded(uint64_t, void*, const fr::Error*) override {}
};

/// A server process with one channel to it. The channel exists before the fork, so nothing needs to be sent.
class ServedChannel {
 public:
  explicit ServedChannel(ChannelConfig config)
      : server_(std::move(*ChannelServer::create(echo_))),
        channel_(std::move(*ClientChannel::create(server_->board(), {.config = config}))) {
    (void)*server_->add(std::move(*channel_.share()));
    wakeCost();  // measured here rather than in both
    child_ = std::make_unique<Child>([this] { server_->run(); });
  }
  ~ServedChannel() { child_.reset(); }
  ClientChannel& operator*() { return channel_; }

 private:
  Echo echo_;
  std::unique_ptr<ChannelServer> server_;
  ClientChannel channel_;
  std::unique_ptr<Child> child_;
};

void CacheLine(benchmark::State& state) {
  struct Words {
    LonelyWord<uint32_t> ping, pong;
  };
  void* p = ::mmap(nullptr, sizeof(Words), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  auto* w = new (p) Words{};
  {
    const Child child([w] {
      for (uint32_t i = 1;; ++i) {
        while (w->ping.value.load(std::memory_order_acquire) != i) cpuRelax();
        w->pong.value.store(i, std::memory_order_release);
      }
    });
    uint32_t i = 0;
    for (auto _ : state) {
      w->ping.value.store(++i, std::memory_order_release);
      while (w->pong.value.load(std::memory_order_acquire) != i) cpuRelax();
    }
  }
  ::munmap(p, sizeof(Words));
}
BENCHMARK(CacheLine)->UseRealTime();

void Mailbox(benchmark::State& state) {
  ServedChannel served({1, 64});
  std::byte request[48] = {};
  std::byte answer[48];
  for (auto _ : state) {
    if (!(*served).call(request, answer)) state.SkipWithError("no answer");
  }
}
BENCHMARK(Mailbox)->UseRealTime();

void Block(benchmark::State& state) {
  ServedChannel served({1, uint64_t(state.range(0))});
  ClientChannel& c = *served;
  const uint32_t block = *c.acquire();
  const uint32_t list[] = {block};
  for (auto _ : state) {
    if (!c.submit(block) || !c.waitAny(list)) state.SkipWithError("no answer");
  }
}
BENCHMARK(Block)->Arg(64)->Arg(1024)->Arg(65536)->UseRealTime();

void BlocksInFlight(benchmark::State& state) {
  ServedChannel served({uint32_t(state.range(0)), 65536});
  ClientChannel& c = *served;
  std::vector<uint32_t> flying;
  while (const auto b = c.acquire()) {
    (void)c.submit(*b);
    flying.push_back(*b);
  }
  for (auto _ : state) {
    const fr::Result<uint32_t> b = c.waitAny(flying);
    if (!b || !c.submit(*b)) state.SkipWithError("no answer");
  }
}
BENCHMARK(BlocksInFlight)->Arg(2)->Arg(4)->Arg(8)->UseRealTime();

void Pipe(benchmark::State& state) {
  int there[2];
  int back[2];
  if (::pipe(there) != 0 || ::pipe(back) != 0) return state.SkipWithError("no pipes");
  {
    const Child child([&] {
      char c;
      while (::read(there[0], &c, 1) == 1 && ::write(back[1], &c, 1) == 1) {
      }
    });
    char c = 0;
    for (auto _ : state) {
      if (::write(there[1], &c, 1) != 1 || ::read(back[0], &c, 1) != 1) state.SkipWithError("broken pipe");
    }
  }
  for (const int fd : {there[0], there[1], back[0], back[1]}) ::close(fd);
}
BENCHMARK(Pipe)->UseRealTime();

void WakeCost(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(wakeCost());
  state.counters["ns"] = double(wakeCost().count());
}
BENCHMARK(WakeCost);

}  // namespace

BENCHMARK_MAIN();
