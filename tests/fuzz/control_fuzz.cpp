// libFuzzer: any bytes as a message between a client and a ray server.
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "oracle/control_message.h"
#include "oracle/scene_info.h"
#include "oracle/server_counters.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace fr;
  if (size < 1) return 0;
  shm::PeerMessage m;
  const auto bytes = std::as_bytes(std::span(data, size)).subspan(1);
  m.bytes.assign(bytes.begin(), bytes.end());
  if (data[0] & 1 && m.bytes.size() >= sizeof(ControlHeader)) {  // past the header's checks
    ControlHeader h;
    std::memcpy(static_cast<void*>(&h), m.bytes.data(), sizeof h);
    h.magic = kControlMagic;
    h.fingerprint = controlFingerprint();
    std::memcpy(m.bytes.data(), &h, sizeof h);
  }
  auto read = readControl(std::move(m), controlFingerprint(), "the other process");
  if (!read) return 0;
  RaySceneInfo info;
  RayServerNumbers numbers;
  (void)read->read(info);
  (void)read->read(numbers);
  (void)read->text();
  (void)read->text(sizeof info);
  return 0;
}
