// libFuzzer: any bytes through the preprocessor and the compiler. What compiles must be a valid program that
// survives being written and read.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

#include "shading/compile.h"
#include "shading/passes.h"
#include "shading/slx.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  fr::setReportSink([](const fr::Error&) {});
  fr::Diagnostics diagnostics;
  fr::CompileOptions options;
  options.lint = fr::Lint::kAll;
  const auto programs =
      fr::compileShaders("fuzz.sl", {reinterpret_cast<const char*>(data), size}, options, diagnostics);
  const auto fail = [](const std::string& what) {
    std::fprintf(stderr, "%s\n", what.c_str());
    std::abort();
  };
  if (programs.ok() == diagnostics.hasErrors()) fail("success and errors do not agree");
  for (const fr::Diagnostic& d : diagnostics.all())
    if (d.code == fr::RiError::kBug) fail(d.message);
  if (!programs) return 0;
  for (const fr::ShaderProgram& p : *programs) {
    if (auto r = fr::validate(p); !r) fail(r.error().message);
    const std::string bytes = fr::writeSlx(p);
    if (auto r = fr::readSlx(bytes); !r) fail(r.error().message);
  }
  return 0;
}
