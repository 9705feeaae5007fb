#include "shading/text_branches.h"

#include "shading/shader_instance.h"

namespace fr {

namespace {

uint32_t parameterOf(const ShaderProgram& p, uint32_t symbol) {
  for (uint32_t k = 0; k < p.parameters.size(); ++k)
    if (p.parameters[k].symbol == symbol) return k;
  return kNoIndex;
}
bool isText(const Symbol& s, Storage storage) {
  return s.storage == storage && s.type == SlType::kString && !s.isArray();
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

std::vector<TextTest> findTextTests(const ShaderProgram& p) {
  std::vector<TextTest> tests;
  for (uint32_t i = p.bodyBegin; i < p.code.size() && tests.size() < 64; ++i) {
    const Instruction& in = p.code[i];
    if (in.op != Op::eq_s && in.op != Op::ne_s) continue;
    uint32_t a = p.operands(in)[1] & kArgIndex, b = p.operands(in)[2] & kArgIndex;
    if (p.symbols[a].storage == Storage::kConstant) std::swap(a, b);
    if (!isText(p.symbols[a], Storage::kParameter) || !isText(p.symbols[b], Storage::kConstant)) continue;
    const uint32_t parameter = parameterOf(p, a);
    if (parameter != kNoIndex) tests.push_back({i, parameter, p.symbols[b].data, in.op == Op::eq_s});
  }
  return tests;
}

uint64_t textTestResults(const ShaderProgram& p, const std::vector<TextTest>& tests,
                         const std::vector<ShaderValue>& values) {
  uint64_t results = 0;
  for (size_t k = 0; k < tests.size(); ++k) {
    const auto& texts = values[tests[k].parameter].strings;
    const bool same = !texts.empty() && texts[0] == p.strings[tests[k].text];
    results |= uint64_t(same == tests[k].equal) << k;
  }
  return results;
}

ShaderProgram decideTextTests(const ShaderProgram& program, const std::vector<TextTest>& tests,
                              uint64_t results) {
  ShaderProgram p = program;
  const uint32_t constants[] = {constantOf(p, 0.0f), constantOf(p, 1.0f)};
  for (size_t k = 0; k < tests.size(); ++k) {
    const uint32_t at = tests[k].instruction;
    Instruction& in = p.code[at];
    if (in.op == Op::nop) continue;
    const bool holds = results >> k & 1;
    const uint32_t result = p.args[in.firstArg] & kArgIndex;
    in.op = Op::assign_f, in.argCount = 2, in.firstArg = uint32_t(p.args.size());
    p.args.insert(p.args.end(), {result | kArgWritten, constants[holds ? 1 : 0] | kArgRead});
    if (at + 1 >= p.code.size() || p.code[at + 1].op != Op::if_begin) continue;
    if ((p.operands(p.code[at + 1])[0] & kArgIndex) == result) decide(p, at + 1, holds);
  }
  return p;
}

}  // namespace fr
