#include "libri/context.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <list>

#include "base/report_mute.h"
#include "libri/contexts.h"
#include "ri/condition.h"

namespace fr::libri {
namespace {

std::list<std::unique_ptr<Context>>& contexts() {
  static auto& all = *new std::list<std::unique_ptr<Context>>;
  return all;
}
Context* theCurrent = nullptr;
RibFormat formatOfNext;

bool endsWith(std::string_view s, std::string_view end) { return s.ends_with(end); }

}  // namespace

Context* current() { return theCurrent; }

Context& adopt(std::unique_ptr<Context> context) {
  contexts().push_back(std::move(context));
  return *(theCurrent = contexts().back().get());
}

Context* enter(const char* request) {
  if (!theCurrent) {
    complain(RiError::kNotStarted, Severity::kError, request, "RiBegin has not been called");
    return nullptr;
  }
  return theCurrent->skipping() ? nullptr : theCurrent;
}

Result<std::unique_ptr<Context>> Context::open(RtToken name, RibFormat format) {
  const std::string_view n = name ? name : "";
  if (n.empty() || n == "frankenrender" || n == "render") return makeSceneContext();
  if (endsWith(n, ".gz") && !n.starts_with('|')) format.gzip = true;
  return makeFileContext(std::string(n), format);
}

void track(Context& c, bool silent, const std::function<void(ri::Renderer&)>& call) {
  if (!c.writes() || c.recording()) return;
  std::optional<ReportMute> mute;
  if (silent) mute.emplace();
  call(c.state());
}

// ---- conditions -------------------------------------------------------------------------------------------

bool Context::condition(const char* text) {
  const Result<bool> r =
      ri::evaluateCondition(libri::text(text), [this](std::string_view n) { return state().variable(n); });
  if (r) return *r;
  complain(r.error().code, Severity::kError, "RiIfBegin", r.error().message);
  return false;
}
void Context::ifBegin(const char* text) {
  const bool enclosing = !skipping();
  const bool active = enclosing && condition(text);
  branches_.push_back({active, active, enclosing});
}
void Context::elseIf(const char* text) {
  if (branches_.empty())
    return complain(RiError::kNesting, Severity::kError, "RiElseIf", "no RiIfBegin before it");
  Branch& b = branches_.back();
  b.active = b.enclosing && !b.taken && condition(text);
  b.taken |= b.active;
}
void Context::elseBranch() {
  if (branches_.empty())
    return complain(RiError::kNesting, Severity::kError, "RiElse", "no RiIfBegin before it");
  Branch& b = branches_.back();
  b.active = b.enclosing && !b.taken;
  b.taken = true;
}
void Context::ifEnd() {
  if (branches_.empty())
    return complain(RiError::kNesting, Severity::kError, "RiIfEnd", "no RiIfBegin before it");
  branches_.pop_back();
}

// ---- handles ----------------------------------------------------------------------------------------------

HandleRecord* Context::newHandle(HandleRecord::Kind kind, std::optional<ri::Handle> name) {
  if (!name) {
    const std::string prefix = handlePrefix();
    name = ri::Handle{fmt::format("{}{}", prefix, ++numbers_), prefix.empty()};
  }
  handles_.push_back({kind, std::move(*name)});
  return &handles_.back();
}

const HandleRecord* Context::findHandle(const char* request, const void* handle,
                                        HandleRecord::Kind kind) const {
  const auto it =
      std::find_if(handles_.begin(), handles_.end(), [&](const HandleRecord& h) { return &h == handle; });
  if (it != handles_.end() && it->kind == kind) return &*it;
  complain(RiError::kBadHandle, Severity::kError, request,
           handle ? "not a handle of this kind from this context" : "the handle is NULL");
  return nullptr;
}

// ---- numbers ----------------------------------------------------------------------------------------------

double decimal(RtFloat f) {
  if (f == std::floor(f) || !std::isfinite(f)) return double(f);
  char digits[32];
  const auto end = std::to_chars(digits, digits + sizeof digits, f).ptr;
  double d = double(f);
  std::from_chars(digits, end, d);
  return d;
}

// ---- parameter lists --------------------------------------------------------------------------------------

Tokens::Tokens(va_list arguments) {
  for (;;) {
    const RtToken token = va_arg(arguments, RtToken);
    if (!token) return;
    tokens_.push_back(token);
    values_.push_back(va_arg(arguments, RtPointer));
  }
}

ri::ParamList Context::params(const char* request, std::string_view category, RtInt n, RtToken const* tokens,
                              RtPointer const* values, const ri::ValueCounts& counts) {
  ri::ParamList list;
  for (RtInt i = 0; i < n; ++i) {
    if (!tokens[i]) {
      complain(RiError::kBadToken, Severity::kError, request, fmt::format("token {} is NULL", i));
      continue;
    }
    const Result<ri::ParsedToken> parsed = ri::parseToken(tokens[i]);
    if (!parsed) {
      complain(RiError::kBadToken, Severity::kError, request, parsed.error().message);
      continue;
    }
    ri::Param p;
    p.name = parsed->name;
    p.form = parsed->declaration ? ri::TokenForm::kInline : ri::TokenForm::kBare;
    const std::optional<ri::Declaration> d =
        parsed->declaration ? parsed->declaration : state().dictionary().find(p.name, category);
    if (!d) {
      complain(RiError::kBadToken, Severity::kError, request,
               fmt::format("\"{}\" was never declared; ignored", p.name));
      continue;
    }
    if (!values[i]) {
      complain(RiError::kMissingData, Severity::kError, request, fmt::format("\"{}\" has no value", p.name));
      continue;
    }
    p.declaration = *d;
    const size_t count = size_t(counts.of(d->storage)) * d->width();
    if (d->type == ri::ValueType::kString) {
      const auto* s = static_cast<RtString const*>(values[i]);
      for (size_t k = 0; k < count; ++k) p.strings.push_back(text(s[k]));
    } else if (d->type == ri::ValueType::kInteger) {
      const auto* v = static_cast<const RtInt*>(values[i]);
      p.ints.assign(v, v + count);
    } else {
      const auto* v = static_cast<const RtFloat*>(values[i]);
      p.floats.assign(v, v + count);
    }
    list.set(std::move(p));
  }
  return list;
}

}  // namespace fr::libri

using namespace fr;
using namespace fr::libri;

extern "C" {

RtVoid RiBegin(RtToken name) {
  guarded("RiBegin", [&] {
    installErrorHandler();
    if (theCurrent && !theCurrent->mayBeEnded())
      return complain(RiError::kNesting, Severity::kError, "RiBegin", "inside of a procedural; ignored");
    Result<std::unique_ptr<Context>> c = Context::open(name, formatOfNext);
    if (!c) return complain(c.error().code, Severity::kSevere, "RiBegin", c.error().message);
    adopt(std::move(*c));
  });
}

RtVoid RiEnd(void) {
  guarded("RiEnd", [&] {
    if (!theCurrent)
      return complain(RiError::kNotStarted, Severity::kError, "RiEnd", "RiBegin has not been called");
    if (!theCurrent->mayBeEnded())
      return complain(RiError::kNesting, Severity::kError, "RiEnd", "inside of a procedural; ignored");
    theCurrent->close();
    contexts().remove_if([](const auto& c) { return c.get() == theCurrent; });
    theCurrent = nullptr;
  });
}

RtContextHandle RiGetContext(void) { return theCurrent; }

RtVoid RiContext(RtContextHandle handle) {
  const auto it =
      std::find_if(contexts().begin(), contexts().end(), [&](const auto& c) { return c.get() == handle; });
  if (it == contexts().end())
    return complain(RiError::kBadHandle, Severity::kError, "RiContext", "there is no such context");
  theCurrent = it->get();
}

// Option "rib" says how files are written, before RiBegin too.
RtVoid RiOptionV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  guarded("RiOption", [&] {
    Context* c = current();
    if (text(name) == "rib") {
      RibFormat f = c ? c->format() : formatOfNext;
      for (RtInt i = 0; i < n; ++i) {
        if (!tokens[i] || !parms[i]) continue;
        const Result<ri::ParsedToken> t = ri::parseToken(tokens[i]);
        if (!t) continue;
        const auto value = [&] { return text(*static_cast<RtString const*>(parms[i])); };
        if (t->name == "format") f.binary = value() == "binary";
        if (t->name == "compression") f.gzip = value() == "gzip";
      }
      if (!c) {
        formatOfNext = f;
      } else if (c->writes() && !c->setFormat(f)) {
        complain(RiError::kNotOptions, Severity::kWarning, "RiOption",
                 "\"rib\" must come before the first request that is written");
      }
      return;
    }
    if (!(c = enter("RiOption"))) return;
    const ri::ParamList p = c->params("RiOption", text(name), n, tokens, parms);
    const auto call = [&](ri::Renderer& r) { r.option(text(name), p); };
    sendTracked("RiOption", call);
  });
}
RtVoid RiOption(RtToken name, ...) { FR_RI_LIST(name, RiOptionV(name, FR_RI_TAIL)); }

}  // extern "C"
