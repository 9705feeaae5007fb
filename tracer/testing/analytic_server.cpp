// The tracer process over analytic scenes: what rendrib --oracle is to the renderer, for the tests of the
// transport.
#include <signal.h>

#include <cstring>

#include "tracer/server.h"
#include "tracer/server_messages.h"

int main(int argc, char** argv) {
  const auto asked = [&](const char* what) { return argc > 1 && !std::strcmp(argv[1], what); };
  if (asked("exit")) return 3;
  if (asked("die")) raise(SIGKILL);
  if (asked("no-memory")) return fr::tracer::kOutOfMemoryStatus;
  auto socket = fr::shm::parentSocket();
  if (!socket) return 2;
  if (asked("babble")) {
    const std::byte junk[64] = {};
    return socket->send(junk, {}).ok() ? 0 : 1;
  }
  if (asked("other-build")) {  // reads what comes, answers as a rendrib of another build would
    fr::tracer::MessageHeader h;
    h.type = fr::tracer::MessageType::kReady;
    h.fingerprint ^= 1;
    std::strcpy(h.version, "9.8.7");
    while (const auto m = socket->receive(std::chrono::seconds(1)))
      if (*m && !(**m).descriptors.empty()) (void)socket->send(std::as_bytes(std::span(&h, 1)), {});
    return 1;
  }
  if (asked("die-later")) {  // when the scene has come
    while (const auto m = socket->receive(std::chrono::seconds(1)))
      if (*m && !(**m).descriptors.empty()) raise(SIGKILL);
    return 1;
  }
  return fr::tracer::serveParent(std::move(socket).value()).ok() ? 0 : 1;
}
