#include "shading/passes.h"

namespace fr {
namespace {

bool writtenOnlyFromOs(const ShaderProgram& p) {
  bool osWritten = false;
  for (const Instruction& in : p.code)
    for (uint32_t a : p.operands(in)) {
      const Symbol& s = p.symbol(a);
      if ((a & kArgWritten) && s.storage == Storage::kGlobal && GlobalId(s.data) == GlobalId::k_Os)
        osWritten = true;
    }
  for (const Instruction& in : p.code) {
    const auto operands = p.operands(in);
    for (size_t k = 0; k < operands.size(); ++k) {
      const Symbol& s = p.symbol(operands[k]);
      if (!(operands[k] & kArgWritten) || s.storage != Storage::kGlobal || GlobalId(s.data) != GlobalId::k_Oi)
        continue;
      if (in.op != Op::assign_t) return false;
      const Symbol& from = p.symbol(operands[1]);
      const bool isOs =
          from.storage == Storage::kGlobal && GlobalId(from.data) == GlobalId::k_Os && !osWritten;
      const bool isOne = from.storage == Storage::kConstant && p.floats[from.data] >= 1 &&
                         p.floats[from.data + 1] >= 1 && p.floats[from.data + 2] >= 1;
      if (!isOs && !isOne) return false;
    }
  }
  return true;
}

/// The map of a shadow() or environment() call: 1 it is "raytrace", 0 it is another constant, -1 unknown.
int isRaytraceName(const ShaderProgram& p, const Instruction& in) {
  for (uint32_t a : p.operands(in)) {
    const Symbol& s = p.symbol(a);
    if (s.type != SlType::kString || (a & kArgWritten)) continue;
    if (s.storage != Storage::kConstant) return -1;
    return p.strings[s.data] == "raytrace" ? 1 : 0;
  }
  return 0;
}

bool isShadowOrEnvironment(Op op) {
  switch (op) {
    case Op::environment_f:
    case Op::environment_t:
    case Op::environment4_f:
    case Op::environment4_t:
    case Op::shadow_f:
    case Op::shadow_t:
    case Op::shadow4_f:
    case Op::shadow4_t:
      return true;
    default:
      return false;
  }
}

}  // namespace

void analyze(ShaderProgram& p) {
  p.flags = 0;
  p.readsGlobals = p.writesGlobals = 0;
  bool lightStatement = false;
  for (const Instruction& in : p.code) {
    const OpInfo& info = opInfo(in.op);
    if (info.flags & kOpRay) p.flags |= kProgramCanAskRays;
    if (info.flags & kOpDerivative) p.flags |= kProgramUsesDerivatives;
    if (info.flags & kOpLights) p.flags |= kProgramUsesLights;
    if (info.flags & kOpRandom) p.flags |= kProgramUsesRandom;
    if (info.flags & kOpTexture) p.flags |= kProgramUsesTextures;
    if (isShadowOrEnvironment(in.op)) {
      const int raytrace = isRaytraceName(p, in);
      if (raytrace > 0) p.flags |= kProgramCanAskRays;
      if (raytrace < 0) p.flags |= kProgramRaysByMapName;
    }
    switch (in.op) {
      case Op::msg_surface:
      case Op::msg_displacement:
      case Op::msg_atmosphere:
      case Op::msg_lightsource:
      case Op::msg_incident:
      case Op::msg_opposite:
        p.flags |= kProgramUsesMessages;
        break;
      case Op::illuminate_begin:
      case Op::illuminate_cone_begin:
      case Op::solar_begin:
      case Op::solar_cone_begin:
        lightStatement = true;
        break;
      case Op::area:
        p.flags |= kProgramUsesDerivatives;
        break;
      default:
        break;
    }
    for (uint32_t a : p.operands(in)) {
      const Symbol& s = p.symbol(a);
      if (s.storage != Storage::kGlobal) continue;
      if (a & kArgRead) p.readsGlobals |= globalBit(GlobalId(s.data));
      if (a & kArgWritten) p.writesGlobals |= globalBit(GlobalId(s.data));
    }
  }
  if (p.writesGlobals & globalBit(GlobalId::k_Oi)) p.flags |= kProgramSetsOpacity;
  if (p.writesGlobals & globalBit(GlobalId::k_P)) p.flags |= kProgramMovesPoints;
  if (p.readsGlobals & (globalBit(GlobalId::k_time) | globalBit(GlobalId::k_dtime)))
    p.flags |= kProgramReadsTime;
  if (p.type == ShaderType::kSurface && writtenOnlyFromOs(p)) p.flags |= kProgramOpaque;
  if (p.type == ShaderType::kLight && !lightStatement) p.flags |= kProgramAmbientLight;
}

}  // namespace fr
