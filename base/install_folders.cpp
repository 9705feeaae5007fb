#include "base/install_folders.h"

#include <dlfcn.h>
#include <unistd.h>

#include <array>
#include <climits>

namespace fr {
namespace {

std::string folderOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  return slash == std::string::npos ? "." : path.substr(0, slash);
}

std::string programFolder() {
  std::array<char, PATH_MAX> buffer{};
  const ssize_t n = ::readlink("/proc/self/exe", buffer.data(), buffer.size() - 1);
  return n > 0 ? folderOf(std::string(buffer.data(), size_t(n))) : std::string();
}

/// Of the shared library that this function is in; "" in a program.
std::string libraryFolder() {
  Dl_info info{};
  if (::dladdr(reinterpret_cast<const void*>(&libraryFolder), &info) == 0 || !info.dli_fname) return {};
  const std::string file = info.dli_fname;
  return file.find(".so") == std::string::npos ? std::string() : folderOf(file);
}

}  // namespace

std::vector<std::string> installedFolders(std::string_view relative) {
  std::vector<std::string> all;
  const std::string tail(relative);
  if (const std::string l = libraryFolder(); !l.empty()) {
    all.push_back(l + "/../" + tail);
    all.push_back(l + "/../../" + tail);
  }
  if (const std::string p = programFolder(); !p.empty()) all.push_back(p + "/../" + tail);
  return all;
}

std::string installedFile(std::string_view relative, std::string_view name) {
  const std::vector<std::string> folders = installedFolders(relative);
  for (const std::string& f : folders)
    if (std::string file = f + "/" + std::string(name); ::access(file.c_str(), R_OK) == 0) return file;
  return folders.empty() ? std::string(name) : folders.back() + "/" + std::string(name);
}

}  // namespace fr
