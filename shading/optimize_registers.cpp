// Every expansion of a function brings its own variables; most are alive only for a few instructions. Sharing
// symbols keeps the memory of a batch small. A linear scan over live ranges.
#include <algorithm>
#include <map>
#include <queue>
#include <tuple>

#include "shading/passes.h"

namespace fr {
namespace {

bool isLoop(Op op) {
  return op == Op::loop_begin || op == Op::gather_begin || op == Op::illuminance_begin ||
         op == Op::illuminance_cone_begin || op == Op::ambient_begin;
}

struct Range {
  uint32_t first = kNoIndex;
  uint32_t last = 0;
};

/// Live ranges of locals and temporaries in the body. What is used in a loop and set before it lives through
/// the loop. A scalar variable is always set first where it is declared, an array is not: one that is used in
/// a loop at all may carry its values from turn to turn. What is set in a loop and read after it (the result
/// of a function that returns from inside) lives from the loop's start: the points that left keep their value
/// while others go on.
std::vector<Range> liveRanges(const ShaderProgram& p) {
  std::vector<Range> ranges(p.symbols.size());
  std::vector<std::pair<uint32_t, uint32_t>> loops;  // open loops, outermost first
  std::vector<std::pair<uint32_t, uint32_t>> all;
  for (uint32_t i = p.bodyBegin; i < p.code.size(); ++i) {
    const Instruction& in = p.code[i];
    if (isLoop(in.op)) {
      const uint32_t end = in.op == Op::gather_begin ? p.code[in.jump].jump : in.jump;
      loops.push_back({i, end});
      all.push_back({i, end});
    }
    for (uint32_t a : p.operands(in)) {
      const uint32_t s = a & kArgIndex;
      Range& r = ranges[s];
      const bool temp = !p.symbols[s].isArray();
      uint32_t begin = i, end = i;
      for (const auto& [b, e] : loops) {
        // The outermost loop that the value has to live through.
        if (temp && (r.first == kNoIndex || r.first >= b)) continue;
        end = std::max(end, e);
        if (!temp) begin = std::min(begin, b);
        break;
      }
      r.first = std::min(r.first, begin);
      r.last = std::max(r.last, end);
    }
    while (!loops.empty() && loops.back().second == i) loops.pop_back();
  }
  for (size_t k = all.size(); k-- > 0;)  // inner loops first
    for (Range& r : ranges)
      if (r.first != kNoIndex && r.first > all[k].first && r.first <= all[k].second && r.last > all[k].second)
        r.first = all[k].first;
  return ranges;
}

}  // namespace

void shareRegisters(ShaderProgram& p) {
  std::vector<Range> ranges = liveRanges(p);
  // Default-value code runs at another time, but its symbols keep their own places: simplest.
  std::vector<bool> inDefaults(p.symbols.size(), false);
  for (uint32_t i = 0; i < p.bodyBegin; ++i)
    for (uint32_t a : p.operands(p.code[i])) inDefaults[a & kArgIndex] = true;

  std::vector<uint32_t> order;
  for (uint32_t i = 0; i < p.symbols.size(); ++i) {
    const Storage st = p.symbols[i].storage;
    if ((st == Storage::kLocal || st == Storage::kTemp) && ranges[i].first != kNoIndex && !inDefaults[i])
      order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](uint32_t a, uint32_t b) { return ranges[a].first < ranges[b].first; });

  using Key = std::tuple<uint32_t, bool, bool, uint32_t>;  // floats of an element, string, varying, length
  std::map<Key, std::vector<uint32_t>> free;
  using Busy = std::pair<uint32_t, uint32_t>;  // last use, register
  std::priority_queue<Busy, std::vector<Busy>, std::greater<>> busy;
  std::vector<uint32_t> home(p.symbols.size());
  for (uint32_t i = 0; i < home.size(); ++i) home[i] = i;
  const auto key = [&](uint32_t i) {
    const Symbol& s = p.symbols[i];
    return Key{slTypeFloats(s.type), s.type == SlType::kString, s.isVarying(), s.arrayLength};
  };
  for (uint32_t i : order) {
    while (!busy.empty() && busy.top().first < ranges[i].first) {
      free[key(busy.top().second)].push_back(busy.top().second);
      busy.pop();
    }
    auto& list = free[key(i)];
    if (!list.empty()) {
      home[i] = list.back();
      list.pop_back();
      Symbol& shared = p.symbols[home[i]];
      shared.name = 0;
      shared.storage = Storage::kTemp;
    }
    busy.push({ranges[i].last, home[i]});
  }
  for (uint32_t k = 0; k < p.args.size(); ++k) {
    uint32_t& a = p.args[k];
    a = (a & ~kArgIndex) | home[a & kArgIndex];
  }
}

}  // namespace fr
