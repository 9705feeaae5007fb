#include "oracle/control_message.h"

#include <algorithm>

#include "base/version.h"
#include "oracle/scene_info.h"
#include "oracle/server_counters.h"
#include "shm/cache_line.h"
#include "shm/channel_layout.h"

namespace fr {

uint64_t controlFingerprint() {
  return shm::layoutHash(kControlVersion, rayQueryFingerprint(), sizeof(SingleRayMail), sizeof(SingleAnswer),
                         sizeof(RaySceneInfo), sizeof(RayServerNumbers), uint64_t(kCounterCount),
                         shm::channelFingerprint());
}

uint64_t rayQueryFingerprint() {
  using Q = RayQuery;
  return shm::layoutHash(
      sizeof(Q), offsetof(Q, kind), offsetof(Q, count), offsetof(Q, level), offsetof(Q, terms),
      offsetof(Q, origin), offsetof(Q, direction), offsetof(Q, time), offsetof(Q, radius),
      offsetof(Q, spread), offsetof(Q, normal), offsetof(Q, node), offsetof(Q, cell), offsetof(Q, u),
      offsetof(Q, v), offsetof(Q, seed), offsetof(Q, importance), offsetof(Q, point), offsetof(Q, color),
      offsetof(Q, hitDistance), offsetof(Q, hitP), offsetof(Q, hitN), offsetof(Q, missP), offsetof(Q, missR),
      offsetof(Q, missDepth), offsetof(Q, hitNode), offsetof(Q, extra), kMaxRays, offsetof(RayTerms, opaque),
      offsetof(RayTerms, label), offsetof(RayTerms, subset), offsetof(RayTerms, extras));
}

Result<void> sendControl(shm::PeerSocket& socket, uint32_t type, uint64_t fingerprint,
                         std::span<const std::byte> body, std::string_view text,
                         std::span<const int> descriptors) {
  std::vector<std::byte> bytes(sizeof(ControlHeader) + body.size() + text.size());
  ControlHeader header;
  header.type = type;
  header.fingerprint = fingerprint;
  const std::string_view version = versionText();
  std::copy_n(version.begin(), std::min(version.size(), sizeof header.version - 1), header.version);
  std::memcpy(bytes.data(), &header, sizeof header);
  if (!body.empty()) std::memcpy(bytes.data() + sizeof header, body.data(), body.size());
  if (!text.empty()) std::memcpy(bytes.data() + sizeof header + body.size(), text.data(), text.size());
  return socket.send(bytes, descriptors);
}

Result<ControlMessage> readControl(shm::PeerMessage m, uint64_t fingerprint, std::string_view peer) {
  ControlHeader header;
  // The first 16 bytes are what every version has had.
  constexpr size_t kOldest = 16;
  if (m.bytes.size() < kOldest)
    return makeError(RiError::kBadFile, "{} sent a message that is cut off", peer);
  std::memcpy(static_cast<void*>(&header), m.bytes.data(), std::min(m.bytes.size(), sizeof header));
  if (header.magic != kControlMagic)
    return makeError(RiError::kBadFile, "{} is no process of frankenrender", peer);
  if (header.fingerprint != fingerprint || m.bytes.size() < sizeof header) {
    std::string theirs;
    for (const char c : std::span(header.version, sizeof header.version - 1)) {
      if (c == 0) break;
      theirs += c >= 32 && c < 127 ? c : '?';
    }
    return makeError(RiError::kVersion,
                     "{} is another build: it is version {} (layout {:016x}), this is version {} (layout "
                     "{:016x}); use programs of one installation",
                     peer, theirs.empty() ? "unknown" : theirs, header.fingerprint, versionText(),
                     fingerprint);
  }
  ControlMessage r;
  r.type = header.type;
  r.body.assign(m.bytes.begin() + sizeof header, m.bytes.end());
  r.descriptors = std::move(m.descriptors);
  return r;
}

Result<std::optional<ControlMessage>> receiveControl(shm::PeerSocket& socket, uint64_t fingerprint,
                                                     std::chrono::milliseconds timeout,
                                                     std::string_view peer) {
  auto got = socket.receive(timeout);
  if (!got) return std::move(got).error();
  if (!*got) return std::optional<ControlMessage>{};
  auto read = readControl(std::move(**got), fingerprint, peer);
  if (!read) return std::move(read).error();
  return std::optional<ControlMessage>(std::move(read).value());
}

}  // namespace fr
