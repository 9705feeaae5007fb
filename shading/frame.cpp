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
  blocks_ = memory_.data() + varyingFloats;
  symbols_.resize(p.symbols.size());
  columns_.resize(e.columnCount());
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    symbols_[i] = ownRegister(i);
    for (uint32_t c = 0; c < p.symbols[i].floats(); ++c) columns_[e.firstColumn(i) + c] = symbols_[i].comp(c);
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

Operand Frame::ownRegister(uint32_t symbol) const {
  const SymbolPlace& place = exe().place(symbol);
  if (exe().program().symbols[symbol].type == SlType::kString) return {};
  if (place.varying) return {memory_.data() + size_t(place.first) * lanes_, lanes_, ~0u};
  return {blocks_ + size_t(place.first) * kLanePad, kLanePad, kLanePad - 1};
}

void Frame::place(GlobalId id, const Operand& values) {
  const uint32_t s = exe().global(id);
  if (s == kNoIndex) return;
  Operand& now = symbols_[s];
  if (now.data == values.data && now.component == values.component) return;
  now = values;
  for (const uint32_t k : exe().argsOf(id)) args_[k] = values;
  for (uint32_t c = 0; c < exe().program().symbols[s].floats(); ++c)
    columns_[exe().firstColumn(s) + c] = values.comp(c);
}

bool Frame::alias(GlobalId id, const Operand& values) {
  const uint32_t s = exe().global(id);
  if (s == kNoIndex || !values.data || (exe().program().writesGlobals & globalBit(id)) ||
      values.varying() != exe().varying(s))
    return false;
  place(id, values);
  return true;
}

void Frame::unalias(GlobalId id) {
  const uint32_t s = exe().global(id);
  if (s != kNoIndex) place(id, ownRegister(s));
}

void Frame::prepare(const ShaderInstance& instance, uint32_t lanes, bool sent) {
  instance_ = &instance;
  if (laidOut_ != instance.exe || lanes_ != lanes) {
    laidOut_ = instance.exe;
    lanes_ = lanes;
    layOut();
    filled_ = 0;
  }
  const Executable& e = exe();
  native_ = nullptr;
  const ShaderProgram& p = e.program();
  // Variables that may be read before they are set start at zero, so that they do not hold the last batch.
  for (const uint32_t s : e.zeroed())
    for (uint32_t c = 0; c < p.symbols[s].floats(); ++c)
      std::memset(symbols_[s].comp(c), 0, (symbols_[s].varying() ? lanes_ : kLanePad) * sizeof(float));
  const bool fill = filled_ != instance.serial || instance.serial == 0 || sent;
  for (uint32_t i = 0; i < p.parameters.size(); ++i) {
    const uint32_t s = p.parameters[i].symbol;
    if (!fill && p.symbols[s].storage == Storage::kParameter && !e.varying(s)) continue;
    const ShaderValue& v = instance.values[i];
    if (p.symbols[s].type == SlType::kString)
      for (uint32_t k = 0; k < v.strings.size(); ++k) strings_[e.place(s).first + k] = v.strings[k];
    else
      fillUniform(symbols_[s], v.floats.data(), uint32_t(v.floats.size()), lanes_);
  }
  filled_ = instance.serial;
  std::memset(counters_, 0, size_t(e.counters()) * lanes_ * sizeof(uint32_t));
  if (p.type == ShaderType::kLight) std::memset(lit, 0, lanes_ * sizeof(int32_t));
  depth = 0;
  rayPhase = raySample = 0;
  finished = true;
}

void Frame::start(const int32_t* startMask) {
  activate(startMask);
  pc = exe().program().bodyBegin;
  end = uint32_t(exe().program().code.size());
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
