// Where the parts of an installation lie, relative to the code that is running.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace fr {

/// Folders "<prefix>/<relative>", best first: <prefix> is one folder above the program's, or, when this code
/// runs inside of a shared library of another program, one and two folders above the library's. They need not
/// exist.
std::vector<std::string> installedFolders(std::string_view relative);
/// The first of them that holds a file or folder `name`, with the name; else what it would be for the program.
std::string installedFile(std::string_view relative, std::string_view name);

}  // namespace fr
