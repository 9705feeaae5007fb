// Finding and opening display drivers: shared objects, opened when a display first asks for one.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "imaging/display_driver.h"

namespace fr {

/// Which driver and file format a RiDisplay type means.
struct DisplayTarget {
  std::string driver;      // "exr", "tiff", "png", "oiio", or the type itself for a driver of somebody else's
  std::string fileFormat;  // as OpenImageIO names it
  std::string path;        // the name, with an extension where the type needs one
  bool isDepth = false;    // zfile, shadow: depth unless the mode says more
};

/// Types whose picture is depth unless the mode says more: "zfile", "shadow", ...
bool isDepthDisplay(std::string_view type);

/// Maps RiDisplay's type and name. Types of windows ("framebuffer", "x11", "it", ...) become files, with one
/// message; so do unknown types for which `searchPath` has no driver. "file" goes by the name's extension,
/// TIFF when there is none that is known.
DisplayTarget resolveDisplayType(const std::string& type, const std::string& name,
                                 const std::vector<std::string>& searchPath);

/// Folders searched, in order: `paths` (Option "searchpath" "display"), $FRANKENRENDER_DISPLAYS, $DISPLAYS,
/// <folder of the program>/../lib/frankenrender/displays (true of the installed tree and of the build tree).
std::vector<std::string> displaySearchPath(const std::vector<std::string>& paths);

/// Opens "fr_display_<name>.so" from the first folder that has it and checks its ABI. Modules stay open until
/// the program ends. Thread-safe. Errors: kNoFile, kVersion, kSystem.
Result<const FrDisplayDriver*> openDisplayDriver(const std::string& name,
                                                 const std::vector<std::string>& searchPath);

}  // namespace fr
