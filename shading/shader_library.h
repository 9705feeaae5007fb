// Finds shaders by name: compiled files, or sources that are compiled in memory.
#pragma once

#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "shading/compile.h"

namespace fr {

/// Folders of the environment variable SHADERS, separated by ':'.
std::vector<std::string> shaderPathFromEnvironment();
/// Folder of the shaders that come with the program: ../share/frankenrender/shaders from the executable; ""
/// when there is none.
std::string standardShaderFolder();

/// Thread safety: all functions may be called by any thread; two threads that ask for one shader compile it
/// once.
class ShaderLibrary {
 public:
  struct Options {
    std::vector<std::string> folders;  // searched in order
    std::string standardShaders;       // searched last, also for #include
    CompileOptions compile;
    bool writeCompiled = false;  // put the .slx beside the source; failures to do so are ignored
  };
  explicit ShaderLibrary(Options options);

  /// A source may also have another name than the shader that it defines, and names of files may differ in
  /// case. "name", "folder/name", "/absolute/name", each also with .sl, .slx or the extensions of other
  /// renderers
  /// (.slo, .slc, .sdl, .sdr), which stand for the name alone. A .slx older than its source (by content) is
  /// not used. Errors: kNoShader when there is no such shader; else what is wrong with it, after all compiler
  /// messages were reported. Failures are remembered too: one message for one broken shader.
  Result<std::shared_ptr<const ShaderProgram>> find(const std::string& name);

  struct Statistics {
    size_t loaded = 0, compiled = 0;
    double compileSeconds = 0;
  };
  Statistics statistics() const;

 private:
  using Found = Result<std::shared_ptr<const ShaderProgram>>;
  Found load(const std::string& name);
  Found tryFolder(const std::string& stem, bool& exists);
  Found compile(const std::string& path, const std::string& slxPath, std::string_view name = {});
  Found loadByContent(const std::string& name);
  void readFolders();
  std::vector<std::string> shadeopFolders(const std::string& shader) const;

  Options options_;
  mutable std::mutex mutex_;
  std::map<std::string, std::shared_future<std::shared_ptr<const Found>>> cache_;
  Statistics statistics_;
  std::once_flag foldersRead_;
  std::map<std::string, std::vector<std::string>> sources_;  // by the shader that they seem to define
  std::map<std::string, std::string> stems_;  // paths without their endings, by their names in lower case
};

}  // namespace fr
