// The one error type, and where errors go.
//
// Expected failures travel as Result<T>; everything that a user should read goes through report(),
// which applies the RI error handler. Bugs of ours use FR_CHECK.
#pragma once

#include <fmt/format.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace fr {

/// RI error codes, values as in Pixar's ri.h (RISpec 3.2, section "Error handling").
enum class RiError : int {
  kNone = 0,
  kNoMem = 1,
  kSystem = 2,
  kNoFile = 3,
  kBadFile = 4,
  kVersion = 5,
  kDiskFull = 6,
  kIncapable = 11,
  kUnimplemented = 12,
  kLimit = 13,
  kBug = 14,
  kNotStarted = 23,
  kNesting = 24,
  kNotOptions = 25,
  kNotAttributes = 26,
  kNotPrimitives = 27,
  kIllState = 28,
  kBadMotion = 29,
  kBadSolid = 30,
  kBadToken = 41,
  kRange = 42,
  kConsistency = 43,
  kBadHandle = 44,
  kNoShader = 45,
  kMissingData = 46,
  kSyntax = 47,
  kMath = 61,
};
const char* riErrorName(RiError code);

enum class Severity : int { kInfo = 0, kWarning = 1, kError = 2, kSevere = 3 };

/// A place in a file of the user's: RIB, shader, cache. line and column count from 1; 0 = unknown.
struct SourceLocation {
  std::string file;
  int line = 0;
  int column = 0;
  /// "file:line:column", leaving out what is unknown; "" when nothing is known.
  std::string str() const;
};

struct Error {
  RiError code = RiError::kNone;
  Severity severity = Severity::kError;
  SourceLocation where;
  std::string message;

  /// "file:line:column: error: message [RIE_NAME]"
  std::string str() const;
  /// The same error with "what: " put in front of the message: each level says what it was doing.
  Error context(std::string_view what) && {
    message = fmt::format("{}: {}", what, message);
    return std::move(*this);
  }
};

template <class... Args>
Error makeError(RiError code, fmt::format_string<Args...> f, Args&&... args) {
  return Error{code, Severity::kError, {}, fmt::format(f, std::forward<Args>(args)...)};
}

/// A value or an Error.
template <class T>
class [[nodiscard]] Result {
 public:
  Result(T v) : v_(std::in_place_index<0>, std::move(v)) {}
  Result(Error e) : v_(std::in_place_index<1>, std::move(e)) {}
  bool ok() const { return v_.index() == 0; }
  explicit operator bool() const { return ok(); }
  T& value() & { return std::get<0>(v_); }
  const T& value() const& { return std::get<0>(v_); }
  T&& value() && { return std::get<0>(std::move(v_)); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  Error& error() & { return std::get<1>(v_); }
  const Error& error() const& { return std::get<1>(v_); }
  Error&& error() && { return std::get<1>(std::move(v_)); }

 private:
  std::variant<T, Error> v_;
};
template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Error e) : e_(std::move(e)) {}
  bool ok() const { return !e_; }
  explicit operator bool() const { return ok(); }
  Error& error() & { return *e_; }
  const Error& error() const& { return *e_; }
  Error&& error() && { return std::move(*e_); }

 private:
  std::optional<Error> e_;
};

/// What report() does (RiErrorHandler): ignore remembers only, print prints and goes on, abort prints and
/// asks the program to stop at errors (abortRequested()).
enum class ErrorMode { kIgnore, kPrint, kAbort };

/// Process-wide reporting. Thread-safe. Returns nothing: the caller goes on with a default.
void report(const Error& e);
template <class... Args>
void reportWarning(RiError code, fmt::format_string<Args...> f, Args&&... args) {
  Error e;  // not one aggregate: GCC 12 takes a throwing format() for a half-built Error and warns
  e.code = code;
  e.severity = Severity::kWarning;
  e.message = fmt::format(f, std::forward<Args>(args)...);
  report(e);
}
/// Reports only the first time that `key` is seen in this process: one message, not one per pixel.
void reportOnce(std::string_view key, const Error& e);

void setErrorMode(ErrorMode mode);
ErrorMode errorMode();
/// RiLastError: the last code reported, kNone if none.
RiError lastError();
/// Number of reports so far at `s` or above. The programs' exit status follows from it.
int reportCount(Severity s);
/// True once an error was reported in kAbort mode.
bool abortRequested();
/// Redirects printed reports (tests, embedding). An empty function restores stderr. Also clears counters.
void setReportSink(std::function<void(const Error&)> sink);

[[noreturn]] void checkFailed(const char* file, int line, const char* expr, const std::string& what);

}  // namespace fr

/// Always on: a bug of ours ends the process with a message instead of rendering rubbish.
#define FR_CHECK(cond)                                            \
  do {                                                            \
    if (!(cond)) ::fr::checkFailed(__FILE__, __LINE__, #cond, {}); \
  } while (0)
#ifdef NDEBUG
#define FR_DCHECK(cond) \
  do {                  \
  } while (0)
#else
#define FR_DCHECK(cond) FR_CHECK(cond)
#endif
