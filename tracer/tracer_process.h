// The tracer process as the renderer sees it: starting it, talking to it, starting it again when it died.
// Internal to tracer/.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "shm/channel.h"
#include "shm/hang_up.h"
#include "shm/peer.h"
#include "tracer/server_messages.h"
#include "tracer/shm_oracle.h"

namespace fr::tracer {

/// So many tracers in a row may die without answering anything; the last one is not replaced.
inline constexpr int kMostDeathsInARow = 5;

/// One tracer process after the other. Each has a number, its *life*; a channel belongs to one life.
///
/// Thread safety: everything. Nobody waits for the mutex longer than starting a tracer takes.
/// Crash of the tracer: its socket hangs up, and a thread that waits for that alone ends the waits of all
/// lines at once (channels look themselves as well, once a second). Whoever notices first (openAfter) buries
/// it, warns once, and starts the next one after a pause that grows with the deaths in a row. After
/// kMostDeathsInARow deaths without an answer in between, or when a tracer says that it must fail (no memory,
/// a scene that it cannot open, another build), there is one error for good. Crash of this process: the
/// tracer sees its socket hang up and ends at once.
class TracerProcess {
 public:
  struct Line {
    std::shared_ptr<shm::ClientChannel> channel;
    uint64_t life = 0;
  };

  /// `cache` must outlive the object. Nothing is started yet.
  TracerProcess(cache::SceneCache& cache, ShmOracleService::Options options);
  /// Says goodbye; the child's destructor sees to the rest.
  ~TracerProcess();

  /// A channel to the tracer, which is started if none runs. Errors: for good.
  Result<Line> open();
  /// The same after a channel of `life` broke with `why`: that tracer is finished off if it still lives.
  Result<Line> openAfter(uint64_t life, const Error& why);
  /// The tracer `life` has answered something. Lock-free.
  void noteAnswer(uint64_t life) { answeredLife_.store(life, std::memory_order_relaxed); }

  std::optional<TracerStatistics> statistics();
  /// Process id of the running tracer, also while it starts; 0 when there is none. Lock-free.
  int processId() const;
  /// Tracers started after the first one.
  uint64_t restarts() const { return restarts_.load(std::memory_order_relaxed); }

 private:
  Result<ReceivedMessage> converse(MessageType type, MessageType wanted, std::span<const std::byte> body = {},
                                   std::string_view text = {}, std::span<const int> fds = {});
  Error fatal(Error e);
  Result<Line> openLocked();
  Result<void> start();
  Result<void> introduce();
  Result<Line> addChannel();
  Result<void> bury(const std::string& why);
  std::string howItEnded(const std::string& why);

  cache::SceneCache& cache_;
  const ShmOracleService::Options options_;
  mutable std::mutex mutex_;                  // all below but the atomics
  std::shared_ptr<shm::ChildProcess> child_;  // channels hold it too: they ask whether it lives
  std::shared_ptr<shm::ServerBoard> board_;   // set when the tracer is ready
  struct Channels {                           // of this tracer; with a mutex of their own
    std::mutex mutex;
    std::vector<std::weak_ptr<shm::ClientChannel>> list;
    bool gone = false;
  };
  std::shared_ptr<Channels> channels_;
  std::unique_ptr<shm::HangUpWatch> watch_;  // last to come, first to go
  uint64_t life_ = 0;
  uint64_t outOfMemoryKills_ = 0;  // of the machine when this tracer was started
  int deathsInARow_ = 0;
  std::optional<Error> failed_;  // for good
  std::atomic<uint64_t> answeredLife_{0};
  std::atomic<int> pid_{0};
  std::atomic<uint64_t> restarts_{0};
};

}  // namespace fr::tracer
