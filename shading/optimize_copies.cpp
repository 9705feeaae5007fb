// Copies: values that do not change need none, and variables can be written directly.
#include <algorithm>

#include "shading/passes.h"

namespace fr {
namespace {

bool isAssign(Op op) {
  return op == Op::assign_f || op == Op::assign_t || op == Op::assign_m || op == Op::assign_s;
}

bool opens(Op op) { return std::string_view(opInfo(op).name).ends_with("_begin"); }
bool closes(Op op) { return std::string_view(opInfo(op).name).ends_with("_end"); }

struct Uses {
  uint32_t writes = 0;
  uint32_t reads = 0;
  uint32_t firstUse = kNoIndex;
  uint32_t lastUse = 0;
};

std::vector<Uses> countUses(const ShaderProgram& p) {
  std::vector<Uses> u(p.symbols.size());
  for (uint32_t i = 0; i < p.code.size(); ++i) {
    for (uint32_t a : p.operands(p.code[i])) {
      Uses& x = u[a & kArgIndex];
      if (a & kArgWritten) x.writes++;
      if (a & kArgRead) x.reads++;
      x.firstUse = std::min(x.firstUse, i);
      x.lastUse = i;
    }
  }
  return u;
}

/// For each instruction the end of the innermost block (if branch, loop body, ...) that contains it.
std::vector<uint32_t> blockEnds(const ShaderProgram& p) {
  std::vector<uint32_t> ends(p.code.size(), uint32_t(p.code.size()));
  std::vector<uint32_t> stack;
  uint32_t end = uint32_t(p.code.size());
  for (uint32_t i = uint32_t(p.code.size()); i-- > 0;) {
    const Op op = p.code[i].op;
    if (closes(op)) {
      stack.push_back(end);
      end = i;
      ends[i] = stack.back();
      continue;
    }
    if (opens(op) && !stack.empty()) {
      end = stack.back();
      stack.pop_back();
    }
    ends[i] = end;
    // Another branch begins behind if_else; condition, body and step of a loop run one after the other.
    if (op == Op::if_else || op == Op::gather_else) end = i;
    // After these some points skip what follows, so that it cannot count on what came before elsewhere; what
    // came before in this block still holds for all points that go on.
  }
  return ends;
}

/// A result of constants becomes a constant; the instruction goes.
bool foldInstruction(ShaderProgram& p, Instruction& in, const std::vector<Uses>& uses,
                     std::vector<uint32_t>& replacement) {
  if (!(opInfo(in.op).flags & kOpFoldable) || in.argCount < 2 || in.argCount > 17) return false;
  const uint32_t result = p.args[in.firstArg] & kArgIndex;
  if (p.symbols[result].storage != Storage::kTemp || uses[result].writes != 1) return false;
  const float* inputs[16];
  for (uint32_t k = 1; k < in.argCount; ++k) {
    const Symbol& s = p.symbol(p.args[in.firstArg + k]);
    if (s.storage != Storage::kConstant || s.type == SlType::kString || s.isArray()) return false;
    inputs[k - 1] = p.floats.data() + s.data;
  }
  float out[16];
  if (!foldConstant(in.op, {inputs, size_t(in.argCount) - 1}, out)) return false;
  Symbol c;
  c.type = p.symbols[result].type;
  c.storage = Storage::kConstant;
  c.cls = SlClass::kUniform;
  c.data = uint32_t(p.floats.size());
  p.floats.insert(p.floats.end(), out, out + slTypeFloats(c.type));
  replacement[result] = uint32_t(p.symbols.size());
  p.symbols.push_back(c);
  in.op = Op::nop;
  in.argCount = 0;
  return true;
}

}  // namespace

void propagateCopies(ShaderProgram& p) {
  const std::vector<Uses> uses = countUses(p);
  const std::vector<uint32_t> ends = blockEnds(p);
  std::vector<uint32_t> replacement(p.symbols.size(), kNoIndex);
  const auto known = [&](uint32_t symbol) {
    return symbol < replacement.size() ? replacement[symbol] : kNoIndex;
  };
  const auto fixed = [&](uint32_t source, uint32_t target) {
    const Symbol& s = p.symbols[source];
    if (s.isArray()) return false;
    switch (s.storage) {
      case Storage::kConstant:
      case Storage::kParameter:
        return true;
      case Storage::kOutputParameter:
        return false;
      case Storage::kGlobal:
        return uses[source].writes == 0 && GlobalId(s.data) != GlobalId::k_L &&
               GlobalId(s.data) != GlobalId::k_Cl && GlobalId(s.data) != GlobalId::k_Ol;
      case Storage::kTemp:
      case Storage::kLocal:
        return source < uses.size() && uses[source].writes == 1 && uses[target].writes == 1;
    }
    return false;
  };
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    Instruction& in = p.code[i];
    for (uint32_t k = 0; k < in.argCount; ++k) {
      uint32_t& a = p.args[in.firstArg + k];
      const uint32_t r = known(a & kArgIndex);
      if (r != kNoIndex && !(a & kArgWritten)) a = (a & ~kArgIndex) | r;
    }
    if (foldInstruction(p, in, uses, replacement)) continue;
    if (!isAssign(in.op)) continue;
    const auto operands = p.operands(in);
    const uint32_t target = operands[0] & kArgIndex, source = operands[1] & kArgIndex;
    const Symbol& t = p.symbols[target];
    if (t.storage != Storage::kLocal || t.declaredClass || t.isArray() || uses[target].writes != 1) continue;
    if (!fixed(source, target)) continue;
    // Every use must lie behind the assignment and inside its block.
    if (uses[target].firstUse != i || uses[target].lastUse >= ends[i]) continue;
    // A local that is itself assigned elsewhere later in a loop was excluded by writes == 1.
    replacement[target] = source;
  }
}

void mergeAssignments(ShaderProgram& p, const std::vector<bool>& underVaryingControl) {
  const std::vector<Uses> uses = countUses(p);
  for (uint32_t i = p.bodyBegin; i + 1 < p.code.size(); ++i) {
    Instruction& in = p.code[i];
    Instruction& copy = p.code[i + 1];
    if (!isAssign(copy.op) || underVaryingControl[i + 1]) continue;
    const OpInfo& info = opInfo(in.op);
    if (!(info.flags & kOpPure) || in.argCount == 0) continue;
    uint32_t& result = p.args[in.firstArg];
    const uint32_t temp = p.operands(copy)[1] & kArgIndex, target = p.operands(copy)[0] & kArgIndex;
    const Symbol& t = p.symbols[target];
    if ((result & kArgIndex) != temp || (result & kArgRead) || p.symbols[temp].storage != Storage::kTemp)
      continue;
    if (uses[temp].writes != 1 || uses[temp].reads != 1) continue;
    if (t.storage != Storage::kLocal || t.cls != p.symbols[temp].cls) continue;
    bool reads = false;
    for (uint32_t k = 1; k < in.argCount; ++k)
      reads = reads || (p.args[in.firstArg + k] & kArgIndex) == target;
    if (reads) continue;  // a kernel may write before it has read all
    result = (result & ~kArgIndex) | target;
    copy.op = Op::nop;
    copy.argCount = 0;
  }
}

}  // namespace fr
