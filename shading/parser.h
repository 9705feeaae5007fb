// Recursive-descent parser of RSL.
#pragma once

#include "shading/ast.h"
#include "shading/lexer.h"

namespace fr {

struct ParserOptions {
  bool prelude = false;  // accept __ambientlights
};

/// Parses all of `tokens`; goes on after an error at the next statement or definition, so that one run finds
/// all errors. Nesting is limited (256 blocks or parentheses, 1000 operators in one expression).
void parseFile(const std::vector<SlToken>& tokens, const PreprocessedSource& source, Diagnostics& diagnostics,
               const ParserOptions& options, ast::File& out);

}  // namespace fr
