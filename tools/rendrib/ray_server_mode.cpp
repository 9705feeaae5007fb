#include "tools/rendrib/ray_server_mode.h"

#include <cstdio>

namespace fr::tools {

int runRayServer(int, char**) {
  std::fputs("rendrib: -rayserver is not built yet\n", stderr);
  return 2;
}

}  // namespace fr::tools
