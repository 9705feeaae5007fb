// What a run of elementwise operations computes, as a graph of vector operations on 32-bit lanes.
//
// Built by recording: the kernels are run once with values that append what is done to them
// (simd_recorded.h). Equal operations on equal operands are one node, operations on constants are evaluated
// at once, and what is exact for every operand is simplified: a graph gives the same bits as the kernels. It
// knows nothing of machines or registers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "shading/rare_case.h"

namespace fr {

enum class VectorOp : uint8_t {
  // Leaves. kConstant: bits in `imm`. kLoad, kLoadUniform: what column `imm` holds before the run. kMask: all
  // ones
  // where the point is active.
  kConstant,
  kLoad,
  kLoadUniform,
  kMask,
  // A variable of a loop, `imm` of loopVariables(): before each turn, and behind the loop.
  kLoopValue,
  kLoopResult,
  // Floats; min and max give the second operand when either is NaN or both are 0.
  kAdd,
  kSub,
  kMul,
  kDiv,
  kMin,
  kMax,
  kSqrt,
  kFloor,
  kCompare,  // `imm` is a Compare: all ones or 0
  // Bits.
  kAnd,
  kAndNot,  // ~a & b
  kOr,
  kXor,
  kSelect,  // a ? b : c, a is all ones or 0
  // Integers; shifts by `imm`.
  kAddInt,
  kSubInt,
  kMulInt,
  kEqualInt,
  kGreaterInt,
  kShiftLeft,
  kShiftRightSigned,
  kShiftRight,
  kToInt,  // truncates; out of range: the smallest integer
  kToFloat,
  kRare,  // result `imm` of rare case a (an index into rareCases(), not a node)
};

enum class Compare : uint8_t { kEqual, kLess, kLessEqual, kNotEqual };

using NodeIndex = uint32_t;

struct Node {
  VectorOp op = VectorOp::kConstant;
  bool uniform = true;  // the same for all points
  uint32_t imm = 0;
  NodeIndex a = 0, b = 0, c = 0;
  uint32_t loop = 0;  // 1 + index into loops(): differs from turn to turn
};

/// What a loop carries from turn to turn.
struct LoopVariable {
  NodeIndex initial = 0, value = 0, result = 0;
  NodeIndex next = 0;  // `value` of the next turn
  NodeIndex exit = 0;  // when the loop is left
};
/// Ends where no point of `more` is left; nodes up to `end` were added by then.
struct GraphLoop {
  uint32_t begin = 0, behind = 0;  // its variables
  NodeIndex more = 0, end = 0;
};
/// Operands of a node that are nodes.
uint32_t operandCount(VectorOp op);
/// The first two operands may change places, bit for bit.
bool commutes(VectorOp op);

/// Where `where` is not 0, the results come from the case's own function, else they are `usual`.
struct RareNode {
  RareCase kind = RareCase::kLargeAngle;
  NodeIndex where = 0;
  std::vector<NodeIndex> in, usual;
};

class ValueGraph {
 public:
  ValueGraph() { clear(); }
  /// Nothing but node 0, the float 0.
  void clear();

  NodeIndex constant(uint32_t bits) { return leaf(VectorOp::kConstant, bits, true); }
  NodeIndex constant(float f) { return constant(__builtin_bit_cast(uint32_t, f)); }
  NodeIndex load(uint32_t column, bool uniform) {
    return leaf(uniform ? VectorOp::kLoadUniform : VectorOp::kLoad, column, uniform);
  }
  NodeIndex mask() { return leaf(VectorOp::kMask, 0, false); }
  NodeIndex unary(VectorOp op, NodeIndex a, uint32_t imm = 0) { return add({op, true, imm, a, 0, 0}); }
  NodeIndex binary(VectorOp op, NodeIndex a, NodeIndex b, uint32_t imm = 0) {
    return add({op, true, imm, a, b, 0});
  }
  NodeIndex select(NodeIndex m, NodeIndex a, NodeIndex b) {
    return add({VectorOp::kSelect, true, 0, m, a, b});
  }
  /// Replaces `results` (the usual values) by what they are once the rare case has been looked at.
  void rare(RareCase kind, NodeIndex where, const NodeIndex* in, int inputs, NodeIndex* results, int count);

  /// Loops follow one another. Until endLoop(), what depends on loopValue() is computed once a turn.
  void beginLoop();
  /// A variable of the loop, as it is before a turn.
  NodeIndex loopValue(NodeIndex initial);
  /// Variable k of the loop: what it becomes, and what is read of it behind the loop.
  NodeIndex loopResult(uint32_t k, NodeIndex next, NodeIndex exit);
  void endLoop(NodeIndex more);
  const std::vector<GraphLoop>& loops() const { return loops_; }
  const std::vector<LoopVariable>& loopVariables() const { return loopVariables_; }

  const std::vector<Node>& nodes() const { return nodes_; }
  const std::vector<RareNode>& rareCases() const { return rare_; }
  bool isConstant(NodeIndex i) const { return nodes_[i].op == VectorOp::kConstant; }

 private:
  struct Hash {
    size_t operator()(const Node& n) const;
  };
  struct Same {
    bool operator()(const Node& x, const Node& y) const {
      return x.op == y.op && x.imm == y.imm && x.a == y.a && x.b == y.b && x.c == y.c;
    }
  };
  NodeIndex leaf(VectorOp op, uint32_t imm, bool uniform);
  NodeIndex add(Node n);
  NodeIndex find(const Node& n);
  bool simplify(Node& n, NodeIndex& result);
  bool simplifyAnd(const Node& n, NodeIndex& result);
  bool simplifyOr(const Node& n, NodeIndex& result);
  bool simplifySelect(const Node& n, NodeIndex& result);
  bool simplifyComparison(const Node& n, NodeIndex& result);
  bool isMask(NodeIndex i) const;
  /// A choice between two constants.
  struct Choice {
    NodeIndex mask = 0;
    uint32_t yes = 0, no = 0;
  };
  bool isChoice(NodeIndex i, Choice& c) const;
  NodeIndex negated(NodeIndex mask) { return add({VectorOp::kXor, true, 0, mask, constant(~0u), 0}); }
  bool fold(const Node& n, uint32_t& bits) const;

  std::vector<Node> nodes_;
  std::vector<RareNode> rare_;
  std::vector<GraphLoop> loops_;
  std::vector<LoopVariable> loopVariables_;
  std::unordered_map<Node, NodeIndex, Hash, Same> known_;
};

}  // namespace fr
