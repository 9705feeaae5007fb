// RiErrorHandler: every report of the renderer goes through it.
#include <unistd.h>
#include <atomic>
#include <cstdio>

#include "libri/context.h"

RtInt RiLastError = RIE_NOERROR;

namespace fr::libri {
namespace {

std::atomic<RtErrorHandler> theHandler{RiErrorPrint};

void sink(const Error& e) {
  // report() calls one sink at a time: handlers need not expect the renderer's threads.
  if (e.severity != Severity::kInfo) RiLastError = int(e.code);
  if (errorMode() == ErrorMode::kIgnore) return;  // ErrorHandler "ignore" of an archive
  const std::string where = e.where.str();
  std::string message = where.empty() ? e.message : where + ": " + e.message;
  theHandler.load()(int(e.code), int(e.severity), message.data());
}

const char* severityName(RtInt severity) {
  static constexpr const char* kNames[] = {"info", "warning", "error", "severe"};
  return severity >= 0 && severity < 4 ? kNames[severity] : "error";
}

}  // namespace

void installErrorHandler() {
  static const bool once = [] {
    setReportSink(sink);
    return true;
  }();
  (void)once;
}

void complain(RiError code, Severity severity, const char* request, std::string message) {
  installErrorHandler();
  report(Error{code, severity, {}, fmt::format("{}: {}", request, message)});
}

}  // namespace fr::libri

using namespace fr::libri;

extern "C" {

RtVoid RiErrorHandler(RtErrorHandler handler) {
  installErrorHandler();
  theHandler = handler ? handler : RiErrorPrint;
  fr::setErrorMode(fr::ErrorMode::kPrint);
  const char* name = handler == RiErrorIgnore  ? "ignore"
                     : handler == RiErrorPrint ? "print"
                     : handler == RiErrorAbort ? "abort"
                                               : nullptr;
  if (Context* c = current(); c && name && c->writes())
    guarded("RiErrorHandler", [&] { c->out().errorHandler(name); });
}

RtVoid RiErrorIgnore(RtInt, RtInt, char*) {}

RtVoid RiErrorPrint(RtInt code, RtInt severity, char* message) {
  if (severity <= RIE_INFO)
    std::fprintf(stderr, "%s\n", message);
  else
    std::fprintf(stderr, "%s: %s [%s]\n", severityName(severity), message,
                 fr::riErrorName(fr::RiError(code)));
}

RtVoid RiErrorAbort(RtInt code, RtInt severity, char* message) {
  RiErrorPrint(code, severity, message);
  if (severity < RIE_ERROR) return;
  std::fflush(nullptr);
  ::_exit(1);  // without destructors: threads of the renderer may be in the midst of anything
}

}  // extern "C"
