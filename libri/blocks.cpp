// Blocks, declarations, archives, conditions.
#include <cstdarg>
#include <cstdio>

#include "libri/context.h"

using namespace fr;
using namespace fr::libri;
using ri::Renderer;

extern "C" {

RtVoid RiFrameBegin(RtInt number) {
  sendTracked(
      "RiFrameBegin", [&](Renderer& r) { r.frameBegin(number); }, false);
}
RtVoid RiFrameEnd(void) {
  sendTracked(
      "RiFrameEnd", [](Renderer& r) { r.frameEnd(); }, false);
}
RtVoid RiWorldBegin(void) {
  sendTracked(
      "RiWorldBegin", [](Renderer& r) { r.worldBegin(); }, false);
}
RtVoid RiWorldEnd(void) {
  sendTracked(
      "RiWorldEnd", [](Renderer& r) { r.worldEnd(); }, false);
}
RtVoid RiAttributeBegin(void) {
  sendTracked(
      "RiAttributeBegin", [](Renderer& r) { r.attributeBegin(); }, false);
}
RtVoid RiAttributeEnd(void) {
  sendTracked(
      "RiAttributeEnd", [](Renderer& r) { r.attributeEnd(); }, false);
}
RtVoid RiTransformBegin(void) {
  sendTracked(
      "RiTransformBegin", [](Renderer& r) { r.transformBegin(); }, false);
}
RtVoid RiTransformEnd(void) {
  sendTracked(
      "RiTransformEnd", [](Renderer& r) { r.transformEnd(); }, false);
}
RtVoid RiSolidBegin(RtToken operation) {
  sendTracked(
      "RiSolidBegin", [&](Renderer& r) { r.solidBegin(text(operation)); }, false);
}
RtVoid RiSolidEnd(void) {
  sendTracked(
      "RiSolidEnd", [](Renderer& r) { r.solidEnd(); }, false);
}
RtVoid RiResourceBegin(void) {
  sendTracked(
      "RiResourceBegin", [](Renderer& r) { r.resourceBegin(); }, false);
}
RtVoid RiResourceEnd(void) {
  sendTracked(
      "RiResourceEnd", [](Renderer& r) { r.resourceEnd(); }, false);
}

RtObjectHandle RiObjectBegin(void) {
  RtObjectHandle handle = nullptr;
  withContext("RiObjectBegin", [&](Context& c) {
    HandleRecord* h = c.newHandle(HandleRecord::Kind::kObject);
    handle = h;
    sendTracked(
        "RiObjectBegin", [&](Renderer& r) { r.objectBegin(h->handle); }, false);
  });
  return handle;
}
RtVoid RiObjectEnd(void) {
  sendTracked(
      "RiObjectEnd", [](Renderer& r) { r.objectEnd(); }, false);
}
RtVoid RiObjectInstance(RtObjectHandle handle) {
  withContext("RiObjectInstance", [&](Context& c) {
    if (const HandleRecord* h = c.findHandle("RiObjectInstance", handle, HandleRecord::Kind::kObject))
      c.out().objectInstance(h->handle);
  });
}

RtVoid RiMotionBeginV(RtInt n, RtFloat times[]) {
  sendTracked("RiMotionBegin", [&](Renderer& r) {
    r.motionBegin(n > 0 && times ? std::vector<float>(times, times + n) : std::vector<float>());
  });
}
RtVoid RiMotionBegin(RtInt n, ...) {
  // Nothing but the arguments tells whether `n` is true: an absurd one must not read the stack.
  if (n < 0 || n > 1024)
    return complain(RiError::kRange, Severity::kError, "RiMotionBegin", fmt::format("{} times", n));
  RtFloat times[1024];
  va_list arguments;
  va_start(arguments, n);
  for (RtInt i = 0; i < n; ++i) times[i] = RtFloat(va_arg(arguments, double));
  va_end(arguments);
  RiMotionBeginV(n, times);
}
RtVoid RiMotionEnd(void) {
  sendTracked("RiMotionEnd", [](Renderer& r) { r.motionEnd(); });
}

RtToken RiDeclare(RtToken name, RtToken declaration) {
  withContext("RiDeclare", [&](Context& c) {
    const std::string d = text(declaration);
    if (d.empty()) return;  // RI_NULL: the name alone, as PRMan allows
    if (Result<void> r = c.state().dictionary().declare(text(name), d); !r)
      return complain(r.error().code, Severity::kError, "RiDeclare", r.error().message);
    if (&c.out() != &c.state()) (void)c.out().dictionary().declare(text(name), d);
    c.out().declare(text(name), d);
  });
  return name;
}

RtVoid RiReadArchiveV(RtToken name, RtArchiveCallback callback, RtInt n, RtToken tokens[],
                      RtPointer parms[]) {
  withContext("RiReadArchive", [&](Context& c) {
    c.readArchive(text(name), c.params("RiReadArchive", "ReadArchive", n, tokens, parms), callback);
  });
}
RtVoid RiReadArchive(RtToken name, RtArchiveCallback callback, ...) {
  FR_RI_LIST(callback, RiReadArchiveV(name, callback, FR_RI_TAIL));
}
RtArchiveHandle RiArchiveBeginV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  RtArchiveHandle handle = nullptr;
  withContext("RiArchiveBegin", [&](Context& c) {
    HandleRecord* h = name ? c.newHandle(HandleRecord::Kind::kArchive, ri::Handle{text(name), false})
                           : c.newHandle(HandleRecord::Kind::kArchive);
    c.archiveBegin(h->handle, c.params("RiArchiveBegin", "ArchiveBegin", n, tokens, parms));
    handle = h;
  });
  return handle;
}
RtArchiveHandle RiArchiveBegin(RtToken name, ...) { FR_RI_LIST(name, RiArchiveBeginV(name, FR_RI_TAIL)); }
RtVoid RiArchiveEnd(void) {
  withContext("RiArchiveEnd", [](Context& c) { c.archiveEnd(); });
}

RtVoid RiVArchiveRecord(RtToken type, RtString format, va_list arguments) {
  withContext("RiArchiveRecord", [&](Context& c) {
    va_list again;
    va_copy(again, arguments);
    const int length = std::vsnprintf(nullptr, 0, format ? format : "", again);
    va_end(again);
    if (length < 0)
      return complain(RiError::kSystem, Severity::kError, "RiArchiveRecord", "the format is bad");
    std::string record(size_t(length), ' ');
    std::vsnprintf(record.data(), record.size() + 1, format ? format : "", arguments);
    const std::string kind = text(type);
    if (kind == "verbatim") return c.verbatim(std::move(record));
    if (kind != "comment" && kind != "structure")
      return complain(RiError::kBadToken, Severity::kError, "RiArchiveRecord",
                      fmt::format("\"{}\" is no kind of record", kind));
    const bool structure = kind == "structure";
    // "##" would make a structure hint of a comment.
    if (!structure && record.starts_with('#')) record.insert(0, " ");
    c.out().archiveRecord(structure ? ri::RecordKind::kStructure : ri::RecordKind::kComment,
                          std::move(record));
  });
}
RtVoid RiArchiveRecord(RtToken type, RtString format, ...) {
  va_list arguments;
  va_start(arguments, format);
  RiVArchiveRecord(type, format, arguments);
  va_end(arguments);
}

}  // extern "C"

// Written as they are; obeyed where nothing is written. Not withContext(): they are met in branches that are
// left out, too.
template <class F>
static void condition(const char* request, RtToken text, F&& obey) {
  guarded(request, [&] {
    Context* c = current();
    if (!c) return void(enter(request));
    if (c->writes() || c->recording()) return c->out().conditional(request + 2, libri::text(text));
    obey(*c);
  });
}

extern "C" {

RtVoid RiIfBeginV(RtToken expression, RtInt, RtToken[], RtPointer[]) {
  condition("RiIfBegin", expression, [&](Context& c) { c.ifBegin(expression); });
}
RtVoid RiIfBegin(RtToken expression, ...) { FR_RI_LIST(expression, RiIfBeginV(expression, FR_RI_TAIL)); }
RtVoid RiElseIfV(RtToken expression, RtInt, RtToken[], RtPointer[]) {
  condition("RiElseIf", expression, [&](Context& c) { c.elseIf(expression); });
}
RtVoid RiElseIf(RtToken expression, ...) { FR_RI_LIST(expression, RiElseIfV(expression, FR_RI_TAIL)); }
RtVoid RiElse(void) {
  condition("RiElse", nullptr, [](Context& c) { c.elseBranch(); });
}
RtVoid RiIfEnd(void) {
  condition("RiIfEnd", nullptr, [](Context& c) { c.ifEnd(); });
}

}  // extern "C"
