#include "shading/ir.h"

#include <fmt/format.h>

#include <iterator>
#include <map>

namespace fr {
namespace {

constexpr OpInfo kOps[] = {
#define FR_OP(name, sig, flags, cost, doc) {#name, sig, flags, cost, doc},
#include "shading/ops.def"
#undef FR_OP
};
static_assert(std::size(kOps) == size_t(Op::kCount));

constexpr GlobalInfo kGlobals[] = {
#define FR_GLOBAL(name, type, cls) {#name, SlType::type, SlClass::cls},
#include "shading/globals.def"
#undef FR_GLOBAL
};
static_assert(std::size(kGlobals) == size_t(GlobalId::kCount) && std::size(kGlobals) <= 64);

std::string quoted(const std::string& s) {
  std::string r = "\"";
  for (char c : s) {
    if (c == '\n') {
      r += "\\n";
    } else if (c == '"' || c == '\\') {
      r += '\\';
      r += c;
    } else {
      r += c;
    }
  }
  return r + "\"";
}

std::string operandText(const ShaderProgram& p, uint32_t arg) {
  const uint32_t index = arg & kArgIndex;
  const Symbol& s = p.symbols[index];
  if (s.storage == Storage::kConstant) {
    if (s.type == SlType::kString && !s.isArray()) return quoted(p.strings[s.data]);
    if (s.type == SlType::kString) return fmt::format("<{} strings>", s.arrayLength);
    std::string r;
    const uint32_t n = s.floats();
    for (uint32_t i = 0; i < n && i < 16; ++i) r += fmt::format("{}{}", i ? " " : "", p.floats[s.data + i]);
    return n == 1 ? r : "(" + r + (n > 16 ? " ...)" : ")");
  }
  const std::string& name = p.strings[s.name];
  if (s.storage == Storage::kTemp) return fmt::format("${}", index);
  if (s.storage == Storage::kLocal) return fmt::format("{}${}", name, index);
  return name;
}

}  // namespace

const char* shaderTypeName(ShaderType type) {
  static constexpr const char* kNames[] = {"surface", "light",  "displacement",
                                           "volume",  "imager", "transformation"};
  return size_t(type) < std::size(kNames) ? kNames[size_t(type)] : "?";
}

const char* slTypeName(SlType type) {
  static constexpr const char* kNames[] = {"float",  "color",  "point",  "vector",
                                           "normal", "matrix", "string", "void"};
  return size_t(type) < std::size(kNames) ? kNames[size_t(type)] : "?";
}

const OpInfo& opInfo(Op op) { return kOps[size_t(op) < std::size(kOps) ? size_t(op) : 0]; }

Op opByName(std::string_view name) {
  static const auto* kByName = [] {
    auto* m = new std::map<std::string_view, Op>;
    for (size_t i = 0; i < std::size(kOps); ++i) m->emplace(kOps[i].name, Op(i));
    return m;
  }();
  auto it = kByName->find(name);
  return it == kByName->end() ? Op::kCount : it->second;
}

const GlobalInfo& globalInfo(GlobalId id) { return kGlobals[size_t(id)]; }

uint32_t ShaderProgram::findGlobal(GlobalId id) const {
  for (uint32_t i = 0; i < symbols.size(); ++i)
    if (symbols[i].storage == Storage::kGlobal && symbols[i].data == uint32_t(id)) return i;
  return kNoIndex;
}

uint32_t ShaderProgram::findParameter(std::string_view parameterName) const {
  for (uint32_t i = 0; i < parameters.size(); ++i)
    if (symbolName(parameters[i].symbol) == parameterName) return i;
  return kNoIndex;
}

std::string disassemble(const ShaderProgram& p) {
  std::string out = fmt::format("{} {}\n", shaderTypeName(p.type), p.name);
  auto declaration = [&](uint32_t i) {
    const Symbol& s = p.symbols[i];
    std::string r =
        fmt::format("{} {} {}", s.isVarying() ? "varying" : "uniform", slTypeName(s.type), operandText(p, i));
    if (s.isArray()) r += fmt::format("[{}]", s.arrayLength);
    return r;
  };
  for (const Parameter& q : p.parameters) {
    out +=
        fmt::format("  param {}{}", p.symbols[q.symbol].storage == Storage::kOutputParameter ? "output " : "",
                    declaration(q.symbol));
    if (q.defaultConstant != kNoIndex) out += " = " + operandText(p, q.defaultConstant);
    out += q.codeEnd > q.codeBegin ? fmt::format(" code {}..{}\n", q.codeBegin, q.codeEnd) : "\n";
  }
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    const Storage st = p.symbols[i].storage;
    if (st == Storage::kLocal || st == Storage::kTemp) out += "  " + declaration(i) + "\n";
  }
  int depth = 1;
  for (uint32_t i = 0; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    const OpInfo& info = opInfo(in.op);
    const std::string_view name = info.name;
    const bool mid =
        in.op == Op::if_else || in.op == Op::loop_test || in.op == Op::loop_step || in.op == Op::gather_else;
    const bool begins = name.ends_with("_begin"), ends = name.ends_with("_end");
    if (i == p.bodyBegin) out += "body:\n";
    if ((mid || ends) && depth > 1) --depth;
    out += fmt::format("{:4} {:{}}{}", i, "", depth * 2, name);
    bool first = true;
    for (uint32_t a : p.operands(in)) {
      out += first ? " " : ", ";
      if (a & kArgWritten) out += (a & kArgRead) ? "&" : ">";
      out += operandText(p, a);
      first = false;
    }
    if (in.jump != kNoIndex) out += fmt::format(" -> {}", in.jump);
    out += '\n';
    if (mid || begins) ++depth;
  }
  return out;
}

}  // namespace fr
