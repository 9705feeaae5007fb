#include "shm/futex.h"

#include <linux/futex.h>
#include <sched.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <system_error>
#include <thread>

namespace fr::shm {
namespace {

using std::chrono::nanoseconds;

const uint32_t* address(const std::atomic<uint32_t>& word) {
  return reinterpret_cast<const uint32_t*>(&word);
}

int usableProcessors() {
  cpu_set_t set;
  CPU_ZERO(&set);
  // With more processors than a cpu_set_t holds the call fails: then there are plenty.
  return ::sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 2;
}

/// Half the median of futex round trips between two threads that sleep a little in between, as waits in a
/// renderer do.
nanoseconds measureWakeCost() {
  if (usableProcessors() < 2) return nanoseconds(0);
  constexpr int kRounds = 24;
  constexpr nanoseconds kFallback{20000};
  std::atomic<uint32_t> ping{0};
  std::atomic<uint32_t> pong{0};
  std::array<nanoseconds, kRounds> trip;
  auto waitFor = [](const std::atomic<uint32_t>& word, uint32_t value) {
    for (uint32_t v; (v = word.load(std::memory_order_acquire)) != value;) {
      futexWait(word, v, std::chrono::milliseconds(10));
    }
  };
  try {
    std::thread partner([&] {
      for (uint32_t i = 1; i <= kRounds; ++i) {
        waitFor(ping, i);
        pong.store(i, std::memory_order_release);  // pairs with the acquire load in waitFor
        futexWake(pong, 1);
      }
    });
    for (uint32_t i = 1; i <= kRounds; ++i) {
      const auto start = std::chrono::steady_clock::now();
      ping.store(i, std::memory_order_release);  // pairs with the acquire load in waitFor
      futexWake(ping, 1);
      waitFor(pong, i);
      trip[i - 1] = std::chrono::steady_clock::now() - start;
    }
    partner.join();
  } catch (const std::system_error&) {
    return kFallback;  // no thread to be had
  }
  std::nth_element(trip.begin(), trip.begin() + kRounds / 2, trip.end());
  return std::clamp<nanoseconds>(trip[kRounds / 2] / 2, nanoseconds(2000), nanoseconds(100000));
}

}  // namespace

FutexResult futexWait(const std::atomic<uint32_t>& word, uint32_t expected, nanoseconds timeout) {
  timespec t{};
  const int64_t ns = timeout.count();
  t.tv_sec = time_t(ns / 1000000000);
  t.tv_nsec = long(ns % 1000000000);
  // Without FUTEX_PRIVATE_FLAG: the word may be mapped at another address by another process.
  if (::syscall(SYS_futex, address(word), FUTEX_WAIT, expected, ns < 0 ? nullptr : &t, nullptr, 0) == 0)
    return FutexResult::kWoken;
  switch (errno) {
    case EAGAIN:
      return FutexResult::kValueDiffers;
    case ETIMEDOUT:
      return FutexResult::kTimedOut;
    default:
      return FutexResult::kInterrupted;
  }
}

int futexWake(const std::atomic<uint32_t>& word, int count) {
  const long n = ::syscall(SYS_futex, address(word), FUTEX_WAKE, count, nullptr, nullptr, 0);
  return n < 0 ? 0 : int(n);
}

nanoseconds wakeCost() {
  static const nanoseconds cost = measureWakeCost();
  return cost;
}

uint32_t currentProcessor() {
  const int processor = ::sched_getcpu();
  return processor < 0 ? 0 : uint32_t(processor);
}

int Doorbell::wake(int count) const {
  // The change of the word keeps a sleeper that has announced itself but not yet entered the kernel from
  // sleeping.
  sequence.fetch_add(1, std::memory_order_seq_cst);
  const int woken = futexWake(sequence, count);
  // Whoever was woken is no sleeper any more, though it may have to wait for a processor: further
  // publications until then need no call.
  if (woken > 0) sleepers.fetch_sub(uint32_t(woken), std::memory_order_seq_cst);
  return woken;
}

void Doorbell::ring(int count) const {
  fullFence();  // SYNC POINT 1, ringer's side
  if (sleepers.load(std::memory_order_relaxed) != 0) wake(count);
}

void DoorbellRow::ringOne(uint32_t processor) {
  fullFence();  // SYNC POINT 1, ringer's side
  for (uint32_t i = 0; i < kBells; ++i) {
    const Doorbell b = bell(processor + i);
    if (b.sleepers.load(std::memory_order_relaxed) != 0 && b.wake(1) > 0) return;
  }
}

void DoorbellRow::wakeAll() {
  for (uint32_t i = 0; i < kBells; ++i) bell(i).wake(INT_MAX);
}

}  // namespace fr::shm
