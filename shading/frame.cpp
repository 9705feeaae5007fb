#include "shading/frame.h"

#include <algorithm>
#include <cstring>

namespace fr {

namespace {
void fillUniform(const Operand& o, const float* values, uint32_t count, uint32_t lanes) {
  const uint32_t n = o.varying() ? lanes : kLanePad;
  for (uint32_t c = 0; c < count; ++c) std::fill_n(o.comp(c), n, values[c]);
}
}  // namespace

void Frame::layOut() {
  const Executable& e = exe();
  const ShaderProgram& p = e.program();
  const size_t varyingFloats = size_t(e.columns()) * lanes_;
  memory_.reserve(varyingFloats + size_t(e.blocks()) * kLanePad + kLanePad);
  // Registers start at zero: unset variables and padding lanes are defined numbers.
  std::memset(memory_.data(), 0, memory_.size() * sizeof(float));
  float* const blocks = memory_.data() + varyingFloats;
  symbols_.resize(p.symbols.size());
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    const SymbolPlace& place = e.place(i);
    if (p.symbols[i].type == SlType::kString)
      symbols_[i] = Operand{};
    else if (place.varying)
      symbols_[i] = Operand{memory_.data() + size_t(place.first) * lanes_, lanes_, ~0u};
    else
      symbols_[i] = Operand{blocks + size_t(place.first) * kLanePad, kLanePad, kLanePad - 1};
  }
  args_.resize(p.args.size());
  for (size_t i = 0; i < p.args.size(); ++i) args_[i] = symbols_[p.args[i] & kArgIndex];
  strings_.assign(e.strings() + 1, {});
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    const Symbol& s = p.symbols[i];
    if (s.storage != Storage::kConstant) continue;
    if (s.type == SlType::kString) {
      for (uint32_t k = 0; k < std::max(1u, s.arrayLength); ++k)
        strings_[e.place(i).first + k] = p.strings[s.data + k];
    } else {
      fillUniform(symbols_[i], p.floats.data() + s.data, s.floats(), lanes_);
    }
  }
  control.resize(e.depth() + 1);
  const size_t maskColumns = 2 + 3 * control.size() + e.counters();
  masks_.reserve(maskColumns * lanes_);
  mask = reinterpret_cast<int32_t*>(masks_.data());
  lit = mask + lanes_;
  blockMasks_ = lit + lanes_;
  counters_ = reinterpret_cast<uint32_t*>(blockMasks_ + 3 * control.size() * lanes_);
}

void Frame::prepare(const ShaderInstance& instance, uint32_t lanes) {
  instance_ = &instance;
  if (laidOut_ != instance.exe.get() || lanes_ != lanes) {
    laidOut_ = instance.exe.get();
    lanes_ = lanes;
    layOut();
  }
  // Local variables start at zero, so that a variable that a shader forgets to set does not hold the last
  // batch.
  const Executable& e = exe();
  std::memset(memory_.data(), 0, size_t(e.localColumns()) * lanes_ * sizeof(float));
  std::memset(memory_.data() + size_t(e.columns()) * lanes_, 0,
              size_t(e.localBlocks()) * kLanePad * sizeof(float));
  const ShaderProgram& p = exe().program();
  for (uint32_t i = 0; i < p.parameters.size(); ++i) {
    const uint32_t s = p.parameters[i].symbol;
    const ShaderValue& v = instance.values[i];
    if (p.symbols[s].type == SlType::kString)
      for (uint32_t k = 0; k < v.strings.size(); ++k) strings_[exe().place(s).first + k] = v.strings[k];
    else
      fillUniform(symbols_[s], v.floats.data(), uint32_t(v.floats.size()), lanes_);
  }
  std::memset(counters_, 0, size_t(exe().counters()) * lanes_ * sizeof(uint32_t));
  std::memset(lit, 0, lanes_ * sizeof(int32_t));
  depth = 0;
  rayPhase = raySample = 0;
  finished = true;
}

void Frame::start(const int32_t* startMask) {
  std::memcpy(mask, startMask, lanes_ * sizeof(int32_t));
  pc = exe().program().bodyBegin;
  end = uint32_t(exe().program().code.size());
  active = kernels().anyActive(mask, lanes_);
  depth = 0;
  rayPhase = raySample = 0;
  solar = false;
  finished = false;
}

Control& Frame::push(Control::Kind kind) {
  Control& c = control[depth];
  c = Control{};
  c.kind = kind;
  c.begin = pc;
  c.saved = blockMasks_ + size_t(depth) * 3 * lanes_;
  c.other = c.saved + lanes_;
  c.third = c.other + lanes_;
  ++depth;
  return c;
}

}  // namespace fr
