// The passes that follow lowering, in the order in which compile.cpp runs them.
#pragma once

#include <string_view>

#include "shading/builder.h"
#include "shading/diagnostics.h"
#include "shading/lexer.h"

namespace fr {

struct PassContext {
  const PreprocessedSource* source = nullptr;
  Diagnostics* diagnostics = nullptr;
  const NoLintLines* noLint = nullptr;
  Lint lint = Lint::kNone;
};

std::string_view preludeSource();

/// Replaces copies of values that do not change by the values themselves.
void propagateCopies(ShaderProgram& program);
/// Removes instructions without an effect: unused results, stores that are overwritten at once, empty
/// conditionals.
void removeDeadCode(ShaderProgram& program);
/// Decides which locals and temporaries are uniform. Reports varying values in uniform variables, and (lint)
/// derivatives under varying control. Returns for each instruction whether some points may be inactive.
std::vector<bool> inferUniformity(ShaderProgram& program, const PassContext& context);
/// The name of a string that differs from point to point, where all points of a batch see one value of it;
/// empty: there is none. `varyingParameters`: parameters that primitive variables make varying.
std::string dividedString(ShaderProgram program, const std::vector<std::string>& varyingParameters);
/// Lets operations write a variable directly instead of through a temporary, where all points are active.
void mergeAssignments(ShaderProgram& program, const std::vector<bool>& underVaryingControl);
/// Lets variables and temporaries that are never alive together share a symbol.
void shareRegisters(ShaderProgram& program);
/// Constant defaults of parameters leave the default-value code.
void extractConstantDefaults(ShaderProgram& program);
/// Drops symbols that nothing refers to (parameters stay) and operands of removed instructions.
void compact(ShaderProgram& program);
/// Fills in flags, readsGlobals and writesGlobals.
void analyze(ShaderProgram& program);
/// Everything that a valid program promises (ir.h).
Result<void> validate(const ShaderProgram& program);

}  // namespace fr
