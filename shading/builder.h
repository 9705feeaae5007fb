// Grows a ShaderProgram: constants are stored once, constant operations are evaluated at once.
#pragma once

#include <map>
#include <span>

#include "base/error.h"
#include "shading/ir.h"

namespace fr {

inline constexpr size_t kMaxInstructions = 2000000;
inline constexpr size_t kMaxArrayLength = 65536;

class ProgramBuilder {
 public:
  ProgramBuilder();

  ShaderProgram program;
  uint32_t where = 0;  // source place of what is emitted next

  uint32_t text(std::string_view s);  // index into strings
  uint32_t constantFloat(float v);
  uint32_t constantFloats(SlType type, std::span<const float> v, uint32_t arrayLength = 0);
  uint32_t constantString(std::string_view s);
  uint32_t temp(SlType type);
  uint32_t local(std::string_view name, SlType type, uint32_t arrayLength = 0);
  uint32_t global(GlobalId id);
  const Symbol& symbol(uint32_t i) const { return program.symbols[i]; }
  bool isConstant(uint32_t i) const { return symbol(i).storage == Storage::kConstant; }
  std::span<const float> constantValue(uint32_t i) const;

  /// Appends an instruction. Operand bits follow from the operation's signature; optional pairs keep theirs.
  void emit(Op op, std::span<const uint32_t> operands);
  void emit(Op op, std::initializer_list<uint32_t> operands) {
    emit(op, std::span(operands.begin(), operands.size()));
  }
  /// A new temporary with the operation's result, or a constant when all operands are and it can be folded.
  uint32_t result(Op op, SlType type, std::span<const uint32_t> inputs);
  uint32_t result(Op op, SlType type, std::initializer_list<uint32_t> inputs) {
    return result(op, type, std::span(inputs.begin(), inputs.size()));
  }
  /// assign_* by type.
  void assign(uint32_t to, uint32_t from);
  bool full() const { return program.code.size() >= kMaxInstructions; }

 private:
  std::map<std::pair<SlType, std::vector<uint32_t>>, uint32_t> constants_;
  std::map<std::string, uint32_t, std::less<>> strings_;
  std::map<uint32_t, uint32_t> stringConstants_;
  std::map<GlobalId, uint32_t> globals_;
};

/// Evaluates a kOpFoldable operation on constants; inputs[i] points to the floats of the i-th input. False
/// when this operation or these values cannot be folded (division by 0: the renderer shall warn).
bool foldConstant(Op op, std::span<const float* const> inputs, float* out);

/// Fills in every `jump`, or says what does not nest. Run it after each change of the code's order.
Result<void> resolveJumps(ShaderProgram& program);

}  // namespace fr
