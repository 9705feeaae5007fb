// A context of the RenderMan Interface in C: where its requests go, and what it must remember between them.
#pragma once

#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <vector>

#include "ri/ri.h"
#include "ri/state_renderer.h"

namespace fr::libri {

/// Behind RtLightHandle, RtObjectHandle and RtArchiveHandle.
struct HandleRecord {
  enum class Kind { kLight, kObject, kArchive } kind;
  ri::Handle handle;
};

/// What RiOption "rib" has said.
struct RibFormat {
  bool binary = false, gzip = false;
};

/// Not thread-safe: one request at a time, as RISpec has it.
class Context {
 public:
  virtual ~Context() = default;

  /// `name` as of RiBegin. kNoFile when a RIB file cannot be written.
  static Result<std::unique_ptr<Context>> open(RtToken name, RibFormat format);

  /// Where requests go at the moment: the scene, the file, or an archive being recorded.
  ri::Renderer& out() { return recorder_ ? *recorder_ : renderer(); }
  /// Attributes, transformations and blocks, as far as out() is not a recorder.
  virtual ri::StateRenderer& state() = 0;
  /// True when the state is not kept by renderer() itself and has to be told apart.
  virtual bool writes() const = 0;
  bool recording() const { return recorder_ != nullptr; }
  /// RiEnd: finishes everything.
  virtual void close() = 0;
  /// False: RiBegin and RiEnd are not this program's to call.
  virtual bool mayBeEnded() const { return true; }

  /// Option "rib" inside the context; false: too late, or nothing is written.
  virtual bool setFormat(RibFormat) { return false; }
  virtual RibFormat format() const { return {}; }
  virtual void readArchive(const std::string& name, ri::ParamList params, RtArchiveCallback callback) = 0;
  /// RIB text into the stream of requests.
  virtual void verbatim(std::string text) = 0;
  virtual void archiveBegin(ri::Handle name, ri::ParamList params) = 0;
  virtual void archiveEnd() = 0;

  // Conditions, where they are obeyed and not written.
  bool skipping() const { return !branches_.empty() && !branches_.back().active; }
  void ifBegin(const char* condition);
  void elseIf(const char* condition);
  void elseBranch();
  void ifEnd();

  /// What the numbers of handles stand behind; not empty: handles are strings.
  virtual std::string handlePrefix() const { return {}; }
  HandleRecord* newHandle(HandleRecord::Kind kind, std::optional<ri::Handle> name = {});
  /// nullptr, with RIE_BADHANDLE, for what is no handle of this kind from this context.
  const HandleRecord* findHandle(const char* request, const void* handle, HandleRecord::Kind kind) const;

  /// Values of a parameter list. `category` as in ri::Dictionary::find; `counts`: values a storage class.
  /// What is not declared or has no value is reported and left out.
  ri::ParamList params(const char* request, std::string_view category, RtInt n, RtToken const* tokens,
                       RtPointer const* values, const ri::ValueCounts& counts = {});

 protected:
  virtual ri::Renderer& renderer() = 0;
  std::unique_ptr<ri::Renderer> recorder_;

 private:
  struct Branch {
    bool taken, active, enclosing;
  };
  bool condition(const char* text);
  std::deque<HandleRecord> handles_;
  int numbers_ = 0;
  std::vector<Branch> branches_;
};

/// The context whose turn it is; nullptr outside RiBegin ... RiEnd.
Context* current();

void complain(RiError code, Severity severity, const char* request, std::string message);
/// Reports nothing and returns the context when `request` may be executed; else nullptr.
Context* enter(const char* request);

/// No exception leaves a C function.
template <class F>
void guarded(const char* request, F&& f) noexcept {
  try {
    f();
  } catch (const std::bad_alloc&) {
    complain(RiError::kNoMem, Severity::kSevere, request, "out of memory");
  } catch (const std::exception& e) {
    complain(RiError::kBug, Severity::kSevere, request, e.what());
  }
}

/// f(Context&), unless there is no context or a condition leaves the request out.
template <class F>
void withContext(const char* request, F&& f) noexcept {
  guarded(request, [&] {
    if (Context* c = enter(request)) f(*c);
  });
}
/// f(Renderer&) for requests that change nothing that RIB writing needs to know.
template <class F>
void send(const char* request, F&& f) noexcept {
  withContext(request, [&](Context& c) { f(c.out()); });
}
/// f(Renderer&) for requests that change blocks, transformations, the camera or declarations: also for the
/// state that is kept beside a file. `silent`: that state reports nothing.
void track(Context& c, bool silent, const std::function<void(ri::Renderer&)>& call);
template <class F>
void sendTracked(const char* request, F&& f, bool silent = true) noexcept {
  withContext(request, [&](Context& c) {
    f(c.out());
    track(c, silent, [&f](ri::Renderer& r) { f(r); });
  });
}

/// The double that reads as the same decimal number: 0.3f is 0.3, in RIB and in the renderer alike.
double decimal(RtFloat f);

inline std::string text(const char* s) { return s ? s : ""; }

/// The pairs of a variable argument list.
class Tokens {
 public:
  explicit Tokens(va_list arguments);
  RtInt count() const { return RtInt(tokens_.size()); }
  RtToken* tokens() { return tokens_.data(); }
  RtPointer* values() { return values_.data(); }

 private:
  std::vector<RtToken> tokens_;
  std::vector<RtPointer> values_;
};

// Inside a function `f(..., last, ...)`: the call of its V form.
#define FR_RI_LIST(last, call)         \
  va_list arguments;                   \
  va_start(arguments, last);           \
  ::fr::libri::Tokens list(arguments); \
  va_end(arguments);                   \
  return call
#define FR_RI_TAIL list.count(), list.tokens(), list.values()

/// Makes every report go to the RiErrorHandler.
void installErrorHandler();

/// Name of one of the Ri...Filter functions; "gaussian" and a warning for others.
std::string filterNameOf(const char* request, RtFilterFunc f);

}  // namespace fr::libri
