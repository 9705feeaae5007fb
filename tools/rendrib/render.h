// rendrib as a renderer: every pixel by rays.
#pragma once

namespace fr::tools {

/// Parses the command line (without -rayserver and --oracle), renders, prints messages. Returns the exit
/// status: 0, 1 when something failed or was replaced by a default, 2 for wrong usage.
int runRendrib(int argc, char** argv);

}  // namespace fr::tools
