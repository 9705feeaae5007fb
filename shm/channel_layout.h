// Byte layout of a channel and of a server board: what client and server share. docs/format/ring.md says the
// same in prose; change both together, and kChannelVersion.
//
// A channel is one sealed memfd: header page, one state line per block, the submission ring, then the blocks.
// Everything in it is input from another process. Whoever reads it keeps private copies of all sizes and
// positions and checks each value.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "shm/cache_line.h"
#include "shm/futex.h"

namespace fr::shm {

inline constexpr uint64_t kChannelMagic = 0x314e414843525246ull;  // "FRRCHAN1"
inline constexpr uint64_t kBoardMagic = 0x31445242'43525246ull;   // "FRRCBRD1"
inline constexpr uint32_t kChannelVersion = 3;
inline constexpr uint32_t kMaxBlocks = 1024;
inline constexpr uint64_t kMaxBlockBytes = 1ull << 30;
inline constexpr uint32_t kMailBytes = 112;

/// Phase of a block: the low bits of its state word. The rest of the word counts the uses of the block.
enum class BlockPhase : uint32_t {
  kFree = 0,       // the client's; contents mean nothing
  kFilling = 1,    // the client's; being written
  kSubmitted = 2,  // the server's; in the ring
  kRunning = 3,    // the server's; taken out of the ring
  kDone = 4,       // the client's; answered
  kFailed = 5,     // the client's; the server could not answer
};
inline constexpr uint64_t kPhaseBits = 3;
constexpr uint64_t blockState(uint64_t use, BlockPhase phase) { return use << kPhaseBits | uint64_t(phase); }

/// What one side tells the other about itself.
enum class SideState : uint32_t {
  kOpen = 0,
  kClosed = 1,  // left in good order
  kBroken = 2,  // found a bad value and will not touch the channel any more
};

/// Written once by the creator before the descriptor is sent; only then `magic`.
struct ChannelHeader {
  /// SYNC POINT 2: the creator's release store, after everything else; pairs with the acquire load in attach.
  std::atomic<uint64_t> magic;
  uint32_t version;
  uint32_t blockCount;
  uint64_t fingerprint;
  uint64_t totalBytes;
  uint64_t blockBytes;     // usable bytes of a block
  uint64_t blockStride;    // bytes from block to block, a multiple of kCacheLine
  uint64_t stateOffset;    // BlockLine[blockCount]
  uint64_t ringOffset;     // std::atomic<uint32_t>[ringCapacity]
  uint64_t blockOffset;    // first block, page aligned
  uint32_t ringCapacity;   // power of two >= blockCount
  uint32_t creatorPid;     // for messages only: a pid is not an identity
  uint64_t questionBytes;  // the first so many bytes of a block are the client's alone to write
  uint8_t pad[kCacheLine - 88];
};
static_assert(sizeof(ChannelHeader) == kCacheLine && offsetof(ChannelHeader, creatorPid) == 76);

/// A word alone on its lines.
template <class Word>
struct alignas(kCacheLine) LonelyWord {
  std::atomic<Word> value;
  uint8_t pad[kCacheLine - sizeof(Word)];
};

/// What a client has submitted.
struct alignas(kCacheLine) TailLine {
  std::atomic<uint64_t> value;  // blocks submitted so far; never wraps
  std::atomic<uint32_t>
      processor;  // on which the client ran when it last submitted: a hint, see ChannelServer
  uint8_t pad[kCacheLine - 12];
};

/// One request or answer of up to kMailBytes, both in the same two lines. Payloads up to 48 bytes touch one
/// 64-byte line. `state` counts: even = the client's (idle, or the answer is there), odd = the server's (a
/// request is there).
struct alignas(kCacheLine) MailboxLine {
  std::atomic<uint32_t> state;
  std::atomic<uint32_t> size;  // valid payload bytes; the top bit marks an answer "failed"
  uint64_t reserved;
  std::byte payload[kMailBytes];
};
inline constexpr uint32_t kMailFailed = 1u << 31;
inline constexpr uint32_t kShortMail = 48;  // with the words before it, one 64-byte line

/// Copies a mail of `size` bytes between two places that have kMailBytes each. Bytes behind it may come
/// along: a fixed size takes a few instructions.
inline void copyMail(std::byte* to, const std::byte* from, uint32_t size) {
  if (size <= kShortMail)
    std::memcpy(to, from, kShortMail);
  else
    std::memcpy(to, from, kMailBytes);
}
static_assert(sizeof(MailboxLine) == kCacheLine && offsetof(MailboxLine, payload) == 16);

struct ChannelControl {
  ChannelHeader header;
  TailLine tail;                     // written by the client
  LonelyWord<uint64_t> head;         // written by the server: blocks taken out so far; for observers
  LonelyWord<uint32_t> clientState;  // SideState, written by the client
  LonelyWord<uint32_t> serverState;  // SideState, written by the server
  DoorbellLine clientBell;           // the client parks here
  MailboxLine mailbox;
};
static_assert(std::is_standard_layout_v<ChannelControl> && sizeof(ChannelControl) == 7 * kCacheLine);
// The offsets that docs/format/ring.md gives.
static_assert(offsetof(ChannelControl, tail) == 128 && offsetof(ChannelControl, head) == 256 &&
              offsetof(ChannelControl, clientState) == 384 && offsetof(ChannelControl, serverState) == 512 &&
              offsetof(ChannelControl, clientBell) == 640 && offsetof(ChannelControl, mailbox) == 768);

struct alignas(kCacheLine) BlockLine {
  std::atomic<uint64_t> state;
  uint8_t pad[kCacheLine - 8];
};
static_assert(sizeof(BlockLine) == kCacheLine);

/// One per server, mapped by the server and all its clients: where the server's threads park.
struct ServerBoardControl {
  std::atomic<uint64_t> magic;  // SYNC POINT 2, as in ChannelHeader
  uint32_t version;
  uint32_t serverPid;  // for messages only
  uint64_t fingerprint;
  uint8_t pad[kCacheLine - 24];
  LonelyWord<uint32_t> serverState;  // SideState
  DoorbellRow bells;
};
static_assert(std::is_standard_layout_v<ServerBoardControl> && sizeof(ServerBoardControl) == 3 * kCacheLine &&
              offsetof(ServerBoardControl, serverState) == 128 && offsetof(ServerBoardControl, bells) == 256);

/// Equal in two builds exactly when they agree about every byte above.
constexpr uint64_t channelFingerprint() {
  return layoutHash(
      kChannelVersion, kCacheLine, kMaxBlocks, kMaxBlockBytes, kMailBytes, kPhaseBits, sizeof(ChannelHeader),
      offsetof(ChannelHeader, blockCount), offsetof(ChannelHeader, totalBytes),
      offsetof(ChannelHeader, stateOffset), offsetof(ChannelHeader, ringCapacity),
      offsetof(ChannelHeader, questionBytes), sizeof(ChannelControl), alignof(ChannelControl),
      offsetof(ChannelControl, tail), offsetof(TailLine, processor), offsetof(ChannelControl, head),
      offsetof(ChannelControl, clientState), offsetof(ChannelControl, serverState),
      offsetof(ChannelControl, clientBell), offsetof(ChannelControl, mailbox), sizeof(BlockLine),
      sizeof(MailboxLine), offsetof(MailboxLine, size), offsetof(MailboxLine, payload), sizeof(DoorbellLine),
      offsetof(DoorbellLine, sleepers), sizeof(ServerBoardControl), offsetof(ServerBoardControl, serverState),
      offsetof(ServerBoardControl, bells), sizeof(DoorbellRow), DoorbellRow::kBells,
      uint64_t(BlockPhase::kFailed), 0x0102030405060708ull);
}

}  // namespace fr::shm
