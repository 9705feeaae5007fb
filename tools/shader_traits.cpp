#include "tools/shader_rays.h"

#include <map>
#include <memory>

#include "base/report_mute.h"
#include "shading/shader_library.h"
#include "tools/shader_folders.h"

namespace fr::tools {

std::function<bool(const std::string&, const std::vector<std::string>&)> shaderRays(
    std::string_view first, std::span<const cache::RibInput> inputs) {
  struct Libraries {
    std::string first;
    std::vector<cache::RibInput> inputs;
    std::map<std::vector<std::string>, std::unique_ptr<ShaderLibrary>> byFolders;
  };
  auto all = std::make_shared<Libraries>(Libraries{std::string(first), {inputs.begin(), inputs.end()}, {}});
  return [all](const std::string& name, const std::vector<std::string>& folders) {
    std::unique_ptr<ShaderLibrary>& library = all->byFolders[folders];
    if (!library) {
      ShaderLibrary::Options o;
      o.folders = shaderFolders(all->first, folders, all->inputs);
      o.standardShaders = standardShaderFolder();
      library = std::make_unique<ShaderLibrary>(std::move(o));
    }
    // What is wrong with it is said when it is loaded to run.
    const ReportMute mute;
    const auto program = library->find(name);
    return program.ok() && ((*program)->has(kProgramCanAskRays) || (*program)->has(kProgramRaysByMapName));
  };
}

}  // namespace fr::tools
