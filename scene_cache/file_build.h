// A .fsc file that is diced into: what SceneCache holds while it builds one. Included by its .cpp files
// alone.
#pragma once

#include <string>

#include "base/whole_file.h"
#include "scene_cache/file_layout.h"

namespace fr::cache {

/// Grids go straight to where they will stand in the file. The file has no name until it is whole, so there
/// is never a half one that could be taken for a whole one.
struct FileBuild {
  std::string path;
  WholeFile file;
  Checksum grids;        // of the arena up to `settled`
  uint64_t settled = 0;  // final, on its way to the disk
  uint64_t onDisk = 0;   // written and let go of
};

/// A file without a name in the folder, for what is not needed after this process; -1 and errno.
int namelessFile(const std::string& folder);

}  // namespace fr::cache
