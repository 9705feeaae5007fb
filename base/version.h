// Which build this is, for messages between processes that may be of different ones.
#pragma once

namespace fr {

/// "0.1.0": version of the whole package.
const char* versionText();

}  // namespace fr
