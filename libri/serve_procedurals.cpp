#include "libri/serve_procedurals.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>

#include "libri/contexts.h"
#include "ri/reader.h"
#include "ri/rib_writer.h"

namespace fr::libri {
namespace {

/// RISpec 3.2, section 5.6; Subdivide2 is the later form of Procedural2.
struct SharedObject {
  RtPointer (*convertParameters)(char*) = nullptr;
  void (*subdivide)(RtPointer, RtFloat) = nullptr;
  void (*free)(RtPointer) = nullptr;
  void (*subdivide2)(RtContextHandle, RtFloat, RtInt, const RtToken*, const RtPointer*) = nullptr;
};

/// The state of one question, and its end: the request that is served.
class Question final : public ri::StateRenderer {
 public:
  explicit Question(std::function<void(const ri::Procedural&, float)> serve) : serve_(std::move(serve)) {}
  bool served() const { return served_; }
  void procedural(ri::Procedural p) override {
    served_ = true;
    serve_(p, state().options().values.getFloat("procedural:detail", kRiInfinity));
  }

 private:
  std::function<void(const ri::Procedural&, float)> serve_;
  bool served_ = false;
};

class ProceduralContext final : public WritingContext {
 public:
  ProceduralContext(const SharedObject& object, int answers)
      : object_(object), answers_(answers), writer_([this](std::string_view s) { write(s); }, options()) {}

  ri::StateRenderer& state() override { return *question_; }
  void close() override {}
  bool mayBeEnded() const override { return false; }
  /// Numbers are the scene's.
  std::string handlePrefix() const override { return "procedural " + std::to_string(::getpid()) + " "; }

  /// False at the end of the input.
  bool serveOne(int questions) {
    bool failed = false;
    question_ = std::make_unique<Question>(
        [&](const ri::Procedural& p, float detail) { failed = !answer(p, detail); });
    ri::Reader reader(*question_);
    const Result<void> read = reader.readDescriptor(questions, "<question>");
    return read.ok() && question_->served() && !failed && !broken_;
  }

 protected:
  ri::Renderer& renderer() override { return writer_; }

 private:
  static ri::RibWriterOptions options() {
    ri::RibWriterOptions o;
    o.binary = true;
    return o;
  }

  bool answer(const ri::Procedural& p, float detail) {
    if (p.kind == ri::ProceduralKind::kProcedural2) {
      if (!object_.subdivide2) return lacks("Subdivide2");
      subdivide2(p, detail);
    } else {
      if (!object_.convertParameters || !object_.subdivide || !object_.free)
        return lacks(!object_.convertParameters ? "ConvertParameters"
                     : !object_.subdivide       ? "Subdivide"
                                                : "Free");
      std::string data = p.data.size() > 1 ? p.data[1] : "";
      const RtPointer blind = object_.convertParameters(data.data());
      object_.subdivide(blind, detail);
      object_.free(blind);
    }
    writer_.flush();
    write("\377");
    return true;
  }
  void subdivide2(const ri::Procedural& p, float detail) {
    std::vector<std::string> names;
    std::vector<std::vector<const char*>> strings(p.params.size());
    std::vector<RtPointer> values;
    for (const ri::Param& v : p.params) {
      ri::Declaration plain = v.declaration;
      names.push_back(fmt::format("{}{} {}", ri::valueTypeName(plain.type),
                                  plain.isArray ? fmt::format("[{}]", plain.arrayLength) : "", v.name));
      std::vector<const char*>& s = strings[names.size() - 1];
      for (const std::string& text : v.strings) s.push_back(text.c_str());
      const void* data = !s.empty()        ? static_cast<const void*>(s.data())
                         : !v.ints.empty() ? static_cast<const void*>(v.ints.data())
                                           : static_cast<const void*>(v.floats.data());
      values.push_back(const_cast<RtPointer>(data));
    }
    std::vector<RtToken> tokens;
    for (const std::string& n : names) tokens.push_back(n.c_str());
    object_.subdivide2(this, detail, RtInt(tokens.size()), tokens.data(), values.data());
  }
  static bool lacks(const char* function) {
    complain(RiError::kBadFile, Severity::kError, "DynamicLoad",
             fmt::format("the shared object has no function {}", function));
    return false;
  }
  void write(std::string_view bytes) {
    while (!bytes.empty() && !broken_) {
      const ssize_t n = ::write(answers_, bytes.data(), bytes.size());
      if (n > 0) bytes.remove_prefix(size_t(n));
      if (n < 0 && errno != EINTR) broken_ = true;
    }
  }

  const SharedObject object_;
  const int answers_;
  bool broken_ = false;
  std::unique_ptr<Question> question_;
  ri::RibWriter writer_;
};

template <class F>
void find(void* library, const char* name, F* function) {
  *function = reinterpret_cast<F>(::dlsym(library, name));
}

}  // namespace
}  // namespace fr::libri

using namespace fr;
using namespace fr::libri;

extern "C" int RiServeProcedurals(int argc, char** argv) {
  int status = 0;
  guarded("DynamicLoad", [&] {
    status = 1;
    installErrorHandler();
    if (argc != 2)
      return complain(RiError::kSyntax, Severity::kError, "DynamicLoad", "one shared object is expected");
    const int questions = ::fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 3);
    const int answers = ::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 3);
    const int nothing = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
    if (questions < 0 || answers < 0 || nothing < 0) return;
    ::dup2(nothing, STDIN_FILENO);
    ::dup2(STDERR_FILENO, STDOUT_FILENO);
    void* library = ::dlopen(argv[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
      const char* why = ::dlerror();
      return complain(RiError::kBadFile, Severity::kError, "DynamicLoad", text(why));
    }
    SharedObject object;
    find(library, "ConvertParameters", &object.convertParameters);
    find(library, "Subdivide", &object.subdivide);
    find(library, "Free", &object.free);
    find(library, "Subdivide2", &object.subdivide2);
    auto owned = std::make_unique<ProceduralContext>(object, answers);
    ProceduralContext& context = *owned;
    adopt(std::move(owned));
    bool any = false;
    while (context.serveOne(questions)) any = true;
    status = any ? 0 : 1;
  });
  return status;
}
