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

/// What follows the last '/' or '\\' of a path: its file, for either system.
std::string_view lastPart(std::string_view path);

/// The first file of `folders` whose name is `name` but for upper and lower case. "" = none. Folders are read
/// again only when they have changed. Thread-safe.
std::string findInOtherCase(std::string_view name, const std::vector<std::string>& folders);

/// As findFile; scenes also name the disks of the machines they were made on, some of which did not tell
/// upper from lower case: where nothing is found, the last part of the name is looked for alone, then in any
/// case, and `moved` tells that it was found so.
std::string findMovedFile(std::string_view name, const std::vector<std::string>& folders, bool& moved);

}  // namespace fr::ri
