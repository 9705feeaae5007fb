// The two kinds of contexts.
#pragma once

#include "libri/context.h"

namespace fr::libri {

/// Renders every world when it ends, in this process.
Result<std::unique_ptr<Context>> makeSceneContext();
/// Writes RIB; "-" is standard output. kNoFile with the reason.
Result<std::unique_ptr<Context>> makeFileContext(const std::string& path, RibFormat format);

}  // namespace fr::libri
