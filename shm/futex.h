// Sleeping and waking across processes.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>

#include "shm/cache_line.h"

namespace fr::shm {

// std::atomic::wait must not be used on shared memory: libstdc++ waits on process-private futexes, and the
// other process never wakes us.
static_assert(std::atomic<uint32_t>::is_always_lock_free && sizeof(std::atomic<uint32_t>) == 4);
static_assert(std::atomic<uint64_t>::is_always_lock_free && sizeof(std::atomic<uint64_t>) == 8);

enum class FutexResult { kWoken, kValueDiffers, kTimedOut, kInterrupted };

/// Sleeps while `word` == expected, at most `timeout` (negative: for as long as it takes, without a timer).
/// May return kWoken without a wake: re-check what you wait for.
FutexResult futexWait(const std::atomic<uint32_t>& word, uint32_t expected, std::chrono::nanoseconds timeout);
/// Wakes at most `count` sleepers of any process; returns how many.
int futexWake(const std::atomic<uint32_t>& word, int count);

/// What it costs to wake a sleeping thread here, measured once per process on first use (about 2 ms), in
/// nanoseconds, between 2 us and 100 us; 0 when there is one processor only and spinning cannot help.
/// Thread-safe.
std::chrono::nanoseconds wakeCost();

/// Everything before it, in this thread, comes before everything after it in the one order that all
/// sequentially consistent operations and fences of all processes agree about.
inline void fullFence() {
#if defined(__SANITIZE_THREAD__)
  // ThreadSanitizer does not know fences; what it needs to see are releases and acquires.
  static thread_local std::atomic<uint32_t> word{0};
  word.fetch_add(1, std::memory_order_seq_cst);
#else
  std::atomic_thread_fence(std::memory_order_seq_cst);
#endif
}

/// A parking place in shared memory: two words of it. Several processes may sleep there and ring.
///
/// Ringer: publish with a release store, then ring().     Sleeper: announce, look again (seq_cst loads),
/// sleep. SYNC POINT 1: the full fence in ring(), between the ringer's publication and its load of
/// `sleepers`, pairs with the sleeper's seq_cst increment of `sleepers` and its seq_cst re-check: in the
/// single total order either the ringer sees the sleeper or the sleeper sees the publication. No wake-up is
/// lost, and nobody pays a system call while nobody sleeps. Not a seq_cst store: that would hold the line
/// that it writes until all earlier stores are out, and a reader who spins on it takes the line away in
/// between. A sleeper that is woken is taken off `sleepers` by whoever woke it, one that returns otherwise
/// takes itself off: the kernel says which (FUTEX_WAKE counts exactly those that FUTEX_WAIT returns 0 to).
/// Crash: a process killed asleep leaves `sleepers` too high: later rings cost a needless system call.
/// Hostile values: whoever is waited for rings in vain. So a waiter that cannot trust everybody who can write
/// here wakes those whom it waits for whatever `sleepers` says, now and then (ClientChannel does, once per
/// WaitPolicy::recheck).
struct Doorbell {
  std::atomic<uint32_t>& sequence;  // what the sleepers sleep on; changes with each ring
  std::atomic<uint32_t>& sleepers;  // asleep or about to be, and not woken yet

  /// Wakes up to `count` sleepers, if there are any. Call after a release publication.
  void ring(int count) const;
  /// Wakes up to `count` of those who sleep here, whatever `sleepers` says. A system call. Returns how many.
  int wake(int count) const;
};

/// The words of one doorbell, alone on their lines.
struct alignas(kCacheLine) DoorbellLine {
  std::atomic<uint32_t> sequence;
  std::atomic<uint32_t> sleepers;
  uint8_t pad[kCacheLine - 8];

  Doorbell bell() { return {sequence, sleepers}; }
};
static_assert(sizeof(DoorbellLine) == kCacheLine);

/// Doorbells of the threads of one server, by the processor on which they went to sleep: whoever rings wakes
/// the one who slept nearest. SYNC POINT 1 holds for each of them, and so for all: a ringer that finds every
/// `sleepers` 0 is seen by everybody who announces itself later.
struct alignas(kCacheLine) DoorbellRow {
  static constexpr uint32_t kBells = 16;
  std::atomic<uint32_t> sleepers[kBells];  // on a line of their own: ringing reads all of them
  std::atomic<uint32_t> sequence[kBells];

  Doorbell bell(uint32_t processor) { return {sequence[processor % kBells], sleepers[processor % kBells]}; }
  /// Wakes one sleeper, if there is any. Call after a release publication.
  void ringOne(uint32_t processor);
  /// Wakes everybody, whatever `sleepers` says. kBells system calls.
  void wakeAll();
};
static_assert(sizeof(DoorbellRow) == kCacheLine);

/// The processor on which the caller runs just now, by its number; 0 if that is unknown. A few nanoseconds.
uint32_t currentProcessor();

/// How long waits spin and how often they look after the peer.
struct WaitPolicy {
  std::chrono::nanoseconds spin{-1};  // -1: wakeCost()
  /// A sleep is cut after this to re-check the peer's life; negative: never, no timer runs.
  std::chrono::nanoseconds recheck{20000000};
};

/// Whether spinning has paid lately, of one waiter: private to a thread, never in shared memory. A spin that
/// ends with what was waited for saves a wake-up; one that ends asleep is lost, and on a busy machine it was
/// taken from whoever was to do the work. So a waiter spins for the price of a wake-up as long as that
/// succeeds at least every other time, and for a sixteenth of it otherwise; now and then it tries again.
class SpinHistory {
 public:
  std::chrono::nanoseconds budget(std::chrono::nanoseconds full) {
    return score_ > 0 || ++waits_ % kTryAgain == 0 ? full : full / kImpatient;
  }
  void note(bool succeeded) { score_ = std::clamp(score_ + (succeeded ? 1 : -1), -kMemory, kMemory); }

 private:
  static constexpr int kMemory = 8;
  static constexpr uint32_t kTryAgain = 32;
  static constexpr int kImpatient = 16;
  int score_ = 2;
  uint32_t waits_ = 0;
};

inline constexpr int kSpinsBeforeTheClock = 16;

enum class WaitOutcome { kReady, kPeerGone, kTimedOut };

/// Spins for policy.spin, then parks at `bell`, until ready() is true (kReady); alive() false ends the wait
/// (kPeerGone, after one more look at ready()), as does `timeout` (< 0: none; precision policy.recheck).
/// ready() must read what the ringer publishes with seq_cst loads (SYNC POINT 1); it is called often. alive()
/// is called once per policy.recheck at most, never while spinning. `history`: of this waiter, or nullptr:
/// spin in full.
template <class Ready, class Alive>
WaitOutcome waitAtDoorbell(Doorbell bell, const WaitPolicy& policy, std::chrono::nanoseconds timeout,
                           Ready&& ready, Alive&& alive, SpinHistory* history = nullptr) {
  using Clock = std::chrono::steady_clock;
  if (ready()) return WaitOutcome::kReady;
  std::chrono::nanoseconds spin = policy.spin.count() < 0 ? wakeCost() : policy.spin;
  if (history) spin = history->budget(spin);
  // Who answers a small question needs less time than a look at the clock or two.
  for (int i = 0; i < kSpinsBeforeTheClock && spin.count() > 0; ++i) {
    cpuRelax();
    if (!ready()) continue;
    if (history) history->note(true);
    return WaitOutcome::kReady;
  }
  const Clock::time_point start = Clock::now();
  Clock::time_point lookedAfterPeer = start;
  while (Clock::now() - start < spin) {
    for (int i = 0; i < 32; ++i) {
      cpuRelax();
      if (!ready()) continue;
      if (history) history->note(true);
      return WaitOutcome::kReady;
    }
  }
  if (history) history->note(false);
  const bool looks = policy.recheck.count() >= 0;
  const std::chrono::nanoseconds nap = looks ? policy.recheck : timeout;
  for (;;) {
    // SYNC POINT 1, sleeper's side (see Doorbell).
    bell.sleepers.fetch_add(1, std::memory_order_seq_cst);
    const uint32_t seen = bell.sequence.load(std::memory_order_seq_cst);
    const bool now = ready();
    // Whoever wakes us has taken us off the list.
    if (now || futexWait(bell.sequence, seen, nap) != FutexResult::kWoken)
      bell.sleepers.fetch_sub(1, std::memory_order_seq_cst);
    if (now || ready()) return WaitOutcome::kReady;
    if (!looks && timeout.count() < 0) continue;
    const Clock::time_point t = Clock::now();
    if (looks && t - lookedAfterPeer >= policy.recheck) {
      lookedAfterPeer = t;
      if (!alive()) return ready() ? WaitOutcome::kReady : WaitOutcome::kPeerGone;
    }
    if (timeout.count() >= 0 && t - start >= timeout) return WaitOutcome::kTimedOut;
  }
}

}  // namespace fr::shm
