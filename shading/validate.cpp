#include <cmath>

#include "shading/passes.h"

namespace fr {
namespace {

Error bad(std::string what) { return makeError(RiError::kBadFile, "invalid program: {}", what); }

bool validSymbol(const ShaderProgram& p, const Symbol& s) {
  if (s.name >= p.strings.size() || s.type >= SlType::kVoid || s.storage > Storage::kTemp ||
      s.cls > SlClass::kVarying || s.declaredClass > 1 || s.arrayLength > kMaxArrayLength)
    return false;
  if (s.storage == Storage::kConstant) {
    if (s.cls != SlClass::kUniform) return false;
    if (s.type == SlType::kString) return !s.isArray() && s.data < p.strings.size();
    return s.data <= p.floats.size() && s.floats() <= p.floats.size() - s.data;
  }
  if (s.storage == Storage::kGlobal) {
    if (s.data >= uint32_t(GlobalId::kCount) || s.isArray()) return false;
    const GlobalInfo& g = globalInfo(GlobalId(s.data));
    return g.type == s.type && g.cls == s.cls;
  }
  return s.data == 0;
}

bool scalarFits(char c, const Symbol& s) {
  if (s.isArray()) return false;
  switch (c) {
    case 'F':
    case 'f':
      return s.type == SlType::kFloat;
    case 'T':
    case 't':
      return isTriple(s.type);
    case 'M':
    case 'm':
      return s.type == SlType::kMatrix;
    case 'S':
    case 's':
      return s.type == SlType::kString;
    default:
      return false;
  }
}

/// Operand `a` against one signature character.
bool operandFits(char c, uint32_t a, const Symbol& s) {
  const bool reads = (a & kArgRead) != 0, writes = (a & kArgWritten) != 0;
  switch (c) {
    case 'F':
    case 'T':
    case 'M':
    case 'S':
      return writes && !reads && scalarFits(c, s);
    case '#':
      return writes && !reads;
    case '!':
      return reads && writes;
    case 'x':
      return reads && writes && s.isArray();
    case 'a':
      return reads && !writes && s.isArray();
    case '?':
      return reads && !writes;
    default:
      return reads && !writes && scalarFits(c, s);
  }
}

bool elementFits(char kind, const Symbol& array) {
  switch (kind) {
    case 'f':
      return array.type == SlType::kFloat;
    case 't':
      return isTriple(array.type);
    case 'm':
      return array.type == SlType::kMatrix;
    default:
      return array.type == SlType::kString;
  }
}

bool extraRules(const ShaderProgram& p, const Instruction& in) {
  const auto o = p.operands(in);
  const std::string_view name = opInfo(in.op).name;
  switch (in.op) {
    case Op::assign_a: {
      const Symbol &x = p.symbol(o[0]), &y = p.symbol(o[1]);
      return x.arrayLength == y.arrayLength && slTypeFloats(x.type) == slTypeFloats(y.type);
    }
    case Op::load_f:
    case Op::load_t:
    case Op::load_m:
    case Op::load_s:
      return elementFits(name.back(), p.symbol(o[1]));
    case Op::store_f:
    case Op::store_t:
    case Op::store_m:
    case Op::store_s:
      return elementFits(name.back(), p.symbol(o[0]));
    case Op::setcomp_t:
      return isTriple(p.symbol(o[0]).type) && !p.symbol(o[0]).isArray();
    case Op::setcomp_m:
      return p.symbol(o[0]).type == SlType::kMatrix && !p.symbol(o[0]).isArray();
    case Op::spline_fa:
      return elementFits('f', p.symbol(o[3]));
    case Op::spline_ta:
      return elementFits('t', p.symbol(o[3]));
    case Op::spline_f:
    case Op::spline_t:
      return in.argCount >= 7;
    case Op::dso_call: {
      if (p.symbol(o[0]).isArray()) return false;
      for (size_t k = 1; k < 4; ++k)
        if (p.symbol(o[k]).storage != Storage::kConstant) return false;
      return true;
    }
    default:
      return true;
  }
}

Result<void> validateInstruction(const ShaderProgram& p, uint32_t index) {
  const Instruction& in = p.code[index];
  const OpInfo& info = opInfo(in.op);
  const auto wrong = [&](const char* what) {
    return bad(fmt::format("instruction {} ({}): {}", index, info.name, what));
  };
  if (in.firstArg > p.args.size() || in.argCount > p.args.size() - in.firstArg)
    return wrong("operands out of range");
  const char* sig = info.signature;
  const auto operands = p.operands(in);
  bool varyingInput = false;
  size_t k = 0;
  for (; k < operands.size() && *sig != '*'; ++k) {
    if (*sig == '\0') return wrong("too many operands");
    const Symbol& s = p.symbol(operands[k]);
    const bool repeat = sig[1] == '+';
    if (!operandFits(*sig, operands[k], s)) return wrong("operand of a wrong type");
    if (!repeat) ++sig;
  }
  if (*sig == '*') {
    if ((operands.size() - k) % 2) return wrong("optional parameters do not come in pairs");
    for (; k < operands.size(); k += 2) {
      if (!operandFits('s', operands[k], p.symbol(operands[k])))
        return wrong("name of an optional parameter");
      if (!(operands[k + 1] & kArgRead)) return wrong("value of an optional parameter");
    }
  } else if (*sig != '\0' && sig[1] != '+') {
    return wrong("too few operands");
  }
  for (uint32_t a : operands) {
    const Symbol& s = p.symbol(a);
    if ((a & kArgRead) && !(a & kArgWritten) && s.isVarying()) varyingInput = true;
    if (!(a & kArgWritten)) continue;
    if (s.storage == Storage::kConstant) return wrong("writes a constant");
    if (s.storage == Storage::kParameter && index >= p.bodyBegin) return wrong("writes a parameter");
  }
  if (!extraRules(p, in)) return wrong("operands do not go together");
  const bool uniformResult = (info.flags & kOpResultUniform) != 0;
  const bool external = info.cost == Cost::kExternal && !(info.flags & kOpRay);
  if (varyingInput && !uniformResult && !external && !(info.flags & kOpControl)) {
    for (uint32_t a : operands)
      if ((a & kArgWritten) && !p.symbol(a).isVarying()) return wrong("varying value into a uniform symbol");
  }
  return {};
}

}  // namespace

Result<void> validate(const ShaderProgram& p) {
  if (p.type > ShaderType::kTransformation) return bad("shader type");
  if (p.strings.empty() || !p.strings[0].empty()) return bad("string 0");
  if (p.files.size() != p.fileHashes.size()) return bad("files");
  if (p.code.size() > kMaxInstructions) return bad("too many instructions");
  if (p.symbols.size() > kArgIndex) return bad("too many symbols");
  for (float f : p.floats)
    if (!std::isfinite(f)) return bad("a constant is not finite");
  uint64_t floats = 0;
  for (size_t i = 0; i < p.symbols.size(); ++i) {
    if (!validSymbol(p, p.symbols[i])) return bad(fmt::format("symbol {}", i));
    floats += p.symbols[i].floats() + 1;
  }
  if (floats > (uint64_t(1) << 26)) return bad("variables need too much memory");
  for (uint32_t a : p.args)
    if ((a & kArgIndex) >= p.symbols.size() || !(a & (kArgRead | kArgWritten)))
      return bad("operand out of range");
  if (p.bodyBegin > p.code.size()) return bad("body");
  uint32_t last = 0;
  std::vector<uint32_t> edges;
  for (const Parameter& q : p.parameters) {
    if (q.symbol >= p.symbols.size()) return bad("parameter symbol");
    const Symbol& s = p.symbols[q.symbol];
    if (s.storage != Storage::kParameter && s.storage != Storage::kOutputParameter)
      return bad("parameter storage");
    if (q.codeBegin < last || q.codeEnd < q.codeBegin || q.codeEnd > p.bodyBegin)
      return bad("parameter code");
    last = q.codeEnd;
    edges.push_back(q.codeBegin);
    edges.push_back(q.codeEnd);
    if (q.defaultConstant == kNoIndex) continue;
    if (q.defaultConstant >= p.symbols.size() || q.codeEnd != q.codeBegin) return bad("parameter default");
    const Symbol& c = p.symbols[q.defaultConstant];
    if (c.storage != Storage::kConstant || slTypeFloats(c.type) != slTypeFloats(s.type) ||
        c.arrayLength != s.arrayLength)
      return bad("parameter default type");
  }
  for (uint32_t i = 0; i < p.code.size(); ++i) {
    if (p.code[i].op >= Op::kCount) return bad("operation");
    if (Result<void> r = validateInstruction(p, i); !r) return r;
  }
  ShaderProgram nesting;  // only what resolveJumps() looks at
  nesting.symbols = p.symbols;
  nesting.floats = p.floats;
  nesting.args = p.args;
  nesting.code = p.code;
  nesting.bodyBegin = p.bodyBegin;
  if (Result<void> r = resolveJumps(nesting); !r) return r;
  for (uint32_t i = 0; i < p.code.size(); ++i)
    if (nesting.code[i].jump != p.code[i].jump) return bad(fmt::format("jump of instruction {}", i));
  // No block reaches over the edge of a parameter's code.
  int depth = 0;
  size_t edge = 0;
  for (uint32_t i = 0; i <= p.bodyBegin && i < p.code.size(); ++i) {
    while (edge < edges.size() && edges[edge] == i) {
      if (depth != 0) return bad("parameter code does not nest");
      ++edge;
    }
    const std::string_view name = opInfo(p.code[i].op).name;
    depth += name.ends_with("_begin") ? 1 : name.ends_with("_end") ? -1 : 0;
  }
  return {};
}

}  // namespace fr
