// slctell: prints a shader's type, parameters and defaults.
#include <CLI/CLI.hpp>

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "shading/shader_library.h"

namespace {

using fr::ShaderProgram;
using fr::SlType;
using fr::Symbol;

std::string typeText(const Symbol& s) {
  std::string r = s.storage == fr::Storage::kOutputParameter ? "output " : "";
  r += s.isVarying() ? "varying " : "uniform ";
  r += fr::slTypeName(s.type);
  if (s.isArray()) r += fmt::format("[{}]", s.arrayLength);
  return r;
}

/// The constant that the default is, and the space it is given in; kNoIndex when it is computed.
uint32_t defaultOf(const ShaderProgram& p, const fr::Parameter& q, std::string& space) {
  if (q.defaultConstant != fr::kNoIndex) return q.defaultConstant;
  // One transform of a constant out of a named space, assigned.
  if (q.codeEnd != q.codeBegin + 2) return fr::kNoIndex;
  const fr::Instruction& t = p.code[q.codeBegin];
  const bool transforms = t.op == fr::Op::transform_p || t.op == fr::Op::transform_v ||
                          t.op == fr::Op::transform_n || t.op == fr::Op::ctransform;
  if (!transforms) return fr::kNoIndex;
  const auto operands = p.operands(t);
  const Symbol &from = p.symbol(operands[1]), &value = p.symbol(operands[3]);
  if (from.storage != fr::Storage::kConstant || value.storage != fr::Storage::kConstant) return fr::kNoIndex;
  space = p.strings[from.data];
  return operands[3] & fr::kArgIndex;
}

nlohmann::json valueOf(const ShaderProgram& p, uint32_t constant) {
  const Symbol& c = p.symbols[constant];
  if (c.type == SlType::kString) return p.strings[c.data];
  if (c.floats() == 1) return p.floats[c.data];
  return std::vector<float>(p.floats.begin() + c.data, p.floats.begin() + c.data + c.floats());
}

std::string valueText(const nlohmann::json& v) {
  if (v.is_string()) return fmt::format("\"{}\"", v.get<std::string>());
  if (!v.is_array()) return fmt::format("{}", v.get<float>());
  std::string r = "[";
  for (const auto& x : v) r += fmt::format("{}{}", r.size() > 1 ? " " : "", x.get<float>());
  return r + "]";
}

nlohmann::json asJson(const ShaderProgram& p) {
  nlohmann::json j;
  j["name"] = p.name;
  j["type"] = fr::shaderTypeName(p.type);
  j["parameters"] = nlohmann::json::array();
  for (const fr::Parameter& q : p.parameters) {
    const Symbol& s = p.symbols[q.symbol];
    nlohmann::json e;
    e["name"] = p.symbolName(q.symbol);
    e["type"] = fr::slTypeName(s.type);
    e["class"] = s.isVarying() ? "varying" : "uniform";
    e["output"] = s.storage == fr::Storage::kOutputParameter;
    if (s.isArray()) e["arrayLength"] = s.arrayLength;
    std::string space;
    const uint32_t constant = defaultOf(p, q, space);
    if (constant == fr::kNoIndex) {
      e["default"] = nullptr;
    } else {
      e["default"] = valueOf(p, constant);
      if (!space.empty()) e["space"] = space;
    }
    j["parameters"].push_back(e);
  }
  j["canAskRays"] = p.has(fr::kProgramCanAskRays);
  j["usesDerivatives"] = p.has(fr::kProgramUsesDerivatives);
  j["opaque"] = p.has(fr::kProgramOpaque);
  return j;
}

void printText(const ShaderProgram& p) {
  std::printf("%s \"%s\"\n", fr::shaderTypeName(p.type), p.name.c_str());
  for (const fr::Parameter& q : p.parameters) {
    const Symbol& s = p.symbols[q.symbol];
    std::printf("    \"%s\" \"%s\"\n", std::string(p.symbolName(q.symbol)).c_str(), typeText(s).c_str());
    std::string space;
    const uint32_t constant = defaultOf(p, q, space);
    std::string text = constant == fr::kNoIndex ? "(computed)" : valueText(valueOf(p, constant));
    if (!space.empty()) text = fmt::format("\"{}\" {}", space, text);
    std::printf("        Default value: %s\n", text.c_str());
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> names, folders;
  bool json = false, code = false;
  CLI::App app{"Prints the type, the parameters and the defaults of shaders.", "slctell"};
  app.add_option("shaders", names, "names or files; sources are compiled first")->required();
  app.add_option("-I,--path", folders, "folder to search before SHADERS and the standard shaders")
      ->allow_extra_args(false);
  app.add_flag("--json", json, "JSON, one object for each shader");
  app.add_flag("--code", code, "also the compiled program");
  app.set_version_flag("--version", "slctell (frankenrender) " FR_VERSION);
  app.footer("Exit status: 0 found, 1 a shader is missing or broken, 2 wrong usage.");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  fr::ShaderLibrary::Options options;
  options.folders = folders;
  options.folders.push_back(".");
  for (const std::string& f : fr::shaderPathFromEnvironment()) options.folders.push_back(f);
  options.standardShaders = fr::standardShaderFolder();
  fr::ShaderLibrary library(std::move(options));
  int status = 0;
  nlohmann::json all = nlohmann::json::array();
  for (const std::string& name : names) {
    const auto p = library.find(name);
    if (!p) {
      if (p.error().code == fr::RiError::kNoShader)
        std::fprintf(stderr, "slctell: %s\n", p.error().message.c_str());
      status = 1;
      continue;
    }
    if (json) {
      all.push_back(asJson(**p));
    } else {
      printText(**p);
      if (code) std::fputs(fr::disassemble(**p).c_str(), stdout);
    }
  }
  if (json) std::printf("%s\n", (all.size() == 1 && names.size() == 1 ? all[0] : all).dump(2).c_str());
  return status;
}
