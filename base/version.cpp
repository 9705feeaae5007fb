#include "base/version.h"

namespace fr {

const char* versionText() { return FR_VERSION; }

}  // namespace fr
