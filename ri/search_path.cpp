#include "ri/search_path.h"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>

namespace fr::ri {
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
  if (name.empty()) return {};
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? char(c + ('a' - 'A')) : c; };
  for (const std::string& f : folders) {
    std::error_code error;
    // The first by name: the order of a folder is no order.
    std::string best;
    for (std::filesystem::directory_iterator i(f.empty() ? "." : f, error), end; !error && i != end;
         i.increment(error)) {
      const std::string here = i->path().filename().string();
      if (std::ranges::equal(here, name, {}, lower, lower) && isFile(i->path()) &&
          (best.empty() || here < best))
        best = here;
    }
    if (!best.empty()) return (std::filesystem::path(f.empty() ? "." : f) / best).string();
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
