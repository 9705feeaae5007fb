// The tracer process over analytic scenes: what rendrib --oracle is to the renderer, for the tests of the
// transport.
#include <cstring>

#include "tracer/server.h"

int main(int argc, char** argv) {
  if (argc > 1 && !std::strcmp(argv[1], "exit")) return 3;
  auto socket = fr::shm::parentSocket();
  if (!socket) return 2;
  if (argc > 1 && !std::strcmp(argv[1], "babble")) {
    const std::byte junk[64] = {};
    return socket->send(junk, {}).ok() ? 0 : 1;
  }
  return fr::tracer::serveParent(std::move(socket).value()).ok() ? 0 : 1;
}
