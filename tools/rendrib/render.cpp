#include "tools/rendrib/render.h"

#include <cstdio>
#include <string_view>

namespace fr::tools {
namespace {

constexpr const char* kUsage =
    R"(Usage: rendrib [--help] [--version]
       rendrib -rayserver [options] scene.rib... | scene.fsc

The ray tracing half of frankenrender. frankenrender starts it by itself when a shader first asks a question
that only ray tracing can answer; there is no need to run it by hand.

  --help       this text; of the ray server: rendrib -rayserver --help
  --version    version
  --oracle     internal: serve the process that started this one (FR_PEER_SOCKET names the socket)
  -rayserver   answer rays for other programs

Rendering a RIB file with rays alone is not built yet.
)";

}  // namespace

int runRendrib(int argc, char** argv) {
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
  }
  std::fputs(argc > 1 ? "rendrib: rendering is not built yet; see rendrib --help\n" : kUsage, stderr);
  return 2;
}

}  // namespace fr::tools
