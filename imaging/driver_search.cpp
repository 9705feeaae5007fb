#include "imaging/driver_search.h"

#include <dlfcn.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <map>
#include <mutex>
#include <string_view>
#include <utility>

#include "base/install_folders.h"

namespace fr {
namespace {

std::string fileName(const std::string& folder, const std::string& name) {
  return folder + "/fr_display_" + name + ".so";
}

bool hasDriver(const std::string& name, const std::vector<std::string>& searchPath) {
  if (name.empty() || name.find('/') != std::string::npos) return false;
  return std::any_of(searchPath.begin(), searchPath.end(),
                     [&](const std::string& f) { return ::access(fileName(f, name).c_str(), R_OK) == 0; });
}

using Names = std::pair<std::string_view, std::string_view>;
/// Extensions and display types of files, and OpenImageIO's name for the format.
constexpr std::array<Names, 25> kFormats = {{
    {"exr", "openexr"}, {"openexr", "openexr"}, {"tif", "tiff"},  {"tiff", "tiff"}, {"tx", "tiff"},
    {"png", "png"},     {"jpg", "jpeg"},        {"jpeg", "jpeg"}, {"tga", "targa"}, {"targa", "targa"},
    {"bmp", "bmp"},     {"hdr", "hdr"},         {"rgbe", "hdr"},  {"ppm", "pnm"},   {"pgm", "pnm"},
    {"pnm", "pnm"},     {"sgi", "sgi"},         {"rla", "rla"},   {"dpx", "dpx"},   {"jp2", "jpeg2000"},
    {"webp", "webp"},   {"pfm", "pnm"},         {"gif", "gif"},   {"iff", "iff"},   {"rgb", "sgi"},
}};
constexpr std::array<std::string_view, 4> kDepthTypes = {"zfile", "z", "shadow", "deepshad"};
constexpr std::array<std::string_view, 9> kWindowTypes = {"framebuffer", "it",           "x11",
                                                          "windows",     "sprite",       "houdini",
                                                          "idisplay",    "zframebuffer", "rgbaframebuffer"};

std::string_view formatNamed(std::string_view name) {
  for (const auto& [known, format] : kFormats)
    if (known == name) return format;
  return {};
}

std::string extensionOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  const size_t dot = path.rfind('.');
  if (dot == std::string::npos || (slash != std::string::npos && dot < slash)) return {};
  std::string e = path.substr(dot + 1);
  std::transform(e.begin(), e.end(), e.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return e;
}

/// Display type "null": the image goes nowhere.
const FrDisplayDriver kNullDriver = {
    FR_DISPLAY_ABI,
    0,
    1u << FR_DISPLAY_U8 | 1u << FR_DISPLAY_U16 | 1u << FR_DISPLAY_U32 | 1u << FR_DISPLAY_FLOAT,
    [](const FrDisplayImage*, void** handle, char*, size_t) {
      static char nothing;
      *handle = &nothing;
      return 0;
    },
    [](void*, int, int, int, int, const void*, size_t, char*, size_t) { return 0; },
    [](void*, int, char*, size_t) { return 0; }};

void addList(std::vector<std::string>& to, const char* list) {
  if (!list) return;
  std::string_view rest = list;
  while (!rest.empty()) {
    const size_t colon = std::min(rest.find(':'), rest.size());
    if (colon > 0) to.emplace_back(rest.substr(0, colon));
    rest.remove_prefix(std::min(colon + 1, rest.size()));
  }
}

}  // namespace

bool isDepthDisplay(std::string_view type) {
  return type == "zframebuffer" ||
         std::find(kDepthTypes.begin(), kDepthTypes.end(), type) != kDepthTypes.end();
}

DisplayTarget resolveDisplayType(const std::string& type, const std::string& name,
                                 const std::vector<std::string>& searchPath) {
  DisplayTarget t;
  t.path = name.empty() ? "ri.tif" : name;
  const auto isOneOf = [&](const auto& list) {
    return std::find(list.begin(), list.end(), type) != list.end();
  };
  if (type == "null") {
    t.driver = type;
    return t;
  }
  t.isDepth = isDepthDisplay(type);
  std::string format(formatNamed(type));
  if (format.empty()) {
    const bool isFile = type.empty() || type == "file" || isOneOf(kDepthTypes);
    if (!isFile && hasDriver(type, searchPath)) {
      t.driver = type;
      return t;
    }
    format = formatNamed(extensionOf(t.path));
    if (!isFile) {
      if (format.empty()) t.path += ".tif";
      const char* why = isOneOf(kWindowTypes) ? "shows no window" : "is unknown";
      reportOnce(
          "display type " + type,
          Error{RiError::kIncapable,
                isOneOf(kWindowTypes) ? Severity::kInfo : Severity::kWarning,
                {},
                fmt::format("display type \"{}\" {}: the image goes to the file {}", type, why, t.path)});
    }
    if (format.empty()) format = "tiff";
  }
  t.fileFormat = format;
  t.driver = format == "openexr" ? "exr" : format == "tiff" || format == "png" ? format : "oiio";
  return t;
}

std::vector<std::string> displaySearchPath(const std::vector<std::string>& paths) {
  std::vector<std::string> all;
  for (const std::string& p : paths) addList(all, p.c_str());
  addList(all, std::getenv("FRANKENRENDER_DISPLAYS"));
  addList(all, std::getenv("DISPLAYS"));
  for (std::string& folder : installedFolders("lib/frankenrender/displays")) all.push_back(std::move(folder));
  return all;
}

Result<const FrDisplayDriver*> openDisplayDriver(const std::string& name,
                                                 const std::vector<std::string>& searchPath) {
  if (name.empty() || name.find('/') != std::string::npos)
    return makeError(RiError::kNoFile, "\"{}\" cannot be the name of a display driver", name);
  if (name == "null") return &kNullDriver;
  static std::mutex mutex;
  static std::map<std::string, const FrDisplayDriver*> open;
  const std::lock_guard lock(mutex);
  for (const std::string& folder : searchPath) {
    const std::string file = fileName(folder, name);
    if (const auto known = open.find(file); known != open.end()) return known->second;
    if (::access(file.c_str(), R_OK) != 0) continue;
    void* module = ::dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!module) return makeError(RiError::kSystem, "display driver {}: {}", file, ::dlerror());
    const auto entry = reinterpret_cast<FrDisplayEntry>(::dlsym(module, FR_DISPLAY_ENTRY));
    if (!entry)
      return makeError(RiError::kVersion, "display driver {} has no function " FR_DISPLAY_ENTRY, file);
    const FrDisplayDriver* driver = entry();
    if (!driver || driver->abi != FR_DISPLAY_ABI || !driver->open || !driver->write || !driver->close)
      return makeError(RiError::kVersion, "display driver {} is of another version", file);
    open.emplace(file, driver);
    return driver;
  }
  std::string searched;
  for (const std::string& folder : searchPath) searched += (searched.empty() ? "" : ":") + folder;
  return makeError(RiError::kNoFile, "no display driver fr_display_{}.so in {}", name, searched);
}

}  // namespace fr
