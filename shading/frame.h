// A running shader: registers, masks, program counter and loop states. On the heap, so that a shader can stop
// at any ray call.
#pragma once

#include <cstdlib>
#include <memory>
#include <string_view>
#include <vector>

#include "shading/shader_instance.h"

namespace fr {

/// 64-byte aligned floats that only grow.
class AlignedFloats {
 public:
  /// At least n floats; contents are lost when it has to grow. Returns true when the address changed.
  bool reserve(size_t n) {
    if (n <= size_) return false;
    data_.reset(static_cast<float*>(std::aligned_alloc(64, (n * sizeof(float) + 63) / 64 * 64)));
    if (!data_) std::abort();
    size_ = n;
    return true;
  }
  float* data() const { return data_.get(); }
  size_t size() const { return size_; }

 private:
  struct Free {
    void operator()(float* p) const { std::free(p); }
  };
  std::unique_ptr<float, Free> data_;
  size_t size_ = 0;
};

/// An open block of control flow. Masks: `saved` is restored at the end of the block, less the points that
/// left it for an outer place; `other` depends on the kind.
struct Control {
  enum class Kind : uint8_t { kIf, kUniformIf, kLoop, kInline, kLights, kIlluminate, kGather };
  enum class Phase : uint8_t { kNext, kReturned, kAimed, kShadowed, kBody };
  Kind kind = Kind::kIf;
  Phase phase = Phase::kNext;
  bool anyContinued = false;
  bool ahead = false;  // kLights: before the machine code that the loop is part of, without its body
  uint32_t begin = 0;  // index of the first instruction of the block
  uint32_t turns = 0;
  int32_t light = -1;    // kLights: index into the task's lights; kGather: sample
  uint32_t samples = 0;  // kGather
  int32_t* saved = nullptr;
  int32_t* other = nullptr;  // kIf: points for the else branch. kLoop: points that continued. kLights,
                             // kGather: live points
  int32_t* third = nullptr;  // kLights: points that the light must be run for. kGather: points that hit
};

class Frame {
 public:
  /// Lays registers out for `lanes` points, writes constants and parameter values. Cheap when the frame ran
  /// the same instance over as many lanes before. Without machine code. `sent`: parameters have been written
  /// to from outside since.
  void prepare(const ShaderInstance& instance, uint32_t lanes, bool sent = false);
  /// Puts a global where the caller's values are, if the program only reads it and has as many values of it.
  /// The values stay valid until the shader is done.
  bool alias(GlobalId id, const Operand& values);
  /// The opposite: the global has a register of its own.
  void unalias(GlobalId id);
  /// Points a global's operands elsewhere; columns as those of its register.
  void place(GlobalId id, const Operand& values);
  /// The register that belongs to a symbol, wherever its operands point now.
  Operand ownRegister(uint32_t symbol) const;
  /// Sets the program counter to the body's first instruction and activates the points of `mask`.
  void start(const int32_t* mask);

  const ShaderInstance& instance() const { return *instance_; }
  const Executable& exe() const { return *instance_->exe; }
  const Operand& symbol(uint32_t index) const { return symbols_[index]; }
  /// Operand k of a step.
  const Operand* args(const Step& s) const { return args_.data() + s.firstArg; }
  std::string_view* strings(uint32_t symbol) { return strings_.data() + exe().place(symbol).first; }
  /// Register of a global, data == nullptr when the program does not use it.
  Operand global(GlobalId id) const {
    const uint32_t s = exe().global(id);
    return s == kNoIndex ? Operand{} : symbols_[s];
  }
  uint32_t lanes() const { return lanes_; }
  /// Machine code of the program, nullptr while there is none.
  const NativeCode* native() const { return native_; }
  void useNative(const NativeCode* code) { native_ = code; }
  /// The parameters of this instance are in their registers, for so many points.
  bool holds(const ShaderInstance& instance, uint32_t lanes) const {
    return instance_ == &instance && laidOut_ == instance.exe && lanes_ == lanes && instance.serial != 0 &&
           filled_ == instance.serial;
  }
  /// Where the components of all symbols are, by Executable::firstColumn().
  float* const* columns() const { return columns_.data(); }

  /// The mask has changed.
  void countActive() {
    activeCount = kernels().countActive(mask, lanes_);
    active = activeCount != 0;
  }
  void activate(const int32_t* points) {
    activeCount = kernels().copyMask(mask, points, lanes_);
    active = activeCount != 0;
  }
  Control& push(Control::Kind kind);
  void pop() { --depth; }
  Control& top() { return control[depth - 1]; }

  uint32_t pc = 0;
  uint32_t end = 0;          // runs until here
  bool active = false;       // any lane of mask set
  uint32_t activeCount = 0;  // as many, as long as any are
  int32_t* mask = nullptr;
  int32_t* lit = nullptr;  // light: points that an illuminate or solar reached
  bool solar = false;      // light: the last statement was solar
  bool finished = false;
  uint32_t depth = 0;
  std::vector<Control> control;
  uint32_t rayPhase = 0;  // of the ray operation at pc: 0 ask, 1 answered
  uint32_t raySample = 0;
  uint32_t* counter(uint32_t c) const { return counters_ + size_t(c) * lanes_; }

 private:
  void layOut();
  const ShaderInstance* instance_ = nullptr;
  std::shared_ptr<const Executable> laidOut_;
  uint64_t filled_ = 0;  // serial of the instance whose parameters are in their registers
  const NativeCode* native_ = nullptr;
  uint32_t lanes_ = 0;
  AlignedFloats memory_, masks_;
  uint32_t* counters_ = nullptr;
  int32_t* blockMasks_ = nullptr;
  float* blocks_ = nullptr;  // uniform registers
  std::vector<Operand> symbols_, args_;
  std::vector<float*> columns_;
  std::vector<std::string_view> strings_;
};

}  // namespace fr
