#include "shm/channel_server.h"

#include <sched.h>

#include <algorithm>
#include <array>
#include <climits>
#include <cstring>
#include <optional>
#include <utility>

namespace fr::shm {

/// A channel as the server sees it. Everything but `memory`'s contents is private to this process.
class ServerChannel {
 public:
  /// What we know of a block.
  struct Block {
    std::atomic<uint64_t> running{
        0};            // the submission between taking it out of the ring and complete(), 0 = none
    uint64_t use = 0;  // of the last submission taken; belongs to the holder of `claim`
  };

  ServerChannel(uint64_t channelId, void* userData, ChannelMemory m)
      : id(channelId), user(userData), memory(std::move(m)), blocks(memory.blockCount()) {}

  /// Anything in the ring?
  bool hasBlocks() const {
    return memory.control().tail.value.load(std::memory_order_seq_cst) !=
           head.load(std::memory_order_seq_cst);
  }
  /// Anything that a thread could do here now? Cheap, may be wrong for a moment. All loads are seq_cst: SYNC
  /// POINT 1.
  bool hasWork() const {
    if (ended.load(std::memory_order_seq_cst)) return false;
    const ChannelControl& c = memory.control();
    return hasBlocks() ||
           c.mailbox.state.load(std::memory_order_seq_cst) != mailSeen.load(std::memory_order_seq_cst) ||
           c.clientState.value.load(std::memory_order_seq_cst) != uint32_t(SideState::kOpen);
  }

  const uint64_t id;
  void* const user;
  const ChannelMemory memory;

  std::atomic<bool> ended{false};
  /// Held while one block is taken out of the ring; guards head and Block::use.
  std::atomic<bool> claim{false};
  std::atomic<uint64_t> head{0};
  std::vector<Block> blocks;
  /// Held while a mail is served; guards mailSeen.
  std::atomic<bool> mailClaim{false};
  std::atomic<uint32_t> mailSeen{0};
  /// Answers that the client has not been woken for, and since when. Hints: races cost a wake-up too many.
  std::atomic<uint64_t> unannounced{0};
  std::atomic<int64_t> unannouncedSince{0};
};

namespace {

constexpr std::chrono::nanoseconds kForever{-1};
/// A channel that has not moved for so long is served by whoever comes by.
constexpr std::chrono::milliseconds kLeftAlone{1};
/// What a client loses at most when it is not woken for the first answer: as much as 50 wake-ups cost.
constexpr std::chrono::nanoseconds kAnnounceAfter{500000};

/// Holds a claim flag for a scope, if it was free.
class Claim {
 public:
  // SYNC POINT 8: the acquire exchange pairs with the release store below: what the flag guards passes from
  // thread to thread of this process.
  explicit Claim(std::atomic<bool>& flag)
      : flag_(flag), held_(!flag.exchange(true, std::memory_order_acquire)) {}
  Claim(const Claim&) = delete;
  Claim& operator=(const Claim&) = delete;
  ~Claim() {
    if (held_) flag_.store(false, std::memory_order_release);
  }
  explicit operator bool() const { return held_; }

 private:
  std::atomic<bool>& flag_;
  const bool held_;
};

struct Taken {
  uint32_t index;
  uint64_t use;
  uint32_t behind;
};

/// After an answer: wakes the client if it sleeps, unless there is something better to wait for. A client
/// that sleeps while it has more in the ring is woken when half of that is answered: then it has as much to
/// do as we have, and neither waits for the other, and a shared processor changes hands once for many blocks.
/// Never later than kAnnounceAfter if we still answer, and with the last block in any case: what is in the
/// ring will be taken, and whoever takes the last one comes here.
void announce(ServerChannel& ch, bool now) {
  const Doorbell bell = ch.memory.control().clientBell.bell();
  fullFence();  // SYNC POINT 1, ringer's side
  if (bell.sleepers.load(std::memory_order_relaxed) == 0) {
    if (ch.unannounced.load(std::memory_order_relaxed) != 0)
      ch.unannounced.store(0, std::memory_order_relaxed);
    return;
  }
  const uint64_t queued = ch.memory.control().tail.value.load(std::memory_order_seq_cst) -
                          ch.head.load(std::memory_order_seq_cst);
  if (!now && queued != 0) {
    const uint64_t answers = ch.unannounced.fetch_add(1, std::memory_order_relaxed) + 1;
    const int64_t time = std::chrono::steady_clock::now().time_since_epoch().count();
    if (answers == 1) ch.unannouncedSince.store(time, std::memory_order_relaxed);
    if (answers < queued &&
        time - ch.unannouncedSince.load(std::memory_order_relaxed) < kAnnounceAfter.count())
      return;
  }
  ch.unannounced.store(0, std::memory_order_relaxed);
  bell.wake(1);
}

/// Takes the next block out of the ring. Nothing: none there, or another thread is at it. Sets `bad` when the
/// client has written something impossible.
std::optional<Taken> takeBlock(ServerChannel& ch, std::optional<Error>& bad) {
  ChannelControl& c = ch.memory.control();
  // SYNC POINT 3: pairs with the client's release store of tail in ClientChannel::submit.
  if (c.tail.value.load(std::memory_order_seq_cst) == ch.head.load(std::memory_order_relaxed))
    return std::nullopt;
  const Claim claim(ch.claim);
  if (!claim) return std::nullopt;
  const uint64_t head = ch.head.load(std::memory_order_relaxed);
  const uint64_t waiting = c.tail.value.load(std::memory_order_seq_cst) - head;
  if (waiting == 0) return std::nullopt;
  if (waiting > ch.memory.blockCount()) {
    bad = makeError(RiError::kConsistency, "its ring holds {} of {} blocks", waiting, ch.memory.blockCount());
    return std::nullopt;
  }
  const uint32_t index = ch.memory.ringSlot(head).load(std::memory_order_relaxed);
  if (index >= ch.memory.blockCount()) {
    bad = makeError(RiError::kConsistency, "it has submitted block {} of {}", index, ch.memory.blockCount());
    return std::nullopt;
  }
  ServerChannel::Block& block = ch.blocks[index];
  const uint64_t state = ch.memory.state(index).load(std::memory_order_relaxed);
  const uint64_t use = state >> kPhaseBits;
  if (block.running.load(std::memory_order_acquire) != 0) {
    bad = makeError(RiError::kConsistency, "it has submitted block {} twice", index);
    return std::nullopt;
  }
  if (state != blockState(use, BlockPhase::kSubmitted) || use <= block.use) {
    bad = makeError(RiError::kConsistency, "it has submitted block {} in state {:#x}", index, state);
    return std::nullopt;
  }
  block.use = use;
  block.running.store(use, std::memory_order_relaxed);  // ordered by SYNC POINT 8
  ch.memory.state(index).store(blockState(use, BlockPhase::kRunning),
                               std::memory_order_relaxed);  // for observers
  ch.head.store(head + 1, std::memory_order_seq_cst);
  c.head.value.store(head + 1, std::memory_order_relaxed);  // for observers
  return Taken{index, use, uint32_t(waiting - 1)};
}

}  // namespace

Result<std::unique_ptr<ChannelServer>> ChannelServer::create(ChannelHandler& handler,
                                                             std::chrono::nanoseconds spin) {
  Result<std::shared_ptr<ServerBoard>> board = ServerBoard::create();
  if (!board) return std::move(board).error();
  return std::unique_ptr<ChannelServer>(new ChannelServer(handler, spin, std::move(*board)));
}

ChannelServer::ChannelServer(ChannelHandler& handler, std::chrono::nanoseconds spin,
                             std::shared_ptr<ServerBoard> board)
    : handler_(handler),
      spin_(spin),
      board_(std::move(board)),
      channels_(std::make_shared<const Channels>()) {}

ChannelServer::~ChannelServer() {
  board_->serverState().store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
  const auto all = channels();  // kept alive while it is walked
  for (const auto& ch : *all) {
    // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
    ch->memory.control().serverState.value.store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
    ch->memory.control().clientBell.bell().wake(INT_MAX);
  }
}

std::shared_ptr<const ChannelServer::Channels> ChannelServer::channels() const {
  const std::lock_guard lock(mutex_);
  return channels_;
}

size_t ChannelServer::channelCount() const { return channels()->size(); }

Result<uint64_t> ChannelServer::add(FileDescriptor fd, void* user) {
  Result<ChannelMemory> memory = ChannelMemory::attach(std::move(fd), ChannelSide::kServer);
  if (!memory) return std::move(memory).error();
  uint64_t id = 0;
  {
    const std::lock_guard lock(mutex_);
    id = nextId_++;
    auto next = std::make_shared<Channels>(*channels_);
    next->push_back(std::make_shared<ServerChannel>(id, user, std::move(*memory)));
    channels_ = std::move(next);
  }
  // SYNC POINT 9: pairs with the seq_cst loads of channelsVersion_ in run().
  channelsVersion_.fetch_add(1, std::memory_order_seq_cst);
  board_->bells().wakeAll();
  return id;
}

void ChannelServer::detach(uint64_t channelId) {
  {
    const std::lock_guard lock(mutex_);
    auto next = std::make_shared<Channels>(*channels_);
    std::erase_if(*next, [&](const auto& ch) { return ch->id == channelId; });
    channels_ = std::move(next);
  }
  // Wakes all, so that no parked thread keeps the channel's memory mapped. SYNC POINT 9.
  channelsVersion_.fetch_add(1, std::memory_order_seq_cst);
  board_->bells().wakeAll();
}

void ChannelServer::remove(uint64_t channelId) {
  const auto all = channels();  // kept alive while it is walked
  for (const auto& ch : *all) {
    if (ch->id != channelId || ch->ended.exchange(true, std::memory_order_seq_cst)) continue;
    // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
    ch->memory.control().serverState.value.store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
    ch->memory.control().clientBell.bell().wake(INT_MAX);
    detach(channelId);
  }
}

void ChannelServer::end(ServerChannel& ch, const Error* error) {
  if (ch.ended.exchange(true, std::memory_order_seq_cst)) return;
  // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
  ch.memory.control().serverState.value.store(uint32_t(error ? SideState::kBroken : SideState::kClosed),
                                              std::memory_order_seq_cst);
  ch.memory.control().clientBell.bell().wake(INT_MAX);
  detach(ch.id);
  handler_.channelEnded(ch.id, ch.user, error);
}

void ChannelServer::complete(const ServedBlock& served, bool ok) {
  if (!served.channel || served.index >= served.channel->blocks.size()) return;
  ServerChannel& ch = *served.channel;
  ServerChannel::Block& block = ch.blocks[served.index];
  // First this, then the state: once the client sees the answer it may submit the block again. Acquire and
  // release: what one holder of the block did happens before the next one starts, even if the client does not
  // keep to the order.
  uint64_t use = served.use;
  if (use == 0 || !block.running.compare_exchange_strong(use, 0, std::memory_order_acq_rel)) return;
  // SYNC POINT 4: publishes the answer; pairs with the seq_cst load in ClientChannel::look.
  ch.memory.state(served.index)
      .store(blockState(use, ok ? BlockPhase::kDone : BlockPhase::kFailed), std::memory_order_release);
  announce(ch, false);
}

bool ChannelServer::serveMail(ServerChannel& ch, std::optional<Error>& bad) {
  ChannelControl& c = ch.memory.control();
  MailboxLine& box = c.mailbox;
  if (box.state.load(std::memory_order_seq_cst) == ch.mailSeen.load(std::memory_order_relaxed)) return false;
  const Claim claim(ch.mailClaim);
  if (!claim) return false;
  const uint32_t seen = ch.mailSeen.load(std::memory_order_relaxed);
  // SYNC POINT 5: pairs with the client's release store in ClientChannel::call.
  const uint32_t state = box.state.load(std::memory_order_seq_cst);
  if (state == seen) return false;
  const uint32_t size = box.size.load(std::memory_order_relaxed);
  if (state != seen + 1 || size > kMailBytes) {
    bad = makeError(RiError::kConsistency, "its mailbox is in state {} after {}, size {}", state, seen, size);
    return false;
  }
  ch.mailSeen.store(state, std::memory_order_relaxed);
  alignas(16) std::array<std::byte, kMailBytes> request;
  alignas(16) std::array<std::byte, kMailBytes> answer{};  // what is copied shall tell nothing
  copyMail(request.data(), box.payload, size);             // private: the client may write on
  const int n = handler_.serveMail(ch.id, ch.user, std::span(request).first(size), answer);
  const bool ok = n >= 0 && n <= int(kMailBytes);
  if (ok) copyMail(box.payload, answer.data(), uint32_t(n));
  box.size.store(ok ? uint32_t(n) : kMailFailed, std::memory_order_relaxed);
  ch.mailSeen.store(state + 1, std::memory_order_relaxed);
  // SYNC POINT 5, back: publishes the answer.
  box.state.store(state + 1, std::memory_order_release);
  c.clientBell.bell().ring(1);
  handler_.mailAnswered();
  return true;
}

bool ChannelServer::serveBlock(const std::shared_ptr<ServerChannel>& channel, std::optional<Error>& bad) {
  ServerChannel& ch = *channel;
  const std::optional<Taken> taken = takeBlock(ch, bad);
  if (!taken) return false;
  const ServedBlock block{ch.id,   ch.user,      taken->index, taken->use, ch.memory.block(taken->index),
                          channel, taken->behind};
  const Served result = handler_.serveBlock(block);
  if (result != Served::kDeferred)
    complete(block, result == Served::kDone);
  else
    announce(ch, true);  // nobody knows when this one will be answered: earlier ones must not wait for it
  return true;
}

/// Whether the client's last block came from this processor.
bool ChannelServer::isNear(const ServerChannel& ch) {
  return ch.memory.control().tail.processor.load(std::memory_order_relaxed) == currentProcessor();
}

bool ChannelServer::hasNear(const Channels& channels) {
  return std::any_of(channels.begin(), channels.end(), [](const auto& ch) { return isNear(*ch); });
}

/// Whether the threads of another processor get on with a channel of theirs.
bool ChannelServer::leaveToOthers(const ServerChannel& ch, Thread::Progress& seen) {
  if (isNear(ch)) return false;
  const auto now = std::chrono::steady_clock::now();
  const uint64_t head = ch.head.load(std::memory_order_relaxed);
  if (head != seen.head) {
    seen = {head, now};
    return true;
  }
  return now - seen.moved < kLeftAlone;
}

/// Serves every channel once: its mail, and one block of it. Returns how many.
size_t ChannelServer::serve(Thread& thread, Whose whose) {
  const Channels& all = *thread.channels;
  size_t served = 0;
  // No clock, no division before the mailbox: a mail is answered in as much time as those take.
  size_t index = thread.turn < all.size() ? thread.turn : 0;
  thread.turn = index + 1;
  for (size_t left = all.size(); left > 0; --left, index = index + 1 < all.size() ? index + 1 : 0) {
    const std::shared_ptr<ServerChannel>& channel = all[index];
    ServerChannel& ch = *channel;
    if (ch.ended.load(std::memory_order_acquire)) continue;
    std::optional<Error> bad;
    size_t here = 0;
    // The mailbox first: somebody stands still until it is answered.
    if (serveMail(ch, bad)) thread.servedMail = true, ++here;
    if (!bad && ch.hasBlocks() && (whose == Whose::kAll || !leaveToOthers(ch, thread.progress[index])) &&
        serveBlock(channel, bad))
      thread.servedMail = false, ++here;
    if (!bad && here == 0) {
      // SYNC POINT 6: pairs with the release store in ~ClientChannel.
      const uint32_t client = ch.memory.control().clientState.value.load(std::memory_order_seq_cst);
      if (client == uint32_t(SideState::kClosed)) {
        end(ch, nullptr);
      } else if (client != uint32_t(SideState::kOpen)) {
        bad = makeError(RiError::kConsistency, "it says that the channel is broken (state {})", client);
      }
    }
    if (bad) {
      const Error e =
          std::move(*bad).context(fmt::format("ray channel {} of process {}", ch.id, ch.memory.creatorPid()));
      end(ch, &e);
    }
    served += here;
  }
  return served;
}

size_t ChannelServer::serveOnce() {
  Thread thread;
  thread.channels = channels();
  return serve(thread, Whose::kAll);
}

bool ChannelServer::hasWork(const Channels& channels) const {
  for (const auto& ch : channels) {
    if (ch->hasWork()) return true;
  }
  return false;
}

void ChannelServer::run() {
  Thread thread;
  SpinHistory spins;
  const WaitPolicy policy{spin_, kForever};
  while (!stop_.load(std::memory_order_seq_cst)) {
    if (const uint64_t now = channelsVersion_.load(std::memory_order_seq_cst);
        !thread.channels || now != thread.version) {
      thread.version = now;
      thread.channels = channels();
      thread.progress.assign(thread.channels->size(), {});
    }
    if (serve(thread, Whose::kNear) > 0) continue;
    // Before we fetch work from other processors: one of our own clients may be about to make some.
    if (hasWork(*thread.channels)) {
      if (hasNear(*thread.channels)) ::sched_yield();
      if (serve(thread, Whose::kAll) > 0) continue;
    }
    auto ready = [&] {
      return stop_.load(std::memory_order_seq_cst) ||
             channelsVersion_.load(std::memory_order_seq_cst) != thread.version || hasWork(*thread.channels);
    };
    // Who asks ray by ray comes back at once. Were both sides impatient, each would find the other asleep.
    waitAtDoorbell(
        board_->bells().bell(currentProcessor()), policy, kForever, ready, [] { return true; },
        thread.servedMail ? nullptr : &spins);
  }
}

void ChannelServer::stop() {
  stop_.store(true, std::memory_order_seq_cst);
  board_->bells().wakeAll();
}

}  // namespace fr::shm
