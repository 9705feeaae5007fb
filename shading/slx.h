// Compiled shaders on disk (.slx): docs/format/bytecode.md, section ".slx files".
#pragma once

#include <span>

#include "base/error.h"
#include "shading/ir.h"

namespace fr {

inline constexpr uint32_t kSlxVersion = 1;

/// The bytes of a .slx file.
std::string writeSlx(const ShaderProgram& program);
/// Accepts any bytes; whatever is returned is a valid program (ir.h). Memory is bounded by the input's size.
Result<ShaderProgram> readSlx(std::span<const char> bytes);

/// Writes to a temporary name and renames.
Result<void> writeSlxFile(const std::string& path, const ShaderProgram& program);
Result<ShaderProgram> readSlxFile(const std::string& path);

}  // namespace fr
