#include "ri/search_path.h"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <mutex>
#include <unordered_map>

namespace fr::ri {

namespace fs = std::filesystem;

namespace {

std::string expandEnvironment(std::string_view s) {
  std::string out;
  for (size_t i = 0; i < s.size(); ++i) {
    if (s[i] != '$') {
      out += s[i];
      continue;
    }
    const bool braces = i + 1 < s.size() && s[i + 1] == '{';
    size_t from = i + (braces ? 2 : 1), to = from;
    while (to < s.size() && (std::isalnum(static_cast<unsigned char>(s[to])) != 0 || s[to] == '_')) ++to;
    if (to == from || (braces && (to >= s.size() || s[to] != '}'))) {
      out += s[i];
      continue;
    }
    if (const char* v = std::getenv(std::string(s.substr(from, to - from)).c_str())) out += v;
    i = braces ? to : to - 1;
  }
  return out;
}

bool isDrive(std::string_view text, size_t from, size_t colon) {
  return colon == from + 1 && std::isalpha(static_cast<unsigned char>(text[from])) != 0 &&
         colon + 1 < text.size() && (text[colon + 1] == '/' || text[colon + 1] == '\\');
}

bool isFile(const std::filesystem::path& p) {
  std::error_code ec;
  return std::filesystem::exists(p, ec) && !std::filesystem::is_directory(p, ec) &&
         ::access(p.c_str(), R_OK) == 0;
}

std::string inLowerCase(std::string_view name) {
  std::string r(name);
  for (char& c : r)
    if (c >= 'A' && c <= 'Z') c = char(c + ('a' - 'A'));
  return r;
}

/// The names in a folder by what they are in lower case. Kept: a scene may look for thousands of files.
struct Listing {
  Listing() = default;
  explicit Listing(const fs::path& folder) : read(fs::file_time_type::clock::now()) {
    std::error_code error;
    changed = fs::last_write_time(folder, error);
    for (fs::directory_iterator i(folder, error), end; !error && i != end; i.increment(error)) {
      std::string name = i->path().filename().string();
      files[inLowerCase(name)].push_back(std::move(name));
    }
    // The first by name is taken: the order of a folder is no order.
    for (auto& [lower, names] : files) std::sort(names.begin(), names.end());
  }
  /// A folder that was read soon after a change may have changed again within one tick of its clock.
  bool isTrue(const fs::path& folder) const {
    std::error_code error;
    return changed == fs::last_write_time(folder, error) && changed + std::chrono::seconds(1) < read;
  }

  fs::file_time_type read = fs::file_time_type::min(), changed = fs::file_time_type::min();
  std::unordered_map<std::string, std::vector<std::string>> files;
};

}  // namespace

std::vector<std::string> parseSearchPath(std::string_view text, const std::vector<std::string>& previous,
                                         const std::vector<std::string>& standard) {
  std::vector<std::string> out;
  size_t from = 0;
  for (size_t i = 0; i <= text.size(); ++i) {
    const bool separator = i == text.size() || text[i] == ';' || (text[i] == ':' && !isDrive(text, from, i));
    if (!separator) continue;
    const std::string_view part = text.substr(from, i - from);
    from = i + 1;
    if (part == "&") {
      out.insert(out.end(), previous.begin(), previous.end());
    } else if (part == "@") {
      out.insert(out.end(), standard.begin(), standard.end());
    } else if (!part.empty()) {
      out.push_back(expandEnvironment(part));
    }
  }
  return out;
}

std::string findFile(std::string_view name, const std::vector<std::string>& folders) {
  const std::filesystem::path file{expandEnvironment(name)};
  if (file.empty()) return {};
  if (file.is_absolute()) return isFile(file) ? file.string() : std::string();
  for (const std::string& f : folders) {
    const std::filesystem::path p = f.empty() || f == "." ? file : std::filesystem::path(f) / file;
    if (isFile(p)) return p.string();
  }
  return isFile(file) ? file.string() : std::string();
}

std::string_view lastPart(std::string_view path) {
  const size_t slash = path.find_last_of("/\\");
  return slash == std::string_view::npos ? path : path.substr(slash + 1);
}

std::string findInOtherCase(std::string_view name, const std::vector<std::string>& folders) {
  static std::mutex mutex;
  static auto& listings = *new std::map<fs::path, Listing>;
  if (name.empty()) return {};
  const std::lock_guard lock(mutex);
  for (const std::string& f : folders) {
    std::error_code error;
    const fs::path folder = fs::absolute(f.empty() ? "." : f, error);
    if (error) continue;
    Listing& listing = listings[folder];
    if (!listing.isTrue(folder)) listing = Listing(folder);
    const auto found = listing.files.find(inLowerCase(name));
    if (found == listing.files.end()) continue;
    for (const std::string& file : found->second)
      if (isFile(folder / file)) return (fs::path(f.empty() ? "." : f) / file).string();
  }
  return {};
}

std::string findMovedFile(std::string_view name, const std::vector<std::string>& folders, bool& moved) {
  std::string found = findFile(name, folders);
  moved = false;
  const std::string_view last = lastPart(name);
  if (!found.empty()) return found;
  if (last.size() < name.size()) found = findFile(last, folders);
  if (found.empty()) found = findInOtherCase(last, folders);
  moved = !found.empty();
  return found;
}

}  // namespace fr::ri
