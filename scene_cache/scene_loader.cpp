#include "scene_cache/scene_loader.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <filesystem>

#include "ri/search_path.h"
#include "scene_cache/rib_stream.h"
#include "scene_cache/tracer_stream.h"

namespace fr::cache {
namespace {

std::string readAll(int fd) {
  std::string text;
  char part[65536];
  for (;;) {
    const ssize_t n = read(fd, part, sizeof(part));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return text;
    text.append(part, size_t(n));
  }
}

}  // namespace

// BMRT's environment variables.
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

std::string noWorldFound(const LoadOptions& options) {
  if (!options.frames) return "no world was found in the scene";
  const auto [first, last] = *options.frames;
  return first == last ? fmt::format("no world of frame {} was found in the scene", first)
                       : fmt::format("no world of frames {} to {} was found in the scene", first, last);
}

Result<void> loadScene(std::span<const RibInput> inputs, const LoadOptions& given,
                       const FrameCallback& onFrame) {
  LoadOptions options = given;
  for (const RibInput& in : inputs) {
    if (in.path == "-") continue;
    // Absolute: the ray tracer's process and a .fsc may live elsewhere.
    std::error_code failed;
    const std::string folder =
        std::filesystem::absolute(in.path, failed).parent_path().lexically_normal().string();
    auto& folders = options.overrides.textureFolders;
    if (!failed && std::find(folders.begin(), folders.end(), folder) == folders.end())
      folders.push_back(folder);
  }
  const ri::StateRenderer::PathLists paths = environmentPaths();
  bool tracerFiles = false, standardInput = false;
  for (const RibInput& in : inputs) {
    tracerFiles = tracerFiles || in.sides == kForTracer;
    standardInput = standardInput || in.path == "-";
  }
  // Two streams read it: it has to be kept.
  std::string text;
  if (tracerFiles && standardInput) text = readAll(STDIN_FILENO);
  std::optional<TracerStream> tracer;
  if (tracerFiles) tracer.emplace(inputs, options, paths, text);
  SceneBuilder builder(options, onFrame, paths, tracer ? &*tracer : nullptr);
  auto r = readStream(builder, inputs, kForReyes, tracerFiles ? &text : nullptr, false);
  if (builder.failure()) return *builder.failure();
  return r;
}

}  // namespace fr::cache
