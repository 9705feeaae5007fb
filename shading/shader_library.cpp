#include "shading/shader_library.h"

#include <chrono>
#include <cstdlib>
#include <filesystem>

#include "base/install_folders.h"
#include "shading/shadeop_library.h"
#include "shading/slx.h"
#include "shading/source.h"

namespace fr {
namespace {

namespace fs = std::filesystem;

bool isFile(const std::string& path) {
  std::error_code ec;
  return fs::is_regular_file(path, ec);
}

std::string withoutExtension(const std::string& name) {
  for (const char* e : {".sl", ".slx", ".slo", ".slc", ".sdl", ".sdr"})
    if (name.size() > std::char_traits<char>::length(e) && name.ends_with(e))
      return name.substr(0, name.size() - std::char_traits<char>::length(e));
  return name;
}

/// True when a source that the program was compiled from has other bytes now. `source`: where its main file
/// is.
bool isStale(const ShaderProgram& p, const std::string& source) {
  for (size_t i = 0; i < p.files.size(); ++i) {
    if (p.fileHashes[i] == 0) continue;
    const std::string path = i == 0 ? source : p.files[i];
    if (!isFile(path)) continue;  // only the compiled shader was handed on
    Result<std::string> text = readSourceFile(path);
    if (!text || hashBytes(text->data(), text->size()) != p.fileHashes[i]) return true;
  }
  return false;
}

}  // namespace

std::vector<std::string> shaderPathFromEnvironment() {
  std::vector<std::string> folders;
  const char* value = std::getenv("SHADERS");
  if (!value) return folders;
  const std::string text(value);
  for (size_t begin = 0; begin <= text.size();) {
    const size_t end = std::min(text.find(':', begin), text.size());
    if (end > begin) folders.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return folders;
}

std::string standardShaderFolder() {
  std::error_code ec;
  const fs::path folder = fs::weakly_canonical(installedFile("share/frankenrender", "shaders"), ec);
  return !ec && fs::is_directory(folder, ec) ? folder.string() : "";
}

ShaderLibrary::ShaderLibrary(Options options) : options_(std::move(options)) {
  if (!options_.standardShaders.empty()) options_.compile.includePaths.push_back(options_.standardShaders);
}

Result<std::shared_ptr<const ShaderProgram>> ShaderLibrary::find(const std::string& name) {
  const std::string key = withoutExtension(name);
  std::promise<std::shared_ptr<const Found>> promise;
  std::shared_future<std::shared_ptr<const Found>> future;
  bool mine = false;
  {
    std::lock_guard lock(mutex_);
    auto it = cache_.find(key);
    if (it == cache_.end()) {
      mine = true;
      it = cache_.emplace(key, promise.get_future().share()).first;
    }
    future = it->second;
  }
  if (mine) promise.set_value(std::make_shared<const Found>(load(key)));
  return *future.get();
}

ShaderLibrary::Found ShaderLibrary::load(const std::string& name) {
  if (name.empty() || name.size() > 4096 || name.find('\0') != std::string::npos)
    return makeError(RiError::kNoShader, "'{}' is not a shader name", name.substr(0, 80));
  std::vector<std::string> stems;
  if (name.front() == '/') {
    stems.push_back(name);
  } else {
    for (const std::string& folder : options_.folders)
      stems.push_back(folder.empty() ? name : folder + "/" + name);
    if (name.find('/') != std::string::npos) stems.push_back(name);
    if (!options_.standardShaders.empty()) stems.push_back(options_.standardShaders + "/" + name);
  }
  for (const std::string& stem : stems) {
    bool exists = false;
    Found f = tryFolder(stem, exists);
    if (exists) return f;
  }
  // Scenes name the folders of the machines they were made on.
  if (const size_t slash = name.find_last_of("/\\"); slash != std::string::npos && slash + 1 < name.size()) {
    const std::string last = name.substr(slash + 1);
    if (Found f = load(last); f || f.error().code != RiError::kNoShader) {
      reportWarning(RiError::kNoShader, "there is no shader '{}'; '{}' of the search path is used instead",
                    name, last);
      return f;
    }
  }
  std::string where;
  for (const std::string& folder : options_.folders) where += (where.empty() ? "" : ":") + folder;
  return makeError(RiError::kNoShader, "there is no shader '{}' (searched: {}{}the standard shaders)", name,
                   where, where.empty() ? "" : " and ");
}

ShaderLibrary::Found ShaderLibrary::tryFolder(const std::string& stem, bool& exists) {
  const std::string slx = stem + ".slx", sl = stem + ".sl";
  const bool haveSource = isFile(sl);
  exists = true;
  if (isFile(slx)) {
    Result<ShaderProgram> p = readSlxFile(slx);
    if (p && !(haveSource && isStale(*p, sl))) {
      if (Result<void> bound = bindShadeops(*p, shadeopFolders(slx)); !bound) return std::move(bound).error();
      std::lock_guard lock(mutex_);
      statistics_.loaded++;
      return std::make_shared<const ShaderProgram>(std::move(*p));
    }
    if (!p && !haveSource) return std::move(p).error();
    if (!p)
      report(Error{
          p.error().code, Severity::kWarning, {}, p.error().message + "; compiling the source instead"});
  }
  if (haveSource) return compile(sl, slx);
  exists = false;
  return makeError(RiError::kNoShader, "no '{}'", stem);
}

std::vector<std::string> ShaderLibrary::shadeopFolders(const std::string& shader) const {
  std::vector<std::string> r = options_.compile.shadeopPaths;
  r.insert(r.end(), options_.folders.begin(), options_.folders.end());
  r.push_back(fs::path(shader).parent_path().string());
  if (!options_.standardShaders.empty()) r.push_back(options_.standardShaders);
  return r;
}

ShaderLibrary::Found ShaderLibrary::compile(const std::string& path, const std::string& slxPath) {
  const auto start = std::chrono::steady_clock::now();
  CompileOptions options = options_.compile;
  // Headers stand beside the shader, or anywhere on the shader path.
  options.includePaths.insert(options.includePaths.begin(), options_.folders.begin(), options_.folders.end());
  options.includePaths.insert(options.includePaths.begin(), fs::path(path).parent_path().string());
  options.shadeopPaths = shadeopFolders(path);
  Diagnostics diagnostics;
  Result<ShaderProgram> p = compileShaderFile(path, options, diagnostics);
  {
    std::lock_guard lock(mutex_);
    statistics_.loaded++;
    statistics_.compiled++;
    statistics_.compileSeconds +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  for (const Diagnostic& d : diagnostics.all()) report(Error{d.code, d.severity, d.where, d.message});
  // The reasons have been given.
  if (!p) return makeError(p.error().code, "shader '{}' cannot be compiled", path);
  if (options_.writeCompiled) (void)writeSlxFile(slxPath, *p).ok();
  return std::make_shared<const ShaderProgram>(std::move(*p));
}

ShaderLibrary::Statistics ShaderLibrary::statistics() const {
  std::lock_guard lock(mutex_);
  return statistics_;
}

}  // namespace fr
