// The ray server's end of a pipe: queries of 1998 and frames from one descriptor, answers to another.
#pragma once

#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "oracle/pipe_codec.h"
#include "oracle/server_counters.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

/// Reads in run(); queries of 1998 and small frames are answered right there, larger frames by threads that
/// start with the first of them. Greets before the scene is loaded; questions wait for it. Thread safety:
/// run() from one thread; open(), refuse() and stop() from any.
class PipeSession {
 public:
  struct Options {
    int input = -1, output = -1;  // stay the caller's
    int stop = -1;                // a descriptor that becomes readable when run() shall end
    int threads = 1;
    bool jitterTimes = false;  // queries of 1998 get a time inside the shutter
  };
  PipeSession(const Options& options, ServerCounters& counters);
  ~PipeSession();

  /// Reads until the end of the input, an error, or stop. What was read is answered. Errors: kBadFile (what
  /// came is no ray query; the client was told if it speaks frames), kSystem.
  Result<void> run();
  /// The scene is there. `tracer` must live until the session ends.
  void open(RayTracer& tracer, const RaySceneInfo& info);
  /// There will be no scene.
  void refuse(const Error& why);
  /// True once anything has come: this is a client and not an idle descriptor.
  bool used() const { return used_.load(std::memory_order_relaxed); }

 private:
  struct Job {
    uint32_t id;
    std::vector<std::byte> body;
  };
  Result<void> take(PipeReader::Item& item);
  Result<void> answerQuery(const PipeQuery& query);
  Result<void> answerFrame(PipeFrame& frame);
  Result<void> answerRays(uint32_t id, std::span<const std::byte> body, AnswerThread& thread, CounterRow& row,
                          RayQuery& block);
  bool waitUntilOpen();
  void startThreads();
  void work();
  void finish();
  Result<void> write(std::span<const std::byte> bytes);
  void writeFrame(PipeFrameType type, uint32_t id, std::span<const std::byte> body);

  const Options options_;
  ServerCounters& counters_;
  std::atomic<bool> used_{false};
  std::mutex writing_;
  std::mutex mutex_;  // all below
  std::condition_variable changed_, room_;
  RayTracer* tracer_ = nullptr;
  RaySceneInfo info_;
  std::optional<Error> refused_;
  bool framed_ = false, ended_ = false;
  std::deque<Job> jobs_;
  std::vector<std::thread> threads_;
  // Of the thread in run():
  CounterRow* row_ = nullptr;
  std::unique_ptr<AnswerThread> thread_;
  std::unique_ptr<RayQuery> block_;
};

}  // namespace fr::tracer
