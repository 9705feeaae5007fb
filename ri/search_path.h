// Lists of folders, as Option "searchpath" gives them.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace fr::ri {

/// Splits "a:b:&" into folders. "&" stands for the `previous` list, "@" for the `standard` one; $NAME and
/// ${NAME} are environment variables. ';' separates too, and a drive letter ("C:/x") is no separator.
std::vector<std::string> parseSearchPath(std::string_view text, const std::vector<std::string>& previous,
                                         const std::vector<std::string>& standard);

/// The first readable regular file `name` in `folders`; absolute names (and "./", "../") stand for
/// themselves. "" = not found.
std::string findFile(std::string_view name, const std::vector<std::string>& folders);

}  // namespace fr::ri
