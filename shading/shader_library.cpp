#include "shading/shader_library.h"

#include <algorithm>
#include <cctype>
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

/// What stands in "surface name (": in code or in a comment, only a compiler could tell.
std::vector<std::string> definedShaders(std::string_view text) {
  const auto isWord = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; };
  const auto isBlank = [](char c) { return std::isspace(static_cast<unsigned char>(c)) != 0; };
  std::vector<std::string> names;
  for (size_t open = text.find('('); open != std::string_view::npos; open = text.find('(', open + 1)) {
    size_t end = open;
    while (end > 0 && isBlank(text[end - 1])) --end;
    size_t name = end;
    while (name > 0 && isWord(text[name - 1])) --name;
    size_t before = name;
    while (before > 0 && isBlank(text[before - 1])) --before;
    if (name == end || before == name) continue;
    size_t word = before;
    while (word > 0 && isWord(text[word - 1])) --word;
    for (const std::string_view type :
         {"surface", "light", "displacement", "volume", "imager", "transformation", "atmosphere", "class"})
      if (text.substr(word, before - word) == type) names.emplace_back(text.substr(name, end - name));
  }
  return names;
}

std::string inLowerCase(std::string_view name) {
  std::string r(name);
  for (char& c : r)
    if (c >= 'A' && c <= 'Z') c = char(c + ('a' - 'A'));
  return r;
}

/// Paths of the files of a folder with this ending, by name.
std::vector<std::string> filesIn(const std::string& folder, std::string_view ending) {
  std::vector<std::string> all;
  std::error_code error;
  for (fs::directory_iterator i(folder.empty() ? "." : folder, error), end; !error && i != end;
       i.increment(error))
    if (i->path().extension() == ending && isFile(i->path().string())) all.push_back(i->path().string());
  std::sort(all.begin(), all.end());
  return all;
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
  if (Found f = loadByContent(name); f || f.error().code != RiError::kNoShader) return f;
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

/// Reads the folders once: scenes ask for many shaders that are not there.
void ShaderLibrary::readFolders() {
  std::vector<std::string> folders = options_.folders;
  if (!options_.standardShaders.empty()) folders.push_back(options_.standardShaders);
  for (const std::string& folder : folders)
    for (const char* ending : {".slx", ".sl"})
      for (const std::string& path : filesIn(folder, ending)) {
        const fs::path stem = fs::path(path).replace_extension();
        stems_.emplace(inLowerCase(stem.filename().string()), stem.string());
        if (folder == options_.standardShaders || std::string_view(ending) != ".sl") continue;
        if (const Result<std::string> text = readSourceFile(path))
          for (std::string& name : definedShaders(*text)) sources_[std::move(name)].push_back(path);
      }
}

/// A source under another name that defines the shader, or a file whose name differs in case.
ShaderLibrary::Found ShaderLibrary::loadByContent(const std::string& name) {
  std::call_once(foldersRead_, [this] { readFolders(); });
  if (const auto sources = sources_.find(name); sources != sources_.end())
    for (const std::string& source : sources->second) {
      Found f = compile(source, {}, name);
      if (f || f.error().code != RiError::kNoShader) return f;  // else it stood in a comment
    }
  if (const auto stem = stems_.find(inLowerCase(name)); stem != stems_.end()) {
    reportWarning(RiError::kNoShader, "there is no shader '{}'; {} is used instead", name, stem->second);
    bool exists = false;
    return tryFolder(stem->second, exists);
  }
  return makeError(RiError::kNoShader, "no '{}'", name);
}

ShaderLibrary::Found ShaderLibrary::compile(const std::string& path, const std::string& slxPath,
                                            std::string_view name) {
  const auto start = std::chrono::steady_clock::now();
  CompileOptions options = options_.compile;
  // Headers stand beside the shader, or anywhere on the shader path.
  options.includePaths.insert(options.includePaths.begin(), options_.folders.begin(), options_.folders.end());
  options.includePaths.insert(options.includePaths.begin(), fs::path(path).parent_path().string());
  options.shadeopPaths = shadeopFolders(path);
  Diagnostics diagnostics;
  Result<ShaderProgram> p = compileShaderFile(path, options, diagnostics, name);
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
  if (options_.writeCompiled && !slxPath.empty()) (void)writeSlxFile(slxPath, *p).ok();
  return std::make_shared<const ShaderProgram>(std::move(*p));
}

ShaderLibrary::Statistics ShaderLibrary::statistics() const {
  std::lock_guard lock(mutex_);
  return statistics_;
}

}  // namespace fr
