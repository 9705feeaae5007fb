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
}  // namespace

bool runsAhead(const Executable& light) {
  const auto& code = light.program().code;
  return std::none_of(code.begin(), code.end(),
                      [](const Instruction& in) { return in.op == Op::msg_surface; });
}

bool plainLight(const Executable& light) {
  const ShaderProgram& p = light.program();
  if (p.type != ShaderType::kLight || !light.zeroed().empty()) return false;
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
  return true;
}

}  // namespace fr
