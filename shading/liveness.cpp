// Backward data flow over blocks of instructions (A. Aho, R. Sethi, J. Ullman, "Compilers", 1986, 10.6).
#include "shading/liveness.h"

#include <algorithm>

namespace fr {

namespace {
bool isResult(const Symbol& s) {
  return s.storage == Storage::kGlobal &&
         (GlobalId(s.data) == GlobalId::k_Ci || GlobalId(s.data) == GlobalId::k_Oi ||
          GlobalId(s.data) == GlobalId::k_alpha);
}
bool isAssign(Op op) {
  return op == Op::assign_f || op == Op::assign_t || op == Op::assign_m || op == Op::assign_s;
}
bool isLightLoop(Op op) {
  return op == Op::illuminance_begin || op == Op::illuminance_cone_begin || op == Op::ambient_begin;
}
/// Nobody ever goes back to the beginning from there.
bool endsBlock(Op op) {
  return op == Op::if_end || op == Op::inline_end || op == Op::illuminate_end || op == Op::solar_end;
}
}  // namespace

bool setByLightLoop(const ShaderProgram& p, GlobalId id) {
  return p.type != ShaderType::kLight &&
         (id == GlobalId::k_L || id == GlobalId::k_Cl || id == GlobalId::k_Ol);
}

Liveness::Liveness(const ShaderProgram& p, const std::vector<bool>& varyingControl)
    : program_(p), varyingControl_(varyingControl) {
  const size_t words = (p.symbols.size() + 63) / 64;
  always_.assign(words, 0);
  for (size_t i = 0; i < p.symbols.size(); ++i) {
    const Storage st = p.symbols[i].storage;
    const bool lit = st == Storage::kGlobal && setByLightLoop(p, GlobalId(p.symbols[i].data));
    if (st == Storage::kParameter || st == Storage::kOutputParameter || (st == Storage::kGlobal && !lit))
      always_[i / 64] |= uint64_t(1) << (i % 64);
  }
  const auto end = uint32_t(p.code.size());
  blockOf_.assign(end - p.bodyBegin, 0);
  bool open = false;
  for (uint32_t i = p.bodyBegin; i < end; ++i) {
    const bool control = (opInfo(p.code[i].op).flags & kOpControl) != 0;
    if (!open || control) begins_.push_back(i);
    blockOf_[i - p.bodyBegin] = uint32_t(begins_.size() - 1);
    open = !control;
  }
  liveIn_.assign(begins_.size(), Bits(words, 0));
  for (bool changed = true; changed;) {
    changed = false;
    for (size_t b = begins_.size(); b-- > 0;) {
      const uint32_t first = begins_[b], last = b + 1 < begins_.size() ? begins_[b + 1] : end;
      Bits live(words, 0);
      addSuccessors(last - 1, live);
      for (uint32_t i = last; i-- > first;) stepBack(i, live);
      if (live != liveIn_[b]) liveIn_[b] = std::move(live), changed = true;
    }
  }
}

void Liveness::addSuccessors(uint32_t i, Bits& live) const {
  const auto add = [&](const Bits& b) {
    for (size_t w = 0; w < live.size(); ++w) live[w] |= b[w];
  };
  const auto from = [&](uint32_t k) {
    if (k < program_.code.size())
      add(liveIn_[blockOf_[k - program_.bodyBegin]]);
    else
      add(always_);
  };
  const Instruction& in = program_.code[i];
  if (isLightLoop(in.op) && program_.type != ShaderType::kLight) {
    // The body, for which the loop has set its variables; behind the loop.
    from(i + 1);
    for (const GlobalId id : {GlobalId::k_L, GlobalId::k_Cl, GlobalId::k_Ol}) {
      const uint32_t s = program_.findGlobal(id);
      if (s == kNoIndex || (id == GlobalId::k_L && in.op == Op::ambient_begin)) continue;
      live[s / 64] &= ~(uint64_t(1) << (s % 64));
    }
    return from(in.jump + 1);
  }
  if (in.op == Op::illuminance_end) {
    from(in.jump);
    return from(i + 1);
  }
  from(i + 1);
  if (endsBlock(in.op) || in.jump == kNoIndex) return;
  // Wherever the machine may go on: at the partner, or behind it. The other way round from the end of a loop.
  from(in.jump);
  if (in.op == Op::if_else) return;
  from(in.jump + 1);
  if (in.op == Op::inline_return) return;
  if (program_.code[in.jump].jump != kNoIndex) from(program_.code[in.jump].jump + 1);
}

void Liveness::stepBack(uint32_t i, Bits& live) const {
  const Instruction& in = program_.code[i];
  const uint32_t flags = opInfo(in.op).flags;
  const bool replaces =
      !(flags & kOpControl) && ((flags & kOpPure) || (isAssign(in.op) && !varyingControl_[i]));
  for (const uint32_t a : program_.operands(in)) {
    const uint32_t s = a & kArgIndex;
    const Symbol& symbol = program_.symbols[s];
    if (!(a & kArgWritten) || (a & kArgRead) || !replaces || symbol.isArray()) continue;
    const bool others = symbol.storage == Storage::kOutputParameter ||
                        (symbol.storage == Storage::kGlobal && !isResult(symbol)) ||
                        (symbol.storage == Storage::kGlobal && program_.type == ShaderType::kLight);
    if (!others) live[s / 64] &= ~(uint64_t(1) << (s % 64));
  }
  for (const uint32_t a : program_.operands(in))
    if (a & kArgRead) live[(a & kArgIndex) / 64] |= uint64_t(1) << (a & 63);
}

std::vector<Liveness::Bits> Liveness::before(const std::vector<uint32_t>& places) const {
  const auto end = uint32_t(program_.code.size());
  std::vector<Bits> result(places.size());
  size_t next = 0;
  while (next < places.size()) {
    if (places[next] >= end) {
      result[next++] = always_;
      continue;
    }
    const uint32_t block = blockOf_[places[next] - program_.bodyBegin];
    const uint32_t first = begins_[block], last = block + 1 < begins_.size() ? begins_[block + 1] : end;
    size_t behind = next;
    while (behind < places.size() && places[behind] < last) ++behind;
    Bits live(always_.size(), 0);
    addSuccessors(last - 1, live);
    size_t k = behind;
    for (uint32_t i = last; i-- > first;) {
      stepBack(i, live);
      while (k > next && places[k - 1] == i) result[--k] = live;
    }
    next = behind;
  }
  return result;
}

}  // namespace fr
