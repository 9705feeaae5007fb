// Creating and checking the memory of channels and server boards; used by both ends.
#pragma once

#include <memory>
#include <span>

#include "base/error.h"
#include "shm/channel_layout.h"
#include "shm/segment.h"

namespace fr::shm {

struct ChannelConfig {
  uint32_t blockCount = 8;      // 1 ... kMaxBlocks
  uint64_t blockBytes = 65536;  // 1 ... kMaxBlockBytes
  /// The first so many bytes of each block hold what is asked: the server maps them read-only, so that a
  /// server which goes wrong leaves them as they were. Whole pages (kQuestionPage), at most blockBytes; 0:
  /// none.
  uint64_t questionBytes = 0;
};

inline constexpr uint64_t kQuestionPage = 4096;

/// Which end of a channel maps it.
enum class ChannelSide { kClient, kServer };

/// A mapped channel with private copies of its geometry: nothing here is read from shared memory again after
/// attach(). Thread safety: const; what the words mean is up to the two ends (channel.h, channel_server.h).
class ChannelMemory {
 public:
  /// Errors: kRange (config), kNoMem.
  static Result<ChannelMemory> create(const ChannelConfig& config);
  /// Maps and checks a channel that another process created: seals, magic, version, layout, every size and
  /// offset. Errors: kVersion (other build), kBadFile (not a channel, or damaged), kNoMem.
  static Result<ChannelMemory> attach(FileDescriptor fd, ChannelSide side);

  ChannelControl& control() const { return *reinterpret_cast<ChannelControl*>(segment_.data()); }
  uint32_t blockCount() const { return blockCount_; }
  uint64_t blockBytes() const { return blockBytes_; }
  uint64_t questionBytes() const { return questionBytes_; }
  std::atomic<uint64_t>& state(uint32_t block) const { return states_[block].state; }
  std::atomic<uint32_t>& ringSlot(uint64_t position) const { return ring_[position & ringMask_]; }
  /// 128-byte aligned, page aligned if there are question bytes. The server must not write those. REQUIRES
  /// block < blockCount().
  std::span<std::byte> block(uint32_t block) const {
    return {blocks_ + uint64_t(block) * blockStride_, size_t(blockBytes_)};
  }
  Result<FileDescriptor> share() const { return segment_.share(Access::kReadWrite); }
  uint32_t creatorPid() const { return creatorPid_; }

 private:
  Segment segment_;
  BlockLine* states_ = nullptr;
  std::atomic<uint32_t>* ring_ = nullptr;
  std::byte* blocks_ = nullptr;
  uint64_t ringMask_ = 0;
  uint64_t blockBytes_ = 0;
  uint64_t questionBytes_ = 0;
  uint64_t blockStride_ = 0;
  uint32_t blockCount_ = 0;
  uint32_t creatorPid_ = 0;
};

/// The page with the doorbells at which a server's threads park. Shared by all ends of one process through a
/// shared_ptr. Thread-safe. Crash of either side: see Doorbell.
class ServerBoard {
 public:
  /// By the server. Errors: kNoMem.
  static Result<std::shared_ptr<ServerBoard>> create();
  /// By a client. Errors as ChannelMemory::attach.
  static Result<std::shared_ptr<ServerBoard>> attach(FileDescriptor fd);

  DoorbellRow& bells() const { return control().bells; }
  std::atomic<uint32_t>& serverState() const { return control().serverState.value; }
  Result<FileDescriptor> share() const { return segment_.share(Access::kReadWrite); }

 private:
  ServerBoardControl& control() const { return *reinterpret_cast<ServerBoardControl*>(segment_.data()); }
  Segment segment_;
};

}  // namespace fr::shm
