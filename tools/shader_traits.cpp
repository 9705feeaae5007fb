#include "tools/shader_traits.h"

#include <map>
#include <memory>
#include <mutex>

#include "base/report_mute.h"
#include "shading/shader_library.h"
#include "tools/shader_folders.h"

namespace fr::tools {

namespace {

class Libraries {
 public:
  Libraries(std::string_view first, std::span<const cache::RibInput> inputs)
      : first_(first), inputs_(inputs.begin(), inputs.end()) {}

  /// nullptr: there is none that could be used.
  std::shared_ptr<const ShaderProgram> find(const std::string& name,
                                            const std::vector<std::string>& folders) {
    const std::lock_guard lock(mutex_);
    std::unique_ptr<ShaderLibrary>& library = byFolders_[folders];
    if (!library) {
      ShaderLibrary::Options o;
      o.folders = shaderFolders(first_, folders, inputs_);
      o.standardShaders = standardShaderFolder();
      library = std::make_unique<ShaderLibrary>(std::move(o));
    }
    // What is wrong with it is said when it is loaded to run.
    const ReportMute mute;
    const auto program = library->find(name);
    return program.ok() ? *program : nullptr;
  }

 private:
  std::mutex mutex_;
  std::string first_;
  std::vector<cache::RibInput> inputs_;
  std::map<std::vector<std::string>, std::unique_ptr<ShaderLibrary>> byFolders_;
};

}  // namespace

ShaderTraits shaderTraits(std::string_view first, std::span<const cache::RibInput> inputs) {
  const auto all = std::make_shared<Libraries>(first, inputs);
  return {
      [all](const std::string& name, const std::vector<std::string>& folders) {
        const auto program = all->find(name, folders);
        return program && (program->has(kProgramCanAskRays) || program->has(kProgramRaysByMapName));
      },
      [all](const std::string& name, const std::vector<std::string>& folders) {
        const auto program = all->find(name, folders);
        return program && program->has(kProgramMovesPoints);
      },
      [all](const std::string& name, const std::vector<std::string>& folders, const std::string& parameter) {
        const auto program = all->find(name, folders);
        const uint32_t k = program ? program->findParameter(parameter) : kNoIndex;
        return k != kNoIndex && program->symbols[program->parameters[k].symbol].type == SlType::kString;
      }};
}

}  // namespace fr::tools
