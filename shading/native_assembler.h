// Machine code of x86-64 with AVX2, as far as native_run.cpp needs it (Intel 64 and IA-32 Architectures
// Software Developer's Manual, volume 2).
#pragma once

#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <map>
#include <type_traits>
#include <utility>
#include <vector>

namespace fr {

/// General registers by their numbers in instructions.
enum Gpr : uint8_t {
  kRax,
  kRcx,
  kRdx,
  kRbx,
  kRsp,
  kRbp,
  kRsi,
  kRdi,
  kR8,
  kR9,
  kR10,
  kR11,
  kR12,
  kR13,
  kR14,
  kR15
};

/// A place in memory: [base + disp], [base + index + disp], or a constant behind the code.
struct MemoryOperand {
  int base = -1;
  int index = -1;
  int32_t disp = 0;
  int constant = -1;
};

/// The part of a vector instruction that does not depend on its operands.
struct VectorCode {
  uint8_t prefix;  // 0 none, 1 0x66, 2 0xf3
  uint8_t map;     // 1 0f, 2 0f38, 3 0f3a
  uint8_t opcode;
};

class Assembler {
 public:
  /// A place in the code that jumps may go to before it is known.
  using Label = uint32_t;

  size_t size() const { return code_.size(); }
  /// The finished code with its constants; 32-byte aligned constants if the code is placed so.
  std::vector<uint8_t> finish();

  // dst, first and second are ymm registers; first = 0 where an instruction has one source.
  void vector(VectorCode c, int dst, int first, int second) {
    vex(c, dst, first, second >= 8, false);
    byte(c.opcode);
    registerOperand(dst, second);
  }
  void vector(VectorCode c, int dst, int first, const MemoryOperand& second, uint32_t immediateBytes = 0) {
    vex(c, dst, first, second.base >= 8, second.index >= 8);
    byte(c.opcode);
    memoryOperand(dst, second, immediateBytes);
  }
  template <class Second>
  void vectorImmediate(VectorCode c, int dst, int first, const Second& second, uint8_t immediate) {
    if constexpr (std::is_same_v<Second, int>)
      vector(c, dst, first, second);
    else
      vector(c, dst, first, second, 1);
    byte(immediate);
  }
  void loadVector(int dst, const MemoryOperand& from) { vector({0, 1, 0x10}, dst, 0, from); }
  void storeVector(const MemoryOperand& to, int from) { vector({0, 1, 0x11}, from, 0, to); }
  void moveVector(int dst, int from) { vector({0, 1, 0x28}, dst, 0, from); }
  /// Shifts of 32-bit lanes by an immediate: `extension` says which.
  void shift(int extension, int dst, int from, uint8_t count) {
    vex({1, 1, 0x72}, 0, dst, from >= 8, false);
    byte(0x72);
    registerOperand(extension, from);
    byte(count);
  }
  void zeroUpper() { bytes({0xc5, 0xf8, 0x77}); }

  void load(Gpr dst, const MemoryOperand& from) { wide(0x8b, dst, from); }
  void store(const MemoryOperand& to, Gpr from) { wide(0x89, from, to); }
  void address(Gpr dst, const MemoryOperand& of) { wide(0x8d, dst, of); }
  void move(Gpr dst, Gpr from) { wide(0x8b, dst, from); }
  void moveImmediate(Gpr dst, uint64_t value) {
    bytes({uint8_t(0x48 | (dst >> 3)), uint8_t(0xb8 | (dst & 7))});
    for (int k = 0; k < 8; ++k) byte(uint8_t(value >> (8 * k)));
  }
  void clear(Gpr r) {
    bytes({uint8_t(0x45 & ((r >> 3) ? 0xff : 0x40)), 0x31, uint8_t(0xc0 | (r & 7) << 3 | (r & 7))});
  }
  void addImmediate(Gpr r, int32_t value) { arithmeticImmediate(0, r, value); }
  /// Returns where the immediate is, to be patched with patch().
  size_t subtractImmediate(Gpr r, int32_t value) {
    arithmeticImmediate(5, r, value);
    return code_.size() - 4;
  }
  void andImmediate(Gpr r, int32_t value) { arithmeticImmediate(4, r, value); }
  void compare(Gpr a, Gpr b) { wide(0x3b, a, b); }
  void push(Gpr r) {
    if (r >= 8) byte(0x41);
    byte(uint8_t(0x50 | (r & 7)));
  }
  void pop(Gpr r) {
    if (r >= 8) byte(0x41);
    byte(uint8_t(0x58 | (r & 7)));
  }
  void call(Gpr r) {
    if (r >= 8) byte(0x41);
    bytes({0xff, uint8_t(0xd0 | (r & 7))});
  }
  void ret() { byte(0xc3); }

  Label newLabel() {
    labels_.push_back(-1);
    return Label(labels_.size() - 1);
  }
  void place(Label l) { labels_[l] = int64_t(code_.size()); }
  void jump(Label to) {
    byte(0xe9);
    fixLater(to);
  }
  enum Condition : uint8_t { kBelow = 2, kZero = 4, kNotZero = 5 };
  void jumpIf(Condition c, Label to) {
    bytes({0x0f, uint8_t(0x80 | c)});
    fixLater(to);
  }
  /// Fills up with instructions that do nothing.
  void align(size_t n) {
    while (code_.size() % n) byte(0x90);
  }
  void patch(size_t at, int32_t value) { std::memcpy(code_.data() + at, &value, 4); }
  /// Eight times these 32 bits, behind the code.
  MemoryOperand constant(uint32_t bits) {
    const auto [it, added] = constants_.try_emplace(bits, int(constants_.size()));
    return MemoryOperand{-1, -1, 0, it->second};
  }

 private:
  void byte(uint8_t b) { code_.push_back(b); }
  void bytes(std::initializer_list<uint8_t> b) { code_.insert(code_.end(), b); }
  void word(int32_t v) {
    for (int k = 0; k < 4; ++k) byte(uint8_t(uint32_t(v) >> (8 * k)));
  }
  void vex(VectorCode c, int reg, int first, bool rmHigh, bool indexHigh) {
    const auto r = uint8_t(reg >= 8 ? 0 : 0x80), v = uint8_t(~first & 15);
    if (c.map == 1 && !rmHigh && !indexHigh) {
      bytes({0xc5, uint8_t(r | v << 3 | 4 | c.prefix)});
      return;
    }
    bytes({0xc4, uint8_t(r | (indexHigh ? 0 : 0x40) | (rmHigh ? 0 : 0x20) | c.map),
           uint8_t(v << 3 | 4 | c.prefix)});
  }
  void registerOperand(int reg, int rm) { byte(uint8_t(0xc0 | (reg & 7) << 3 | (rm & 7))); }
  void memoryOperand(int reg, const MemoryOperand& m, uint32_t immediateBytes);
  template <class Operand>
  void wide(uint8_t opcode, Gpr reg, const Operand& rm) {
    if constexpr (std::is_same_v<Operand, Gpr>) {
      bytes({uint8_t(0x48 | (reg >> 3) << 2 | rm >> 3), opcode});
      registerOperand(reg, rm);
    } else {
      bytes({uint8_t(0x48 | (reg >> 3) << 2 | (rm.index >= 8 ? 2 : 0) | (rm.base >= 8 ? 1 : 0)), opcode});
      memoryOperand(reg, rm, 0);
    }
  }
  void arithmeticImmediate(int extension, Gpr r, int32_t value) {
    bytes({uint8_t(0x48 | r >> 3), 0x81});
    registerOperand(extension, r);
    word(value);
  }
  void fixLater(Label to) {
    jumps_.push_back({code_.size(), to});
    word(0);
  }

  struct Jump {
    size_t at;
    Label to;
  };
  struct ConstantUse {
    size_t at;
    uint32_t behind;  // bytes of the instruction behind the displacement
    int constant;
  };
  std::vector<uint8_t> code_;
  std::vector<int64_t> labels_;
  std::vector<Jump> jumps_;
  std::vector<ConstantUse> uses_;
  std::map<uint32_t, int> constants_;
};

}  // namespace fr
