// One run of frankenrender: scenes in, pictures and statistics out.
#pragma once

#include "tools/frankenrender/command_line.h"

namespace fr::tools {

/// Loads and renders everything; prints messages. Returns the exit status: 0, or 1 when something failed or
/// was replaced by a default.
int runJob(const CommandLine& commandLine);

}  // namespace fr::tools
