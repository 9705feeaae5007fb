#include "shm/channel_memory.h"

#include <sys/mman.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cstring>
#include <new>

namespace fr::shm {
namespace {

/// For memory that has an exact size: the usual padding of segments plays no part.
constexpr uint64_t kPage = kQuestionPage;

/// Geometry follows from the three numbers of the config; both sides compute it and compare.
struct Geometry {
  uint64_t stateOffset, ringOffset, blockOffset, blockStride, totalBytes;
  uint32_t ringCapacity;
};

bool validConfig(const ChannelConfig& c) {
  return c.blockCount >= 1 && c.blockCount <= kMaxBlocks && c.blockBytes >= 1 &&
         c.blockBytes <= kMaxBlockBytes && c.questionBytes <= c.blockBytes &&
         c.questionBytes % kQuestionPage == 0;
}

Geometry geometryOf(const ChannelConfig& config) {
  const uint32_t blockCount = config.blockCount;
  Geometry g{};
  g.ringCapacity = std::bit_ceil(blockCount);
  g.stateOffset = sizeof(ChannelControl);
  g.ringOffset = g.stateOffset + uint64_t(blockCount) * sizeof(BlockLine);
  g.blockOffset = roundUp(g.ringOffset + uint64_t(g.ringCapacity) * sizeof(uint32_t), kPage);
  g.blockStride = roundUp(config.blockBytes, config.questionBytes ? kPage : kCacheLine);
  // One page of surplus: segments keep their last kEndPadding bytes to themselves.
  g.totalBytes = roundUp(g.blockOffset + g.blockStride * blockCount, kPage) + kPage;
  return g;
}

SegmentOptions optionsFor(const char* name) {
  SegmentOptions o;
  o.name = name;
  o.reserve = 0;  // exactly what is there
  o.sealedOnly = true;
  return o;
}

}  // namespace

Result<ChannelMemory> ChannelMemory::create(const ChannelConfig& config) {
  if (!validConfig(config)) {
    return makeError(RiError::kRange, "a channel cannot have {} blocks of {} bytes, {} of them questions",
                     config.blockCount, config.blockBytes, config.questionBytes);
  }
  const Geometry g = geometryOf(config);
  Result<FileDescriptor> fd = createSealedMemory("frankenrender-channel", g.totalBytes);
  if (!fd) return std::move(fd).error().context("channel");
  {
    Result<Segment> s = Segment::attach(fd->duplicate(), Access::kReadWrite, optionsFor("channel"));
    if (!s) return std::move(s).error();
    // The memory is zero: every atomic starts at 0, which is a valid start for each of them.
    auto* c = new (s->data()) ChannelControl;
    ChannelHeader& h = c->header;
    h.version = kChannelVersion;
    h.blockCount = config.blockCount;
    h.fingerprint = channelFingerprint();
    h.totalBytes = g.totalBytes;
    h.blockBytes = config.blockBytes;
    h.blockStride = g.blockStride;
    h.stateOffset = g.stateOffset;
    h.ringOffset = g.ringOffset;
    h.blockOffset = g.blockOffset;
    h.ringCapacity = g.ringCapacity;
    h.creatorPid = uint32_t(::getpid());
    h.questionBytes = config.questionBytes;
    h.magic.store(kChannelMagic, std::memory_order_release);  // SYNC POINT 2: pairs with attach()
  }
  return attach(std::move(*fd), ChannelSide::kClient);
}

Result<ChannelMemory> ChannelMemory::attach(FileDescriptor fd, ChannelSide side) {
  Result<Segment> s = Segment::attach(std::move(fd), Access::kReadWrite, optionsFor("channel"));
  if (!s) return std::move(s).error();
  if (s->size() < sizeof(ChannelControl)) return makeError(RiError::kBadFile, "channel: too small");
  const ChannelHeader& h = reinterpret_cast<const ChannelControl*>(s->data())->header;
  // SYNC POINT 2: pairs with the release store in create().
  if (h.magic.load(std::memory_order_acquire) != kChannelMagic) {
    return makeError(RiError::kBadFile, "channel: not a channel, or not finished");
  }
  // Each word is read once: the sender may still be writing.
  const uint32_t version = h.version;
  const uint64_t fingerprint = h.fingerprint;
  if (version != kChannelVersion || fingerprint != channelFingerprint()) {
    return makeError(
        RiError::kVersion,
        "channel: the other process speaks version {} (layout {:016x}), this one version {} ({:016x})",
        version, fingerprint, kChannelVersion, channelFingerprint());
  }
  const ChannelConfig config{h.blockCount, h.blockBytes, h.questionBytes};
  if (!validConfig(config)) {
    return makeError(RiError::kBadFile, "channel: {} blocks of {} bytes, {} of them questions",
                     config.blockCount, config.blockBytes, config.questionBytes);
  }
  // What we use is what we compute; the header must agree with it, and the memory must be there.
  const Geometry g = geometryOf(config);
  if (h.stateOffset != g.stateOffset || h.ringOffset != g.ringOffset || h.blockOffset != g.blockOffset ||
      h.blockStride != g.blockStride || h.ringCapacity != g.ringCapacity || h.totalBytes != g.totalBytes ||
      s->size() < g.totalBytes - kPage) {
    return makeError(RiError::kBadFile, "channel: its header contradicts itself");
  }
  ChannelMemory m;
  m.states_ = reinterpret_cast<BlockLine*>(s->data() + g.stateOffset);
  m.ring_ = reinterpret_cast<std::atomic<uint32_t>*>(s->data() + g.ringOffset);
  m.blocks_ = s->data() + g.blockOffset;
  m.ringMask_ = g.ringCapacity - 1;
  m.blockBytes_ = config.blockBytes;
  m.questionBytes_ = config.questionBytes;
  m.blockStride_ = g.blockStride;
  m.blockCount_ = config.blockCount;
  m.creatorPid_ = h.creatorPid;
  m.segment_ = std::move(*s);
  if (side == ChannelSide::kServer && config.questionBytes > 0) {
    for (uint32_t b = 0; b < config.blockCount; ++b)
      if (::mprotect(m.block(b).data(), config.questionBytes, PROT_READ) != 0)
        return makeError(RiError::kNoMem, "channel: its questions cannot be protected: {}",
                         std::strerror(errno));
  }
  return m;
}

Result<std::shared_ptr<ServerBoard>> ServerBoard::create() {
  Result<FileDescriptor> fd = createSealedMemory("frankenrender-board", kPage);
  if (!fd) return std::move(fd).error().context("server board");
  auto board = std::make_shared<ServerBoard>();
  Result<Segment> s = Segment::attach(std::move(*fd), Access::kReadWrite, optionsFor("server board"));
  if (!s) return std::move(s).error();
  board->segment_ = std::move(*s);
  auto* c = new (board->segment_.data()) ServerBoardControl;
  c->version = kChannelVersion;
  c->serverPid = uint32_t(::getpid());
  c->fingerprint = channelFingerprint();
  c->magic.store(kBoardMagic, std::memory_order_release);  // SYNC POINT 2: pairs with attach()
  return board;
}

Result<std::shared_ptr<ServerBoard>> ServerBoard::attach(FileDescriptor fd) {
  Result<Segment> s = Segment::attach(std::move(fd), Access::kReadWrite, optionsFor("server board"));
  if (!s) return std::move(s).error();
  if (s->size() < sizeof(ServerBoardControl)) return makeError(RiError::kBadFile, "server board: too small");
  const auto* c = reinterpret_cast<const ServerBoardControl*>(s->data());
  // SYNC POINT 2: pairs with the release store in create().
  if (c->magic.load(std::memory_order_acquire) != kBoardMagic) {
    return makeError(RiError::kBadFile, "server board: not a server board");
  }
  const uint32_t version = c->version;
  const uint64_t fingerprint = c->fingerprint;
  if (version != kChannelVersion || fingerprint != channelFingerprint()) {
    return makeError(
        RiError::kVersion,
        "server board: the server speaks version {} (layout {:016x}), this program version {} ({:016x})",
        version, fingerprint, kChannelVersion, channelFingerprint());
  }
  auto board = std::make_shared<ServerBoard>();
  board->segment_ = std::move(*s);
  return board;
}

}  // namespace fr::shm
