// Numbers and strings as RIB text.
#pragma once

#include <fmt/format.h>

#include <cmath>
#include <iterator>
#include <string>
#include <string_view>

namespace fr::ri {

/// The shortest text that reads back as the same number.
template <class T>
void appendNumber(std::string& to, T v) {
  if (std::isnan(v)) {
    to += "nan";
  } else {
    fmt::format_to(std::back_inserter(to), "{}", v);
  }
}

/// With quotes and escapes.
void appendQuoted(std::string& to, std::string_view s);

}  // namespace fr::ri
