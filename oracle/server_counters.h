// Numbers of a running ray server, in a page that others may read while it works.
//
// One piece of sealed memory: a header, gauges, and a row of counters for each thread. A thread alone writes
// its row, with relaxed stores, in cache lines that nobody else writes: counting costs a thread nothing that
// it would notice, and looking costs the server nothing at all. Readers get a read-only descriptor; the
// server decides nothing by what stands here. The numbers of one reading need not belong to one instant.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>

#include "base/error.h"
#include "shm/cache_line.h"
#include "shm/segment.h"

namespace fr {

enum class Counter : uint32_t {
  kTrace,  // rays asked by clients, by RayKind
  kVisibility,
  kHitTest,
  kFullTrace,
  kNestedTrace,  // rays asked by shaders at hits, by RayKind
  kNestedVisibility,
  kNestedHitTest,
  kNestedFullTrace,
  kBlocks,         // blocks answered
  kBlockRays,      // rays in them
  kSingles,        // mailbox questions
  kPipeQueries,    // questions of the 1998 protocol
  kPipeFrames,     // blocks of the framed protocol, also in kBlocks
  kIntersections,  // walks through the tree
  kRejected,       // rays that made no sense
  kHitsShaded,
  kPointsShaded,
  kWaiting,  // blocks that stood behind a block in its ring when it was taken out: divided by kBlocks, the
             // queue's depth
  kBusyNanoseconds,
  kCount
};
inline constexpr uint32_t kCounterCount = uint32_t(Counter::kCount);

enum class Gauge : uint32_t {
  kThreads,
  kClients,   // connected now
  kChannels,  // in service now
  kClientsEver,
  kReady,        // 1: the scene is loaded
  kSceneBytes,   // skeleton, nodes, arena
  kTreeBytes,    // acceleration structure
  kRecordBytes,  // our own records about the grids
  kGridsUsed,    // grids that rays can hit
  kGridsDiced,   // of which this process diced; the others were in the cache already
  kStarted,      // CLOCK_BOOTTIME nanoseconds
  kCount
};
inline constexpr uint32_t kGaugeCount = uint32_t(Gauge::kCount);

/// One reading. Fixed layout: it travels between processes.
struct RayServerNumbers {
  std::array<uint64_t, kCounterCount> counter{};
  std::array<uint64_t, kGaugeCount> gauge{};
  int32_t processId = 0;
  uint32_t reserved = 0;

  uint64_t operator[](Counter c) const { return counter[size_t(c)]; }
  uint64_t operator[](Gauge g) const { return gauge[size_t(g)]; }
};

/// One thread's row. Only its thread adds.
class alignas(shm::kCacheLine) CounterRow {
 public:
  void add(Counter c, uint64_t n) {
    std::atomic<uint64_t>& w = words_[size_t(c)];
    w.store(w.load(std::memory_order_relaxed) + n, std::memory_order_relaxed);
  }
  uint64_t read(Counter c) const { return words_[size_t(c)].load(std::memory_order_relaxed); }

 private:
  std::atomic<uint64_t> words_[32] = {};
};
static_assert(kCounterCount <= 32 && sizeof(CounterRow) == 256);

/// The server's side. Thread safety: row() and set() from any thread, a row belongs to one.
class ServerCounters {
 public:
  static constexpr uint32_t kMostRows = 320;
  /// Errors: kNoMem, kSystem.
  static Result<std::unique_ptr<ServerCounters>> create();
  /// A row that no other thread has; the last one is shared when all are taken (counts may then be lost).
  /// Rows are not given back: their counts stay.
  CounterRow& row();
  void set(Gauge g, uint64_t value);
  RayServerNumbers read() const;
  /// A descriptor to send. Read-only.
  Result<shm::FileDescriptor> share() const;

 private:
  ServerCounters() = default;
  shm::Segment memory_;
  std::atomic<uint32_t> used_{0};
};

/// A reader's side. Thread-safe.
class CounterReader {
 public:
  /// Errors: kVersion (another build), kBadFile (no counters, or memory that could shrink), kNoMem.
  static Result<CounterReader> attach(shm::FileDescriptor fd);
  RayServerNumbers read() const;

 private:
  explicit CounterReader(shm::Segment memory) : memory_(std::move(memory)) {}
  shm::Segment memory_;
};

}  // namespace fr
