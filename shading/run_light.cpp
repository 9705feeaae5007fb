#include "shading/run_light.h"

#include <algorithm>

#include "shading/executable.h"
#include "shading/recorded_kernels.h"

namespace fr {

namespace {
bool givenByTheLoop(GlobalId id) {
  switch (id) {
    case GlobalId::k_P:
    case GlobalId::k_Ps:
    case GlobalId::k_N:
    case GlobalId::k_Ns:
    case GlobalId::k_L:
    case GlobalId::k_Cl:
    case GlobalId::k_Ol:
      return true;
    default:
      return false;
  }
}
bool emits(Op op) {
  return op == Op::illuminate_begin || op == Op::illuminate_cone_begin || op == Op::solar_begin ||
         op == Op::solar_cone_begin;
}
/// Every variable that is read has been set by then, for all points that read it: in a block that is still
/// open. Of programs without loops and jumps.
bool setsWhatItReads(const ShaderProgram& p) {
  std::vector<std::vector<uint32_t>> set(1);  // by open block
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    for (const uint32_t a : p.operands(in)) {
      const Symbol& s = p.symbol(a);
      const bool variable = s.storage == Storage::kLocal || s.storage == Storage::kTemp;
      if (!variable || !(a & kArgRead)) continue;
      const bool known = std::any_of(set.begin(), set.end(), [&](const auto& block) {
        return std::find(block.begin(), block.end(), a & kArgIndex) != block.end();
      });
      if (!known) return false;
    }
    for (const uint32_t a : p.operands(in))
      if ((a & kArgWritten) && !p.symbol(a).isArray()) set.back().push_back(a & kArgIndex);
    if (in.op == Op::if_begin || emits(in.op)) set.emplace_back();
    if (in.op == Op::if_else) set.back().clear();
    const bool end = in.op == Op::if_end || in.op == Op::illuminate_end || in.op == Op::solar_end;
    if (end && set.size() > 1) set.pop_back();
  }
  return true;
}
}  // namespace

bool runsAhead(const Executable& light) {
  const auto& code = light.program().code;
  return std::none_of(code.begin(), code.end(), [](const Instruction& in) {
    return in.op == Op::msg_surface || in.op == Op::random_f || in.op == Op::random_t;
  });
}

bool plainLight(const Executable& light) {
  const ShaderProgram& p = light.program();
  if (p.type != ShaderType::kLight) return false;
  const auto& used = light.usedGlobals();
  if (!std::all_of(used.begin(), used.end(), givenByTheLoop)) return false;
  // One illuminate or solar outside of conditions; L is read, and what others may ask for is written, where
  // it is certain to hold what this run has given it.
  int conditions = 0, emissions = 0;
  bool emitting = false;
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    switch (in.op) {
      case Op::if_begin:
        ++conditions;
        break;
      case Op::if_end:
        --conditions;
        break;
      case Op::if_else:
      case Op::nop:
        break;
      case Op::illuminate_begin:
      case Op::illuminate_cone_begin:
      case Op::solar_begin:
      case Op::solar_cone_begin:
        if (conditions > 0 || ++emissions > 1) return false;
        emitting = true;
        break;
      case Op::illuminate_end:
      case Op::solar_end:
        emitting = false;
        break;
      default:
        if (!light.steps()[i].kernel || !recordedKernels().op[size_t(in.op)]) return false;
    }
    for (const uint32_t a : p.operands(in)) {
      const Symbol& s = p.symbol(a);
      if (s.storage == Storage::kGlobal) {
        const auto id = GlobalId(s.data);
        if (id == GlobalId::k_L && !emitting) return false;
        if ((a & kArgWritten) && id != GlobalId::k_Cl && id != GlobalId::k_Ol) return false;
      }
      if (s.storage != Storage::kOutputParameter) continue;
      if (s.isArray() || (a & kArgRead) || conditions > 0) return false;
    }
  }
  return light.zeroed().empty() || setsWhatItReads(p);
}

}  // namespace fr
