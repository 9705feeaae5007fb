// What a run does, in order, before anybody knows of registers.
#pragma once

#include <cstdint>
#include <vector>

#include "shading/native_run.h"

namespace fr {

/// The nodes of a graph that its outputs need, as lists of things to do: one for what is uniform, computed
/// once, and one for the loop over the points.
class RunSchedule {
 public:
  static constexpr uint32_t kNever = ~0u;

  /// One thing to do: skip vectors without active points, read a column that will be overwritten, compute a
  /// node, look at a rare case, keep a uniform value for the loop over the points, begin a loop of the graph,
  /// leave it, turn, store a result.
  struct Item {
    enum class Kind : uint8_t {
      kSkip,
      kTouch,
      kNode,
      kRare,
      kKeep,
      kLoopBegin,
      kLoopTest,
      kLoopEnd,
      kStore
    } kind;
    uint32_t index;  // node; of kRare a rare case, of kStore an output, of kLoop... a loop
  };

  /// `graph` and `outputs` stay alive.
  RunSchedule(const ValueGraph& graph, const std::vector<RunOutput>& outputs, bool skipInactive);

  /// Lists one of the two phases; touched() is of that phase then.
  std::vector<Item> list(bool uniformPhase);
  /// There is anything to do per point.
  bool hasLoop() const { return loop_; }
  bool needed(NodeIndex i) const { return needed_[i]; }
  /// The node was read by kTouch: its column may have changed since.
  bool touched(NodeIndex i) const { return touched_[i]; }
  bool isLeaf(NodeIndex i) const {
    return operandCount(nodes_[i].op) == 0 && nodes_[i].op != VectorOp::kRare;
  }
  /// The mask, kNever when nobody asks for it.
  NodeIndex maskNode() const { return maskNode_; }
  /// Nodes of a rare case's results, kNever where one is not needed.
  const std::vector<NodeIndex>& rareResults(uint32_t rare) const { return rareResults_[rare]; }

  /// Calls f with the variables of a loop that somebody needs: their index.
  template <class F>
  void forVariables(uint32_t loop, const F& f) const {
    const GraphLoop& l = graph_.loops()[loop];
    for (uint32_t v = l.begin; v < l.behind; ++v)
      if (needed_[graph_.loopVariables()[v].value]) f(v);
  }
  /// The value of a variable at the loop's end has a place of its own.
  bool exitsApart(uint32_t variable) const {
    const LoopVariable& v = graph_.loopVariables()[variable];
    return needed_[v.result] && v.exit != v.value;
  }

  /// Calls f with every node that an item reads.
  template <class F>
  void forOperands(const Item& item, const F& f) const;

 private:
  void need(NodeIndex i);
  void findExternal();
  void findKept();
  void listStores(std::vector<Item>& items) const;
  void listNodes(bool uniformPhase, std::vector<Item>& items) const;

  const ValueGraph& graph_;
  const std::vector<Node>& nodes_;
  const std::vector<RunOutput>& outputs_;
  const bool skipInactive_;
  bool loop_ = false;
  NodeIndex maskNode_ = kNever;
  std::vector<bool> needed_, kept_, touched_;
  std::vector<std::vector<NodeIndex>> external_;  // by loop: what its turns read that does not change
  std::vector<std::vector<NodeIndex>> rareResults_;
};

template <class F>
void RunSchedule::forOperands(const Item& item, const F& f) const {
  switch (item.kind) {
    case Item::Kind::kNode: {
      const Node& n = nodes_[item.index];
      const NodeIndex operands[] = {n.a, n.b, n.c};
      for (uint32_t o = 0; o < operandCount(n.op); ++o) f(operands[o]);
      break;
    }
    case Item::Kind::kRare: {
      const RareNode& r = graph_.rareCases()[item.index];
      f(r.where);
      for (const NodeIndex i : r.in) f(i);
      for (const NodeIndex i : r.usual) f(i);
      break;
    }
    case Item::Kind::kTouch:
    case Item::Kind::kKeep:
      f(item.index);
      break;
    case Item::Kind::kLoopBegin:
      forVariables(item.index, [&](uint32_t v) { f(graph_.loopVariables()[v].initial); });
      break;
    case Item::Kind::kLoopTest:
      f(graph_.loops()[item.index].more);
      forVariables(item.index, [&](uint32_t v) {
        if (exitsApart(v)) f(graph_.loopVariables()[v].exit);
      });
      break;
    case Item::Kind::kLoopEnd:
      forVariables(item.index, [&](uint32_t v) { f(graph_.loopVariables()[v].next); });
      for (const NodeIndex i : external_[item.index]) f(i);
      break;
    case Item::Kind::kStore:
      f(outputs_[item.index].value);
      if (outputs_[item.index].masked) f(maskNode_);
      break;
    case Item::Kind::kSkip:
      f(maskNode_);
      break;
  }
}

}  // namespace fr
