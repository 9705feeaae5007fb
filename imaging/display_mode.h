// What the mode string of RiDisplay asks for.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace fr {

struct DisplayMode {
  struct Channel {
    std::string name;      // in the file: R G B A Z, or variable components
    std::string variable;  // "" for the renderer's own channels
    int component = 0;     // own channels: index 0..4 of R G B A Z
  };
  std::vector<Channel> channels;
};

/// Never fails: a word that is no combination of rgb, a, z is the name of a shader variable. "" is "rgba".
DisplayMode parseDisplayMode(const std::string& mode);

/// Its items, which "," or "+" part, with single blanks between words.
std::vector<std::string> splitDisplayMode(const std::string& mode);
/// True for the name of a shader variable: no combination of rgb, a, z, and not Ci or Oi.
bool isVariableOfMode(std::string_view name);

}  // namespace fr
