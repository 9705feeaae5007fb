// base/log.h for code that lives in other people's programs: stderr is theirs. What went wrong is in the
// error text of the handle it happened to.
#include "base/log.h"

namespace fr {

void setLogLevel(Severity) {}
void setLogName(std::string_view) {}
void logMessage(Severity, std::string_view) {}

}  // namespace fr
