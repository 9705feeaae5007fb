#include "shading/run_recorder.h"

#include <algorithm>

namespace fr {

namespace {
constexpr uint32_t kDeepest = 32;  // blocks within blocks
/// More than this and it is better to see first whether any point wants it.
constexpr uint32_t kMostNodesUniform = 60, kMostNodesVarying = 400, kMostNodesOfLights = 6000;

uint32_t nodesOf(Op op) {
  switch (opInfo(op).cost) {
    case Cost::kHeavy:
      return 700;
    case Cost::kMath:
      return 50;
    default:
      return 5;
  }
}
bool isLightLoop(Op op) {
  return op == Op::illuminance_begin || op == Op::illuminance_cone_begin || op == Op::ambient_begin;
}
bool isEmission(Op op) {
  return op == Op::illuminate_begin || op == Op::illuminate_cone_begin || op == Op::solar_begin ||
         op == Op::solar_cone_begin;
}
/// Operands of a light loop before the optional ones.
uint32_t fixedOperands(Op op) {
  return op == Op::illuminance_cone_begin ? 4 : op == Op::illuminance_begin ? 2 : 1;
}
bool isDifference(Op op) {
  return op == Op::du_f || op == Op::du_t || op == Op::dv_f || op == Op::dv_t || op == Op::calculatenormal;
}

/// Operands of a kernel that are values already; the first one is the result.
class ValueOperands final : public OperandRecorder {
 public:
  NodeIndex read(uint32_t operand, uint32_t component) override { return in[operand][component]; }
  void write(uint32_t, uint32_t component, NodeIndex value) override { out[component] = value; }
  NodeIndex in[6][3] = {}, out[3] = {};
};
}  // namespace

RunRecorder::RunRecorder(const Executable& exe, std::span<const RunLight> lights)
    : lights_(lights.begin(), lights.end()) {
  const auto add = [&](const Executable& e) {
    uint32_t base = 0;
    if (!parts_.empty()) base = parts_.back().base + parts_.back().exe->columnCount();
    if (parts_.size() > 1) base += light_column::count(lights_[parts_.size() - 2]);
    parts_.push_back({&e, base, std::vector<NodeIndex>(e.columnCount(), kUnknown), {}});
  };
  add(exe);
  for (const RunLight& l : lights) add(*l.exe);
  firstDifference_ = parts_.back().base + parts_.back().exe->columnCount();
  if (!lights.empty()) firstDifference_ += light_column::count(lights.back());
  for (const Step& s : exe.steps())
    sends_ = sends_ || (isLightLoop(s.op) && s.argCount != fixedOperands(s.op));
  clear();
}

void RunRecorder::clear() {
  for (Part& p : parts_) {
    for (const uint32_t c : p.touched) p.values[c] = kUnknown;
    p.touched.clear();
  }
  written_.clear();
  blocks_.clear();
  graph.clear();
  ones_ = graph.constant(~0u);
  part_ = 0;
  failed_ = readsLights_ = false;
  steps_ = varyingSteps_ = 0;
  lightsAsked_.clear();
  differences_.clear();
  differenceColumns_ = 0;
  ahead_ = {};
  setMask(ones_);
}

bool RunRecorder::record(uint32_t begin, uint32_t end) {
  recordRange(begin, end);
  return !failed_;
}

// What may be part of a run.

RunRecorder::Extent RunRecorder::instructionOf(uint32_t part, uint32_t i, uint32_t depth) const {
  const Executable& exe = *parts_[part].exe;
  const Step& s = exe.steps()[i];
  if (!s.control) {
    if (s.op == Op::nop) return {i + 1, 1};
    // Of all points that the run is for.
    if (isDifference(s.op) && depth == 0 && exe.program().type != ShaderType::kLight) return {i + 1, 5};
    if (s.kernel && recordedKernels().op[size_t(s.op)]) return {i + 1, nodesOf(s.op)};
    return {};
  }
  return depth < kDeepest ? blockOf(part, i, depth) : Extent{};
}

/// A break, continue or return that stays within what is recorded.
bool RunRecorder::leavesWithin(uint32_t part, uint32_t i) const {
  const ShaderProgram& p = parts_[part].exe->program();
  const Instruction& in = p.code[i];
  if (in.jump == kNoIndex || in.jump >= p.code.size()) return false;
  const Op target = p.code[in.jump].op;
  if (in.op == Op::inline_return) return target == Op::inline_end;
  return target == Op::illuminance_end || target == Op::loop_end || target == Op::loop_step;
}

/// Points would leave blocks that are not recorded.
bool RunRecorder::jumpsOut(uint32_t begin, uint32_t end) const {
  const ShaderProgram& p = parts_[0].exe->program();
  for (uint32_t i = begin + 1; i < end; ++i) {
    const Op op = p.code[i].op;
    const bool jump = op == Op::break_loop || op == Op::continue_loop || op == Op::inline_return;
    if (jump && p.code[i].jump > end) return true;
  }
  return false;
}

RunRecorder::Extent RunRecorder::blockOf(uint32_t part, uint32_t begin, uint32_t depth) const {
  const Executable& exe = *parts_[part].exe;
  const ShaderProgram& p = exe.program();
  const Step& s = exe.steps()[begin];
  if (depth > 0 && (s.op == Op::break_loop || s.op == Op::continue_loop || s.op == Op::inline_return))
    return leavesWithin(part, begin) ? Extent{begin + 1, 2} : Extent{};
  if (s.op == Op::loop_begin) return part == 0 ? loopOf(begin, depth) : Extent{};
  if (isLightLoop(s.op)) return part == 0 ? lightsOf(begin, depth) : Extent{};
  if (s.op != Op::if_begin && s.op != Op::inline_begin && !(part > 0 && isEmission(s.op))) return {};
  if (s.jump == kNoIndex) return {};
  const bool hasElse = p.code[s.jump].op == Op::if_else;
  const uint32_t end = hasElse ? exe.steps()[s.jump].jump : s.jump;
  uint32_t nodes = 10;
  for (uint32_t i = begin + 1; i < end;) {
    if (hasElse && i == s.jump) {
      ++i;
      continue;
    }
    // Messages are answered at compile time, where they are about a light of the loop.
    const bool message = part == 0 && p.code[i].op == Op::msg_lightsource;
    const Extent e = message ? Extent{i + 1, 5} : instructionOf(part, i, depth + 1);
    if (e.end == 0) return {};
    i = e.end, nodes += e.nodes;
  }
  if (depth == 0 && jumpsOut(begin, end)) return {};
  if (s.op == Op::if_begin) {
    const uint32_t condition = p.operands(p.code[begin])[0] & kArgIndex;
    if (nodes > (exe.varying(condition) ? kMostNodesVarying : kMostNodesUniform)) return {};
  }
  return {end + 1, nodes};
}

std::pair<uint32_t, uint32_t> RunRecorder::placesOf(uint32_t begin) const {
  const ShaderProgram& p = parts_[0].exe->program();
  std::pair<uint32_t, uint32_t> places{kNoIndex, kNoIndex};
  const uint32_t end = p.code[begin].jump;
  for (uint32_t i = begin + 1; i < end; ++i) {
    if (p.code[i].jump != end) continue;
    if (p.code[i].op == Op::loop_test) places.first = i;
    if (p.code[i].op == Op::loop_step) places.second = i;
  }
  return places;
}

bool RunRecorder::hasLoop(uint32_t begin, uint32_t end) const {
  const auto& code = parts_[0].exe->program().code;
  return std::any_of(code.begin() + begin, code.begin() + end,
                     [](const Instruction& in) { return in.op == Op::loop_begin; });
}

/// Loops that points leave at different times; where all take the same number of turns, a pass over the batch
/// for each turn costs little. No loops in loops.
RunRecorder::Extent RunRecorder::loopOf(uint32_t begin, uint32_t depth) const {
  const Executable& exe = *parts_[0].exe;
  const ShaderProgram& p = exe.program();
  const uint32_t end = p.code[begin].jump;
  const auto [test, step] = placesOf(begin);
  if (test == kNoIndex || step == kNoIndex || !exe.varying(p.operands(p.code[test])[0] & kArgIndex))
    return {};
  if (hasLoop(begin + 1, end)) return {};
  for (uint32_t i = begin + 1; i < end; ++i) {
    const Op op = p.code[i].op;
    const bool jump = op == Op::break_loop || op == Op::continue_loop || op == Op::inline_return;
    if (jump && p.code[i].jump > end) return {};
  }
  uint32_t nodes = 20;
  for (uint32_t i = begin + 1; i < end;) {
    if (i == test || i == step) {
      ++i;
      continue;
    }
    const Extent e = instructionOf(0, i, depth + 1);
    if (e.end == 0) return {};
    i = e.end, nodes += e.nodes;
  }
  if (nodes > kMostNodesOfLights) return {};
  return {end + 1, nodes};
}

/// Loops over lights, in shaders that have no options for any of their light loops. The number of nodes
/// is that of all turns.
RunRecorder::Extent RunRecorder::lightsOf(uint32_t begin, uint32_t depth) const {
  const Executable& exe = *parts_[0].exe;
  const ShaderProgram& p = exe.program();
  const Step& s = exe.steps()[begin];
  // Lights are lit by all the others, which its own code knows nothing of.
  // Parameters that are sent to a light change what all of its columns hold.
  if (p.type == ShaderType::kLight || sends_) return {};
  const bool ambient = s.op == Op::ambient_begin;
  if (!ambient) {
    const Symbol& category = p.symbol(p.operands(p.code[begin])[0]);
    if (category.storage != Storage::kConstant || !p.strings[category.data].empty()) return {};
  }
  uint32_t body = 20;
  for (uint32_t i = begin + 1; i < s.jump;) {
    const Extent e = p.code[i].op == Op::msg_lightsource ? Extent{i + 1, 5} : instructionOf(0, i, depth + 1);
    if (e.end == 0) return {};
    i = e.end, body += e.nodes;
  }
  if (depth == 0 && jumpsOut(begin, s.jump)) return {};
  uint32_t nodes = 0;
  for (uint32_t k = 0; k < lights_.size(); ++k) {
    const Executable& light = *lights_[k].exe;
    if (light.has(kProgramAmbientLight) != ambient) continue;
    nodes += body;
    if (!lights_[k].plain) {
      if (!runsAhead(light)) return {};
      continue;
    }
    for (uint32_t i = light.program().bodyBegin; i < light.program().code.size();) {
      const Extent e = instructionOf(k + 1, i, depth + 1);
      if (e.end == 0) return {};
      i = e.end, nodes += e.nodes;
    }
    if (nodes > kMostNodesOfLights) return {};
  }
  return {s.jump + 1, nodes};
}

// Values.

NodeIndex& RunRecorder::current(uint32_t part, uint32_t symbol, uint32_t component) {
  Part& p = parts_[part];
  const uint32_t column = p.exe->firstColumn(symbol) + component;
  NodeIndex& value = p.values[column];
  if (value != kUnknown) return value;
  p.touched.push_back(column);
  const Symbol& s = p.exe->program().symbols[symbol];
  if (s.storage == Storage::kConstant)
    return value = graph.constant(p.exe->program().floats[s.data + component]);
  // A light's P is its origin.
  const bool origin = part > 0 && s.storage == Storage::kGlobal;
  readsLights_ = readsLights_ || part > 0;
  return value = graph.load(p.base + column, origin || !p.exe->varying(symbol));
}

NodeIndex RunRecorder::readColumn(uint32_t part, uint32_t symbol, uint32_t component) {
  const NodeIndex seen = asActivePointsSeeIt(current(part, symbol, component));
  // A uniform variable that some points have assigned to and others read: only a machine that asks whether
  // anybody was there knows its value.
  const bool origin = part > 0 && parts_[part].exe->program().symbols[symbol].storage == Storage::kGlobal;
  if (!origin && !parts_[part].exe->varying(symbol) && !graph.nodes()[seen].uniform) failed_ = true;
  return seen;
}

void RunRecorder::writeColumn(uint32_t symbol, uint32_t component, NodeIndex value, bool masked) {
  Part& p = parts_[part_];
  const uint32_t column = p.exe->firstColumn(symbol) + component;
  // Operations without a mask, too: in a block that all points enter or none they may write a variable
  // directly.
  if (mask_ != ones_) value = graph.select(mask_, value, current(part_, symbol, component));
  if (p.values[column] == kUnknown) p.touched.push_back(column);
  p.values[column] = value;
  if (part_ == 0) written_.push_back({symbol, column, masked});
}

NodeIndex RunRecorder::read(uint32_t operand, uint32_t component) {
  return readColumn(part_, symbol(operand), component);
}
void RunRecorder::write(uint32_t operand, uint32_t component, NodeIndex value) {
  writeColumn(symbol(operand), component, value, step_->masked);
}

RunRecorder::Triple RunRecorder::readTriple(const Step& s, uint32_t operand) {
  step_ = &s;
  Triple t;
  for (uint32_t c = 0; c < 3; ++c) t.c[c] = read(operand, c);
  return t;
}
RunRecorder::Triple RunRecorder::readGlobal(uint32_t part, GlobalId id) {
  Triple t;
  const uint32_t s = parts_[part].exe->global(id);
  for (uint32_t c = 0; c < 3 && s != kNoIndex; ++c) t.c[c] = readColumn(part, s, c);
  return t;
}
void RunRecorder::writeGlobal(GlobalId id, const Triple& t) {
  const uint32_t s = parts_[part_].exe->global(id);
  for (uint32_t c = 0; c < 3 && s != kNoIndex; ++c) writeColumn(s, c, t.c[c], true);
}
/// What a light begins with.
void RunRecorder::setGlobal(uint32_t light, GlobalId id, const Triple& t) {
  Part& p = parts_[light + 1];
  const uint32_t s = p.exe->global(id);
  for (uint32_t c = 0; c < 3 && s != kNoIndex; ++c) {
    const uint32_t column = p.exe->firstColumn(s) + c;
    if (p.values[column] == kUnknown) p.touched.push_back(column);
    p.values[column] = t.c[c];
  }
}
RunRecorder::Triple RunRecorder::chosen(NodeIndex mask, const Triple& a, const Triple& b) {
  Triple t;
  for (uint32_t c = 0; c < 3; ++c) t.c[c] = graph.select(mask, a.c[c], b.c[c]);
  return t;
}

RunRecorder::Triple RunRecorder::call(recorded::Kernel kernel, std::initializer_list<Triple> in) {
  ValueOperands v;
  recorded::Operand operands[6];
  uint32_t k = 0;
  for (uint32_t o = 0; o < 6; ++o) operands[o] = {&v, o};
  for (const Triple& t : in) std::copy_n(t.c, 3, v.in[++k]);
  recorded::KernelCall c;
  c.arg = operands, c.argCount = k + 1;
  kernel(c);
  return {{v.out[0], v.out[1], v.out[2]}};
}
NodeIndex RunRecorder::cone(NodeIndex mask, const Triple& direction, const Triple& axis, NodeIndex angle) {
  return call(recordedKernels().helper[size_t(Helper::maskCone)],
              {Triple{{mask}}, direction, axis, Triple{{angle}}})
      .c[0];
}

// Masks.

void RunRecorder::setMask(NodeIndex mask) {
  mask_ = mask;
  holds_.clear(), fails_.clear();
  std::vector<NodeIndex> todo{mask};
  while (!todo.empty() && holds_.size() < 64) {
    const NodeIndex m = todo.back();
    todo.pop_back();
    if (m == ones_) continue;
    holds_.push_back(m);
    const Node& n = graph.nodes()[m];
    if (n.op == VectorOp::kAnd) todo.push_back(n.a), todo.push_back(n.b);
    if (n.op == VectorOp::kAndNot) fails_.push_back(n.a), todo.push_back(n.b);
    if (n.op == VectorOp::kXor && (n.a == ones_ || n.b == ones_)) fails_.push_back(n.a == ones_ ? n.b : n.a);
  }
}

/// A value that is the same for the active points, and needs fewer choices.
NodeIndex RunRecorder::asActivePointsSeeIt(NodeIndex value) {
  const auto in = [](const std::vector<NodeIndex>& list, NodeIndex m) {
    return std::find(list.begin(), list.end(), m) != list.end();
  };
  if (holds_.empty()) return value;
  for (;;) {
    const Node& n = graph.nodes()[value];
    NodeIndex next = value;
    if (n.op == VectorOp::kSelect)
      next = in(holds_, n.a) ? n.b : in(fails_, n.a) ? n.c : value;
    else if (n.op == VectorOp::kAnd)
      next = in(holds_, n.a) ? n.b : in(holds_, n.b) ? n.a : in(fails_, n.a) || in(fails_, n.b) ? 0 : value;
    else if (n.op == VectorOp::kAndNot)
      next = in(fails_, n.a) ? n.b : in(holds_, n.a) ? 0 : value;
    if (next == value) return value;
    value = next;
  }
}

/// The active points leave every block from `outermost` on (Machine::leave).
void RunRecorder::leave(size_t outermost) {
  for (size_t i = outermost; i < blocks_.size(); ++i) {
    // The next light would not be run for them, but it has been.
    if (blocks_[i].ahead) lightsAreMissed();
    blocks_[i].saved = without(blocks_[i].saved, mask_);
    if (blocks_[i].kind == Block::Kind::kLights) blocks_[i].other = without(blocks_[i].other, mask_);
  }
  setMask(0);
}

void RunRecorder::leaveLoop(const Step& s) {
  step_ = &s;
  const NodeIndex count = read(0, 0);
  if (!graph.isConstant(count)) {
    failed_ = true;
    return;
  }
  auto n =
      std::max(1u, uint32_t(std::clamp(__builtin_bit_cast(float, graph.nodes()[count].imm), 1.0f, 64.0f)));
  size_t target = blocks_.size();
  const auto isLoop = [](const Block& b) {
    return b.kind == Block::Kind::kLights || b.kind == Block::Kind::kLoop;
  };
  while (target > 0 && !(isLoop(blocks_[target - 1]) && --n == 0)) --target;
  if (target == 0) {
    failed_ = true;
    return;
  }
  if (blocks_[target - 1].kind == Block::Kind::kLoop) {
    NodeIndex& goingOn = blocks_[target - 1].other;
    if (s.op == Op::continue_loop) goingOn = graph.binary(VectorOp::kOr, goingOn, mask_);
  } else if (s.op == Op::break_loop) {
    if (blocks_[target - 1].ahead) lightsAreMissed();
    blocks_[target - 1].other = without(blocks_[target - 1].other, mask_);
  }
  leave(target);
}

// Instructions.

void RunRecorder::recordRange(uint32_t begin, uint32_t end) {
  for (uint32_t i = begin; i < end && !failed_;) {
    const Step& s = step(i);
    if (nobody()) return;
    if (part_ == 0 && blocks_.empty()) ahead_.at = i;
    if (!s.control) {
      if (s.op == Op::msg_lightsource)
        recordMessage(s);
      else if (isDifference(s.op))
        recordDifference(s);
      else if (s.op != Op::nop)
        recordStep(s);
      ++i;
    } else if (s.op == Op::if_begin) {
      i = recordIf(i);
    } else if (s.op == Op::inline_begin) {
      i = recordInline(i);
    } else if (s.op == Op::loop_begin) {
      i = recordLoop(i);
    } else if (isLightLoop(s.op)) {
      i = recordLights(i);
    } else if (isEmission(s.op)) {
      i = recordEmission(i);
    } else if (s.op == Op::break_loop || s.op == Op::continue_loop) {
      leaveLoop(s);
      ++i;
    } else if (s.op == Op::inline_return) {
      size_t target = blocks_.size();
      while (target > 0 && blocks_[target - 1].kind != Block::Kind::kInline) --target;
      if (target == 0) failed_ = true;
      leave(target);
      ++i;
    } else {
      failed_ = true;
    }
  }
}

void RunRecorder::recordStep(const Step& s) {
  step_ = &s;
  operands_.resize(s.argCount);
  for (uint32_t k = 0; k < s.argCount; ++k) operands_[k] = {this, k};
  recorded::KernelCall call;
  call.arg = operands_.data(), call.argCount = s.argCount;
  // The kernel would look at what its result has been.
  if (s.op == Op::assign_f || s.op == Op::assign_t)
    for (uint32_t c = 0; c < (s.op == Op::assign_f ? 1u : 3u); ++c) write(0, c, read(1, c));
  else
    recordedKernels().op[size_t(s.op)](call);
  ++steps_, varyingSteps_ += s.varying;
}

void RunRecorder::recordDifference(const Step& s) {
  step_ = &s;
  const Executable& exe = *parts_[0].exe;
  const uint32_t from = symbol(1), to = symbol(0);
  bool held = exe.varying(from) && exe.varying(to) && mask_ == ones_;
  for (uint32_t c = 0; held && c < exe.program().symbols[from].floats(); ++c) {
    const uint32_t column = exe.firstColumn(from) + c;
    const Node& n = graph.nodes()[current(0, from, c)];
    held = n.op == VectorOp::kLoad && n.imm == column;
  }
  if (!held) {
    failed_ = true;
    ahead_.failedAt = ahead_.at;
    return;
  }
  const uint32_t components = slTypeFloats(exe.program().symbols[to].type);
  const auto known = std::find_if(differences_.begin(), differences_.end(),
                                  [&](const RunDifference& d) { return d.op == s.op && d.symbol == from; });
  uint32_t column = differenceColumns_;
  if (known != differences_.end()) {
    column = known->column;
  } else {
    differences_.push_back({s.op, from, column});
    differenceColumns_ += components;
  }
  for (uint32_t c = 0; c < components; ++c)
    writeColumn(to, c, graph.load(firstDifference_ + column + c, false), s.masked);
  ++steps_, ++varyingSteps_;
}

uint32_t RunRecorder::recordIf(uint32_t i) {
  const Step& s = step(i);
  const bool hasElse = step(s.jump).op == Op::if_else;
  const uint32_t end = hasElse ? step(s.jump).jump : s.jump;
  step_ = &s;
  const NodeIndex condition = read(0, 0), zero = graph.constant(0.0f), outer = mask_;
  const auto where = [&](Compare c) {
    return both(outer, graph.binary(VectorOp::kCompare, condition, zero, uint32_t(c)));
  };
  blocks_.push_back({Block::Kind::kIf, outer, 0});
  setMask(where(Compare::kNotEqual));
  recordRange(i + 1, hasElse ? s.jump : end);
  if (hasElse) {
    setMask(where(Compare::kEqual));
    recordRange(s.jump + 1, end);
  }
  setMask(blocks_.back().saved);
  blocks_.pop_back();
  return end + 1;
}

uint32_t RunRecorder::recordInline(uint32_t i) {
  const uint32_t end = step(i).jump;
  // Whoever returns is active again behind the body.
  const NodeIndex outer = mask_;
  blocks_.push_back({Block::Kind::kInline, outer, 0});
  recordRange(i + 1, end);
  setMask(blocks_.back().saved);
  blocks_.pop_back();
  return end + 1;
}

/// for and while: one turn, from variables that the graph's loop carries on.
uint32_t RunRecorder::recordLoop(uint32_t i) {
  const Executable& exe = *parts_[0].exe;
  const ShaderProgram& p = exe.program();
  const uint32_t end = step(i).jump;
  const auto [test, stepBegin] = placesOf(i);
  const NodeIndex outer = mask_;
  // Whatever a turn may write.
  std::vector<uint32_t> symbols;
  bool lights = false;
  for (uint32_t k = i + 1; k < end; ++k) {
    lights = lights || isLightLoop(p.code[k].op);
    for (const uint32_t a : p.operands(p.code[k]))
      if ((a & kArgWritten) && p.symbol(a).type != SlType::kString) symbols.push_back(a & kArgIndex);
  }
  for (const GlobalId id : {GlobalId::k_L, GlobalId::k_Cl, GlobalId::k_Ol})
    if (lights && exe.global(id) != kNoIndex) symbols.push_back(exe.global(id));
  std::sort(symbols.begin(), symbols.end());
  symbols.erase(std::unique(symbols.begin(), symbols.end()), symbols.end());
  struct Carried {
    uint32_t column;
    NodeIndex value, exit;
  };
  std::vector<Carried> carried;
  // Points that the run is not for must not keep it turning.
  const NodeIndex first = both(graph.mask(), outer);
  std::vector<NodeIndex> initial;
  for (const uint32_t s : symbols)
    for (uint32_t c = 0; c < p.symbols[s].floats(); ++c) {
      initial.push_back(current(0, s, c));
      carried.push_back({exe.firstColumn(s) + c, 0, 0});
    }
  graph.beginLoop();
  const NodeIndex live = graph.loopValue(first);
  for (size_t k = 0; k < carried.size(); ++k)
    parts_[0].values[carried[k].column] = carried[k].value = graph.loopValue(initial[k]);
  blocks_.push_back({Block::Kind::kLoop, outer, 0});
  setMask(live);
  recordRange(i + 1, test);
  for (Carried& c : carried) c.exit = parts_[0].values[c.column];
  step_ = &step(test);
  const NodeIndex condition = read(0, 0);
  const NodeIndex more = both(
      mask_, graph.binary(VectorOp::kCompare, condition, graph.constant(0.0f), uint32_t(Compare::kNotEqual)));
  setMask(more);
  recordRange(test + 1, stepBegin);
  setMask(graph.binary(VectorOp::kOr, mask_, blocks_.back().other));
  recordRange(stepBegin + 1, end);
  graph.loopResult(0, mask_, live);
  for (uint32_t k = 0; k < carried.size(); ++k) {
    NodeIndex& value = parts_[0].values[carried[k].column];
    value = graph.loopResult(k + 1, value, carried[k].exit);
  }
  graph.endLoop(more);
  blocks_.pop_back();
  setMask(outer);
  return end + 1;
}

}  // namespace fr
