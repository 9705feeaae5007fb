#include "shm/futex.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mman.h>

#include <new>
#include <thread>
#include <vector>

#include "shm/fork_for_test.h"

namespace fr::shm {
namespace {

using std::chrono::milliseconds;

/// A T in memory shared with forked children.
template <class T>
struct SharedObject {
  SharedObject() {
    void* p = ::mmap(nullptr, sizeof(T), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    object = new (p) T{};
  }
  ~SharedObject() { ::munmap(object, sizeof(T)); }
  T* operator->() { return object; }
  T* object;
};

struct Bells {
  DoorbellLine a, b;
  DoorbellRow row;
  std::atomic<uint32_t> x, y;
};

const WaitPolicy kParkAtOnce{std::chrono::nanoseconds(0), milliseconds(20)};
const auto kAlive = [] { return true; };

TEST(Futex, TellsWhyItReturned) {
  std::atomic<uint32_t> word{5};
  EXPECT_EQ(futexWait(word, 4, milliseconds(1000)), FutexResult::kValueDiffers);
  EXPECT_EQ(futexWait(word, 5, milliseconds(1)), FutexResult::kTimedOut);
  EXPECT_EQ(futexWait(word, 5, milliseconds(0)), FutexResult::kTimedOut);
  EXPECT_EQ(futexWake(word, 1), 0);
}

TEST(Futex, WakeCostIsSane) {
  const auto cost = wakeCost();
  EXPECT_GE(cost.count(), 0);
  EXPECT_LE(cost, std::chrono::microseconds(100));
}

/// Two sides that hand a number to and fro: any lost wake-up would only be healed by the time-out of
/// `recheck`, which here is longer than the test may take.
template <class Join>
void pingPong(SharedObject<Bells>& s, uint32_t rounds, const WaitPolicy& policy, Join&& startOther) {
  auto join = startOther([&, rounds, policy] {
    for (uint32_t i = 1; i <= rounds; ++i) {
      waitAtDoorbell(
          s->a.bell(), policy, milliseconds(-1), [&] { return s->x.load(std::memory_order_seq_cst) == i; },
          kAlive);
      s->y.store(i, std::memory_order_seq_cst);
      s->b.bell().ring(1);
    }
    return 0;
  });
  for (uint32_t i = 1; i <= rounds; ++i) {
    s->x.store(i, std::memory_order_seq_cst);
    s->a.bell().ring(1);
    waitAtDoorbell(
        s->b.bell(), policy, milliseconds(-1), [&] { return s->y.load(std::memory_order_seq_cst) == i; },
        kAlive);
  }
  join();
  EXPECT_EQ(s->a.sleepers.load(), 0u);
  EXPECT_EQ(s->b.sleepers.load(), 0u);
}

TEST(Doorbell, NoWakeUpIsLostBetweenThreads) {
  for (const int64_t spin : {0, 300, 3000}) {
    SharedObject<Bells> s;
    pingPong(s, 5000, {std::chrono::nanoseconds(spin), std::chrono::seconds(100)}, [](auto f) {
      auto t = std::make_shared<std::thread>(f);
      return [t] { t->join(); };
    });
  }
}

TEST(Doorbell, NoWakeUpIsLostBetweenProcesses) {
  SharedObject<Bells> s;
  pingPong(s, 5000, {std::chrono::nanoseconds(500), std::chrono::seconds(100)}, [](auto f) {
    const pid_t child = forkChild(f);
    return [child] { EXPECT_EQ(joinChild(child), 0); };
  });
}

TEST(Doorbell, RingsAsManyAsAsked) {
  SharedObject<Bells> s;
  std::atomic<int> awake{0};
  std::vector<std::thread> sleepers;
  sleepers.reserve(4);
  for (int i = 0; i < 4; ++i) {
    sleepers.emplace_back([&] {
      waitAtDoorbell(
          s->a.bell(), {std::chrono::nanoseconds(0), std::chrono::seconds(100)}, milliseconds(-1),
          [&] { return s->x.load(std::memory_order_seq_cst) == 1; }, kAlive);
      ++awake;
    });
  }
  while (s->a.sleepers.load() < 4) std::this_thread::yield();
  s->x.store(1, std::memory_order_seq_cst);
  s->a.bell().ring(100);
  for (auto& t : sleepers) t.join();
  EXPECT_EQ(awake, 4);
}

TEST(Doorbell, WakingNeedsNoSleeperOnTheList) {
  SharedObject<Bells> s;
  std::thread sleeper([&] {
    waitAtDoorbell(
        s->row.bell(3), {std::chrono::nanoseconds(0), milliseconds(-1)}, milliseconds(-1),
        [&] { return s->x.load(std::memory_order_seq_cst) == 1; }, kAlive);
  });
  while (s->row.bell(3).sleepers.load() == 0) std::this_thread::yield();
  // Somebody lies about it.
  s->row.bell(3).sleepers.store(0);
  s->x.store(1, std::memory_order_release);
  s->row.ringOne(0);
  s->row.wakeAll();
  sleeper.join();
}

/// Threads of one server that sleep at bells of different processors, and a ringer that comes from any.
TEST(Doorbell, ARowWakesOneSleeperWhereverItIs) {
  SharedObject<Bells> s;
  constexpr uint32_t kRounds = 3000;
  std::atomic<uint32_t> taken{0};
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 3; ++t) {
    threads.emplace_back([&, t] {
      for (;;) {
        waitAtDoorbell(
            s->row.bell(5 * t), {std::chrono::nanoseconds(200), milliseconds(-1)}, milliseconds(-1),
            [&] { return s->x.load(std::memory_order_seq_cst) != taken.load(std::memory_order_seq_cst); },
            kAlive);
        uint32_t n = taken.load();
        if (n >= kRounds) return;
        if (n < s->x.load() && taken.compare_exchange_strong(n, n + 1)) {
          s->y.store(n + 1, std::memory_order_release);
          s->b.bell().ring(1);
        }
      }
    });
  }
  // Any wake-up that is lost is a hang: nobody has a timer.
  for (uint32_t i = 1; i <= kRounds; ++i) {
    s->x.store(i, std::memory_order_release);
    s->row.ringOne(i * 7);
    waitAtDoorbell(
        s->b.bell(), {std::chrono::nanoseconds(200), milliseconds(-1)}, milliseconds(-1),
        [&] { return s->y.load(std::memory_order_seq_cst) == i; }, kAlive);
  }
  s->x.store(kRounds + 1, std::memory_order_release);
  s->row.wakeAll();
  for (auto& t : threads) t.join();
}

TEST(Doorbell, TimesOut) {
  SharedObject<Bells> s;
  EXPECT_EQ(waitAtDoorbell(
                s->a.bell(), kParkAtOnce, milliseconds(30), [] { return false; }, kAlive),
            WaitOutcome::kTimedOut);
  EXPECT_EQ(s->a.sleepers.load(), 0u);
}

TEST(Doorbell, NoticesAPeerThatDies) {
  SharedObject<Bells> s;
  const pid_t child = forkChild([] {
    for (;;) ::pause();
    return 0;
  });
  std::thread killer([&] {
    while (s->a.sleepers.load() == 0) std::this_thread::yield();
    ::kill(child, SIGKILL);
  });
  int status = 0;
  EXPECT_EQ(waitAtDoorbell(
                s->a.bell(), kParkAtOnce, milliseconds(-1), [] { return false; },
                [&] { return ::waitpid(child, &status, WNOHANG) == 0; }),
            WaitOutcome::kPeerGone);
  killer.join();
}

TEST(Doorbell, AHostileRingerCannotKeepUsFromLookingAfterThePeer) {
  SharedObject<Bells> s;
  std::atomic<bool> stop{false};
  std::thread hostile([&] {
    while (!stop) {
      s->a.sequence.fetch_add(1);
      s->a.sleepers.store(0);
      futexWake(s->a.sequence, 100);
    }
  });
  int looks = 0;
  EXPECT_EQ(waitAtDoorbell(
                s->a.bell(), {std::chrono::nanoseconds(0), milliseconds(5)}, milliseconds(-1),
                [] { return false; }, [&] { return ++looks < 3; }),
            WaitOutcome::kPeerGone);
  stop = true;
  hostile.join();
}

}  // namespace
}  // namespace fr::shm
