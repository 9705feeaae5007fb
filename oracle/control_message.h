// What a client and a ray server say to each other over their socket: greetings, descriptors, numbers. Rays
// travel through channels (shm/channel.h). docs/format/ring.md has the conversation in prose.
//
// Whole messages (SOCK_SEQPACKET): a fixed header, then bytes. The header's layout never changes; it carries
// the sender's version and a fingerprint of everything whose layout both must agree upon, so that two builds
// that do not fit refuse each other and can say which they are.
#pragma once

#include <chrono>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "oracle/ray_query.h"
#include "oracle/single_ray.h"
#include "shm/peer.h"

namespace fr {

enum class ControlType : uint32_t {
  // client -> server
  kHello = 64,  // text: the client's name, for messages. First
  kChannel,     // descriptor of one channel
  kScene,       // asks for the scene cache, to be mapped read-only
  kStatistics,  // asks for kNumbers
  kGoodbye,
  // server -> client
  kGreeting =
      96,     // at once, while the scene is still loading; descriptor: counters (oracle/server_counters.h)
  kReady,     // RaySceneInfo; descriptor: the server's board
  kAdded,     // after kChannel: the channel is served
  kSegments,  // after kScene: descriptors of skeleton, nodes, arena, all read-only
  kNumbers,   // after kStatistics: RayServerNumbers
  kRefused,   // text: why. After any; the server then closes the connection unless the client's message was
              // well
              // formed
};

/// Version of the conversation and of what travels through blocks and mailboxes.
inline constexpr uint32_t kControlVersion = 1;
inline constexpr uint32_t kControlMagic = 0x52544652;  // "FRTR"

/// The name of a client that only looks (server_watch.h): it is not counted.
inline constexpr std::string_view kWatcherName = "raystat";

/// Clients and ray servers of different builds must agree about every byte of these.
uint64_t controlFingerprint();
/// Of RayQuery alone.
uint64_t rayQueryFingerprint();

struct ControlHeader {
  uint32_t magic = kControlMagic;
  uint32_t type = 0;
  uint64_t fingerprint = 0;
  char version[32] = {};  // text of the sender's version, ends with 0
};
static_assert(sizeof(ControlHeader) == 48 && std::is_trivially_copyable_v<ControlHeader>);

/// Sends header, body and text as one message. Errors: kRange when it is too long, kSystem when the peer is
/// gone.
Result<void> sendControl(shm::PeerSocket& socket, uint32_t type, uint64_t fingerprint,
                         std::span<const std::byte> body = {}, std::string_view text = {},
                         std::span<const int> descriptors = {});
inline Result<void> sendControl(shm::PeerSocket& socket, ControlType type,
                                std::span<const std::byte> body = {}, std::string_view text = {},
                                std::span<const int> descriptors = {}) {
  return sendControl(socket, uint32_t(type), controlFingerprint(), body, text, descriptors);
}

struct ControlMessage {
  uint32_t type = 0;
  std::vector<std::byte> body;  // what follows the header
  std::vector<shm::FileDescriptor> descriptors;

  bool is(ControlType t) const { return type == uint32_t(t); }
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

/// Checks the header of a message. Errors: kVersion (another build: names both versions), kBadFile (not of
/// ours). `peer`: what the sender is called in errors.
Result<ControlMessage> readControl(shm::PeerMessage message, uint64_t fingerprint, std::string_view peer);

/// Nothing on time-out. Errors: kSystem (peer gone), and as readControl.
Result<std::optional<ControlMessage>> receiveControl(shm::PeerSocket& socket, uint64_t fingerprint,
                                                     std::chrono::milliseconds timeout,
                                                     std::string_view peer);

}  // namespace fr
