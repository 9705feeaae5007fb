// rendrib: the ray tracer as a program. So far it serves one renderer, which starts it.
#include <cstdio>
#include <string_view>

#include "base/log.h"
#include "tracer/server.h"

namespace {

constexpr const char* kUsage =
    R"(Usage: rendrib [--help] [--version]

The ray tracing half of frankenrender. frankenrender starts it by itself when a shader first asks a question
that only ray tracing can answer; there is no need to run it by hand.

  --help       this text
  --version    version
  --oracle     internal: serve the process that started this one (FR_PEER_SOCKET names the socket)

Rendering a RIB file with rays alone, and serving rays to other renderers (-rayserver), are not built yet.
)";

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2) {
    const std::string_view a = argv[1];
    if (a == "--help" || a == "-h") {
      std::fputs(kUsage, stdout);
      return 0;
    }
    if (a == "--version") {
      std::puts("rendrib (frankenrender) " FR_VERSION);
      return 0;
    }
    if (a == fr::tracer::kOracleArgument) {
      fr::setLogName("rendrib");
      auto socket = fr::shm::parentSocket();
      if (!socket) {
        fr::report(socket.error());
        return 2;
      }
      fr::Result<void> served = fr::tracer::serveParent(std::move(socket).value());
      if (!served) fr::report(served.error());
      return served ? 0 : 1;
    }
  }
  std::fputs(argc > 1 ? "rendrib: rendering and -rayserver are not built yet; see rendrib --help\n" : kUsage,
             stderr);
  return 2;
}
