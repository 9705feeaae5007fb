// A ShaderProgram prepared for the virtual machine: every symbol has a place in a frame, every instruction
// its kernel.
//
// Immutable, but for the machine code that is made when the program has proved to be in use; shared by all
// instances of the shader in a process.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

#include "shading/kernels.h"
#include "shading/native_code.h"
#include "shading/parameter_branches.h"
#include "shading/shadeop_library.h"

namespace fr {

class Liveness;

/// An instruction as the machine's loop reads it.
struct Step {
  Kernel kernel = nullptr;  // nullptr: the machine's own code
  uint32_t firstArg = 0;
  uint32_t jump = kNoIndex;
  Op op = Op::nop;
  uint16_t argCount = 0;
  const Shadeop* shadeop = nullptr;
  uint32_t counter = kNoIndex;  // column of per-point invocation counts (random numbers, rays)
  uint32_t unread = 0;          // rays: bit k: nobody reads what operand k is given
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
  /// Predefined variables that the program uses.
  const std::vector<GlobalId>& usedGlobals() const { return usedGlobals_; }
  /// Places in ShaderProgram::args that hold a global.
  const std::vector<uint32_t>& argsOf(GlobalId id) const { return globalArgs_[size_t(id)]; }
  /// The value that a symbol has when the body begins may be read.
  bool liveAtEntry(uint32_t symbol) const { return liveAtEntry_[symbol]; }
  /// Variables of which that holds: they begin with 0.
  const std::vector<uint32_t>& zeroed() const { return zeroed_; }
  /// By instruction: some of the points that the shader began with may be inactive there.
  const std::vector<bool>& varyingControl() const { return varyingControl_; }
  /// Numbers the components of all symbols (array elements too) that are not strings.
  uint32_t firstColumn(uint32_t symbol) const { return firstColumn_[symbol]; }
  uint32_t columnCount() const { return columnCount_; }

  /// The program as machine code for batches that are lit by `lights`, nullptr until there is any. Asked once
  /// for a batch: after some batches the code is made, by the thread that asks then, while others go on
  /// without. Thread-safe. `owner`(k): the executable of light k, which the code keeps alive. `final`: set
  /// when the answer will not change any more.
  template <class Owner>
  const NativeCode* native(std::span<const RunLight> lights, const Owner& owner,
                           bool* final = nullptr) const {
    bool ignored;
    return native(
        lights, [](const void* o, uint32_t k) { return (*static_cast<const Owner*>(o))(k); }, &owner,
        final ? *final : ignored);
  }
  /// Without lights.
  const NativeCode* native() const {
    return native({}, [](uint32_t) { return std::shared_ptr<const Executable>(); });
  }
  /// The same for instances with these values, which decide what they can (parameter_branches.h). nullptr:
  /// they decide nothing. Thread-safe.
  std::shared_ptr<const Executable> decided(const std::vector<ShaderValue>& values) const;
  /// From now on code is made for the first batch.
  void makeNativeAtOnce() const { nativeAtOnce_.store(true, std::memory_order_relaxed); }
  /// How often code was made. For tests.
  uint32_t nativeCount() const;

  uint32_t columns() const { return columns_; }
  uint32_t blocks() const { return blocks_; }
  uint32_t strings() const { return strings_; }
  uint32_t counters() const { return counters_; }
  uint32_t depth() const { return depth_; }  // deepest nesting of control flow
  bool has(ProgramFlags f) const { return program_->has(f); }
  /// A light that machine code of surfaces may contain (run_light.h).
  bool plainLight() const { return plainLight_; }

 private:
  using OwnerOf = std::shared_ptr<const Executable> (*)(const void* owner, uint32_t light);
  const NativeCode* native(std::span<const RunLight> lights, OwnerOf ownerOf, const void* owner,
                           bool& final) const;
  void inferClasses(const std::vector<std::string>& varyingParameters);
  bool followControl(std::vector<char>& leaves, bool inferring);
  void placeSymbols(const Liveness& liveness);
  void prepareSteps();
  void findUnread(const Liveness& liveness);
  void bindShadeop(Step& s, const Instruction& in);

  std::shared_ptr<const ShaderProgram> program_;
  std::vector<std::string> varyingParameters_;
  std::vector<ParameterTest> parameterTests_;
  std::vector<Step> steps_;
  std::vector<SymbolPlace> places_;
  std::array<uint32_t, size_t(GlobalId::kCount)> globals_;
  std::array<std::vector<uint32_t>, size_t(GlobalId::kCount)> globalArgs_;
  std::vector<GlobalId> usedGlobals_;
  std::vector<bool> varyingControl_, liveAtEntry_;
  std::vector<uint32_t> zeroed_, firstColumn_;
  uint32_t columns_ = 0, blocks_ = 0, strings_ = 0, counters_ = 0, depth_ = 0, columnCount_ = 0;
  bool plainLight_ = false;
  /// Code for one set of lights.
  struct Native {
    std::vector<RunLight> lights;
    std::vector<std::shared_ptr<const Executable>> owners;
    uint32_t batches = 0;
    bool tried = false, done = false;        // compilation has begun; has ended
    std::unique_ptr<const NativeCode> code;  // once made it stays
  };
  mutable std::mutex nativeMutex_;
  mutable std::vector<std::unique_ptr<Native>> natives_;
  mutable std::atomic<bool> nativeAtOnce_{false};
  mutable std::mutex decidedMutex_;
  mutable std::vector<std::pair<uint64_t, std::shared_ptr<const Executable>>> decided_;
};

}  // namespace fr
