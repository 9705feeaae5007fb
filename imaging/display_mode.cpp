#include "imaging/display_mode.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <sstream>
#include <string_view>

namespace fr {
namespace {

constexpr std::array<std::string_view, 14> kScalars = {
    "s", "t", "u", "v", "du", "dv", "time", "alpha", "depth", "Kr", "area", "facing", "mask", "occlusion"};
constexpr std::array<std::string_view, 3> kVectorSuffix = {"R", "G", "B"};

int componentsOf(const std::vector<std::string>& words) {
  for (const std::string& w : words) {
    if (w == "float" || w == "integer" || w == "int") return 1;
    if (w == "color" || w == "point" || w == "vector" || w == "normal") return 3;
  }
  return std::find(kScalars.begin(), kScalars.end(), words.back()) != kScalars.end() ? 1 : 3;
}

}  // namespace

DisplayMode parseDisplayMode(const std::string& text) {
  DisplayMode mode;
  std::string all = text.empty() ? "rgba" : text;
  std::replace(all.begin(), all.end(), '+', ',');
  std::istringstream list(all);
  for (std::string item; std::getline(list, item, ',');) {
    std::istringstream in(item);
    std::vector<std::string> words;
    for (std::string w; in >> w;) words.push_back(w);
    if (words.empty()) continue;
    const std::string& name = words.back();
    std::string_view rest = name;
    if (rest.starts_with("rgb")) rest.remove_prefix(3);
    if (rest.starts_with("a")) rest.remove_prefix(1);
    if (rest.starts_with("z")) rest.remove_prefix(1);
    if (rest.empty()) {
      const std::string_view own = "RGBAZ";
      for (char c : name) {
        const std::string channel(1, char(c - 'a' + 'A'));
        mode.channels.push_back({channel, "", int(own.find(channel[0]))});
      }
    } else if (name == "Ci" || name == "Oi") {
      // The composited colour; the opacity channels are one alpha here.
      for (int i = 0; i < 3; ++i)
        mode.channels.push_back({std::string(kVectorSuffix[size_t(i)]), "", name == "Ci" ? i : 3});
    } else {
      const int n = componentsOf(words);
      const bool alone = mode.channels.empty() && list.eof();
      for (int i = 0; i < n; ++i) {
        const std::string_view suffix = n == 1 ? std::string_view("Y") : kVectorSuffix[size_t(i)];
        const std::string channel = alone    ? std::string(suffix)
                                    : n == 1 ? name
                                             : fmt::format("{}.{}", name, suffix);
        mode.channels.push_back({channel, name, i});
      }
    }
  }
  if (mode.channels.empty()) return parseDisplayMode("rgba");
  return mode;
}

}  // namespace fr
