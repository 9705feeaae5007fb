// The kernels once more, as recipes: run with recorded values, each appends what it computes to a graph.
#pragma once

#include <cstdint>

#include "shading/kernels.h"
#include "shading/value_graph.h"

namespace fr {

/// Gives a recipe its operands and takes its results.
class OperandRecorder {
 public:
  virtual NodeIndex read(uint32_t operand, uint32_t component) = 0;
  virtual void write(uint32_t operand, uint32_t component, NodeIndex value) = 0;

 protected:
  ~OperandRecorder() = default;
};

/// Recipes called on this thread append to `graph` for as long as this lives.
class RecordingScope {
 public:
  explicit RecordingScope(ValueGraph& graph);
  ~RecordingScope();
  RecordingScope(const RecordingScope&) = delete;
  RecordingScope& operator=(const RecordingScope&) = delete;

 private:
  ValueGraph* before_;
};

namespace recorded {

// What the kernels' files know under the names of kernels.h.
struct Operand {
  OperandRecorder* recorder = nullptr;
  uint32_t index = 0;
};
struct KernelCall {
  const Operand* arg = nullptr;
  uint32_t argCount = 0;
  uint32_t lanes = 1;
  const int32_t* mask = nullptr;  // results are masked by whoever stores them
  const float* matrix = nullptr;
  uint32_t mode = 0;
};
using Kernel = void (*)(const KernelCall&);
struct KernelTable {
  Kernel op[size_t(Op::kCount)] = {};
  Kernel helper[size_t(Helper::kCount)] = {};
};

}  // namespace recorded

/// Thread-safe.
const recorded::KernelTable& recordedKernels();

}  // namespace fr
