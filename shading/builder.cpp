#include "shading/builder.h"

#include <bit>

namespace fr {

ProgramBuilder::ProgramBuilder() {
  program.strings.emplace_back();
  strings_.emplace("", 0);
}

uint32_t ProgramBuilder::text(std::string_view s) {
  auto it = strings_.find(s);
  if (it != strings_.end()) return it->second;
  const uint32_t i = uint32_t(program.strings.size());
  program.strings.emplace_back(s);
  strings_.emplace(s, i);
  return i;
}

uint32_t ProgramBuilder::constantFloats(SlType type, std::span<const float> v, uint32_t arrayLength) {
  // By their bits: -0 and 0 are different constants, and NaNs have no order.
  std::vector<uint32_t> key;
  key.reserve(v.size() + 1);
  for (const float f : v) key.push_back(std::bit_cast<uint32_t>(f));
  key.push_back(arrayLength);
  auto it = constants_.find({type, key});
  if (it != constants_.end()) return it->second;
  Symbol s;
  s.type = type;
  s.storage = Storage::kConstant;
  s.cls = SlClass::kUniform;
  s.arrayLength = arrayLength;
  s.data = uint32_t(program.floats.size());
  program.floats.insert(program.floats.end(), v.begin(), v.end());
  const uint32_t i = uint32_t(program.symbols.size());
  program.symbols.push_back(s);
  constants_.emplace(std::make_pair(type, std::move(key)), i);
  return i;
}

uint32_t ProgramBuilder::constantFloat(float v) { return constantFloats(SlType::kFloat, {&v, 1}); }

uint32_t ProgramBuilder::constantString(std::string_view s) {
  const uint32_t t = text(s);
  auto it = stringConstants_.find(t);
  if (it != stringConstants_.end()) return it->second;
  Symbol c;
  c.type = SlType::kString;
  c.storage = Storage::kConstant;
  c.cls = SlClass::kUniform;
  c.data = t;
  const uint32_t i = uint32_t(program.symbols.size());
  program.symbols.push_back(c);
  stringConstants_.emplace(t, i);
  return i;
}

uint32_t ProgramBuilder::temp(SlType type) {
  Symbol s;
  s.type = type;
  s.storage = Storage::kTemp;
  program.symbols.push_back(s);
  return uint32_t(program.symbols.size() - 1);
}

uint32_t ProgramBuilder::local(std::string_view name, SlType type, uint32_t arrayLength) {
  Symbol s;
  s.name = text(name);
  s.type = type;
  s.storage = Storage::kLocal;
  s.arrayLength = arrayLength;
  program.symbols.push_back(s);
  return uint32_t(program.symbols.size() - 1);
}

uint32_t ProgramBuilder::global(GlobalId id) {
  auto it = globals_.find(id);
  if (it != globals_.end()) return it->second;
  const GlobalInfo& info = globalInfo(id);
  Symbol s;
  s.name = text(info.name);
  s.type = info.type;
  s.storage = Storage::kGlobal;
  s.cls = info.cls;
  s.declaredClass = 1;
  s.data = uint32_t(id);
  const uint32_t i = uint32_t(program.symbols.size());
  program.symbols.push_back(s);
  globals_.emplace(id, i);
  return i;
}

std::span<const float> ProgramBuilder::constantValue(uint32_t i) const {
  return {program.floats.data() + symbol(i).data, symbol(i).floats()};
}

void ProgramBuilder::emit(Op op, std::span<const uint32_t> operands) {
  if (full()) return;
  Instruction in;
  in.op = op;
  in.where = where;
  in.firstArg = uint32_t(program.args.size());
  in.argCount = uint16_t(operands.size());
  const char* sig = opInfo(op).signature;
  bool pairs = false;
  for (uint32_t a : operands) {
    if (*sig == '*') pairs = true;
    uint32_t bits = kArgRead;
    if (pairs) {
      if (a & kArgWritten) bits = kArgRead | kArgWritten;
    } else {
      const char c = *sig;
      if (c == 'F' || c == 'T' || c == 'M' || c == 'S' || c == '#') bits = kArgWritten;
      if (c == '!' || c == 'x') bits = kArgRead | kArgWritten;
      if (sig[1] != '+') ++sig;
    }
    program.args.push_back((a & kArgIndex) | bits);
  }
  program.code.push_back(in);
}

uint32_t ProgramBuilder::result(Op op, SlType type, std::span<const uint32_t> inputs) {
  if ((opInfo(op).flags & kOpFoldable) && inputs.size() <= 16) {
    const float* values[16];
    size_t n = 0;
    for (uint32_t i : inputs) {
      const uint32_t s = i & kArgIndex;
      if (!isConstant(s) || symbol(s).type == SlType::kString || symbol(s).isArray()) break;
      values[n++] = program.floats.data() + symbol(s).data;
    }
    float out[16];
    if (n == inputs.size() && foldConstant(op, {values, n}, out))
      return constantFloats(type, {out, slTypeFloats(type)});
  }
  const uint32_t t = temp(type);
  std::vector<uint32_t> operands{t};
  operands.insert(operands.end(), inputs.begin(), inputs.end());
  emit(op, operands);
  return t;
}

void ProgramBuilder::assign(uint32_t to, uint32_t from) {
  const Symbol& s = symbol(to);
  const Op op = s.isArray()                 ? Op::assign_a
                : s.type == SlType::kFloat  ? Op::assign_f
                : isTriple(s.type)          ? Op::assign_t
                : s.type == SlType::kMatrix ? Op::assign_m
                                            : Op::assign_s;
  emit(op, {to, from});
}

Result<void> resolveJumps(ShaderProgram& p) {
  struct Open {
    uint32_t begin;
    Op op;
    uint32_t middle = kNoIndex;  // if_else, loop_test, gather_else
    uint32_t step = kNoIndex;
    std::vector<uint32_t> breaks, continues;
  };
  std::vector<Open> open;
  const auto bad = [&](uint32_t i) {
    return makeError(RiError::kBadFile, "instruction {} ({}) does not nest", i, opInfo(p.code[i].op).name);
  };
  const auto isIlluminance = [](Op op) {
    return op == Op::illuminance_begin || op == Op::illuminance_cone_begin || op == Op::ambient_begin;
  };
  for (uint32_t i = 0; i < p.code.size(); ++i) {
    // Default-value code must not reach into the body.
    if (i == p.bodyBegin && !open.empty()) return bad(i);
    Instruction& in = p.code[i];
    in.jump = kNoIndex;
    const auto close = [&] {
      p.code[open.back().begin].jump = i;
      in.jump = open.back().begin;
      for (uint32_t b : open.back().breaks) p.code[b].jump = i;
      for (uint32_t c : open.back().continues)
        p.code[c].jump = open.back().step != kNoIndex ? open.back().step : i;
      open.pop_back();
    };
    const Op top = open.empty() ? Op::nop : open.back().op;
    switch (in.op) {
      case Op::if_begin:
      case Op::loop_begin:
      case Op::inline_begin:
      case Op::illuminance_begin:
      case Op::illuminance_cone_begin:
      case Op::ambient_begin:
      case Op::illuminate_begin:
      case Op::illuminate_cone_begin:
      case Op::solar_begin:
      case Op::solar_cone_begin:
      case Op::gather_begin:
        if (open.size() >= 1000) return makeError(RiError::kLimit, "control flow nests deeper than 1000");
        open.push_back({i, in.op, kNoIndex, kNoIndex, {}, {}});
        break;
      case Op::if_else:
        if (top != Op::if_begin || open.back().middle != kNoIndex) return bad(i);
        open.back().middle = i;
        break;
      case Op::if_end: {
        if (top != Op::if_begin) return bad(i);
        const uint32_t middle = open.back().middle, begin = open.back().begin;
        close();
        if (middle != kNoIndex) {
          p.code[begin].jump = middle;
          p.code[middle].jump = i;
        }
        break;
      }
      case Op::loop_test:
        if (top != Op::loop_begin || open.back().middle != kNoIndex) return bad(i);
        open.back().middle = i;
        break;
      case Op::loop_step:
        if (top != Op::loop_begin || open.back().middle == kNoIndex || open.back().step != kNoIndex)
          return bad(i);
        open.back().step = i;
        break;
      case Op::loop_end: {
        if (top != Op::loop_begin || open.back().step == kNoIndex) return bad(i);
        const uint32_t middle = open.back().middle, step = open.back().step;
        close();
        p.code[middle].jump = p.code[step].jump = i;
        break;
      }
      case Op::inline_end:
        if (top != Op::inline_begin) return bad(i);
        close();
        break;
      case Op::illuminance_end:
        if (!isIlluminance(top)) return bad(i);
        close();
        break;
      case Op::illuminate_end:
        if (top != Op::illuminate_begin && top != Op::illuminate_cone_begin) return bad(i);
        close();
        break;
      case Op::solar_end:
        if (top != Op::solar_begin && top != Op::solar_cone_begin) return bad(i);
        close();
        break;
      case Op::gather_else:
        if (top != Op::gather_begin || open.back().middle != kNoIndex) return bad(i);
        open.back().middle = i;
        break;
      case Op::gather_end: {
        if (top != Op::gather_begin || open.back().middle == kNoIndex) return bad(i);
        const uint32_t middle = open.back().middle, begin = open.back().begin;
        close();
        p.code[begin].jump = middle;
        p.code[middle].jump = i;
        break;
      }
      case Op::inline_return: {
        size_t k = open.size();
        while (k > 0 && open[k - 1].op != Op::inline_begin) --k;
        if (k == 0) return bad(i);
        open[k - 1].breaks.push_back(i);
        break;
      }
      case Op::break_loop:
      case Op::continue_loop: {
        const Symbol& n = p.symbol(p.args[in.firstArg]);
        if (n.storage != Storage::kConstant || n.type != SlType::kFloat || n.isArray()) return bad(i);
        float left = p.floats[n.data];
        size_t k = open.size();
        for (; k > 0; --k) {
          const Op o = open[k - 1].op;
          if (o == Op::inline_begin) return bad(i);
          const bool isLoop = o == Op::loop_begin || o == Op::gather_begin || isIlluminance(o);
          if (isLoop && (left -= 1) < 1) break;
        }
        if (k == 0 || !(left > -1)) return bad(i);
        (in.op == Op::break_loop ? open[k - 1].breaks : open[k - 1].continues).push_back(i);
        break;
      }
      default:
        break;
    }
  }
  if (!open.empty()) return bad(open.back().begin);
  return {};
}

}  // namespace fr
