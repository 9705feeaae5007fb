// A ShaderProgram prepared for the virtual machine: every symbol has a place in a frame, every instruction
// its kernel.
//
// Immutable; shared by all instances of the shader in a process.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "shading/kernels.h"
#include "shading/shadeop_library.h"

namespace fr {

/// An instruction as the machine's loop reads it.
struct Step {
  Kernel kernel = nullptr;  // nullptr: the machine's own code
  uint32_t firstArg = 0;
  uint32_t jump = kNoIndex;
  Op op = Op::nop;
  uint16_t argCount = 0;
  const Shadeop* shadeop = nullptr;
  uint32_t counter = kNoIndex;  // column of per-point invocation counts (random numbers, rays)
  bool varying = false;         // some result is varying: runs over the whole batch
  bool masked = false;
  bool control = false;  // looked at even when no point is active
};

/// Where a symbol lives: column (varying), block (uniform) or index into the frame's strings.
struct SymbolPlace {
  uint32_t first = 0;
  bool varying = false;
};

class Executable {
 public:
  /// `varyingParameters`: names of parameters that instances of this executable get per point (primitive
  /// variables); what depends on them becomes varying too.
  explicit Executable(std::shared_ptr<const ShaderProgram> program,
                      const std::vector<std::string>& varyingParameters = {});

  const ShaderProgram& program() const { return *program_; }
  const std::vector<Step>& steps() const { return steps_; }
  const SymbolPlace& place(uint32_t symbol) const { return places_[symbol]; }
  bool varying(uint32_t symbol) const { return places_[symbol].varying; }
  uint32_t global(GlobalId id) const { return globals_[size_t(id)]; }  // symbol, kNoIndex: not used
  uint32_t columns() const { return columns_; }
  uint32_t blocks() const { return blocks_; }
  /// Columns and blocks of named local variables come first: [0, localColumns).
  uint32_t localColumns() const { return localColumns_; }
  uint32_t localBlocks() const { return localBlocks_; }
  uint32_t strings() const { return strings_; }
  uint32_t counters() const { return counters_; }
  uint32_t depth() const { return depth_; }  // deepest nesting of control flow
  bool has(ProgramFlags f) const { return program_->has(f); }

 private:
  void inferClasses(const std::vector<std::string>& varyingParameters);
  void placeSymbols();
  void prepareSteps();
  void bindShadeop(Step& s, const Instruction& in);

  std::shared_ptr<const ShaderProgram> program_;
  std::vector<Step> steps_;
  std::vector<SymbolPlace> places_;
  std::array<uint32_t, size_t(GlobalId::kCount)> globals_;
  uint32_t columns_ = 0, blocks_ = 0, strings_ = 0, counters_ = 0, depth_ = 0, localColumns_ = 0,
           localBlocks_ = 0;
};

}  // namespace fr
