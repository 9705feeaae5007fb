// A program's runs of elementwise instructions as machine code.
//
// Between two instructions of another kind (control flow, textures, rays, strings) all values of a point stay
// in registers; what is read later is stored. The machine runs a program with or without: the results are the
// same bits.
#pragma once

#include <memory>
#include <vector>

#include "shading/native_run.h"

namespace fr {

class Executable;

class NativeCode {
 public:
  struct Run {
    RunFunction function = nullptr;
    uint32_t end = 0;                      // the instruction behind it
    uint32_t steps = 0, varyingSteps = 0;  // that it stands for
  };
  /// Nothing when there is no such code here (nativeCodeAvailable()) or the program has no use for it.
  static std::unique_ptr<const NativeCode> compile(const Executable& exe);

  /// The run that begins at an instruction, nullptr if none does.
  const Run* at(uint32_t instruction) const {
    const uint32_t r = runAt_[instruction];
    return r == 0 ? nullptr : &runs_[r - 1];
  }
  size_t bytes() const { return memory_->size(); }
  size_t runCount() const { return runs_.size(); }

 private:
  NativeCode() = default;
  std::vector<uint32_t> runAt_;  // by instruction: 1 + index into runs_, or 0
  std::vector<Run> runs_;
  std::unique_ptr<NativeMemory> memory_;
};

}  // namespace fr
