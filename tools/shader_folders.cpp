#include "tools/shader_folders.h"

#include <algorithm>
#include <filesystem>

#include "shading/shader_library.h"

namespace fr::tools {
namespace {

void append(std::vector<std::string>& folders, std::string folder) {
  if (std::find(folders.begin(), folders.end(), folder) == folders.end())
    folders.push_back(std::move(folder));
}

void appendList(std::vector<std::string>& folders, std::string_view list) {
  for (size_t begin = 0; begin <= list.size();) {
    const size_t end = std::min(list.find(':', begin), list.size());
    if (end > begin) append(folders, std::string(list.substr(begin, end - begin)));
    begin = end + 1;
  }
}

}  // namespace

std::vector<std::string> shaderFolders(std::string_view first, const cache::Skeleton& skeleton,
                                       std::span<const cache::RibInput> inputs) {
  std::vector<std::string> scene;
  if (!skeleton.searchPaths().empty()) appendList(scene, skeleton.string(skeleton.searchPaths()[0]));
  return shaderFolders(first, scene, inputs);
}

std::vector<std::string> shaderFolders(std::string_view first, std::span<const std::string> scene,
                                       std::span<const cache::RibInput> inputs) {
  std::vector<std::string> folders;
  appendList(folders, first);
  for (const std::string& folder : scene) append(folders, folder);
  for (std::string& folder : shaderPathFromEnvironment()) append(folders, std::move(folder));
  for (const cache::RibInput& input : inputs) {
    const std::filesystem::path folder = std::filesystem::path(input.path).parent_path();
    append(folders, folder.empty() ? std::string(".") : folder.string());
  }
  append(folders, ".");
  return folders;
}

}  // namespace fr::tools
