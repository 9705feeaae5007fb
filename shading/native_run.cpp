// One pass over the nodes in the order in which they were recorded. Registers are given out as needed; when
// there is none, the value that is needed last makes room (L. Belady, "A study of replacement algorithms",
// IBM Systems Journal 5(2), 1966), which is the best that can be done within a run. Uniform values are
// computed once, before the loop over the points, and are memory operands in it.
#include "shading/native_run.h"

#include <algorithm>
#include <array>

#include "base/isa.h"
#include "shading/kernels.h"
#include "shading/native_assembler.h"
#include "shading/native_schedule.h"

namespace fr {

namespace {

constexpr int kRegisters = 16;
constexpr uint32_t kNever = RunSchedule::kNever;
constexpr int kBytes = 32;  // of a vector

// What stays in general registers through the loop.
constexpr Gpr kColumns = kRbx, kOffset = kR12, kEnd = kR13, kMask = kR14, kScratch = kRax;
constexpr Gpr kPointers[] = {kRcx, kRdx, kRsi, kRdi, kR8, kR9, kR10, kR11, kRbp, kR15};
constexpr Gpr kCallerSaved[] = {kRcx, kRdx, kRsi, kRdi, kR8, kR9, kR10, kR11};
constexpr Gpr kCalleeSaved[] = {kRbx, kRbp, kR12, kR13, kR14, kR15};

// The stack frame: arguments of rare cases, registers during one, then values.
constexpr int kArguments = 0, kResults = kMostRareValues * kBytes, kWhere = 2 * kMostRareValues * kBytes;
constexpr int kSavedVectors = kWhere + kBytes, kSavedPointers = kSavedVectors + kRegisters * kBytes;
constexpr int kOldStack = kSavedPointers + 64, kEnded = kOldStack + 8, kValues = kOldStack + 32;

VectorCode codeOf(VectorOp op) {
  switch (op) {
    case VectorOp::kAdd:
      return {0, 1, 0x58};
    case VectorOp::kSub:
      return {0, 1, 0x5c};
    case VectorOp::kMul:
      return {0, 1, 0x59};
    case VectorOp::kDiv:
      return {0, 1, 0x5e};
    case VectorOp::kMin:
      return {0, 1, 0x5d};
    case VectorOp::kMax:
      return {0, 1, 0x5f};
    case VectorOp::kSqrt:
      return {0, 1, 0x51};
    case VectorOp::kFloor:
      return {1, 3, 0x08};
    case VectorOp::kCompare:
      return {0, 1, 0xc2};
    case VectorOp::kAnd:
      return {0, 1, 0x54};
    case VectorOp::kAndNot:
      return {0, 1, 0x55};
    case VectorOp::kOr:
      return {0, 1, 0x56};
    case VectorOp::kXor:
      return {0, 1, 0x57};
    case VectorOp::kSelect:
      return {1, 3, 0x4a};
    case VectorOp::kAddInt:
      return {1, 1, 0xfe};
    case VectorOp::kSubInt:
      return {1, 1, 0xfa};
    case VectorOp::kMulInt:
      return {1, 2, 0x40};
    case VectorOp::kEqualInt:
      return {1, 1, 0x76};
    case VectorOp::kGreaterInt:
      return {1, 1, 0x66};
    case VectorOp::kToInt:
      return {2, 1, 0x5b};
    default:
      return {0, 1, 0x5b};  // kToFloat
  }
}
/// Predicates without exceptions for quiet NaN; `turned`: of the operands in the other order.
uint8_t predicateOf(Compare c, bool turned) {
  switch (c) {
    case Compare::kEqual:
      return 0x00;
    case Compare::kNotEqual:
      return 0x04;
    case Compare::kLess:
      return turned ? 0x1e : 0x11;
    case Compare::kLessEqual:
      return turned ? 0x1d : 0x12;
  }
  return 0;
}

class RunCompiler {
 public:
  RunCompiler(const ValueGraph& graph, const std::vector<RunOutput>& outputs, bool skipInactive)
      : graph_(graph), nodes_(graph.nodes()), outputs_(outputs), schedule_(graph, outputs, skipInactive) {}

  std::vector<uint8_t> compile();

 private:
  using Item = RunSchedule::Item;
  struct Place {
    int reg = -1;      // vector register
    int spilled = -1;  // offset in the frame
    int kept = -1;     // the same, of uniform values in the loop
    uint32_t use = 0;  // index of the next use in uses_
  };
  /// Where an input of a rare case is when the case is met.
  struct Location {
    int reg = -1;
    NodeIndex node = 0;
    MemoryOperand memory;
  };
  struct RareStub {
    uint32_t rare = 0;
    Assembler::Label entry = 0, back = 0;
    std::vector<Location> in;
    int where = 0;
    std::vector<int> usual, results;
    bool uniform = false;
  };

  void emitPhase();
  void choosePointers();
  void countUses();

  uint32_t nextUse(NodeIndex i) const {
    const Place& p = places_[i];
    const auto& list = uses_[i];
    return p.use < list.size() ? list[p.use] : kNever;
  }
  bool inMemory(NodeIndex i) const {
    return (schedule_.isLeaf(i) && !schedule_.touched(i)) || places_[i].spilled >= 0 ||
           (!uniformPhase_ && places_[i].kept >= 0);
  }
  MemoryOperand memoryOf(NodeIndex i);
  MemoryOperand columnAt(uint32_t column, bool uniform);
  int allocate();
  int ensure(NodeIndex i);
  void used(NodeIndex i);
  void define(NodeIndex i, int reg);
  int stackSlot();
  void emit(const Item& item);
  void emitNode(NodeIndex i);
  void emitRare(uint32_t index);
  void emitStore(const RunOutput& o);
  void emitLoopBegin(uint32_t loop);
  void emitLoopTest(uint32_t loop);
  void emitLoopEnd(uint32_t loop);
  void emptyRegisters();
  void emitStub(const RareStub& s);
  /// Calls f with a register or a memory operand that holds node i.
  template <class F>
  void withOperand(NodeIndex i, const F& f);

  const ValueGraph& graph_;
  const std::vector<Node>& nodes_;
  const std::vector<RunOutput>& outputs_;
  RunSchedule schedule_;

  Assembler a_;
  bool uniformPhase_ = true;
  std::vector<Item> items_;
  std::vector<std::vector<uint32_t>> uses_;
  std::vector<Place> places_;
  std::array<NodeIndex, kRegisters> holds_{};
  std::vector<int> freeSlots_, slotsLater_;  // of the frame; free once the item is done
  Assembler::Label skip_ = 0;
  struct Loop {
    Assembler::Label top = 0, behind = 0;
    int turns = 0;
  } loop_;
  /// Places of loops' variables in the frame, before a turn and behind the loop.
  std::vector<std::pair<int, int>> variables_;
  uint32_t pinned_ = 0;  // registers that must not make room
  int frame_ = kValues;
  uint32_t now_ = 0;  // index of the item that is being emitted
  std::vector<std::pair<uint32_t, Gpr>> pointers_;
  std::vector<RareStub> stubs_;
};

void RunCompiler::countUses() {
  for (auto& u : uses_) u.clear();
  for (uint32_t at = 0; at < items_.size(); ++at)
    schedule_.forOperands(items_[at], [&](NodeIndex i) { uses_[i].push_back(at); });
  for (Place& p : places_) p.reg = p.spilled = -1, p.use = 0;
  holds_.fill(kNever);
}

MemoryOperand RunCompiler::columnAt(uint32_t column, bool uniform) {
  Gpr base = kScratch;
  for (const auto& [c, r] : pointers_)
    if (c == column && !uniformPhase_) base = r;
  if (base == kScratch) a_.load(kScratch, MemoryOperand{kColumns, -1, int32_t(column * 8), -1});
  return {base, uniform ? -1 : int(kOffset), 0, -1};
}

MemoryOperand RunCompiler::memoryOf(NodeIndex i) {
  const Node& n = nodes_[i];
  if (n.op == VectorOp::kConstant) return a_.constant(n.imm);
  if (places_[i].spilled >= 0) return {kRsp, -1, places_[i].spilled, -1};
  if (!uniformPhase_ && places_[i].kept >= 0) return {kRsp, -1, places_[i].kept, -1};
  if (n.op == VectorOp::kMask) return {kMask, kOffset, 0, -1};
  if (n.op == VectorOp::kLoopValue) return {kRsp, -1, variables_[n.imm].first, -1};
  if (n.op == VectorOp::kLoopResult) return {kRsp, -1, variables_[n.imm].second, -1};
  return columnAt(n.imm, n.op == VectorOp::kLoadUniform);
}

int RunCompiler::stackSlot() {
  if (!freeSlots_.empty()) {
    const int slot = freeSlots_.back();
    freeSlots_.pop_back();
    return slot;
  }
  const int slot = frame_;
  frame_ += kBytes;
  return slot;
}

/// A register, whatever it holds moved to memory if that is still needed.
int RunCompiler::allocate() {
  int victim = 0;
  uint32_t latest = 0;
  for (int r = 0; r < kRegisters; ++r) {
    if (holds_[size_t(r)] == kNever && !(pinned_ >> r & 1)) return r;
    if (pinned_ >> r & 1) continue;
    const uint32_t use = nextUse(holds_[size_t(r)]);
    // Of equals the one that is in memory anyway.
    const bool better = use > latest || (use == latest && inMemory(holds_[size_t(r)]));
    if (better) victim = r, latest = use;
  }
  const NodeIndex i = holds_[size_t(victim)];
  if (!inMemory(i)) {
    places_[i].spilled = stackSlot();
    a_.storeVector({kRsp, -1, places_[i].spilled, -1}, victim);
  }
  places_[i].reg = -1;
  holds_[size_t(victim)] = kNever;
  return victim;
}

int RunCompiler::ensure(NodeIndex i) {
  if (places_[i].reg >= 0) return places_[i].reg;
  const int r = allocate();
  a_.loadVector(r, memoryOf(i));
  places_[i].reg = r;
  holds_[size_t(r)] = i;
  return r;
}

/// The item that is being emitted is done with this operand.
void RunCompiler::used(NodeIndex i) {
  Place& p = places_[i];
  while (p.use < uses_[i].size() && uses_[i][p.use] <= now_) ++p.use;
  if (p.use < uses_[i].size()) return;
  if (p.reg >= 0) holds_[size_t(p.reg)] = kNever;
  p.reg = -1;
  if (p.spilled >= 0) slotsLater_.push_back(p.spilled);
  p.spilled = -1;
}

void RunCompiler::define(NodeIndex i, int reg) {
  if (nextUse(i) == kNever) return;  // its last user folded it away
  places_[i].reg = reg;
  holds_[size_t(reg)] = i;
}

template <class F>
void RunCompiler::withOperand(NodeIndex i, const F& f) {
  Place& p = places_[i];
  if (p.reg < 0 && nodes_[i].op != VectorOp::kConstant) {
    // Worth a register when one is free and the value is needed again soon.
    const auto& list = uses_[i];
    const uint32_t again = p.use + 1 < list.size() ? list[p.use + 1] : kNever;
    const bool room = std::find(holds_.begin(), holds_.end(), kNever) != holds_.end();
    if (room && again != kNever && again - now_ < 40) ensure(i);
  }
  // A copy: f may free the register.
  if (const int reg = p.reg; reg >= 0)
    f(reg);
  else
    f(memoryOf(i));
}

void RunCompiler::emitNode(NodeIndex i) {
  const Node& n = nodes_[i];
  const VectorCode code = codeOf(n.op);
  // An operand's register may become the result's: an instruction reads before it writes.
  const auto result = [&](std::initializer_list<NodeIndex> operands) {
    for (const NodeIndex o : operands) used(o);
    return allocate();
  };
  switch (n.op) {
    case VectorOp::kShiftLeft:
    case VectorOp::kShiftRight:
    case VectorOp::kShiftRightSigned: {
      const int from = ensure(n.a);
      const int dst = result({n.a});
      a_.shift(n.op == VectorOp::kShiftLeft    ? 6
               : n.op == VectorOp::kShiftRight ? 2
                                               : 4,
               dst, from, uint8_t(n.imm));
      return define(i, dst);
    }
    case VectorOp::kSqrt:
    case VectorOp::kToInt:
    case VectorOp::kToFloat:
    case VectorOp::kFloor:
      return withOperand(n.a, [&](const auto& from) {
        const int dst = result({n.a});
        if (n.op == VectorOp::kFloor)
          a_.vectorImmediate(code, dst, 0, from, 0x09);
        else
          a_.vector(code, dst, 0, from);
        define(i, dst);
      });
    case VectorOp::kSelect: {
      const int no = ensure(n.c), mask = ensure(n.a);
      return withOperand(n.b, [&](const auto& yes) {
        const int dst = result({n.a, n.b, n.c});
        a_.vectorImmediate(code, dst, no, yes, uint8_t(mask << 4));
        define(i, dst);
      });
    }
    default: {
      NodeIndex first = n.a, second = n.b;
      const bool turn = (commutes(n.op) || n.op == VectorOp::kCompare) && places_[first].reg < 0 &&
                        (places_[second].reg >= 0 || nodes_[first].op == VectorOp::kConstant);
      if (turn) std::swap(first, second);
      const int x = ensure(first);
      return withOperand(second, [&](const auto& y) {
        const int dst = result({n.a, n.b});
        if (n.op == VectorOp::kCompare)
          a_.vectorImmediate(code, dst, x, y, predicateOf(Compare(n.imm), turn));
        else
          a_.vector(code, dst, x, y);
        define(i, dst);
      });
    }
  }
}

void RunCompiler::emitRare(uint32_t index) {
  const RareNode& rare = graph_.rareCases()[index];
  RareStub stub;
  stub.rare = index, stub.uniform = uniformPhase_;
  stub.where = ensure(rare.where);
  for (const NodeIndex i : rare.usual) stub.usual.push_back(ensure(i));
  const std::vector<NodeIndex>& nodes = schedule_.rareResults(index);
  // A result takes over its usual value's register, unless that is needed further.
  for (size_t k = 0; k < rare.usual.size(); ++k) {
    const NodeIndex usual = rare.usual[k];
    const auto& list = uses_[usual];
    const bool later = !list.empty() && list.back() > now_;
    const bool shared = std::count(rare.usual.begin(), rare.usual.end(), usual) > 1 || usual == rare.where;
    int r = stub.usual[k];
    if (nodes[k] == kNever) {
      r = -1;
    } else if (later || shared) {
      r = allocate();
      pinned_ |= 1u << r;
      a_.moveVector(r, places_[usual].reg);
    }
    stub.results.push_back(r);
  }
  for (const NodeIndex i : rare.in) {
    Location l;
    l.reg = places_[i].reg, l.node = i;
    if (l.reg < 0 && places_[i].spilled >= 0) l.memory = {kRsp, -1, places_[i].spilled, -1};
    stub.in.push_back(l);
  }
  stub.entry = a_.newLabel(), stub.back = a_.newLabel();
  a_.vector({1, 2, 0x0e}, stub.where, 0, stub.where);  // vtestps
  a_.jumpIf(Assembler::kNotZero, stub.entry);
  a_.place(stub.back);
  used(rare.where);
  for (const NodeIndex i : rare.in) used(i);
  for (const NodeIndex i : rare.usual) used(i);
  for (size_t k = 0; k < nodes.size(); ++k)
    if (nodes[k] != kNever) define(nodes[k], stub.results[k]);
  pinned_ = 0;
  stubs_.push_back(std::move(stub));
}

/// Out of line: everything is saved, so that the code beside knows nothing of the call.
void RunCompiler::emitStub(const RareStub& s) {
  const RareNode& rare = graph_.rareCases()[s.rare];
  uniformPhase_ = s.uniform;
  a_.place(s.entry);
  const auto saved = [](int reg) { return MemoryOperand{kRsp, -1, kSavedVectors + reg * kBytes, -1}; };
  for (int r = 0; r < kRegisters; ++r) a_.storeVector(saved(r), r);
  for (size_t k = 0; k < std::size(kCallerSaved); ++k)
    a_.store({kRsp, -1, kSavedPointers + int(k) * 8, -1}, kCallerSaved[k]);
  const auto pass = [&](int to, const MemoryOperand& from) {
    a_.loadVector(0, from);
    a_.storeVector({kRsp, -1, to, -1}, 0);
  };
  for (size_t k = 0; k < s.in.size(); ++k) {
    const Location& l = s.in[k];
    const int to = kArguments + int(k) * kBytes;
    if (l.reg >= 0)
      pass(to, saved(l.reg));
    else if (l.memory.base >= 0)
      pass(to, l.memory);
    else
      pass(to, memoryOf(l.node));
  }
  for (size_t k = 0; k < s.usual.size(); ++k) pass(kResults + int(k) * kBytes, saved(s.usual[k]));
  pass(kWhere, saved(s.where));
  a_.zeroUpper();
  a_.address(kRdi, {kRsp, -1, kArguments, -1});
  a_.address(kRsi, {kRsp, -1, kResults, -1});
  a_.address(kRdx, {kRsp, -1, kWhere, -1});
  a_.moveImmediate(kRax, reinterpret_cast<uint64_t>(kernelsOf(int(Isa::kAvx2)).rare[size_t(rare.kind)]));
  a_.call(kRax);
  for (int r = 0; r < kRegisters; ++r) {
    const auto k = std::find(s.results.begin(), s.results.end(), r) - s.results.begin();
    if (size_t(k) < s.results.size())
      a_.loadVector(r, {kRsp, -1, kResults + int(k) * kBytes, -1});
    else
      a_.loadVector(r, saved(r));
  }
  for (size_t k = 0; k < std::size(kCallerSaved); ++k)
    a_.load(kCallerSaved[k], {kRsp, -1, kSavedPointers + int(k) * 8, -1});
  a_.jump(s.back);
}

void RunCompiler::emitStore(const RunOutput& o) {
  const int value = ensure(o.value);
  if (o.uniform) {
    MemoryOperand to = columnAt(o.column, true);
    a_.storeVector(to, value);
    to.disp = kBytes;
    a_.storeVector(to, value);
  } else if (o.masked) {
    const int mask = ensure(schedule_.maskNode()), old = allocate();
    const MemoryOperand to = columnAt(o.column, false);
    a_.loadVector(old, to);
    a_.vectorImmediate(codeOf(VectorOp::kSelect), old, old, value, uint8_t(mask << 4));
    a_.storeVector(to, old);
    used(schedule_.maskNode());
  } else {
    a_.storeVector(columnAt(o.column, false), value);
  }
  used(o.value);
}

/// Everything that is still needed is in memory, where the turns of a loop, and what is behind it, find it.
void RunCompiler::emptyRegisters() {
  for (int r = 0; r < kRegisters; ++r) {
    const NodeIndex i = holds_[size_t(r)];
    if (i == kNever) continue;
    if (!inMemory(i)) {
      places_[i].spilled = stackSlot();
      a_.storeVector({kRsp, -1, places_[i].spilled, -1}, r);
    }
    places_[i].reg = -1;
    holds_[size_t(r)] = kNever;
  }
}

void RunCompiler::emitLoopBegin(uint32_t loop) {
  variables_.resize(graph_.loopVariables().size());
  const auto place = [&] {
    frame_ += kBytes;
    return frame_ - kBytes;
  };
  schedule_.forVariables(loop, [&](uint32_t v) {
    const int slot = place();
    variables_[v] = {slot, schedule_.exitsApart(v) ? place() : slot};
    a_.storeVector({kRsp, -1, slot, -1}, ensure(graph_.loopVariables()[v].initial));
  });
  schedule_.forOperands({Item::Kind::kLoopBegin, loop}, [&](NodeIndex i) { used(i); });
  emptyRegisters();
  loop_ = {a_.newLabel(), a_.newLabel(), place()};
  a_.moveImmediate(kScratch, kMostTurns);
  a_.store({kRsp, -1, loop_.turns, -1}, kScratch);
  a_.place(loop_.top);
}

void RunCompiler::emitLoopTest(uint32_t loop) {
  schedule_.forVariables(loop, [&](uint32_t v) {
    if (schedule_.exitsApart(v))
      a_.storeVector({kRsp, -1, variables_[v].second, -1}, ensure(graph_.loopVariables()[v].exit));
  });
  const int more = ensure(graph_.loops()[loop].more);
  a_.vector({1, 2, 0x0e}, more, 0, more);  // vtestps
  a_.jumpIf(Assembler::kZero, loop_.behind);
  schedule_.forOperands({Item::Kind::kLoopTest, loop}, [&](NodeIndex i) { used(i); });
}

void RunCompiler::emitLoopEnd(uint32_t loop) {
  // Variables that change places are read before any is written.
  std::vector<std::pair<int, int>> moved;
  schedule_.forVariables(loop, [&](uint32_t v) {
    const NodeIndex next = graph_.loopVariables()[v].next;
    if (nodes_[next].op != VectorOp::kLoopValue || next == graph_.loopVariables()[v].value) return;
    moved.push_back({stackSlot(), variables_[v].first});
    a_.storeVector({kRsp, -1, moved.back().first, -1}, ensure(next));
  });
  schedule_.forVariables(loop, [&](uint32_t v) {
    const NodeIndex next = graph_.loopVariables()[v].next;
    if (nodes_[next].op != VectorOp::kLoopValue)
      a_.storeVector({kRsp, -1, variables_[v].first, -1}, ensure(next));
  });
  schedule_.forOperands({Item::Kind::kLoopEnd, loop}, [&](NodeIndex i) { used(i); });
  emptyRegisters();
  for (const auto& [from, to] : moved) {
    a_.loadVector(0, {kRsp, -1, from, -1});
    a_.storeVector({kRsp, -1, to, -1}, 0);
    slotsLater_.push_back(from);
  }
  a_.load(kScratch, {kRsp, -1, loop_.turns, -1});
  a_.addImmediate(kScratch, -1);
  a_.store({kRsp, -1, loop_.turns, -1}, kScratch);
  a_.jumpIf(Assembler::kNotZero, loop_.top);
  a_.moveImmediate(kScratch, 1);
  a_.store({kRsp, -1, kEnded, -1}, kScratch);
  a_.place(loop_.behind);
}

void RunCompiler::emit(const Item& item) {
  switch (item.kind) {
    case Item::Kind::kSkip: {
      const int mask = ensure(schedule_.maskNode());
      a_.vector({1, 2, 0x0e}, mask, 0, mask);  // vtestps
      a_.jumpIf(Assembler::kZero, skip_);
      return used(schedule_.maskNode());
    }
    case Item::Kind::kTouch:
      ensure(item.index);
      return used(item.index);
    case Item::Kind::kNode:
      return emitNode(item.index);
    case Item::Kind::kRare:
      return emitRare(item.index);
    case Item::Kind::kKeep: {
      const int value = ensure(item.index);
      places_[item.index].kept = frame_;
      frame_ += kBytes;
      a_.storeVector({kRsp, -1, places_[item.index].kept, -1}, value);
      return used(item.index);
    }
    case Item::Kind::kLoopBegin:
      return emitLoopBegin(item.index);
    case Item::Kind::kLoopTest:
      return emitLoopTest(item.index);
    case Item::Kind::kLoopEnd:
      return emitLoopEnd(item.index);
    case Item::Kind::kStore:
      return emitStore(outputs_[item.index]);
  }
}

void RunCompiler::emitPhase() {
  items_ = schedule_.list(uniformPhase_);
  countUses();
  for (now_ = 0; now_ < items_.size(); ++now_) {
    emit(items_[now_]);
    freeSlots_.insert(freeSlots_.end(), slotsLater_.begin(), slotsLater_.end());
    slotsLater_.clear();
  }
}

/// The columns that the loop names most often stay in general registers.
void RunCompiler::choosePointers() {
  std::vector<std::pair<uint32_t, uint32_t>> named;  // column, times
  const auto name = [&](uint32_t column, uint32_t times) {
    const auto it =
        std::find_if(named.begin(), named.end(), [&](const auto& x) { return x.first == column; });
    if (it == named.end())
      named.push_back({column, times});
    else
      it->second += times;
  };
  for (NodeIndex i = 0; i < nodes_.size(); ++i)
    if (schedule_.needed(i) && nodes_[i].op == VectorOp::kLoad) name(nodes_[i].imm, 1);
  for (const RunOutput& o : outputs_)
    if (!o.uniform) name(o.column, o.masked ? 2 : 1);
  std::stable_sort(named.begin(), named.end(),
                   [](const auto& x, const auto& y) { return x.second > y.second; });
  for (size_t k = 0; k < std::min(named.size(), std::size(kPointers)); ++k)
    pointers_.push_back({named[k].first, kPointers[k]});
  for (const auto& [column, r] : pointers_) a_.load(r, {kColumns, -1, int32_t(column * 8), -1});
}

std::vector<uint8_t> RunCompiler::compile() {
  uses_.resize(nodes_.size());
  places_.resize(nodes_.size());

  for (const Gpr r : kCalleeSaved) a_.push(r);
  a_.move(kRax, kRsp);
  const size_t frameSize = a_.subtractImmediate(kRsp, 0);
  a_.andImmediate(kRsp, -kBytes);
  a_.store({kRsp, -1, kOldStack, -1}, kRax);
  a_.clear(kRax);
  a_.store({kRsp, -1, kEnded, -1}, kRax);
  a_.move(kColumns, kRdi);
  a_.move(kEnd, kRsi);
  a_.move(kMask, kRdx);
  uniformPhase_ = true;
  emitPhase();
  if (schedule_.hasLoop()) {
    uniformPhase_ = false;
    choosePointers();
    a_.clear(kOffset);
    a_.align(32);
    const Assembler::Label begin = a_.newLabel();
    skip_ = a_.newLabel();
    a_.place(begin);
    emitPhase();
    a_.place(skip_);
    a_.addImmediate(kOffset, kBytes);
    a_.compare(kOffset, kEnd);
    a_.jumpIf(Assembler::kBelow, begin);
  }
  a_.zeroUpper();
  a_.load(kRax, {kRsp, -1, kEnded, -1});
  a_.load(kRsp, {kRsp, -1, kOldStack, -1});
  for (size_t k = std::size(kCalleeSaved); k-- > 0;) a_.pop(kCalleeSaved[k]);
  a_.ret();
  for (const RareStub& s : stubs_) emitStub(s);
  a_.patch(frameSize, frame_ + kBytes);
  return a_.finish();
}

}  // namespace

std::vector<uint8_t> compileRun(const ValueGraph& graph, const std::vector<RunOutput>& outputs,
                                bool skipInactive) {
  return RunCompiler(graph, outputs, skipInactive).compile();
}

}  // namespace fr
