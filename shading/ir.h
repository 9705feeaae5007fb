// The typed intermediate representation of a compiled shader.
//
// Three-address code over symbols, with structured control flow and every user function inlined. The
// virtual machine executes it over batches; a native back end can read the same thing: nothing here says
// how it is executed. docs/format/bytecode.md describes each rule, shading/ops.def each operation.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace fr {

enum class ShaderType : uint8_t { kSurface, kLight, kDisplacement, kVolume, kImager, kTransformation };
const char* shaderTypeName(ShaderType type);

enum class SlType : uint8_t { kFloat, kColor, kPoint, kVector, kNormal, kMatrix, kString, kVoid };
const char* slTypeName(SlType type);
inline bool isTriple(SlType t) { return t >= SlType::kColor && t <= SlType::kNormal; }
/// Floats per value: 1, 3 or 16; 0 for strings.
inline uint32_t slTypeFloats(SlType t) {
  return t == SlType::kFloat ? 1u : isTriple(t) ? 3u : t == SlType::kMatrix ? 16u : 0u;
}

enum class SlClass : uint8_t { kUniform, kVarying };

enum class Storage : uint8_t {
  kConstant,
  kParameter,        // read-only
  kOutputParameter,  // written by the shader, read by others and by displays
  kGlobal,           // predefined variable; Symbol::data is its GlobalId
  kLocal,            // named variable: written by assign_* and masked operations only
  kTemp,             // may be computed for inactive points
};

enum class GlobalId : uint8_t {
#define FR_GLOBAL(name, type, cls) k_##name,
#include "shading/globals.def"
#undef FR_GLOBAL
  kCount
};
struct GlobalInfo {
  const char* name;
  SlType type;
  SlClass cls;
};
const GlobalInfo& globalInfo(GlobalId id);
inline uint64_t globalBit(GlobalId id) { return uint64_t(1) << unsigned(id); }

inline constexpr uint32_t kNoIndex = 0xffffffffu;

struct Symbol {
  uint32_t name = 0;  // index into strings; "" for temporaries and constants
  SlType type = SlType::kFloat;
  Storage storage = Storage::kTemp;
  SlClass cls = SlClass::kVarying;
  uint8_t declaredClass = 0;  // 1: the source said `uniform` or `varying`
  uint32_t arrayLength = 0;   // 0: not an array
  uint32_t data = 0;          // constant: first float in `floats`, or string index; global: GlobalId; else 0
  bool isArray() const { return arrayLength != 0; }
  bool isVarying() const { return cls == SlClass::kVarying; }
  /// Floats of one point's value, arrays included.
  uint32_t floats() const { return slTypeFloats(type) * (arrayLength ? arrayLength : 1); }
};
static_assert(sizeof(Symbol) == 16 && std::is_trivially_copyable_v<Symbol>);

enum class Op : uint16_t {
#define FR_OP(name, sig, flags, cost, doc) name,
#include "shading/ops.def"
#undef FR_OP
  kCount
};

/// Properties of an operation, see ops.def.
enum OpFlags : uint32_t {
  kOpPure = 1,  // no effect but its results: may be removed when they are unused, or computed for all points
  kOpFoldable = 2,         // all-constant inputs give a constant, the same on every machine
  kOpRay = 4,              // asks the ray oracle: execution may be suspended here
  kOpDerivative = 8,       // needs neighbours or ray differentials of its inputs
  kOpMasked = 16,          // writes its outputs for active points only
  kOpControl = 32,         // control flow
  kOpResultUniform = 64,   // results are uniform whatever the inputs
  kOpResultVarying = 128,  // results are varying whatever the inputs
  kOpLights = 256,         // runs light shaders
  kOpTexture = 512,        // reads texture, shadow or point files
  kOpRandom = 1024,        // depends on the random stream
};
enum class Cost : uint8_t { kNone, kCheap, kMath, kHeavy, kExternal };

struct OpInfo {
  const char* name;
  const char* signature;
  uint32_t flags;
  Cost cost;
  const char* doc;
};
const OpInfo& opInfo(Op op);
/// Op::kCount when there is none of that name.
Op opByName(std::string_view name);

/// Operand: a symbol index and how it is used.
inline constexpr uint32_t kArgWritten = 0x80000000u;  // the operation writes it
inline constexpr uint32_t kArgRead = 0x40000000u;  // the operation reads it (both bits: read, then written)
inline constexpr uint32_t kArgIndex = 0x3fffffffu;

/// File index, line and column in 8, 16 and 8 bits; each stops at its largest value.
inline uint32_t packPlace(uint32_t file, uint32_t line, uint32_t column) {
  return (file < 255 ? file : 255) << 24 | (line < 65535 ? line : 65535) << 8 | (column < 255 ? column : 255);
}

struct Instruction {
  Op op = Op::nop;
  uint16_t argCount = 0;
  uint32_t firstArg = 0;     // index into args
  uint32_t jump = kNoIndex;  // control flow: index of the matching instruction (docs/format/bytecode.md)
  uint32_t where = 0;        // source place, see packPlace()
  uint32_t file() const { return where >> 24; }
  uint32_t line() const { return (where >> 8) & 0xffffu; }
  uint32_t column() const { return where & 0xffu; }
};
static_assert(sizeof(Instruction) == 16 && std::is_trivially_copyable_v<Instruction>);

/// A shader parameter in order of declaration. Its default is either a constant, or the value that the
/// instructions [codeBegin, codeEnd) leave in the symbol when run at instance binding, after those of all
/// earlier parameters, with coordinate systems set up and no points.
struct Parameter {
  uint32_t symbol = 0;
  uint32_t defaultConstant = kNoIndex;  // a constant symbol of the same type and length
  uint32_t codeBegin = 0;
  uint32_t codeEnd = 0;
};
static_assert(sizeof(Parameter) == 16 && std::is_trivially_copyable_v<Parameter>);

enum ProgramFlags : uint32_t {
  kProgramCanAskRays = 1,     // a ray operation is reachable
  kProgramRaysByMapName = 2,  // a shadow() or environment() whose map may be named "raytrace" at run time
  kProgramUsesDerivatives = 4,
  kProgramUsesLights = 8,    // illuminance, diffuse, ambient ...
  kProgramSetsOpacity = 16,  // writes Oi
  kProgramOpaque = 32,       // Oi is Os wherever it is written, or it is never written
  kProgramUsesRandom = 64,
  kProgramReadsTime = 128,
  kProgramUsesTextures = 256,
  kProgramUsesMessages = 512,   // surface(), lightsource() ...
  kProgramAmbientLight = 1024,  // light without illuminate or solar
  kProgramMovesPoints = 2048,   // writes P
};

/// One compiled shader. Valid by construction when it comes from compileShader*() or readSlx(): every index
/// is in range, operand types match the signatures, control flow nests, jumps match.
struct ShaderProgram {
  ShaderType type = ShaderType::kSurface;
  std::string name;
  uint32_t flags = 0;
  uint64_t readsGlobals = 0;  // bits by GlobalId
  uint64_t writesGlobals = 0;
  uint64_t sourceHash = 0;  // of the preprocessed source and of how it was compiled
  std::vector<Symbol> symbols;
  std::vector<float> floats;
  std::vector<std::string> strings;  // [0] is ""
  std::vector<std::string> files;    // source files that Instruction::where names
  std::vector<uint64_t> fileHashes;  // of the bytes of files[i]; 0: not a file
  std::vector<Parameter> parameters;
  std::vector<uint32_t> args;
  std::vector<Instruction> code;  // default-value code, then the body
  uint32_t bodyBegin = 0;         // the body is [bodyBegin, code.size())

  std::span<const uint32_t> operands(const Instruction& i) const {
    return {args.data() + i.firstArg, i.argCount};
  }
  const Symbol& symbol(uint32_t arg) const { return symbols[arg & kArgIndex]; }
  std::string_view symbolName(uint32_t index) const { return strings[symbols[index].name]; }
  /// kNoIndex when there is no such global or parameter.
  uint32_t findGlobal(GlobalId id) const;
  uint32_t findParameter(std::string_view parameterName) const;  // index into parameters
  bool has(ProgramFlags f) const { return (flags & f) != 0; }
};

/// Readable listing, one instruction a line. For tests and `slctell --code`.
std::string disassemble(const ShaderProgram& program);

}  // namespace fr
