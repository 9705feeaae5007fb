// Errors and warnings of one compilation, with the source line, a caret and a hint.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"

namespace fr {

/// A place in the sources of a compilation. line and column count from 1.
struct SourcePlace {
  uint32_t file = 0;
  uint32_t line = 0;
  uint32_t column = 0;
};

/// Which warnings a compilation gives.
enum class Lint : uint8_t {
  kNone,    // those alone that say that something is not what was written (a missing default value ...)
  kCommon,  // also what is most likely wrong: variables without a value, derivatives of undefined neighbours
  kAll,     // also what is superfluous or loose: unused variables, points used as vectors
};

struct Diagnostic {
  Severity severity = Severity::kError;
  RiError code = RiError::kSyntax;
  SourceLocation where;
  std::string message;
  std::string hint;        // "" or a sentence that says what to write instead
  std::string sourceLine;  // "" when the place is unknown
  /// "file:line:column: error: message", the source line, a caret line and "hint: ...".
  std::string str() const;
};

/// Collects all problems of a file in source order of discovery. The same message at the same place is kept
/// once.
class Diagnostics {
 public:
  static constexpr size_t kMaxKept = 200;

  void add(Diagnostic d);
  bool hasErrors() const { return errors_ != 0; }
  size_t errorCount() const { return errors_; }
  size_t warningCount() const { return warnings_; }
  const std::vector<Diagnostic>& all() const { return all_; }
  std::string str() const;
  /// Lets `change` add to the messages from the n-th on.
  void edit(size_t n, const std::function<void(Diagnostic&)>& change) {
    for (; n < all_.size(); ++n) change(all_[n]);
  }
  /// The first error as an Error that mentions how many more there are.
  Error firstError(std::string_view what) const;

 private:
  std::vector<Diagnostic> all_;
  size_t errors_ = 0, warnings_ = 0;
};

/// The word of `candidates` nearest to `word`, or "" when none is near: for "did you mean".
class NearestWord {
 public:
  explicit NearestWord(std::string_view word);
  void offer(std::string_view candidate);
  const std::string& best() const { return best_; }
  /// "did you mean 'x'?" or "".
  std::string hint() const;

 private:
  std::string word_, best_;
  size_t distance_;
};

}  // namespace fr
