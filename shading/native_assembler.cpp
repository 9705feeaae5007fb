#include "shading/native_assembler.h"

namespace fr {

void Assembler::memoryOperand(int reg, const MemoryOperand& m, uint32_t immediateBytes) {
  const auto field = uint8_t((reg & 7) << 3);
  if (m.constant >= 0) {
    byte(uint8_t(field | 5));
    uses_.push_back({code_.size(), immediateBytes, m.constant});
    word(0);
    return;
  }
  // Without a displacement unless the base is rbp or r13, which cannot do without.
  const uint8_t mode = m.disp == 0 && (m.base & 7) != 5 ? 0 : m.disp >= -128 && m.disp <= 127 ? 0x40 : 0x80;
  if (m.index >= 0) {
    bytes({uint8_t(mode | field | 4), uint8_t((m.index & 7) << 3 | (m.base & 7))});
  } else if ((m.base & 7) == 4) {
    bytes({uint8_t(mode | field | 4), uint8_t(4 << 3 | (m.base & 7))});
  } else {
    byte(uint8_t(mode | field | (m.base & 7)));
  }
  if (mode == 0x40) byte(uint8_t(m.disp));
  if (mode == 0x80) word(m.disp);
}

std::vector<uint8_t> Assembler::finish() {
  for (const Jump& j : jumps_) patch(j.at, int32_t(labels_[j.to] - int64_t(j.at) - 4));
  align(32);
  const size_t pool = code_.size();
  code_.resize(pool + constants_.size() * 32);
  for (const auto& [bits, index] : constants_)
    for (size_t k = 0; k < 8; ++k) std::memcpy(code_.data() + pool + size_t(index) * 32 + k * 4, &bits, 4);
  for (const ConstantUse& u : uses_)
    patch(u.at, int32_t(int64_t(pool) + u.constant * 32 - int64_t(u.at) - 4 - int64_t(u.behind)));
  return std::move(code_);
}

}  // namespace fr
