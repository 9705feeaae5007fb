#include <algorithm>

#include "shading/passes.h"

namespace fr {
namespace {

/// Removes nops; default-value ranges and the body's begin move along.
void squeeze(ShaderProgram& p) {
  std::vector<uint32_t> newIndex(p.code.size() + 1);
  uint32_t n = 0;
  for (uint32_t i = 0; i < p.code.size(); ++i) {
    newIndex[i] = n;
    if (p.code[i].op != Op::nop) ++n;
  }
  newIndex[p.code.size()] = n;
  std::erase_if(p.code, [](const Instruction& in) { return in.op == Op::nop; });
  for (Parameter& q : p.parameters) {
    q.codeBegin = newIndex[q.codeBegin];
    q.codeEnd = newIndex[q.codeEnd];
  }
  p.bodyBegin = newIndex[p.bodyBegin];
}

bool removable(Op op) {
  const uint32_t flags = opInfo(op).flags;
  if (flags & kOpPure) return true;
  switch (op) {
    case Op::assign_f:
    case Op::assign_t:
    case Op::assign_m:
    case Op::assign_s:
    case Op::assign_a:
    case Op::store_f:
    case Op::store_t:
    case Op::store_m:
    case Op::store_s:
    case Op::setcomp_t:
    case Op::setcomp_m:
      return true;
    default:
      // Nobody sees whether a ray or a texture was asked for.
      return (flags & (kOpRay | kOpTexture)) && !(flags & (kOpControl | kOpMasked));
  }
}

bool isAssign(Op op) {
  return op == Op::assign_f || op == Op::assign_t || op == Op::assign_m || op == Op::assign_s;
}

void erase(Instruction& in) {
  in.op = Op::nop;
  in.argCount = 0;
}

/// A variable's first value (0 unless given) that is overwritten before anyone reads it.
bool removeOverwritten(ShaderProgram& p) {
  bool changed = false;
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    if (!isAssign(p.code[i].op)) continue;
    const uint32_t target = p.operands(p.code[i])[0] & kArgIndex;
    const Storage storage = p.symbols[target].storage;
    if (storage != Storage::kLocal) continue;
    for (uint32_t j = i + 1; j < p.code.size() && j < i + 400; ++j) {
      const Instruction& next = p.code[j];
      bool read = false, written = false;
      for (uint32_t a : p.operands(next)) {
        if ((a & kArgIndex) != target) continue;
        read = read || (a & kArgRead);
        written = written || (a & kArgWritten);
      }
      if (read || (opInfo(next.op).flags & kOpControl)) break;
      if (!written) continue;
      if (isAssign(next.op)) {
        erase(p.code[i]);
        changed = true;
      }
      break;
    }
  }
  return changed;
}

bool removeEmptyBlocks(ShaderProgram& p) {
  bool changed = false;
  for (uint32_t i = 0; i + 1 < p.code.size(); ++i) {
    const Op a = p.code[i].op, b = p.code[i + 1].op;
    if ((a == Op::if_begin && b == Op::if_end) || (a == Op::inline_begin && b == Op::inline_end)) {
      erase(p.code[i]);
      erase(p.code[i + 1]);
      changed = true;
    } else if (a == Op::if_else && b == Op::if_end) {
      erase(p.code[i]);
      changed = true;
    } else if (a == Op::if_begin && b == Op::if_else && i + 2 < p.code.size() &&
               p.code[i + 2].op == Op::if_end) {
      erase(p.code[i]);
      erase(p.code[i + 1]);
      erase(p.code[i + 2]);
      changed = true;
    }
  }
  return changed;
}

}  // namespace

void removeDeadCode(ShaderProgram& p) {
  squeeze(p);
  for (int round = 0; round < 50; ++round) {
    bool changed = removeOverwritten(p);
    std::vector<uint32_t> readers(p.symbols.size(), 0);
    const auto counts = [](const Instruction& in, uint32_t a) {
      // An instruction that reads what it changes (setcomp, store) does not keep it alive by itself.
      return (a & kArgRead) && !((a & kArgWritten) && removable(in.op));
    };
    for (const Instruction& in : p.code)
      for (uint32_t a : p.operands(in))
        if (counts(in, a)) readers[a & kArgIndex]++;
    // Backwards: a chain of unused results goes in one round.
    for (uint32_t i = uint32_t(p.code.size()); i-- > 0;) {
      Instruction& in = p.code[i];
      if (in.op == Op::nop || !removable(in.op) || in.argCount == 0) continue;
      bool needed = false, writes = false;
      for (uint32_t a : p.operands(in)) {
        if (!(a & kArgWritten)) continue;
        writes = true;
        const Storage s = p.symbol(a).storage;
        needed = needed || (s != Storage::kLocal && s != Storage::kTemp) || readers[a & kArgIndex] > 0;
      }
      if (needed || !writes) continue;
      for (uint32_t a : p.operands(in))
        if (counts(in, a)) readers[a & kArgIndex]--;
      erase(in);
      changed = true;
    }
    squeeze(p);
    while (removeEmptyBlocks(p)) {
      changed = true;
      squeeze(p);
    }
    if (!changed) break;
  }
}

void extractConstantDefaults(ShaderProgram& p) {
  for (Parameter& q : p.parameters) {
    if (q.codeEnd != q.codeBegin + 1) continue;
    Instruction& in = p.code[q.codeBegin];
    if (!isAssign(in.op) && in.op != Op::assign_a) continue;
    const auto operands = p.operands(in);
    const Symbol& c = p.symbol(operands[1]);
    const Symbol& s = p.symbols[q.symbol];
    if ((operands[0] & kArgIndex) != q.symbol || c.storage != Storage::kConstant) continue;
    const bool same = slTypeFloats(c.type) == slTypeFloats(s.type) && c.arrayLength == s.arrayLength &&
                      (c.type == SlType::kString) == (s.type == SlType::kString);
    if (!same) continue;
    q.defaultConstant = operands[1] & kArgIndex;
    erase(in);
  }
  squeeze(p);
}

void compact(ShaderProgram& p) {
  squeeze(p);
  std::vector<bool> used(p.symbols.size(), false);
  for (const Instruction& in : p.code)
    for (uint32_t a : p.operands(in)) used[a & kArgIndex] = true;
  for (const Parameter& q : p.parameters) {
    used[q.symbol] = true;
    if (q.defaultConstant != kNoIndex) used[q.defaultConstant] = true;
  }
  // The results of a shader are always there, and light loops set L, Cl, Ol.
  for (size_t i = 0; i < p.symbols.size(); ++i)
    if (p.symbols[i].storage == Storage::kGlobal) used[i] = true;
  std::vector<uint32_t> symbolIndex(p.symbols.size(), kNoIndex);
  std::vector<uint32_t> stringIndex(p.strings.size(), kNoIndex);
  std::vector<Symbol> symbols;
  std::vector<std::string> strings{""};
  std::vector<float> floats;
  stringIndex[0] = 0;
  const auto keepString = [&](uint32_t s) {
    if (stringIndex[s] == kNoIndex) {
      stringIndex[s] = uint32_t(strings.size());
      strings.push_back(p.strings[s]);
    }
    return stringIndex[s];
  };
  for (size_t i = 0; i < p.symbols.size(); ++i) {
    if (!used[i]) continue;
    symbolIndex[i] = uint32_t(symbols.size());
    Symbol s = p.symbols[i];
    s.name = keepString(s.name);
    if (s.storage == Storage::kConstant) {
      if (s.type == SlType::kString) {
        s.data = keepString(s.data);
      } else {
        const uint32_t at = uint32_t(floats.size());
        floats.insert(floats.end(), p.floats.begin() + s.data, p.floats.begin() + s.data + s.floats());
        s.data = at;
      }
    }
    symbols.push_back(s);
  }
  std::vector<uint32_t> args;
  for (Instruction& in : p.code) {
    const uint32_t first = uint32_t(args.size());
    for (uint32_t a : p.operands(in)) args.push_back((a & ~kArgIndex) | symbolIndex[a & kArgIndex]);
    in.firstArg = first;
  }
  for (Parameter& q : p.parameters) {
    q.symbol = symbolIndex[q.symbol];
    if (q.defaultConstant != kNoIndex) q.defaultConstant = symbolIndex[q.defaultConstant];
  }
  p.symbols = std::move(symbols);
  p.strings = std::move(strings);
  p.floats = std::move(floats);
  p.args = std::move(args);
}

}  // namespace fr
