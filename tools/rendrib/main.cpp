// rendrib: the ray tracer as a program. Three uses, three files: a renderer of its own (render.h), a ray
// server for others (ray_server_mode.h), and the process that frankenrender starts (--oracle, here).
#include <csignal>
#include <cstdio>
#include <span>
#include <string_view>

#include "base/freed_memory.h"
#include "base/log.h"
#include "shm/peer.h"
#include "tools/rendrib/ray_server_mode.h"
#include "tools/rendrib/render.h"
#include "tracer/server.h"

namespace {

/// The ray tracer of the renderer that started us.
int serveRenderer() {
  auto socket = fr::shm::parentSocket();
  if (!socket) {
    fr::report(socket.error());
    return 2;
  }
  const fr::Result<void> served = fr::tracer::serveParent(std::move(socket).value());
  if (!served) fr::report(served.error());
  return served ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  fr::returnFreedMemory();
  fr::setLogName("rendrib");
  std::signal(SIGXFSZ, SIG_IGN);  // a file beyond the limit is a failing write
  const std::span<char*> arguments(argv + 1, size_t(argc > 0 ? argc - 1 : 0));
  if (arguments.size() == 1 && arguments[0] == std::string_view(fr::tracer::kOracleArgument))
    return serveRenderer();
  // As in 1998 the switch may stand anywhere: RAYSERVER="rendrib -frames 3 3 -rayserver scene.rib".
  for (const char* a : arguments)
    if (a == std::string_view("-rayserver") || a == std::string_view("--rayserver"))
      return fr::tools::runRayServer(argc, argv);
  return fr::tools::runRendrib(argc, argv);
}
