#include "tracer/server_messages.h"

#include <algorithm>
#include <cctype>

#include "base/version.h"

namespace fr::tracer {
namespace {

/// The other end's version text, as far as it can be shown.
std::string versionIn(const MessageHeader& h) {
  std::string text;
  for (const char c : h.version)
    if (c == 0)
      break;
    else
      text += std::isprint(static_cast<unsigned char>(c)) ? c : '?';
  return text.empty() ? "unknown" : text;
}

}  // namespace

Result<void> sendMessage(shm::PeerSocket& socket, MessageType type, std::span<const std::byte> body,
                         std::string_view text, std::span<const int> descriptors) {
  std::vector<std::byte> bytes(sizeof(MessageHeader) + body.size() + text.size());
  MessageHeader header;
  header.type = type;
  const std::string_view version = versionText();
  std::copy_n(version.begin(), std::min(version.size(), sizeof header.version), header.version);
  std::memcpy(bytes.data(), &header, sizeof header);
  if (!body.empty()) std::memcpy(bytes.data() + sizeof header, body.data(), body.size());
  if (!text.empty()) std::memcpy(bytes.data() + sizeof header + body.size(), text.data(), text.size());
  return socket.send(bytes, descriptors);
}

Result<std::optional<ReceivedMessage>> receiveMessage(shm::PeerSocket& socket,
                                                      std::chrono::milliseconds timeout) {
  auto got = socket.receive(timeout);
  if (!got) return std::move(got).error();
  if (!*got) return std::optional<ReceivedMessage>{};
  shm::PeerMessage& m = **got;
  MessageHeader header;
  if (m.bytes.size() < kStableHeaderBytes)
    return makeError(RiError::kBadFile, "a message between renderer and ray tracer is cut off");
  std::memcpy(static_cast<void*>(&header), m.bytes.data(), std::min(sizeof header, m.bytes.size()));
  if (header.magic != kMessageMagic)
    return makeError(RiError::kBadFile, "the other process is not a ray tracer of ours");
  if (header.fingerprint != messageFingerprint())
    return makeError(
        RiError::kVersion,
        "renderer and ray tracer (rendrib) are of different builds: the other one is version {} (layout "
        "{:016x}), this one is version {} (layout {:016x})",
        versionIn(header), header.fingerprint, versionText(), messageFingerprint());
  if (m.bytes.size() < sizeof header)
    return makeError(RiError::kBadFile, "a message between renderer and ray tracer is cut off");
  ReceivedMessage r;
  r.type = header.type;
  r.body.assign(m.bytes.begin() + sizeof header, m.bytes.end());
  r.descriptors = std::move(m.descriptors);
  return std::optional<ReceivedMessage>(std::move(r));
}

}  // namespace fr::tracer
