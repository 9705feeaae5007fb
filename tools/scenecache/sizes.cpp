#include "tools/scenecache/sizes.h"

#include <cctype>
#include <charconv>

namespace fr::tools {

std::optional<uint64_t> parseBytes(std::string_view text) {
  double number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc{} || !(number > 0)) return std::nullopt;
  std::string_view unit(end, size_t(text.data() + text.size() - end));
  double scale = 1;
  if (!unit.empty()) {
    constexpr std::string_view kUnits = "BKMGT";
    const size_t power = kUnits.find(char(std::toupper(static_cast<unsigned char>(unit[0]))));
    if (power == std::string_view::npos) return std::nullopt;
    for (size_t i = 0; i < power; ++i) scale *= 1024;
    unit.remove_prefix(1);
    if (!unit.empty() && unit != "B" && unit != "b" && unit != "iB") return std::nullopt;
  }
  if (number * scale > 9e18) return std::nullopt;
  return uint64_t(number * scale);
}

}  // namespace fr::tools
