#include "shm/channel_server.h"

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

  ServerChannel(uint64_t channelId, void* userData, ChannelMemory m, std::function<bool()> alive)
      : id(channelId),
        user(userData),
        memory(std::move(m)),
        clientAlive(std::move(alive)),
        blocks(memory.blockCount()) {}

  /// Anything that a thread could do here now? Cheap, may be wrong for a moment. All loads are seq_cst: SYNC
  /// POINT 1.
  bool hasWork() const {
    if (ended.load(std::memory_order_seq_cst)) return false;
    const ChannelControl& c = memory.control();
    return c.tail.value.load(std::memory_order_seq_cst) != head.load(std::memory_order_seq_cst) ||
           c.mailbox.state.load(std::memory_order_seq_cst) != mailSeen.load(std::memory_order_seq_cst) ||
           c.clientState.value.load(std::memory_order_seq_cst) != uint32_t(SideState::kOpen);
  }

  const uint64_t id;
  void* const user;
  const ChannelMemory memory;
  const std::function<bool()> clientAlive;

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
constexpr std::chrono::seconds kBusyLook{1};
// A thread that has had nothing to do for a while looks up no more often than this.
constexpr std::chrono::milliseconds kIdleRecheck{320};
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

/// Whether what this thread served last was a mail.
thread_local bool servedMail = false;

/// After an answer: wakes the client if it sleeps, unless there is something better to wait for. A client
/// that sleeps while it has more in the ring is woken when half of that is answered: then it has as much to
/// do as we have, and neither waits for the other, and a shared processor changes hands once for many blocks.
/// Never later than kAnnounceAfter if we still answer, and with the last block in any case: what is in the
/// ring will be taken, and whoever takes the last one comes here.
void announce(ServerChannel& ch, bool now) {
  Doorbell& bell = ch.memory.control().clientBell;
  // SYNC POINT 1, ringer's side: the answer was published with seq_cst.
  if (bell.sleepers.load(std::memory_order_seq_cst) == 0) {
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
  bell.ring(1);
}

/// Takes the next block out of the ring. Nothing: none there, or another thread is at it. Sets `bad` when the
/// client has written something impossible.
std::optional<Taken> takeBlock(ServerChannel& ch, std::optional<Error>& bad) {
  ChannelControl& c = ch.memory.control();
  // SYNC POINT 3: pairs with the client's seq_cst store of tail in ClientChannel::submit.
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

Result<std::unique_ptr<ChannelServer>> ChannelServer::create(ChannelHandler& handler, Options options) {
  Result<std::shared_ptr<ServerBoard>> board = ServerBoard::create();
  if (!board) return std::move(board).error();
  return std::unique_ptr<ChannelServer>(new ChannelServer(handler, options, std::move(*board)));
}

ChannelServer::ChannelServer(ChannelHandler& handler, Options options, std::shared_ptr<ServerBoard> board)
    : handler_(handler),
      options_(options),
      board_(std::move(board)),
      channels_(std::make_shared<const Channels>()) {}

ChannelServer::~ChannelServer() {
  board_->serverState().store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
  const auto all = channels();  // kept alive while it is walked
  for (const auto& ch : *all) {
    // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
    ch->memory.control().serverState.value.store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
    ch->memory.control().clientBell.ring(INT_MAX);
  }
}

std::shared_ptr<const ChannelServer::Channels> ChannelServer::channels() const {
  const std::lock_guard lock(mutex_);
  return channels_;
}

size_t ChannelServer::channelCount() const { return channels()->size(); }

Result<uint64_t> ChannelServer::add(FileDescriptor fd, void* user, std::function<bool()> clientAlive) {
  Result<ChannelMemory> memory = ChannelMemory::attach(std::move(fd));
  if (!memory) return std::move(memory).error();
  uint64_t id = 0;
  {
    const std::lock_guard lock(mutex_);
    id = nextId_++;
    auto next = std::make_shared<Channels>(*channels_);
    next->push_back(std::make_shared<ServerChannel>(id, user, std::move(*memory), std::move(clientAlive)));
    channels_ = std::move(next);
  }
  // SYNC POINT 9: pairs with the seq_cst loads of channelsVersion_ in run().
  channelsVersion_.fetch_add(1, std::memory_order_seq_cst);
  board_->bell().ring(INT_MAX);
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
  board_->bell().ring(INT_MAX);
}

void ChannelServer::remove(uint64_t channelId) {
  const auto all = channels();  // kept alive while it is walked
  for (const auto& ch : *all) {
    if (ch->id != channelId || ch->ended.exchange(true, std::memory_order_seq_cst)) continue;
    // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
    ch->memory.control().serverState.value.store(uint32_t(SideState::kClosed), std::memory_order_seq_cst);
    ch->memory.control().clientBell.ring(INT_MAX);
    detach(channelId);
  }
}

void ChannelServer::end(ServerChannel& ch, const Error* error) {
  if (ch.ended.exchange(true, std::memory_order_seq_cst)) return;
  // SYNC POINT 7: pairs with the seq_cst loads in ClientChannel::serverLeft.
  ch.memory.control().serverState.value.store(uint32_t(error ? SideState::kBroken : SideState::kClosed),
                                              std::memory_order_seq_cst);
  ch.memory.control().clientBell.ring(INT_MAX);
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
  // SYNC POINT 4: publishes the answer; pairs with the seq_cst load in ClientChannel::look. seq_cst rather
  // than release for the doorbell (SYNC POINT 1).
  ch.memory.state(served.index)
      .store(blockState(use, ok ? BlockPhase::kDone : BlockPhase::kFailed), std::memory_order_seq_cst);
  announce(ch, false);
}

size_t ChannelServer::serveChannel(const std::shared_ptr<ServerChannel>& channel) {
  ServerChannel& ch = *channel;
  if (ch.ended.load(std::memory_order_acquire)) return 0;
  ChannelControl& c = ch.memory.control();
  size_t served = 0;
  std::optional<Error> bad;

  // The mailbox first: somebody stands still until it is answered.
  MailboxLine& box = c.mailbox;
  if (box.state.load(std::memory_order_seq_cst) != ch.mailSeen.load(std::memory_order_relaxed)) {
    if (const Claim claim(ch.mailClaim); claim) {
      const uint32_t seen = ch.mailSeen.load(std::memory_order_relaxed);
      // SYNC POINT 5: pairs with the client's seq_cst store in ClientChannel::call.
      const uint32_t state = box.state.load(std::memory_order_seq_cst);
      const uint32_t size = box.size.load(std::memory_order_relaxed);
      if (state == seen + 1 && size <= kMailBytes) {
        ch.mailSeen.store(state, std::memory_order_relaxed);
        alignas(16) std::array<std::byte, kMailBytes> request;
        alignas(16) std::array<std::byte, kMailBytes> answer;
        std::memcpy(request.data(), box.payload, size);  // private: the client may write on
        const int n = handler_.serveMail(ch.id, ch.user, std::span(request).first(size), answer);
        const bool ok = n >= 0 && n <= int(kMailBytes);
        if (ok) std::memcpy(box.payload, answer.data(), size_t(n));
        box.size.store(ok ? uint32_t(n) : kMailFailed, std::memory_order_relaxed);
        ch.mailSeen.store(state + 1, std::memory_order_relaxed);
        // SYNC POINT 5, back: publishes the answer.
        box.state.store(state + 1, std::memory_order_seq_cst);
        c.clientBell.ring(1);
        servedMail = true;
        ++served;
      } else if (state != seen) {
        bad = makeError(RiError::kConsistency, "its mailbox is in state {} after {}, size {}", state, seen,
                        size);
      }
    }
  }

  if (!bad) {
    if (const std::optional<Taken> taken = takeBlock(ch, bad)) {
      const ServedBlock block{ch.id,   ch.user,      taken->index, taken->use, ch.memory.block(taken->index),
                              channel, taken->behind};
      servedMail = false;
      const Served result = handler_.serveBlock(block);
      if (result != Served::kDeferred)
        complete(block, result == Served::kDone);
      else
        announce(ch, true);  // nobody knows when this one will be answered: earlier ones must not wait for it
      ++served;
    }
  }

  if (!bad && served == 0) {
    // SYNC POINT 6: pairs with the seq_cst store in ~ClientChannel.
    const uint32_t client = c.clientState.value.load(std::memory_order_seq_cst);
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
  return served;
}

size_t ChannelServer::serve(const Channels& channels, size_t start) {
  size_t served = 0;
  for (size_t i = 0; i < channels.size(); ++i)
    served += serveChannel(channels[(start + i) % channels.size()]);
  return served;
}

size_t ChannelServer::serveOnce() { return serve(*channels(), 0); }

bool ChannelServer::hasWork(const Channels& channels) const {
  for (const auto& ch : channels) {
    if (ch->hasWork()) return true;
  }
  return false;
}

void ChannelServer::lookAfterClients(const Channels& channels) {
  for (const auto& ch : channels) {
    if (!ch->clientAlive || ch->ended.load(std::memory_order_acquire) || ch->clientAlive()) continue;
    const Error e = makeError(RiError::kSystem, "ray channel {}: its process {} is gone", ch->id,
                              ch->memory.creatorPid());
    end(*ch, &e);
  }
}

void ChannelServer::run() {
  using Clock = std::chrono::steady_clock;
  std::shared_ptr<const Channels> mine;
  uint64_t version = 0;
  size_t turn = 0;
  SpinHistory spins;
  WaitPolicy policy = options_.wait;
  policy.longestRecheck = kIdleRecheck;
  Clock::time_point lastLook = Clock::now();
  while (!stop_.load(std::memory_order_seq_cst)) {
    if (const uint64_t now = channelsVersion_.load(std::memory_order_seq_cst); !mine || now != version) {
      version = now;
      mine = channels();
    }
    if (serve(*mine, turn++) > 0) {
      if (const Clock::time_point now = Clock::now(); now - lastLook >= kBusyLook) {
        lastLook = now;
        lookAfterClients(*mine);
      }
      continue;
    }
    auto ready = [&] {
      return stop_.load(std::memory_order_seq_cst) ||
             channelsVersion_.load(std::memory_order_seq_cst) != version || hasWork(*mine);
    };
    waitAtDoorbell(
        board_->bell(), policy, kForever, ready,
        [&] {
          lookAfterClients(*mine);
          return true;
        },
        // Who asks ray by ray comes back at once. Were both sides impatient, each would find the other
        // asleep.
        servedMail ? nullptr : &spins);
  }
}

void ChannelServer::stop() {
  stop_.store(true, std::memory_order_seq_cst);
  board_->bell().ring(INT_MAX);
}

}  // namespace fr::shm
