#include "shading/value_graph.h"

#include <bit>
#include <cmath>
#include <utility>

namespace fr {

namespace {
constexpr uint32_t kOnes = ~0u, kSign = 0x80000000u, kOne = 0x3f800000u;

float asFloat(uint32_t bits) { return std::bit_cast<float>(bits); }
uint32_t asBits(float f) { return std::bit_cast<uint32_t>(f); }

}  // namespace

bool commutes(VectorOp op) {
  switch (op) {
    case VectorOp::kAdd:
    case VectorOp::kMul:
    case VectorOp::kAnd:
    case VectorOp::kOr:
    case VectorOp::kXor:
    case VectorOp::kAddInt:
    case VectorOp::kMulInt:
    case VectorOp::kEqualInt:
      return true;
    default:
      return false;
  }
}

uint32_t operandCount(VectorOp op) {
  switch (op) {
    case VectorOp::kConstant:
    case VectorOp::kLoad:
    case VectorOp::kLoadUniform:
    case VectorOp::kMask:
    case VectorOp::kLoopValue:
    case VectorOp::kLoopResult:
    case VectorOp::kRare:
      return 0;
    case VectorOp::kSqrt:
    case VectorOp::kFloor:
    case VectorOp::kShiftLeft:
    case VectorOp::kShiftRightSigned:
    case VectorOp::kShiftRight:
    case VectorOp::kToInt:
    case VectorOp::kToFloat:
      return 1;
    case VectorOp::kSelect:
      return 3;
    default:
      return 2;
  }
}

size_t ValueGraph::Hash::operator()(const Node& n) const {
  uint64_t h = uint64_t(n.op) * 0x9e3779b97f4a7c15ull + n.imm;
  for (const uint32_t x : {n.a, n.b, n.c}) h = (h ^ (h >> 29)) * 0xbf58476d1ce4e5b9ull + x;
  return size_t(h ^ (h >> 32));
}

void ValueGraph::clear() {
  nodes_.clear();
  rare_.clear();
  known_.clear();
  constant(0u);
  loops_.clear();
  loopVariables_.clear();
}

NodeIndex ValueGraph::find(const Node& n) {
  const auto [it, added] = known_.try_emplace(n, NodeIndex(nodes_.size()));
  if (added) nodes_.push_back(n);
  return it->second;
}

NodeIndex ValueGraph::leaf(VectorOp op, uint32_t imm, bool uniform) {
  return find({op, uniform, imm, 0, 0, 0});
}

NodeIndex ValueGraph::add(Node n) {
  const uint32_t count = operandCount(n.op);
  if (commutes(n.op) && n.a > n.b) std::swap(n.a, n.b);
  bool constants = true;
  const NodeIndex operands[] = {n.a, n.b, n.c};
  for (uint32_t k = 0; k < count; ++k) {
    constants = constants && isConstant(operands[k]);
    n.uniform = n.uniform && nodes_[operands[k]].uniform;
  }
  uint32_t bits;
  if (constants && fold(n, bits)) return constant(bits);
  NodeIndex simple;
  if (simplify(n, simple)) return simple;
  const NodeIndex rest[] = {n.a, n.b, n.c};
  for (uint32_t k = 0; k < operandCount(n.op); ++k) n.loop = std::max(n.loop, nodes_[rest[k]].loop);
  return find(n);
}

/// Rewrites that are exact for every operand, NaN and signed zeros included. True: `result` is the value.
bool ValueGraph::simplify(Node& n, NodeIndex& result) {
  const auto is = [&](NodeIndex i, uint32_t bits) { return isConstant(i) && nodes_[i].imm == bits; };
  const auto to = [&](NodeIndex i) {
    result = i;
    return true;
  };
  switch (n.op) {
    case VectorOp::kAdd:  // x + -0
      if (is(n.a, kSign)) return to(n.b);
      if (is(n.b, kSign)) return to(n.a);
      break;
    case VectorOp::kSub:  // x - 0
      if (is(n.b, 0)) return to(n.a);
      break;
    case VectorOp::kMul:
      if (is(n.a, kOne)) return to(n.b);
      if (is(n.b, kOne)) return to(n.a);
      break;
    case VectorOp::kDiv:
      if (is(n.b, kOne)) return to(n.a);
      // By a power of two whose inverse is a normal number: a multiplication rounds the same.
      if (isConstant(n.b)) {
        const uint32_t b = nodes_[n.b].imm, exponent = (b >> 23) & 0xff;
        if ((b & 0x7fffffu) == 0 && exponent > 0 && exponent < 253)
          return to(add({VectorOp::kMul, true, 0, n.a, constant(1.0f / asFloat(b)), 0}));
      }
      break;
    case VectorOp::kMin:
    case VectorOp::kMax:
      if (n.a == n.b) return to(n.a);
      break;
    case VectorOp::kAnd:
      return simplifyAnd(n, result);
    case VectorOp::kAndNot:
      if (is(n.a, 0)) return to(n.b);
      if (is(n.a, kOnes) || is(n.b, 0) || n.a == n.b) return to(0);
      // ~x & (x & y), ~x & (~x & y)
      if (nodes_[n.b].op == VectorOp::kAnd && (nodes_[n.b].a == n.a || nodes_[n.b].b == n.a)) return to(0);
      if (nodes_[n.b].op == VectorOp::kAndNot && nodes_[n.b].a == n.a) return to(n.b);
      break;
    case VectorOp::kOr:
      return simplifyOr(n, result);
    case VectorOp::kCompare:
      return simplifyComparison(n, result);
    case VectorOp::kXor:
      if (is(n.b, 0)) return to(n.a);
      if (is(n.a, 0)) return to(n.b);
      if (n.a == n.b) return to(0);
      // A sign changed twice.
      for (auto [x, y] : {std::pair(n.a, n.b), std::pair(n.b, n.a)})
        if (isConstant(x) && nodes_[y].op == VectorOp::kXor)
          for (auto [u, v] : {std::pair(nodes_[y].a, nodes_[y].b), std::pair(nodes_[y].b, nodes_[y].a)})
            if (isConstant(u))
              return to(add({VectorOp::kXor, true, 0, constant(nodes_[x].imm ^ nodes_[u].imm), v, 0}));
      break;
    case VectorOp::kSelect:
      return simplifySelect(n, result);
    case VectorOp::kAddInt:
      if (is(n.a, 0)) return to(n.b);
      if (is(n.b, 0)) return to(n.a);
      break;
    case VectorOp::kShiftLeft:
    case VectorOp::kShiftRight:
    case VectorOp::kShiftRightSigned:
      if (n.imm == 0) return to(n.a);
      break;
    default:
      break;
  }
  return false;
}

bool ValueGraph::simplifyAnd(const Node& n, NodeIndex& result) {
  const auto is = [&](NodeIndex i, uint32_t bits) { return isConstant(i) && nodes_[i].imm == bits; };
  const auto to = [&](NodeIndex i) {
    result = i;
    return true;
  };
  if (n.a == n.b || is(n.b, kOnes)) return to(n.a);
  if (is(n.a, kOnes)) return to(n.b);
  if (is(n.a, 0) || is(n.b, 0)) return to(0);
  for (auto [x, y] : {std::pair(n.a, n.b), std::pair(n.b, n.a)}) {
    const Node &p = nodes_[x], &q = nodes_[y];
    if (q.op == VectorOp::kAnd) {
      // Masks of masks: an absolute value of an absolute value.
      if (isConstant(x))
        for (auto [u, v] : {std::pair(q.a, q.b), std::pair(q.b, q.a)})
          if (isConstant(u)) return to(add({VectorOp::kAnd, true, 0, constant(p.imm & nodes_[u].imm), v, 0}));
      if (q.a == x || q.b == x) return to(y);  // x & (x & z)
    }
    if (q.op == VectorOp::kOr && (q.a == x || q.b == x)) return to(x);  // x & (x | z)
    if (q.op == VectorOp::kAndNot && q.a == x) return to(0);            // x & (~x & z)
    if (q.op == VectorOp::kAndNot && q.b == x) return to(y);            // x & (~z & x)
    // ~x & y
    if (p.op == VectorOp::kXor && (is(p.a, kOnes) || is(p.b, kOnes)))
      return to(add({VectorOp::kAndNot, true, 0, is(p.a, kOnes) ? p.b : p.a, y, 0}));
  }
  return false;
}

bool ValueGraph::simplifyOr(const Node& n, NodeIndex& result) {
  const auto is = [&](NodeIndex i, uint32_t bits) { return isConstant(i) && nodes_[i].imm == bits; };
  const auto to = [&](NodeIndex i) {
    result = i;
    return true;
  };
  if (n.a == n.b || is(n.b, 0)) return to(n.a);
  if (is(n.a, 0)) return to(n.b);
  if (is(n.a, kOnes) || is(n.b, kOnes)) return to(constant(kOnes));
  for (auto [x, y] : {std::pair(n.a, n.b), std::pair(n.b, n.a)}) {
    const Node& q = nodes_[y];
    if (q.op == VectorOp::kAnd && (q.a == x || q.b == x)) return to(x);  // x | (x & z)
  }
  return false;
}

bool ValueGraph::simplifySelect(const Node& n, NodeIndex& result) {
  const auto is = [&](NodeIndex i, uint32_t bits) { return isConstant(i) && nodes_[i].imm == bits; };
  const auto to = [&](NodeIndex i) {
    result = i;
    return true;
  };
  const auto choose = [&](NodeIndex m, NodeIndex yes, NodeIndex no) {
    return to(add({VectorOp::kSelect, true, 0, m, yes, no}));
  };
  if (n.b == n.c) return to(n.b);
  if (isConstant(n.a)) return to(nodes_[n.a].imm ? n.b : n.c);
  const Node m = nodes_[n.a], yes = nodes_[n.b], no = nodes_[n.c];
  if (m.op == VectorOp::kXor && (is(m.a, kOnes) || is(m.b, kOnes)))
    return choose(is(m.a, kOnes) ? m.b : m.a, n.c, n.b);
  // The same question once more.
  if (yes.op == VectorOp::kSelect && yes.a == n.a) return choose(n.a, yes.b, n.c);
  if (no.op == VectorOp::kSelect && no.a == n.a) return choose(n.a, n.b, no.c);
  if (yes.op == VectorOp::kAnd && (yes.a == n.a || yes.b == n.a))
    return choose(n.a, yes.a == n.a ? yes.b : yes.a, n.c);
  if (no.op == VectorOp::kAndNot && no.a == n.a) return choose(n.a, n.b, no.b);
  if (is(n.c, 0)) return to(add({VectorOp::kAnd, true, 0, n.a, n.b, 0}));
  if (is(n.b, 0)) return to(add({VectorOp::kAndNot, true, 0, n.a, n.c, 0}));
  return false;
}

/// All ones or 0 in every lane.
bool ValueGraph::isMask(NodeIndex i) const {
  // Deep ones are not worth the time.
  const auto mask = [&](const auto& self, NodeIndex k, int depth) -> bool {
    const Node& n = nodes_[k];
    switch (n.op) {
      case VectorOp::kMask:
      case VectorOp::kCompare:
      case VectorOp::kEqualInt:
      case VectorOp::kGreaterInt:
        return true;
      case VectorOp::kConstant:
        return n.imm == 0 || n.imm == kOnes;
      case VectorOp::kAnd:
      case VectorOp::kAndNot:
      case VectorOp::kOr:
      case VectorOp::kXor:
        return depth < 6 && self(self, n.a, depth + 1) && self(self, n.b, depth + 1);
      default:
        return false;
    }
  };
  return mask(mask, i, 0);
}

bool ValueGraph::isChoice(NodeIndex i, Choice& c) const {
  const Node& n = nodes_[i];
  if (n.op == VectorOp::kSelect && isConstant(n.b) && isConstant(n.c)) {
    c = {n.a, nodes_[n.b].imm, nodes_[n.c].imm};
    return true;
  }
  if (n.op == VectorOp::kAndNot && isConstant(n.b) && isMask(n.a)) {
    c = {n.a, 0, nodes_[n.b].imm};
    return true;
  }
  if (n.op == VectorOp::kAnd)
    for (auto [x, y] : {std::pair(n.a, n.b), std::pair(n.b, n.a)})
      if (isConstant(y) && isMask(x)) {
        c = {x, nodes_[y].imm, 0};
        return true;
      }
  return false;
}

/// Truth values are numbers in shaders: asking whether one is 0 is the condition itself.
bool ValueGraph::simplifyComparison(const Node& n, NodeIndex& result) {
  Choice c;
  const bool first = isConstant(n.b) && isChoice(n.a, c);
  if (!first && !(isConstant(n.a) && isChoice(n.b, c))) return false;
  const auto with = [&](uint32_t bits) {
    Node k = n;
    (first ? k.a : k.b) = constant(bits);
    return nodes_[add(k)].imm != 0;
  };
  const bool yes = with(c.yes), no = with(c.no);
  result = yes && no ? constant(kOnes) : yes ? c.mask : no ? negated(c.mask) : 0;
  return true;
}

/// What an operation on constants gives on every machine. False: it is left to the machine.
bool ValueGraph::fold(const Node& n, uint32_t& r) const {
  const uint32_t count = operandCount(n.op);
  const uint32_t a = count > 0 ? nodes_[n.a].imm : 0, b = count > 1 ? nodes_[n.b].imm : 0,
                 c = count > 2 ? nodes_[n.c].imm : 0;
  const float x = asFloat(a), y = asFloat(b);
  const auto number = [&](float f) {
    r = asBits(f);
    return !std::isnan(f);  // whose sign differs between machines
  };
  const auto flag = [&](bool f) {
    r = f ? kOnes : 0;
    return true;
  };
  const auto word = [&](uint32_t w) {
    r = w;
    return true;
  };
  switch (n.op) {
    case VectorOp::kAdd:
      return number(x + y);
    case VectorOp::kSub:
      return number(x - y);
    case VectorOp::kMul:
      return number(x * y);
    case VectorOp::kDiv:
      return number(x / y);
    case VectorOp::kMin:
      return number(x < y ? x : y);
    case VectorOp::kMax:
      return number(x > y ? x : y);
    case VectorOp::kSqrt:
      return number(std::sqrt(x));
    case VectorOp::kFloor:
      return number(std::floor(x));
    case VectorOp::kCompare:
      switch (Compare(n.imm)) {
        case Compare::kEqual:
          return flag(x == y);
        case Compare::kLess:
          return flag(x < y);
        case Compare::kLessEqual:
          return flag(x <= y);
        case Compare::kNotEqual:
          return flag(x != y);
      }
      return false;
    case VectorOp::kAnd:
      return word(a & b);
    case VectorOp::kAndNot:
      return word(~a & b);
    case VectorOp::kOr:
      return word(a | b);
    case VectorOp::kXor:
      return word(a ^ b);
    case VectorOp::kSelect:
      return word(a ? b : c);
    case VectorOp::kAddInt:
      return word(a + b);
    case VectorOp::kSubInt:
      return word(a - b);
    case VectorOp::kMulInt:
      return word(a * b);
    case VectorOp::kEqualInt:
      return flag(a == b);
    case VectorOp::kGreaterInt:
      return flag(int32_t(a) > int32_t(b));
    case VectorOp::kShiftLeft:
      return word(a << n.imm);
    case VectorOp::kShiftRight:
      return word(a >> n.imm);
    case VectorOp::kShiftRightSigned:
      return word(uint32_t(int32_t(a) >> n.imm));
    case VectorOp::kToInt:
      if (!(x > -2147483648.0f && x < 2147483648.0f)) return word(kSign);
      return word(uint32_t(int32_t(x)));
    case VectorOp::kToFloat:
      return number(float(int32_t(a)));
    default:
      return false;
  }
}

void ValueGraph::rare(RareCase kind, NodeIndex where, const NodeIndex* in, int inputs, NodeIndex* results,
                      int count) {
  if (isConstant(where) && nodes_[where].imm == 0) return;
  RareNode r;
  r.kind = kind, r.where = where;
  r.in.assign(in, in + inputs);
  r.usual.assign(results, results + count);
  // The same question once more.
  for (size_t k = 0; k < rare_.size(); ++k)
    if (rare_[k].kind == kind && rare_[k].where == where && rare_[k].in == r.in &&
        rare_[k].usual == r.usual) {
      for (int i = 0; i < count; ++i)
        results[i] = find({VectorOp::kRare, true, uint32_t(i), NodeIndex(k), 0, 0});
      return;
    }
  bool uniform = nodes_[where].uniform;
  for (const NodeIndex i : r.in) uniform = uniform && nodes_[i].uniform;
  for (const NodeIndex i : r.usual) uniform = uniform && nodes_[i].uniform;
  uint32_t loop = nodes_[where].loop;
  for (const NodeIndex i : r.in) loop = std::max(loop, nodes_[i].loop);
  for (const NodeIndex i : r.usual) loop = std::max(loop, nodes_[i].loop);
  const auto index = NodeIndex(rare_.size());
  rare_.push_back(std::move(r));
  for (int i = 0; i < count; ++i)
    results[i] = find({VectorOp::kRare, uniform, uint32_t(i), index, 0, 0, loop});
}

void ValueGraph::beginLoop() {
  GraphLoop l;
  l.begin = uint32_t(loopVariables_.size());
  loops_.push_back(l);
}
NodeIndex ValueGraph::loopValue(NodeIndex initial) {
  LoopVariable v;
  v.initial = initial;
  v.value =
      find({VectorOp::kLoopValue, false, uint32_t(loopVariables_.size()), 0, 0, 0, uint32_t(loops_.size())});
  loopVariables_.push_back(v);
  return v.value;
}
NodeIndex ValueGraph::loopResult(uint32_t k, NodeIndex next, NodeIndex exit) {
  const uint32_t index = loops_.back().begin + k;
  LoopVariable& v = loopVariables_[index];
  v.next = next, v.exit = exit;
  v.result = leaf(VectorOp::kLoopResult, index, false);
  return v.result;
}
void ValueGraph::endLoop(NodeIndex more) {
  GraphLoop& l = loops_.back();
  l.behind = uint32_t(loopVariables_.size());
  l.more = more, l.end = NodeIndex(nodes_.size());
}

}  // namespace fr
