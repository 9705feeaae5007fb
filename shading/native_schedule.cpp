#include "shading/native_schedule.h"

#include <algorithm>

namespace fr {

RunSchedule::RunSchedule(const ValueGraph& graph, const std::vector<RunOutput>& outputs, bool skipInactive)
    : graph_(graph), nodes_(graph.nodes()), outputs_(outputs), skipInactive_(skipInactive) {
  needed_.assign(nodes_.size(), false);
  kept_.assign(nodes_.size(), false);
  touched_.assign(nodes_.size(), false);
  bool masked = skipInactive_;
  for (const RunOutput& o : outputs_) {
    need(o.value);
    loop_ = loop_ || !o.uniform;
    masked = masked || o.masked;
  }
  for (NodeIndex i = 0; i < nodes_.size() && masked; ++i)
    if (nodes_[i].op == VectorOp::kMask) maskNode_ = i, needed_[i] = true;
  rareResults_.resize(graph_.rareCases().size());
  for (size_t k = 0; k < rareResults_.size(); ++k)
    rareResults_[k].assign(graph_.rareCases()[k].usual.size(), kNever);
  for (NodeIndex i = 0; i < nodes_.size(); ++i)
    if (needed_[i] && nodes_[i].op == VectorOp::kRare) rareResults_[nodes_[i].a][nodes_[i].imm] = i;
  findExternal();
  findKept();
}

void RunSchedule::findExternal() {
  external_.resize(graph_.loops().size());
  const auto note = [&](uint32_t loop, NodeIndex i) {
    auto& list = external_[loop - 1];
    if (nodes_[i].loop != loop && nodes_[i].op != VectorOp::kConstant) list.push_back(i);
  };
  for (NodeIndex i = 0; i < nodes_.size(); ++i) {
    const uint32_t loop = nodes_[i].loop;
    if (loop == 0 || !needed_[i]) continue;
    const bool rare = nodes_[i].op == VectorOp::kRare;
    forOperands({rare ? Item::Kind::kRare : Item::Kind::kNode, rare ? nodes_[i].a : i},
                [&](NodeIndex o) { note(loop, o); });
  }
  for (uint32_t k = 0; k < graph_.loops().size(); ++k) {
    forVariables(k, [&](uint32_t v) {
      if (exitsApart(v)) note(k + 1, graph_.loopVariables()[v].exit);
    });
    std::sort(external_[k].begin(), external_[k].end());
    external_[k].erase(std::unique(external_[k].begin(), external_[k].end()), external_[k].end());
  }
}

void RunSchedule::need(NodeIndex i) {
  // Iteratively: graphs can be deep.
  std::vector<NodeIndex> todo{i};
  while (!todo.empty()) {
    const NodeIndex k = todo.back();
    todo.pop_back();
    if (needed_[k]) continue;
    needed_[k] = true;
    const Node& n = nodes_[k];
    if (n.op == VectorOp::kRare) {
      const RareNode& r = graph_.rareCases()[n.a];
      todo.push_back(r.where);
      todo.insert(todo.end(), r.in.begin(), r.in.end());
      todo.insert(todo.end(), r.usual.begin(), r.usual.end());
      continue;
    }
    if (n.op == VectorOp::kLoopValue || n.op == VectorOp::kLoopResult) {
      const LoopVariable& v = graph_.loopVariables()[n.imm];
      todo.insert(todo.end(), {v.initial, v.next, v.value});
      if (n.op == VectorOp::kLoopResult) todo.push_back(v.exit);
      for (const GraphLoop& l : graph_.loops())
        if (n.imm >= l.begin && n.imm < l.behind) todo.push_back(l.more);
      continue;
    }
    const NodeIndex operands[] = {n.a, n.b, n.c};
    for (uint32_t o = 0; o < operandCount(n.op); ++o) todo.push_back(operands[o]);
  }
}

std::vector<RunSchedule::Item> RunSchedule::list(bool uniformPhase) {
  std::vector<Item> items;
  if (!uniformPhase && skipInactive_) items.push_back({Item::Kind::kSkip, 0});
  // Columns that are copied to others and overwritten themselves are read before anything is stored.
  std::fill(touched_.begin(), touched_.end(), false);
  for (const RunOutput& o : outputs_) {
    const Node& n = nodes_[o.value];
    if (o.uniform != uniformPhase || (n.op != VectorOp::kLoad && n.op != VectorOp::kLoadUniform)) continue;
    const bool overwritten = std::any_of(outputs_.begin(), outputs_.end(),
                                         [&](const RunOutput& other) { return other.column == n.imm; });
    if (!overwritten || n.uniform != uniformPhase || touched_[o.value]) continue;
    touched_[o.value] = true;
    items.push_back({Item::Kind::kTouch, o.value});
  }
  listNodes(uniformPhase, items);
  if (!uniformPhase) {
    listStores(items);
    return items;
  }
  for (NodeIndex i = 0; i < nodes_.size(); ++i)
    if (kept_[i]) items.push_back({Item::Kind::kKeep, i});
  for (uint32_t k = 0; k < outputs_.size(); ++k)
    if (outputs_[k].uniform) items.push_back({Item::Kind::kStore, k});
  return items;
}

/// Nodes follow one another as they were recorded, but for those that do not change from turn to turn of a
/// loop: they are computed before it.
void RunSchedule::listNodes(bool uniformPhase, std::vector<Item>& items) const {
  std::vector<bool> rareListed(graph_.rareCases().size(), false);
  const auto list = [&](NodeIndex i) {
    if (!needed_[i] || nodes_[i].uniform != uniformPhase) return;
    if (nodes_[i].op == VectorOp::kRare) {
      if (!rareListed[nodes_[i].a]) items.push_back({Item::Kind::kRare, nodes_[i].a});
      rareListed[nodes_[i].a] = true;
    } else if (!isLeaf(i)) {
      items.push_back({Item::Kind::kNode, i});
    }
  };
  NodeIndex next = 0;
  for (uint32_t k = 0; k < graph_.loops().size() && !uniformPhase; ++k) {
    const GraphLoop& l = graph_.loops()[k];
    bool used = false;
    forVariables(k, [&](uint32_t) { used = true; });
    if (!used) continue;
    for (NodeIndex i = next; i < l.end; ++i)
      if (nodes_[i].loop == 0) list(i);
    items.push_back({Item::Kind::kLoopBegin, k});
    // What the test and the values at the loop's end are made of.
    std::vector<bool> early(l.end, false);
    std::vector<NodeIndex> todo{l.more};
    forVariables(k, [&](uint32_t v) {
      if (exitsApart(v)) todo.push_back(graph_.loopVariables()[v].exit);
    });
    while (!todo.empty()) {
      const NodeIndex i = todo.back();
      todo.pop_back();
      if (nodes_[i].loop != k + 1 || early[i]) continue;
      early[i] = true;
      if (nodes_[i].op == VectorOp::kRare)
        forOperands({Item::Kind::kRare, nodes_[i].a}, [&](NodeIndex o) { todo.push_back(o); });
      else
        forOperands({Item::Kind::kNode, i}, [&](NodeIndex o) { todo.push_back(o); });
    }
    for (const bool before : {true, false}) {
      for (NodeIndex i = 0; i < l.end; ++i)
        if (nodes_[i].loop == k + 1 && early[i] == before) list(i);
      items.push_back({before ? Item::Kind::kLoopTest : Item::Kind::kLoopEnd, k});
    }
    next = l.end;
  }
  for (NodeIndex i = next; i < nodes_.size(); ++i)
    if (nodes_[i].loop == 0) list(i);
}

/// A result is stored as soon as it is known and the column's old values are not needed any more.
void RunSchedule::listStores(std::vector<Item>& items) const {
  std::vector<uint32_t> defined(nodes_.size(), 0), lastUse(nodes_.size(), 0);
  for (uint32_t at = 0; at < items.size(); ++at) {
    forOperands(items[at], [&](NodeIndex i) { lastUse[i] = at; });
    if (items[at].kind == Item::Kind::kNode) defined[items[at].index] = at;
    if (items[at].kind == Item::Kind::kRare)
      for (const NodeIndex i : rareResults_[items[at].index])
        if (i != kNever) defined[i] = at;
    if (items[at].kind == Item::Kind::kLoopEnd)
      forVariables(items[at].index, [&](uint32_t v) { defined[graph_.loopVariables()[v].result] = at; });
  }
  std::vector<uint32_t> columnRead;
  for (NodeIndex i = 0; i < nodes_.size(); ++i)
    if (nodes_[i].op == VectorOp::kLoad && needed_[i]) {
      if (columnRead.size() <= nodes_[i].imm) columnRead.resize(nodes_[i].imm + 1, 0);
      columnRead[nodes_[i].imm] = lastUse[i];
    }
  std::vector<std::pair<uint32_t, uint32_t>> stores;  // item behind which, output
  for (uint32_t k = 0; k < outputs_.size(); ++k) {
    const RunOutput& o = outputs_[k];
    if (o.uniform) continue;
    uint32_t at = defined[o.value];
    if (o.column < columnRead.size()) at = std::max(at, columnRead[o.column]);
    stores.push_back({at, k});
  }
  std::stable_sort(stores.begin(), stores.end(),
                   [](const auto& x, const auto& y) { return x.first < y.first; });
  std::vector<Item> merged;
  size_t next = 0;
  for (uint32_t at = 0; at < items.size(); ++at) {
    merged.push_back(items[at]);
    // Nothing is stored before the last column has been touched.
    if (at + 1 < items.size() && items[at + 1].kind == Item::Kind::kTouch) continue;
    for (; next < stores.size() && stores[next].first <= at; ++next)
      merged.push_back({Item::Kind::kStore, stores[next].second});
  }
  for (; next < stores.size(); ++next) merged.push_back({Item::Kind::kStore, stores[next].second});
  items = std::move(merged);
}

/// Uniform values that the loop reads.
void RunSchedule::findKept() {
  const auto keep = [&](NodeIndex i) {
    if (nodes_[i].uniform && nodes_[i].op != VectorOp::kConstant) kept_[i] = true;
  };
  for (NodeIndex i = 0; i < nodes_.size(); ++i) {
    if (!needed_[i] || nodes_[i].uniform) continue;
    const Node& n = nodes_[i];
    if (n.op == VectorOp::kRare)
      forOperands({Item::Kind::kRare, n.a}, keep);
    else
      forOperands({Item::Kind::kNode, i}, keep);
  }
  for (uint32_t k = 0; k < graph_.loops().size(); ++k)
    for (const Item::Kind kind : {Item::Kind::kLoopBegin, Item::Kind::kLoopTest, Item::Kind::kLoopEnd})
      forOperands({kind, k}, [&](NodeIndex i) {
        if (needed_[i]) keep(i);
      });
  for (const RunOutput& o : outputs_)
    if (!o.uniform) keep(o.value);
}

}  // namespace fr
