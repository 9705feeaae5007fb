// Messages on stderr. Data never goes there, messages never go to stdout.
#pragma once

#include <string_view>

#include "base/error.h"

namespace fr {

/// Nothing below this severity is printed (default kInfo). --quiet sets kError.
void setLogLevel(Severity lowest);
/// Name put in front of each line, e.g. the program and "tracer"; empty by default.
void setLogName(std::string_view name);
/// Prints one line. Thread-safe; a line is never torn between threads.
void logMessage(Severity severity, std::string_view line);

}  // namespace fr
