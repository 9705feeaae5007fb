// The server's end of the ring transport: many channels, a few threads, one doorbell.
#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "base/error.h"
#include "shm/channel_memory.h"

namespace fr::shm {

class ServerChannel;  // private to channel_server.cpp

/// A block that a handler holds. Copyable; keeps the memory mapped even when the channel is removed
/// meanwhile.
struct ServedBlock {
  uint64_t channelId = 0;
  void* user = nullptr;  // what was given to add()
  uint32_t index = 0;
  uint64_t use = 0;            // which submission of that block this is
  std::span<std::byte> bytes;  // the client's memory: it may change while you read. Copy what you check.
  std::shared_ptr<ServerChannel> channel;
  uint32_t behind = 0;  // blocks that waited behind this one in the channel's ring
};

enum class Served {
  kDone,      // the answer stands in the block
  kFailed,    // the client gets BlockStatus::kFailed
  kDeferred,  // the handler will call ChannelServer::complete() later, from any thread
};

/// What the server does with what arrives. Called from the threads in ChannelServer::run(), several at once.
class ChannelHandler {
 public:
  virtual ~ChannelHandler() = default;
  virtual Served serveBlock(const ServedBlock& block) = 0;
  /// `request` is a private copy. Write at most kMailBytes to `answer` and return how many; negative: failed.
  /// An answer cannot be deferred.
  virtual int serveMail(uint64_t channelId, void* user, std::span<const std::byte> request,
                        std::span<std::byte, kMailBytes> answer) = 0;
  /// The answer of the serveMail() that this thread called last is on its way: time for what nobody waits
  /// for.
  virtual void mailAnswered() {}
  /// A channel has been taken out of service: by its client's orderly end (no error), or because it sent
  /// something impossible. Called once per channel, not for those that remove()
  /// takes out. Blocks that are deferred may still be completed; that does nothing then.
  virtual void channelEnded(uint64_t channelId, void* user, const Error* error) = 0;
};

/// Drains many channels from any number of threads, which park at the doorbells of the board, each at that of
/// its processor.
///
/// Whom a thread serves: the channels whose clients last submitted on its own processor, one block each by
/// turns. Their blocks are in this processor's cache; fetching a block from another one costs as much as
/// tracing some of its rays. Channels of other processors are left to the threads there as long as these get
/// on with them; when a thread has nothing to do otherwise, or a channel has not moved for a while, it serves
/// that too, so that no processor idles and nobody starves.
///
/// Thread safety: everything from any thread. A channel's ring is emptied by one thread at a time (a claim
/// flag in private memory, held for the taking out only); blocks of one channel run on several threads at
/// once. Invariants: positions, geometry and "which block is running" are kept in private memory; a block
/// runs at most once per submission, whatever the client writes. A channel with an impossible value is taken
/// out of service with an Error, the others do not notice. A client can waste our time (submitting, ringing)
/// but not stop, crash or read us. Crash of a client: whoever holds the socket to it sees a hang-up and calls
/// remove(); here nobody looks, and a server that sleeps has no timer. Crash of the server: see
/// ClientChannel.
class ChannelServer {
 public:
  /// `spin`: as in WaitPolicy. Errors: kNoMem.
  static Result<std::unique_ptr<ChannelServer>> create(ChannelHandler& handler,
                                                       std::chrono::nanoseconds spin = WaitPolicy{}.spin);
  /// REQUIRES: no thread in run(). Tells all clients that the server has left.
  ~ChannelServer();

  /// Send share() of it to each client.
  const std::shared_ptr<ServerBoard>& board() const { return board_; }

  /// Puts a client's channel into service and returns its id (from 1). Errors as ChannelMemory::attach.
  Result<uint64_t> add(FileDescriptor fd, void* user = nullptr);
  /// Takes a channel out of service. Blocks already running are finished; their answers go nowhere.
  void remove(uint64_t channelId);
  size_t channelCount() const;

  /// Serves until stop(). Call it from each of the server's threads.
  void run();
  /// Serves what is there, without waiting; returns the number of blocks and mails served.
  size_t serveOnce();
  /// Ends all run() calls, after what they are serving. May be called from a signal-free thread only, once or
  /// often.
  void stop();

  /// Ends a deferred block. A second call for the same ServedBlock does nothing.
  void complete(const ServedBlock& block, bool ok);

 private:
  using Channels = std::vector<std::shared_ptr<ServerChannel>>;
  /// What one thread knows.
  struct Thread {
    std::shared_ptr<const Channels> channels;
    uint64_t version = 0;  // of `channels`
    size_t turn = 0;
    struct Progress {  // of another processor's channel, as last seen
      uint64_t head = 0;
      std::chrono::steady_clock::time_point moved;
    };
    std::vector<Progress> progress;  // of each of `channels`
    bool servedMail = false;         // whether what it served last was a mail
  };
  enum class Whose { kNear, kAll };
  static bool isNear(const ServerChannel& channel);
  static bool hasNear(const Channels& channels);
  ChannelServer(ChannelHandler& handler, std::chrono::nanoseconds spin, std::shared_ptr<ServerBoard> board);
  std::shared_ptr<const Channels> channels() const;
  size_t serve(Thread& thread, Whose whose);
  static bool leaveToOthers(const ServerChannel& channel, Thread::Progress& seen);
  bool serveMail(ServerChannel& channel, std::optional<Error>& bad);
  bool serveBlock(const std::shared_ptr<ServerChannel>& channel, std::optional<Error>& bad);
  bool hasWork(const Channels& channels) const;
  void end(ServerChannel& channel, const Error* error);
  void detach(uint64_t channelId);

  ChannelHandler& handler_;
  const std::chrono::nanoseconds spin_;
  std::shared_ptr<ServerBoard> board_;
  mutable std::mutex mutex_;
  std::shared_ptr<const Channels> channels_;  // replaced, never changed
  std::atomic<uint64_t> channelsVersion_{0};
  uint64_t nextId_ = 1;
  std::atomic<bool> stop_{false};
};

}  // namespace fr::shm
