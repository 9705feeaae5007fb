#include "scene_cache/scene_loader.h"

#include <cstdlib>

#include "ri/reader.h"
#include "ri/search_path.h"
#include "scene_cache/scene_builder.h"

namespace fr::cache {
namespace {

/// BMRT's environment variables: the standard lists, which "@" in Option "searchpath" stands for.
ri::StateRenderer::PathLists environmentPaths() {
  ri::StateRenderer::PathLists lists;
  static constexpr std::pair<const char*, const char*> kVariables[] = {{"shader", "SHADERS"},
                                                                       {"texture", "TEXTURES"},
                                                                       {"archive", "ARCHIVES"},
                                                                       {"procedural", "PROCEDURALS"},
                                                                       {"display", "DISPLAYS"}};
  for (const auto& [category, variable] : kVariables)
    if (const char* value = std::getenv(variable); value && *value)
      lists[category] = ri::parseSearchPath(value, {}, {});
  return lists;
}

std::string folderOf(const std::string& path) {
  const size_t slash = path.find_last_of('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

}  // namespace

Result<void> loadScene(std::span<const RibInput> inputs, const LoadOptions& options,
                       const FrameCallback& onFrame) {
  SceneBuilder builder(options, onFrame, environmentPaths());
  ri::ReaderOptions readerOptions;
  for (const RibInput& in : inputs)
    if (in.path != "-") readerOptions.archivePath.push_back(folderOf(in.path));
  ri::Reader reader(builder, readerOptions);
  builder.setArchiveReader([&](const std::string& name) { return reader.readArchive(name); });
  std::optional<Error> first;
  for (const RibInput& in : inputs) {
    builder.setSides(in.sides);
    auto r = in.path == "-" ? reader.readStdin() : reader.readFile(in.path);
    if (!r) {
      if (first) report(*first);
      first = std::move(r).error();
    }
    if (builder.stopped() || builder.failure()) break;
  }
  builder.finish();
  if (builder.failure()) return *builder.failure();
  if (first) return *first;
  return {};
}

}  // namespace fr::cache
