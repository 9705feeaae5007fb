// slc: compiles RenderMan shaders to .slx.
#include <sys/utsname.h>

#include <CLI/CLI.hpp>
#include <cctype>
#include <cstdio>
#include <filesystem>

#include "shading/compile.h"
#include "shading/shader_library.h"
#include "shading/slx.h"
#include "shading/source.h"

namespace {

struct Settings {
  std::vector<std::string> files, includePaths, defines, undefines;
  std::string output;
  bool lint = false, noWarnings = false, quiet = false;
};

/// 0, or 1 when this file could not be compiled or written.
int compileOne(const std::string& file, const Settings& s) {
  fr::Diagnostics diagnostics;
  auto text = fr::readSourceFile(file);
  if (!text) {
    std::fprintf(stderr, "slc: %s\n", text.error().message.c_str());
    return 1;
  }
  fr::CompileOptions options;
  options.includePaths = s.includePaths;
  options.defines = s.defines;
  for (const std::string& name : s.undefines) options.defines.push_back("!" + name);
  options.lint = s.noWarnings ? fr::Lint::kNone : s.lint ? fr::Lint::kAll : fr::Lint::kCommon;
  options.shadeopPaths = s.includePaths;
  options.shadeopPaths.push_back(std::filesystem::path(file).parent_path().string());
  options.shadeopPaths.push_back(".");
  auto programs = fr::compileShaders(file, *text, options, diagnostics);
  for (const fr::Diagnostic& d : diagnostics.all())
    if (d.severity >= fr::Severity::kError || !(s.quiet || s.noWarnings)) std::fputs(d.str().c_str(), stderr);
  if (const size_t more = diagnostics.errorCount() + diagnostics.warningCount() - diagnostics.all().size())
    std::fprintf(stderr, "and %zu more messages\n", more);
  if (!programs) return 1;
  if (!s.output.empty() && programs->size() > 1) {
    std::fprintf(stderr, "slc: '%s' holds %zu shaders: -o names only one file\n", file.c_str(),
                 programs->size());
    return 1;
  }
  int status = 0;
  for (const fr::ShaderProgram& p : *programs) {
    const std::string path = s.output.empty() ? p.name + ".slx" : s.output;
    if (auto r = fr::writeSlxFile(path, p); !r) {
      std::fprintf(stderr, "slc: %s\n", r.error().message.c_str());
      status = 1;
    } else if (!s.quiet) {
      std::fprintf(stderr, "%s: %s shader '%s', %zu instructions\n", path.c_str(), fr::shaderTypeName(p.type),
                   p.name.c_str(), p.code.size());
    }
  }
  return status;
}

/// -arch: the platform's code, as rendrib has it.
void printArchitecture() {
  utsname u{};
  uname(&u);
  std::string system = u.sysname;
  for (char& c : system) c = char(std::tolower(static_cast<unsigned char>(c)));
  std::printf("%s-%s\n", system.c_str(), u.machine);
}

}  // namespace

int main(int argc, char** argv) {
  Settings s;
  bool arch = false, native = false;
  CLI::App app{
      "Compiles RenderMan Shading Language sources to .slx files, one for each shader, in this folder.",
      "slc"};
  app.add_option("files", s.files, "shader sources (.sl)");
  app.add_option("-o,--output", s.output, "name of the compiled file (one shader only)");
  app.add_option("-I", s.includePaths,
                 "folder for #include and for shared objects with functions; may be repeated")
      ->allow_extra_args(false);
  app.add_option("-D", s.defines, "macro NAME or NAME=VALUE; may be repeated")->allow_extra_args(false);
  app.add_option("-U", s.undefines, "no predefined macro NAME; may be repeated")->allow_extra_args(false);
  app.add_flag("-W,--warnings", s.lint,
               "all warnings: also unused variables, points used as vectors, hidden names ...");
  app.add_flag("-w,--no-warnings", s.noWarnings, "no warnings at all");
  app.add_flag("-q,--quiet", s.quiet, "print errors only");
  app.add_flag("--arch", arch, "print the platform's code (also -arch)");
  app.add_flag("--dso", native, "accepted for BMRT's makefiles: there is nothing to link (also -dso)");
  app.set_version_flag("--version", "slc (frankenrender) " FR_VERSION);
  app.footer(
      "Warnings are given for what is most likely wrong; `#pragma nolint [n]` silences those of the next n "
      "lines.\nFRANKENRENDER and BMRT are defined as 1. Exit status: 0 compiled, 1 errors in a source, 2 "
      "wrong usage.");
  // The options of BMRT's slc that are words behind one dash.
  std::vector<std::string> words;
  for (int i = argc - 1; i > 0; --i) {
    const std::string_view word = argv[i];
    words.push_back(word == "-arch" || word == "-dso" ? "-" + std::string(word) : std::string(word));
  }
  try {
    app.parse(words);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (arch) {
    printArchitecture();
    return 0;
  }
  if (s.files.empty()) {
    std::fprintf(stderr, "slc: no shader source is named; see slc --help\n");
    return 2;
  }
  if (!s.output.empty() && s.files.size() > 1) {
    std::fprintf(stderr, "slc: -o goes with one source file\n");
    return 2;
  }
  if (native)
    std::fprintf(stderr, "slc: -dso: compiled shaders are portable, they run at full speed as they are\n");
  const std::string standard = fr::standardShaderFolder();
  if (!standard.empty()) s.includePaths.push_back(standard);
  int status = 0;
  for (const std::string& f : s.files) status = std::max(status, compileOne(f, s));
  return status;
}
