#include "shading/shader_instance.h"

#include <algorithm>
#include <atomic>

#include "base/error.h"
#include "shading/machine.h"

namespace fr {

namespace {
ShaderValue constantValue(const ShaderProgram& p, uint32_t symbol) {
  const Symbol& s = p.symbols[symbol];
  ShaderValue v;
  v.type = s.type;
  v.arrayLength = s.arrayLength;
  if (s.type == SlType::kString)
    for (uint32_t k = 0; k < std::max(1u, s.arrayLength); ++k) v.strings.push_back(p.strings[s.data + k]);
  else
    v.floats.assign(p.floats.begin() + s.data, p.floats.begin() + s.data + s.floats());
  return v;
}
bool fits(const Symbol& s, const ShaderValue& v) {
  if (s.type == SlType::kString)
    return v.type == SlType::kString && v.strings.size() == std::max(1u, s.arrayLength);
  const bool sameKind = s.type == v.type || (isTriple(s.type) && isTriple(v.type));
  return sameKind && v.floats.size() == s.floats();
}
}  // namespace

std::shared_ptr<const ShaderInstance> bindShader(std::shared_ptr<const Executable> exe,
                                                 const DMat4& shaderToCurrent,
                                                 const std::vector<ParameterSetting>& settings,
                                                 const ShaderHost& host) {
  auto instance = std::make_shared<ShaderInstance>();
  instance->exe = std::move(exe);
  instance->toCurrent = shaderToCurrent;
  const ShaderProgram& p = instance->program();
  // Zeros first, so that the default code may run with everything in place.
  for (const Parameter& parameter : p.parameters) {
    const Symbol& s = p.symbols[parameter.symbol];
    ShaderValue v;
    v.type = s.type, v.arrayLength = s.arrayLength;
    if (s.type == SlType::kString)
      v.strings.resize(std::max(1u, s.arrayLength));
    else
      v.floats.resize(s.floats());
    instance->values.push_back(std::move(v));
  }
  std::unique_ptr<Machine> machine;
  for (uint32_t i = 0; i < p.parameters.size(); ++i) {
    const Parameter& parameter = p.parameters[i];
    const std::string_view name = p.symbolName(parameter.symbol);
    const auto given =
        std::find_if(settings.rbegin(), settings.rend(), [&](const auto& s) { return s.name == name; });
    if (given != settings.rend()) {
      if (fits(p.symbols[parameter.symbol], given->value)) {
        const SlType type = instance->values[i].type;
        instance->values[i] = given->value;
        instance->values[i].type = type;
        instance->values[i].arrayLength = p.symbols[parameter.symbol].arrayLength;
        continue;
      }
      reportOnce(
          fmt::format("shading.parameter.{}.{}", p.name, name),
          Error{RiError::kConsistency,
                Severity::kWarning,
                {},
                fmt::format("shader \"{}\": parameter \"{}\" has another type or length than the shader's; "
                            "the default is used",
                            p.name, name)});
    }
    if (parameter.defaultConstant != kNoIndex) {
      instance->values[i] = constantValue(p, parameter.defaultConstant);
      instance->values[i].type = p.symbols[parameter.symbol].type;
      instance->values[i].arrayLength = p.symbols[parameter.symbol].arrayLength;
    } else if (parameter.codeBegin < parameter.codeEnd) {
      if (!machine) machine = std::make_unique<Machine>(host);
      machine->beginDefaults(*instance);
      instance->values[i] = machine->runDefault(parameter);
    }
  }
  // Only now: default values are computed from the ones before them.
  static std::atomic<uint64_t> serials{0};
  instance->serial = serials.fetch_add(1, std::memory_order_relaxed) + 1;
  return instance;
}

}  // namespace fr
