// RSL source to ShaderProgram.
#pragma once

#include <string>
#include <vector>

#include "shading/diagnostics.h"
#include "shading/ir.h"

namespace fr {

struct CompileOptions {
  std::vector<std::string> includePaths;
  std::vector<std::string> defines;       // NAME or NAME=VALUE; "!NAME" undefines a predefined macro
  std::vector<std::string> shadeopPaths;  // folders of shared objects with functions (shadeop_library.h)
  Lint lint = Lint::kNone;
  int optimize = 2;  // 0 nothing, 1 dead code and copies, 2 also shared registers
};

/// Compiles all shaders of `source` (surface, light ... definitions, in order). On errors the diagnostics say
/// what is wrong and where; the Error is the first of them. No shader in the source is an error.
/// FRANKENRENDER and BMRT are predefined. Never throws; bad input of any kind ends in an Error. Thread-safe.
Result<std::vector<ShaderProgram>> compileShaders(const std::string& fileName, const std::string& source,
                                                  const CompileOptions& options, Diagnostics& diagnostics);
/// The shader of that name (kNoShader: the file has none); without a name the one called like the file, else
/// the first.
Result<ShaderProgram> compileShaderFile(const std::string& path, const CompileOptions& options,
                                        Diagnostics& diagnostics, std::string_view name = {});
/// The first shader of a string. `fileName` is for messages and #include "..." only.
Result<ShaderProgram> compileShaderString(const std::string& source, const CompileOptions& options,
                                          Diagnostics& diagnostics,
                                          const std::string& fileName = "shader.sl");

/// Counts up whenever the compiler produces other programs from the same source.
inline constexpr uint32_t kCompilerVersion = 3;

}  // namespace fr
