// A program's runs of elementwise instructions as machine code.
//
// Between two instructions of another kind (loops, textures, rays, strings) all values of a point stay in
// registers; what is read later is stored. Short conditions and light loops are part of a run.
// The machine runs a program with or without: the results are the same bits.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "shading/ir.h"
#include "shading/native_run.h"
#include "shading/run_light.h"

namespace fr {

class Executable;

class NativeCode {
 public:
  struct Run {
    RunFunction function = nullptr;
    uint32_t end = 0;                      // the instruction behind it
    uint32_t steps = 0, varyingSteps = 0;  // that it stands for
    uint32_t lights = 0;                   // evaluations of a light
    bool readsLights = false;              // its columns are the program's, then those of the lights in a row
    uint32_t loopAhead = kNoIndex;         // the lights of this loop run before it
    std::vector<RunDifference> differences;  // are computed before it, into columns from this one on
    uint32_t firstDifference = 0;
  };
  /// For batches that are lit by `lights`. Nothing when there is no such code here (nativeCodeAvailable()) or
  /// the program has no use for it.
  static std::unique_ptr<const NativeCode> compile(const Executable& exe, std::span<const RunLight> lights);

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
