#include "shm/channel.h"

#include <cstring>
#include <numeric>

namespace fr::shm {
namespace {

/// A client that only polls asks after the server's life this often.
constexpr uint32_t kPollsPerLook = 1024;

constexpr std::chrono::nanoseconds kForever{-1};

/// Most mails have one size, and a copy of a size that is known takes a few instructions.
void copyShortOrAny(std::byte* to, const std::byte* from, size_t size) {
  if (size == kShortMail)
    std::memcpy(to, from, kShortMail);
  else if (size > 0)
    std::memcpy(to, from, size);
}

}  // namespace

Result<ClientChannel> ClientChannel::create(std::shared_ptr<ServerBoard> board, Options options) {
  if (!board) return makeError(RiError::kBadHandle, "a channel needs a server board");
  Result<ChannelMemory> memory = ChannelMemory::create(options.config);
  if (!memory) return std::move(memory).error();
  return ClientChannel(std::move(*memory), std::move(board), std::move(options));
}

ClientChannel::ClientChannel(ChannelMemory memory, std::shared_ptr<ServerBoard> board, Options options)
    : memory_(std::move(memory)),
      board_(std::move(board)),
      options_(std::move(options)),
      books_(memory_.blockCount()),
      gone_(std::make_unique<std::atomic<bool>>(false)) {
  free_.resize(books_.size());
  std::iota(free_.rbegin(), free_.rend(), 0u);  // block 0 comes out first
}

ClientChannel::~ClientChannel() {
  if (!board_) return;
  const SideState last = error_ ? SideState::kBroken : SideState::kClosed;
  // SYNC POINT 6: pairs with the seq_cst load of clientState in ChannelServer.
  memory_.control().clientState.value.store(uint32_t(last), std::memory_order_release);
  board_->bells().ringOne(currentProcessor());
}

Error ClientChannel::breakChannel(Error e) {
  if (!error_) error_ = std::move(e);
  return *error_;
}

bool ClientChannel::serverLeft() const {
  if (gone_->load(std::memory_order_seq_cst)) return true;
  // SYNC POINT 7: pairs with the seq_cst stores of serverState in ChannelServer (end, ~ChannelServer).
  return memory_.control().serverState.value.load(std::memory_order_seq_cst) != uint32_t(SideState::kOpen) ||
         board_->serverState().load(std::memory_order_seq_cst) != uint32_t(SideState::kOpen);
}

bool ClientChannel::serverAlive() {
  // We have waited long. Other clients can write into the board as well, and one that means harm may have
  // made it say that nobody sleeps there.
  board_->bells().wakeAll();
  return !serverLeft() && (!options_.serverAlive || options_.serverAlive());
}

void ClientChannel::serverIsGone() const {
  gone_->store(true, std::memory_order_seq_cst);
  memory_.control().clientBell.bell().wake(1);
}

Error ClientChannel::serverGone() {
  const uint32_t state = memory_.control().serverState.value.load(std::memory_order_seq_cst);
  if (state == uint32_t(SideState::kBroken)) {
    return breakChannel(
        makeError(RiError::kSystem, "the server has refused this channel: it found bad values in it"));
  }
  if (!gone_->load(std::memory_order_seq_cst) && serverLeft())
    return breakChannel(makeError(RiError::kSystem, "the server has left"));
  return breakChannel(makeError(RiError::kSystem, "the server process is gone"));
}

std::optional<uint32_t> ClientChannel::acquire() {
  if (free_.empty() || error_) return std::nullopt;
  const uint32_t block = free_.back();
  free_.pop_back();
  BlockBook& book = books_[block];
  book.phase = BlockPhase::kFilling;
  ++book.use;
  // For observers only; the server looks at a block after it has seen it in the ring (SYNC POINT 3).
  memory_.state(block).store(blockState(book.use, BlockPhase::kFilling), std::memory_order_relaxed);
  return block;
}

std::span<std::byte> ClientChannel::data(uint32_t block) const {
  if (block >= books_.size()) return {};
  const BlockPhase phase = books_[block].phase;
  if (phase == BlockPhase::kFree) return {};
  if (phase == BlockPhase::kSubmitted && !error_) return {};
  return memory_.block(block);
}

Result<void> ClientChannel::submit(uint32_t block) {
  if (error_) return *error_;
  if (block >= books_.size()) return makeError(RiError::kBadHandle, "block {} does not exist", block);
  BlockBook& book = books_[block];
  if (book.phase == BlockPhase::kFree || book.phase == BlockPhase::kSubmitted) {
    return makeError(RiError::kBadHandle, "block {} is not ours to submit", block);
  }
  if (serverLeft()) return serverGone();
  if (book.phase != BlockPhase::kFilling) ++book.use;
  book.phase = BlockPhase::kSubmitted;
  // The ring cannot be full: each block is in it at most once, and it has a slot for each. The slot itself is
  // free: the server read it before it finished the block that it held (SYNC POINT 4).
  memory_.state(block).store(blockState(book.use, BlockPhase::kSubmitted), std::memory_order_relaxed);
  memory_.ringSlot(tail_).store(block, std::memory_order_relaxed);
  TailLine& tail = memory_.control().tail;
  const uint32_t processor = currentProcessor();
  tail.processor.store(processor, std::memory_order_relaxed);
  // SYNC POINT 3: publishes contents, state and slot; pairs with the seq_cst load of tail in ChannelServer.
  tail.value.store(++tail_, std::memory_order_release);
  board_->bells().ringOne(processor);
  return {};
}

BlockStatus ClientChannel::look(uint32_t block) {
  BlockBook& book = books_[block];
  if (book.phase == BlockPhase::kDone) return BlockStatus::kDone;
  if (book.phase == BlockPhase::kFailed) return BlockStatus::kFailed;
  if (error_) return BlockStatus::kBroken;
  // SYNC POINT 4: pairs with the release store in ChannelServer::complete; the answer is visible after it.
  const uint64_t state = memory_.state(block).load(std::memory_order_seq_cst);
  if (state == blockState(book.use, BlockPhase::kSubmitted) ||
      state == blockState(book.use, BlockPhase::kRunning)) {
    return BlockStatus::kPending;
  }
  if (state == blockState(book.use, BlockPhase::kDone)) {
    book.phase = BlockPhase::kDone;
    return BlockStatus::kDone;
  }
  if (state == blockState(book.use, BlockPhase::kFailed)) {
    book.phase = BlockPhase::kFailed;
    return BlockStatus::kFailed;
  }
  breakChannel(makeError(RiError::kConsistency,
                         "the server has written an impossible state {:#x} for block {}", state, block));
  return BlockStatus::kBroken;
}

BlockStatus ClientChannel::poll(uint32_t block) {
  if (block >= books_.size()) return BlockStatus::kBroken;
  const BlockPhase phase = books_[block].phase;
  if (phase == BlockPhase::kFree || phase == BlockPhase::kFilling) return BlockStatus::kBroken;
  BlockStatus status = look(block);
  if (status != BlockStatus::kPending) return status;
  const bool gone = ++idlePolls_ % kPollsPerLook == 0 ? !serverAlive() : serverLeft();
  if (!gone) return BlockStatus::kPending;
  status = look(block);  // it may have answered before it left
  if (status != BlockStatus::kPending) return status;
  serverGone();
  return BlockStatus::kBroken;
}

Result<uint32_t> ClientChannel::waitAny(std::span<const uint32_t> blocks) {
  if (blocks.empty()) return makeError(RiError::kBadHandle, "nothing to wait for");
  for (const uint32_t b : blocks) {
    if (b >= books_.size() || books_[b].phase == BlockPhase::kFree ||
        books_[b].phase == BlockPhase::kFilling) {
      return makeError(RiError::kBadHandle, "block {} was not submitted", b);
    }
  }
  uint32_t settled = 0;
  auto find = [&] {
    for (const uint32_t b : blocks) {
      const BlockStatus s = look(b);
      if (s == BlockStatus::kDone || s == BlockStatus::kFailed) {
        settled = b;
        return true;
      }
    }
    return false;
  };
  auto ready = [&] { return find() || error_.has_value() || serverLeft(); };
  waitAtDoorbell(
      memory_.control().clientBell.bell(), options_.wait, kForever, ready, [&] { return serverAlive(); },
      &blockSpins_);
  // Once more: what the server answered before it left counts.
  if (find()) return settled;
  return error_ ? *error_ : serverGone();
}

void ClientChannel::release(uint32_t block) {
  if (block >= books_.size()) return;
  BlockBook& book = books_[block];
  if (book.phase == BlockPhase::kFree || book.phase == BlockPhase::kSubmitted) return;
  book.phase = BlockPhase::kFree;
  memory_.state(block).store(blockState(book.use, BlockPhase::kFree),
                             std::memory_order_relaxed);  // for observers
  free_.push_back(block);
}

Result<uint32_t> ClientChannel::call(std::span<const std::byte> request, std::span<std::byte> answer) {
  if (error_) return *error_;
  if (request.size() > kMailBytes) {
    return makeError(RiError::kRange, "a request of {} bytes does not fit the mailbox", request.size());
  }
  MailboxLine& box = memory_.control().mailbox;
  copyShortOrAny(box.payload, request.data(), request.size());
  box.size.store(uint32_t(request.size()), std::memory_order_relaxed);
  const uint32_t posted = mailState_ + 1;
  // SYNC POINT 5: publishes payload and size; pairs with the seq_cst load in ChannelServer::serveMail.
  box.state.store(posted, std::memory_order_release);
  board_->bells().ringOne(currentProcessor());
  // SYNC POINT 5, back: pairs with the server's release store of the next even value.
  auto answered = [&] { return box.state.load(std::memory_order_seq_cst) != posted; };
  auto ready = [&] { return answered() || serverLeft(); };
  waitAtDoorbell(memory_.control().clientBell.bell(), options_.wait, kForever, ready,
                 [&] { return serverAlive(); });
  const uint32_t state = box.state.load(std::memory_order_seq_cst);
  if (state == posted) return serverGone();
  const uint32_t word = box.size.load(std::memory_order_relaxed);
  const uint32_t size = word & ~kMailFailed;
  if (state != posted + 1 || size > kMailBytes) {
    return breakChannel(makeError(
        RiError::kConsistency, "the server has written an impossible mail (state {}, size {})", state, size));
  }
  mailState_ = state;
  if (word & kMailFailed) return makeError(RiError::kIncapable, "the server could not answer");
  if (size > answer.size())
    return makeError(RiError::kRange, "an answer of {} bytes, room for {}", size, answer.size());
  copyShortOrAny(answer.data(), box.payload, size);
  return size;
}

}  // namespace fr::shm
