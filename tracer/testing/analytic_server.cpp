// The tracer process over analytic scenes: what rendrib --oracle is to the renderer, for the tests of the
// transport.
#include <signal.h>

#include <cstring>

#include "tracer/server.h"

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
  if (asked("die-later")) {  // when the scene has come
    while (const auto m = socket->receive(std::chrono::seconds(1)))
      if (*m && !(**m).descriptors.empty()) raise(SIGKILL);
    return 1;
  }
  return fr::tracer::serveParent(std::move(socket).value()).ok() ? 0 : 1;
}
