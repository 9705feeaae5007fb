// Which values may still be read: what need not be stored, and what must be 0 or given before a shader
// begins.
#pragma once

#include <cstdint>
#include <vector>

#include "shading/ir.h"

namespace fr {

/// L, Cl and Ol of shaders that are lit: light loops set them for their bodies, and nobody else asks for
/// them.
bool setByLightLoop(const ShaderProgram& program, GlobalId id);

class Liveness {
 public:
  /// `varyingControl[i]`: some points may be inactive at instruction i, so what it assigns does not replace
  /// all of the old value. The results of a shader (Ci, Oi, alpha) are read at its end; other predefined
  /// variables and output parameters may be read by the renderer and other shaders at any time.
  Liveness(const ShaderProgram& program, const std::vector<bool>& varyingControl);

  /// The value that the symbol has when the body begins may be read.
  bool atEntry(uint32_t symbol) const { return has(liveIn_.empty() ? none_ : liveIn_[0], symbol); }
  /// One bit a symbol.
  using Bits = std::vector<uint64_t>;
  /// For each of `places`, instruction indices in rising order, the symbols that may be read from there on.
  std::vector<Bits> before(const std::vector<uint32_t>& places) const;
  static bool has(const Bits& b, uint32_t i) { return i / 64 < b.size() && (b[i / 64] >> (i % 64) & 1); }

 private:
  void stepBack(uint32_t instruction, Bits& live) const;
  void addSuccessors(uint32_t instruction, Bits& live) const;

  const ShaderProgram& program_;
  const std::vector<bool>& varyingControl_;
  std::vector<uint32_t> blockOf_, begins_;  // by instruction of the body; by block
  std::vector<Bits> liveIn_;
  Bits always_, none_;
};

}  // namespace fr
