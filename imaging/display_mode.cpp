#include "imaging/display_mode.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <sstream>
#include <string_view>

namespace fr {
namespace {

constexpr std::array<std::string_view, 14> kScalars = {
    "s", "t", "u", "v", "du", "dv", "time", "alpha", "depth", "Kr", "area", "facing", "mask", "occlusion"};
constexpr int kMostComponents = 64;
constexpr std::array<std::string_view, 3> kVectorSuffix = {"R", "G", "B"};

int componentsOf(const std::vector<std::string>& words) {
  for (const std::string& w : words) {
    const size_t bracket = w.find('[');
    const std::string_view type = std::string_view(w).substr(0, bracket);
    int length = 1;  // "float[2] st"
    if (bracket != std::string::npos) std::from_chars(w.data() + bracket + 1, w.data() + w.size(), length);
    length = std::clamp(length, 1, kMostComponents);
    if (type == "float" || type == "integer" || type == "int") return length;
    if (type == "color" || type == "point" || type == "vector" || type == "normal")
      return std::min(3 * length, kMostComponents);
    if (type == "hpoint") return 4;
    if (type == "matrix") return 16;
  }
  return std::find(kScalars.begin(), kScalars.end(), words.back()) != kScalars.end() ? 1 : 3;
}

std::vector<std::string> wordsOf(const std::string& item) {
  std::istringstream in(item);
  std::vector<std::string> words;
  for (std::string w; in >> w;) words.push_back(w);
  return words;
}

/// A word of "rgb", "a", "z", each at most once and in this order.
bool isFixed(std::string_view name) {
  if (name.starts_with("rgb")) name.remove_prefix(3);
  if (name.starts_with("a")) name.remove_prefix(1);
  if (name.starts_with("z")) name.remove_prefix(1);
  return name.empty();
}

}  // namespace

std::vector<std::string> splitDisplayMode(const std::string& text) {
  std::string all = text;
  std::replace(all.begin(), all.end(), '+', ',');
  std::istringstream list(all);
  std::vector<std::string> items;
  for (std::string item; std::getline(list, item, ',');) {
    std::string joined;
    for (const std::string& w : wordsOf(item)) joined += (joined.empty() ? "" : " ") + w;
    if (!joined.empty()) items.push_back(std::move(joined));
  }
  return items;
}

bool isVariableOfMode(std::string_view name) { return !isFixed(name) && name != "Ci" && name != "Oi"; }

DisplayMode parseDisplayMode(const std::string& text) {
  DisplayMode mode;
  const std::vector<std::string> items = splitDisplayMode(text);
  for (const std::string& item : items) {
    const std::vector<std::string> words = wordsOf(item);
    const std::string& name = words.back();
    if (isFixed(name)) {
      const std::string_view own = "RGBAZ";
      for (char c : name) {
        const std::string channel(1, char(c - 'a' + 'A'));
        mode.channels.push_back({channel, "", int(own.find(channel[0]))});
      }
    } else if (name == "Ci" || name == "Oi") {
      // The composited colour; the opacity channels are one alpha here. Beside others they keep their names.
      const bool alone = items.size() == 1 || name == "Ci";
      for (int i = 0; i < 3; ++i) {
        const std::string channel(kVectorSuffix[size_t(i)]);
        mode.channels.push_back({alone ? channel : name + "." + channel, "", name == "Ci" ? i : 3});
      }
    } else {
      const int n = componentsOf(words);
      const bool alone = items.size() == 1;
      for (int i = 0; i < n; ++i) {
        const std::string suffix = n == 1   ? "Y"
                                   : n == 3 ? std::string(kVectorSuffix[size_t(i)])
                                            : fmt::format("{}", i);
        const std::string channel = n == 1 && !alone  ? name
                                    : alone && n <= 3 ? suffix
                                                      : fmt::format("{}.{}", name, suffix);
        mode.channels.push_back({channel, name, i});
      }
    }
  }
  // A name can be in a file once.
  std::vector<DisplayMode::Channel> once;
  for (DisplayMode::Channel& c : mode.channels)
    if (std::none_of(once.begin(), once.end(), [&](const auto& o) { return o.name == c.name; }))
      once.push_back(std::move(c));
  mode.channels = std::move(once);
  if (mode.channels.empty()) return parseDisplayMode("rgba");
  return mode;
}

}  // namespace fr
