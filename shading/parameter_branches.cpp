#include "shading/parameter_branches.h"

#include "shading/shader_instance.h"

namespace fr {

namespace {

uint32_t parameterOf(const ShaderProgram& p, uint32_t symbol) {
  for (uint32_t k = 0; k < p.parameters.size(); ++k)
    if (p.parameters[k].symbol == symbol) return k;
  return kNoIndex;
}
bool compares(Op op) {
  switch (op) {
    case Op::eq_s:
    case Op::ne_s:
    case Op::eq_f:
    case Op::ne_f:
    case Op::lt_f:
    case Op::le_f:
    case Op::gt_f:
    case Op::ge_f:
      return true;
    default:
      return false;
  }
}
template <class T>
bool holds(Op op, const T& x, const T& y) {
  switch (op) {
    case Op::eq_s:
    case Op::eq_f:
      return x == y;
    case Op::ne_s:
    case Op::ne_f:
      return x != y;
    case Op::lt_f:
      return x < y;
    case Op::le_f:
      return x <= y;
    case Op::gt_f:
      return x > y;
    default:
      return x >= y;
  }
}

/// A constant symbol for a number.
uint32_t constantOf(ShaderProgram& p, float value) {
  Symbol s;
  s.storage = Storage::kConstant, s.cls = SlClass::kUniform;
  s.data = uint32_t(p.floats.size());
  p.floats.push_back(value);
  p.symbols.push_back(s);
  return uint32_t(p.symbols.size() - 1);
}

void remove(ShaderProgram& p, uint32_t begin, uint32_t end) {
  for (uint32_t i = begin; i < end; ++i) {
    Instruction& in = p.code[i];
    in.op = Op::nop, in.argCount = 0, in.jump = kNoIndex;
  }
}

/// Leaves one side of the condition that begins at `begin`.
void decide(ShaderProgram& p, uint32_t begin, bool holds) {
  const uint32_t middle = p.code[begin].jump;
  const bool hasElse = p.code[middle].op == Op::if_else;
  const uint32_t end = hasElse ? p.code[middle].jump : middle;
  remove(p, begin, begin + 1);
  if (holds)
    remove(p, middle, end + 1);
  else
    remove(p, begin, middle + 1), remove(p, end, end + 1);
}

}  // namespace

std::vector<ParameterTest> findParameterTests(const ShaderProgram& p,
                                              const std::function<bool(uint32_t)>& fixed) {
  std::vector<ParameterTest> tests;
  for (uint32_t i = p.bodyBegin; i < p.code.size() && tests.size() < 64; ++i) {
    const Instruction& in = p.code[i];
    if (!compares(in.op)) continue;
    uint32_t a = p.operands(in)[1] & kArgIndex, b = p.operands(in)[2] & kArgIndex;
    const bool turned = p.symbols[a].storage == Storage::kConstant;
    if (turned) std::swap(a, b);
    const Symbol &x = p.symbols[a], &y = p.symbols[b];
    if (x.storage != Storage::kParameter || y.storage != Storage::kConstant || x.isArray() || y.isArray())
      continue;
    const uint32_t parameter = parameterOf(p, a);
    if (parameter != kNoIndex && fixed(a)) tests.push_back({i, parameter, b, turned});
  }
  return tests;
}

uint64_t parameterTestResults(const ShaderProgram& p, const std::vector<ParameterTest>& tests,
                              const std::vector<ShaderValue>& values) {
  uint64_t results = 0;
  for (size_t k = 0; k < tests.size(); ++k) {
    const ParameterTest& t = tests[k];
    const Op op = p.code[t.instruction].op;
    const ShaderValue& v = values[t.parameter];
    const uint32_t at = p.symbols[t.constant].data;
    const auto compare = [&](const auto& x, const auto& y) {
      return t.turned ? holds(op, y, x) : holds(op, x, y);
    };
    const bool text = op == Op::eq_s || op == Op::ne_s;
    const bool result = text ? compare(v.strings[0], p.strings[at]) : compare(v.floats[0], p.floats[at]);
    results |= uint64_t(result) << k;
  }
  return results;
}

ShaderProgram decideParameterTests(const ShaderProgram& program, const std::vector<ParameterTest>& tests,
                                   uint64_t results) {
  ShaderProgram p = program;
  const uint32_t constants[] = {constantOf(p, 0.0f), constantOf(p, 1.0f)};
  for (size_t k = 0; k < tests.size(); ++k) {
    const uint32_t at = tests[k].instruction;
    Instruction& in = p.code[at];
    if (in.op == Op::nop) continue;
    const bool outcome = results >> k & 1;
    const uint32_t to = p.args[in.firstArg] & kArgIndex;
    in.op = Op::assign_f, in.argCount = 2, in.firstArg = uint32_t(p.args.size());
    p.args.insert(p.args.end(), {to | kArgWritten, constants[outcome ? 1 : 0] | kArgRead});
    if (at + 1 >= p.code.size() || p.code[at + 1].op != Op::if_begin) continue;
    if ((p.operands(p.code[at + 1])[0] & kArgIndex) == to) decide(p, at + 1, outcome);
  }
  return p;
}

}  // namespace fr
