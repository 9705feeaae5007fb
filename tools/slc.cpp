// slc: compiles RenderMan shaders to .slx.
#include <CLI/CLI.hpp>

#include <cstdio>
#include <filesystem>

#include "shading/compile.h"
#include "shading/shader_library.h"
#include "shading/slx.h"
#include "shading/source.h"

namespace {

struct Settings {
  std::vector<std::string> files, includePaths, defines;
  std::string output;
  bool lint = false, quiet = false;
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
  options.lint = s.lint;
  options.shadeopPaths = s.includePaths;
  options.shadeopPaths.push_back(std::filesystem::path(file).parent_path().string());
  options.shadeopPaths.push_back(".");
  auto programs = fr::compileShaders(file, *text, options, diagnostics);
  if (!s.quiet || diagnostics.hasErrors()) std::fputs(diagnostics.str().c_str(), stderr);
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

}  // namespace

int main(int argc, char** argv) {
  Settings s;
  CLI::App app{
      "Compiles RenderMan Shading Language sources to .slx files, one for each shader, in this folder.",
      "slc"};
  app.add_option("files", s.files, "shader sources (.sl)")->required();
  app.add_option("-o,--output", s.output, "name of the compiled file (one shader only)");
  app.add_option("-I", s.includePaths, "folder for #include and for shared objects with functions; may be repeated")->allow_extra_args(false);
  app.add_option("-D", s.defines, "macro NAME or NAME=VALUE; may be repeated")->allow_extra_args(false);
  app.add_flag("-W,--warnings", s.lint,
               "more warnings: unused and uninitialised variables, undefined derivatives ...");
  app.add_flag("-q,--quiet", s.quiet, "print errors only");
  app.set_version_flag("--version", "slc (frankenrender) " FR_VERSION);
  app.footer(
      "FRANKENRENDER and BMRT are defined as 1. Exit status: 0 compiled, 1 errors in a source, 2 wrong "
      "usage.");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (!s.output.empty() && s.files.size() > 1) {
    std::fprintf(stderr, "slc: -o goes with one source file\n");
    return 2;
  }
  const std::string standard = fr::standardShaderFolder();
  if (!standard.empty()) s.includePaths.push_back(standard);
  int status = 0;
  for (const std::string& f : s.files) status = std::max(status, compileOne(f, s));
  return status;
}
