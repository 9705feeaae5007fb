// MakeTexture, MakeShadow and their kin in RIB files.
#pragma once

#include <string>
#include <vector>

#include "base/error.h"
#include "ri/renderer.h"

namespace fr::tools {

/// Makes the texture that a request asks for; what cannot be made is reported with its place. Pictures are
/// searched in `folders`, then in the current folder. For cache::LoadOptions::makeTexture.
void makeRequestedTexture(ri::MakeKind kind, const ri::MakeTextureArgs& args,
                          const std::vector<std::string>& folders, const SourceLocation& where);

}  // namespace fr::tools
