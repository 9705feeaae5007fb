// A graph as machine code: values in registers from the first load of a point to the last store.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "shading/value_graph.h"

namespace fr {

/// What becomes of a graph's values.
struct RunOutput {
  uint32_t column = 0;
  NodeIndex value = 0;
  bool uniform = false;  // the column is a block of 16 equal floats
  bool masked = false;   // active points alone
};

/// Turns after which a loop is ended: more than any shader needs, fewer than a user would wait for.
inline constexpr uint32_t kMostTurns = 1u << 20;

/// Not 0: a loop was ended. columns[c]: column c of ValueGraph::load() and RunOutput, `bytes` long (a
/// multiple of 64) unless it is uniform.
using RunFunction = uint64_t (*)(float* const* columns, size_t bytes, const int32_t* mask);

/// True where machine code can be made: x86-64 with AVX2, not forbidden by FRANKENRENDER_NATIVE=0.
bool nativeCodeAvailable();

/// The instructions of a function that computes `outputs` for all points, or, when `skipInactive`, for
/// vectors that have an active point.
std::vector<uint8_t> compileRun(const ValueGraph& graph, const std::vector<RunOutput>& outputs,
                                bool skipInactive);

/// Memory that can be executed, and no longer be written.
class NativeMemory {
 public:
  /// Nothing when the system gives none.
  static std::unique_ptr<NativeMemory> of(const std::vector<uint8_t>& code);
  ~NativeMemory();
  NativeMemory(const NativeMemory&) = delete;
  NativeMemory& operator=(const NativeMemory&) = delete;
  const uint8_t* at(size_t offset) const { return static_cast<const uint8_t*>(memory_) + offset; }
  size_t size() const { return size_; }

 private:
  NativeMemory(void* memory, size_t size) : memory_(memory), size_(size) {}
  void* memory_;
  size_t size_;
};

}  // namespace fr
