// The client's end of the ring transport.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "base/error.h"
#include "shm/channel_memory.h"

namespace fr::shm {

enum class BlockStatus {
  kPending,  // the server has it
  kDone,     // answered: read data(), then release()
  kFailed,   // the server could not answer (its reason is in its own messages); release() or submit again
  kBroken,   // the channel is of no use any more: see error()
};

/// A client thread's channel to a server: blocks of opaque bytes that are submitted, answered in place, and
/// released; and a mailbox for one small synchronous request.
///
///   block = acquire();  fill data(block);  submit(block);  ...  waitAny({block});  read data(block);
///   release(block)
///
/// Thread safety: none; a channel belongs to one thread at a time.
/// Invariants: a block is in the ring at most once; the client never believes a word of shared memory: it
/// keeps its own phase and use count of each block, and any other value than the two or three that the
/// protocol allows makes the channel broken for good, with an Error. Crash of the server: waits end with an
/// Error within about WaitPolicy::recheck, or at once when somebody who knows calls serverIsGone(); a channel
/// is not repaired: make a new one with the next server and submit again (what was asked is still in data():
/// the server cannot write into ChannelConfig::questionBytes; what lies behind it may be anything). Crash of
/// the client: the server notices by its own means (ChannelServer::remove, the alive callback).
class ClientChannel {
 public:
  struct Options {
    ChannelConfig config = {};
    WaitPolicy wait = {};
    /// False when the server is known to be dead. Called at most once per wait.recheck. Empty: never known to
    /// be dead.
    std::function<bool()> serverAlive = {};
  };
  /// `board`: the server's. Send share() to the server (ChannelServer::add). Errors: kRange, kNoMem.
  static Result<ClientChannel> create(std::shared_ptr<ServerBoard> board, Options options);
  ClientChannel(ClientChannel&&) noexcept = default;
  ClientChannel& operator=(ClientChannel&&) = delete;
  /// Tells the server that the client has left.
  ~ClientChannel();

  /// The descriptor to send to the server.
  Result<FileDescriptor> share() const { return memory_.share(); }
  uint32_t blockCount() const { return memory_.blockCount(); }
  uint64_t blockBytes() const { return memory_.blockBytes(); }

  /// A block that nobody uses, or nothing when all are in use.
  std::optional<uint32_t> acquire();
  /// The bytes of a block that is acquired or answered; empty for any other block (they are the server's).
  std::span<std::byte> data(uint32_t block) const;
  /// Hands an acquired (or failed, or done) block to the server. Errors: kBadHandle (not acquired), the
  /// channel's error.
  Result<void> submit(uint32_t block);
  /// Never blocks.
  BlockStatus poll(uint32_t block);
  /// Waits until one of `blocks` (all submitted) is done or failed, and returns it: the first such in the
  /// order of `blocks`. Errors: kBadHandle (empty list, a block that was not submitted), kSystem (the server
  /// is gone), the channel's error.
  Result<uint32_t> waitAny(std::span<const uint32_t> blocks);
  /// Makes a block free: acquired or answered, not submitted.
  void release(uint32_t block);

  /// One small request, answered before this returns. Returns the number of bytes written to `answer`.
  /// Errors: kRange (request > kMailBytes, or the answer does not fit), kIncapable (the server failed it),
  /// kSystem (the server is gone), the channel's error.
  Result<uint32_t> call(std::span<const std::byte> request, std::span<std::byte> answer);

  /// The server is known to be dead: waits end at once, and so does everything else. From any thread.
  void serverIsGone() const;

  /// Set once the channel is broken.
  const std::optional<Error>& error() const { return error_; }

 private:
  struct BlockBook {  // what we know of a block without asking shared memory
    uint64_t use = 0;
    BlockPhase phase = BlockPhase::kFree;  // kFree, kFilling, kSubmitted, kDone, kFailed
  };
  ClientChannel(ChannelMemory memory, std::shared_ptr<ServerBoard> board, Options options);
  Error breakChannel(Error e);
  BlockStatus look(uint32_t block);
  bool serverLeft() const;
  bool serverAlive();
  Error serverGone();

  ChannelMemory memory_;
  std::shared_ptr<ServerBoard> board_;  // null when moved from
  Options options_;
  std::vector<BlockBook> books_;
  std::vector<uint32_t> free_;               // last released first: its lines are still in our cache
  std::unique_ptr<std::atomic<bool>> gone_;  // serverIsGone()
  uint32_t idlePolls_ = 0;
  SpinHistory blockSpins_;  // mail is always waited for in full: see ChannelServer::run
  uint64_t tail_ = 0;
  uint32_t mailState_ = 0;
  std::optional<Error> error_;
};

}  // namespace fr::shm
