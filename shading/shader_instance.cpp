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
/// Makes something of a value that does not fit, and tells what; null: nothing.
const char* madeToFit(const Symbol& s, ShaderValue& v) {
  const bool isString = s.type == SlType::kString;
  if (isString != (v.type == SlType::kString)) return nullptr;
  const size_t has = isString ? v.strings.size() : v.floats.size();
  const size_t takes = isString ? std::max(1u, s.arrayLength) : s.floats();
  if (has == takes) return "another type than the shader's; its numbers are used";
  if (s.type == SlType::kColor && has == 1 && takes == 3) {
    v.floats.resize(3, v.floats[0]);
    return "1 number, not 3; all three are that one";
  }
  const bool sameKind = s.type == v.type || (isTriple(s.type) && isTriple(v.type));
  if (!sameKind || has < takes) return nullptr;
  isString ? v.strings.resize(takes) : v.floats.resize(takes);
  return "more values than the shader's; the first are used";
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
      ShaderValue value = given->value;
      const bool whole = fits(p.symbols[parameter.symbol], value);
      const char* const made = whole ? nullptr : madeToFit(p.symbols[parameter.symbol], value);
      if (!whole)
        reportOnce(fmt::format("shading.parameter.{}.{}", p.name, name),
                   Error{RiError::kConsistency,
                         Severity::kWarning,
                         {},
                         fmt::format(
                             "shader \"{}\": parameter \"{}\" has {}", p.name, name,
                             made ? made : "another type or length than the shader's; the default is used")});
      if (whole || made) {
        const SlType type = instance->values[i].type;
        instance->values[i] = std::move(value);
        instance->values[i].type = type;
        instance->values[i].arrayLength = p.symbols[parameter.symbol].arrayLength;
        continue;
      }
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
  if (auto decided = instance->exe->decided(instance->values)) instance->exe = std::move(decided);
  // Only now: default values are computed from the ones before them.
  static std::atomic<uint64_t> serials{0};
  instance->serial = serials.fetch_add(1, std::memory_order_relaxed) + 1;
  return instance;
}

}  // namespace fr
