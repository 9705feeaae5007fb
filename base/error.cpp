#include "base/error.h"

#include <atomic>
#include <cstdio>
#include <map>
#include <mutex>
#include <set>

#include "base/interrupt.h"
#include "base/log.h"
#include "base/report_mute.h"

namespace fr {
namespace {

struct Reporter {
  std::recursive_mutex mutex;  // a sink may do what reports again
  std::set<std::string, std::less<>> seen;
  std::map<std::string, int, std::less<>> printed;  // by shape
  std::function<void(const Error&)> sink;
  std::atomic<ErrorMode> mode{ErrorMode::kPrint};
  std::atomic<int> last{0};
  std::atomic<int> counts[4]{};
  std::atomic<bool> abort{false};
};
Reporter& reporter() {
  static Reporter* r = new Reporter;  // never destroyed: threads may report until the very end
  return *r;
}

/// Messages that say the same of another thing are printed so many times: a mistake of an exporter is in
/// every object.
constexpr int kMostAlike = 100;
constexpr size_t kMostShapes = 10000;

/// A message without what it names and counts.
std::string shapeOf(const Error& e) {
  std::string shape;
  char quote = 0;
  for (const char c : e.message) {
    if (quote != 0) {
      if (c == quote) quote = 0;
    } else if (c == '"' || c == '\'') {
      quote = c;
      shape += c;
    } else if (c < '0' || c > '9') {
      shape += c;
    }
  }
  return shape;
}

/// With the lock held: true while it may be printed.
bool mayPrint(Reporter& r, const Error& e, bool& last) {
  std::string shape = shapeOf(e);
  if (r.printed.size() >= kMostShapes && !r.printed.contains(shape)) return true;
  const int n = ++r.printed[std::move(shape)];
  last = n == kMostAlike;
  return n <= kMostAlike;
}

}  // namespace

const char* riErrorName(RiError code) {
  switch (code) {
    case RiError::kNone:
      return "RIE_NOERROR";
    case RiError::kNoMem:
      return "RIE_NOMEM";
    case RiError::kSystem:
      return "RIE_SYSTEM";
    case RiError::kNoFile:
      return "RIE_NOFILE";
    case RiError::kBadFile:
      return "RIE_BADFILE";
    case RiError::kVersion:
      return "RIE_VERSION";
    case RiError::kDiskFull:
      return "RIE_DISKFULL";
    case RiError::kIncapable:
      return "RIE_INCAPABLE";
    case RiError::kUnimplemented:
      return "RIE_UNIMPLEMENT";
    case RiError::kLimit:
      return "RIE_LIMIT";
    case RiError::kBug:
      return "RIE_BUG";
    case RiError::kNotStarted:
      return "RIE_NOTSTARTED";
    case RiError::kNesting:
      return "RIE_NESTING";
    case RiError::kNotOptions:
      return "RIE_NOTOPTIONS";
    case RiError::kNotAttributes:
      return "RIE_NOTATTRIBS";
    case RiError::kNotPrimitives:
      return "RIE_NOTPRIMS";
    case RiError::kIllState:
      return "RIE_ILLSTATE";
    case RiError::kBadMotion:
      return "RIE_BADMOTION";
    case RiError::kBadSolid:
      return "RIE_BADSOLID";
    case RiError::kBadToken:
      return "RIE_BADTOKEN";
    case RiError::kRange:
      return "RIE_RANGE";
    case RiError::kConsistency:
      return "RIE_CONSISTENCY";
    case RiError::kBadHandle:
      return "RIE_BADHANDLE";
    case RiError::kNoShader:
      return "RIE_NOSHADER";
    case RiError::kMissingData:
      return "RIE_MISSINGDATA";
    case RiError::kSyntax:
      return "RIE_SYNTAX";
    case RiError::kMath:
      return "RIE_MATH";
  }
  return "RIE_UNKNOWN";
}

std::string SourceLocation::str() const {
  if (file.empty()) return {};
  if (line <= 0) return file;
  if (column <= 0) return fmt::format("{}:{}", file, line);
  return fmt::format("{}:{}:{}", file, line, column);
}

std::string Error::str() const {
  static constexpr const char* kNames[] = {"info", "warning", "error", "severe"};
  const std::string place = where.str();
  const std::string text =
      fmt::format("{}{}{}: {}", place, place.empty() ? "" : ": ", kNames[int(severity)], message);
  return code == RiError::kNone ? text : fmt::format("{} [{}]", text, riErrorName(code));
}

namespace {
thread_local int t_muted = 0;
}
ReportMute::ReportMute() { ++t_muted; }
ReportMute::~ReportMute() { --t_muted; }

void report(const Error& e) {
  if (t_muted > 0) return;
  Reporter& r = reporter();
  r.last = int(e.code);
  r.counts[int(e.severity)]++;
  const ErrorMode mode = r.mode;
  if (mode == ErrorMode::kAbort && e.severity >= Severity::kError) r.abort = true;
  const std::lock_guard lock(r.mutex);
  if (r.sink) {
    r.sink(e);
  } else if (mode != ErrorMode::kIgnore) {
    bool last = false;
    if (!mayPrint(r, e, last)) return;
    logMessage(e.severity, e.str());
    if (last) logMessage(e.severity, "more messages like the last one are not printed");
  }
}

void reportOnce(std::string_view key, const Error& e) {
  if (t_muted > 0) return;
  Reporter& r = reporter();
  {
    const std::lock_guard lock(r.mutex);
    if (r.seen.size() > 10000 || !r.seen.emplace(key).second) return;
  }
  report(e);
}

void setErrorMode(ErrorMode mode) { reporter().mode = mode; }
ErrorMode errorMode() { return reporter().mode; }
RiError lastError() { return RiError(reporter().last.load()); }
int reportCount(Severity s) {
  int n = 0;
  for (int i = int(s); i < 4; ++i) n += reporter().counts[i];
  return n;
}
bool abortRequested() { return reporter().abort || interrupted(); }

namespace {
std::atomic<bool> userInterrupts{false};
static_assert(std::atomic<bool>::is_always_lock_free);
}  // namespace
void interrupt() noexcept { userInterrupts = true; }
bool interrupted() noexcept { return userInterrupts; }

void setReportSink(std::function<void(const Error&)> sink) {
  Reporter& r = reporter();
  const std::lock_guard lock(r.mutex);
  r.sink = std::move(sink);
  r.seen.clear(), r.printed.clear();
  r.last = 0;
  r.abort = false;
  for (auto& c : r.counts) c = 0;
}

void checkFailed(const char* file, int line, const char* expr, const std::string& what) {
  std::fprintf(stderr, "%s:%d: internal error: check failed: %s %s\n", file, line, expr, what.c_str());
  std::abort();
}

}  // namespace fr
