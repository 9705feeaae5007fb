// What the mode string of RiDisplay asks for.
#pragma once

#include <string>
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

}  // namespace fr
