// rendrib -rayserver: answers rays for other programs instead of making a picture.
#pragma once

namespace fr::tools {

/// Runs until the client's end, a signal, or for ever (see --help of the mode). Returns the exit status: 0
/// ended in order, 1 failed, 2 wrong usage. Prints messages. Call it from main().
int runRayServer(int argc, char** argv);

}  // namespace fr::tools
