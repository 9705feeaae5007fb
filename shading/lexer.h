// RSL tokens out of preprocessed text.
#pragma once

#include <set>

#include "shading/source.h"

namespace fr {

enum class TokenKind : uint8_t { kEnd, kIdentifier, kKeyword, kNumber, kString, kPunctuation };

struct SlToken {
  TokenKind kind = TokenKind::kEnd;
  std::string text;  // identifier, keyword, punctuation; the decoded value of a string
  double number = 0;
  SourcePlace place;
  uint32_t length = 0;  // characters of the source
  bool is(std::string_view s) const {
    return (kind == TokenKind::kPunctuation || kind == TokenKind::kKeyword) && text == s;
  }
};

/// Lines (file << 32 | line) on which `#pragma nolint` silences warnings.
using NoLintLines = std::set<uint64_t>;

/// Never fails as a whole: bad characters are reported and skipped. The last token is kEnd. Adjacent string
/// constants are joined.
std::vector<SlToken> tokenize(const PreprocessedSource& source, Diagnostics& diagnostics,
                              NoLintLines& noLint);

}  // namespace fr
