// What ShmOracleService and the tracer process say to each other over their socket. Internal to tracer/.
//
// Whole messages (SOCK_SEQPACKET), a fixed header and then bytes; both ends are the same build, and refuse
// each other when they are not. Rays do not travel here: they go through channels (shm/channel.h), whose
// descriptors do.
//
//   client -> server   kPath*     text: a folder of the shader search path, in order
//                      kScratch?  text: the folder of SceneCache::scratch()
//                      kScene     SceneMessage, then text: folder of the standard shaders; descriptors:
//                      skeleton, nodes, arena kChannel   descriptor of one channel kStatistics, kGoodbye
//   server -> client   kReady     descriptor of the server's board (after kScene)
//                      kAdded     (after kChannel)
//                      kNumbers   TracerStatistics (after kStatistics and kGoodbye)
//                      kRefused   text: why (after any)
#pragma once

#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <vector>

#include "oracle/ray_query.h"
#include "shm/peer.h"
#include "tracer/ray_tracer.h"

namespace fr::tracer {

enum class MessageType : uint32_t {
  kPath = 1,
  kScene,
  kChannel,
  kStatistics,
  kGoodbye,
  kReady,
  kAdded,
  kNumbers,
  kRefused,
  kScratch
};

inline constexpr uint32_t kMessageMagic = 0x52544652;  // "RFTR"

/// Both ends must agree about every byte of these.
constexpr uint64_t messageFingerprint() {
  uint64_t h = 4;  // version of the conversation
  for (uint64_t x :
       {uint64_t(sizeof(RayQuery)), uint64_t(offsetof(RayQuery, color)), uint64_t(offsetof(RayQuery, node)),
        uint64_t(sizeof(TracerStatistics)), uint64_t(cache::kFormatVersion), uint64_t(kMaxRays)})
    h = h * 0x9e3779b97f4a7c15ull + x;
  return h;
}

/// The first three members stay where they are in every version: they tell builds apart.
struct MessageHeader {
  uint32_t magic = kMessageMagic;
  MessageType type{};
  uint64_t fingerprint = messageFingerprint();
  char version[16] = {};  // versionText(), for messages; padded with zeros
};
inline constexpr size_t kStableHeaderBytes = offsetof(MessageHeader, version);

struct SceneMessage {
  int32_t threads;
  int32_t maxRayLevel;
  float patchMultiplier;
  uint32_t pad;
  uint64_t memoryBudget;  // of both processes together; 0: none
};

/// Sends header, body and text as one message. Errors: kRange when it is too long, kSystem when the peer is
/// gone.
Result<void> sendMessage(shm::PeerSocket& socket, MessageType type, std::span<const std::byte> body = {},
                         std::string_view text = {}, std::span<const int> descriptors = {});

struct ReceivedMessage {
  MessageType type{};
  std::vector<std::byte> body;  // what follows the header
  std::vector<shm::FileDescriptor> descriptors;

  /// The first bytes of the body as a T; false when it is too short.
  template <class T>
  bool read(T& out) const {
    static_assert(std::is_trivially_copyable_v<T>);
    if (body.size() < sizeof(T)) return false;
    std::memcpy(static_cast<void*>(&out), body.data(), sizeof(T));
    return true;
  }
  std::string_view text(size_t from = 0) const {
    return from >= body.size()
               ? std::string_view{}
               : std::string_view(reinterpret_cast<const char*>(body.data()) + from, body.size() - from);
  }
};
/// Checks the header. Nothing on time-out. Errors: kSystem (peer gone), kVersion (another build), kBadFile.
Result<std::optional<ReceivedMessage>> receiveMessage(shm::PeerSocket& socket,
                                                      std::chrono::milliseconds timeout);

}  // namespace fr::tracer
