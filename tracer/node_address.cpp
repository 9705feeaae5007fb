#include "tracer/node_address.h"

#include <algorithm>
#include <bit>

namespace fr::tracer {
namespace {

constexpr uint32_t kMostDepth = 15;

uint32_t half(uint32_t index, uint32_t depth) {
  const uint32_t cut = depth > kMostDepth ? depth - kMostDepth : 0;
  return (1u << (depth - cut)) | (index >> cut);
}

}  // namespace

NodeAddress addressOf(const cache::SceneCache& cache, cache::NodeId node) {
  NodeAddress a;
  if (node >= cache.nodeCount()) return a;
  const cache::PatchNode& n = cache.node(node);
  a.root = n.root;
  a.place = half(n.iu, n.du) | half(n.iv, n.dv) << 16;
  return a;
}

cache::NodeId nodeAt(const cache::SceneCache& cache, const NodeAddress& address) {
  if (address.root >= cache.skeleton().rootPatches().size()) return cache::kNone;
  const uint32_t u = address.place & 0xffff, v = address.place >> 16;
  if (u == 0 || v == 0) return cache::kNone;
  const uint32_t du = uint32_t(std::bit_width(u)) - 1, dv = uint32_t(std::bit_width(v)) - 1;
  const uint32_t iu = u - (1u << du), iv = v - (1u << dv);
  cache::NodeId at = address.root;
  for (uint32_t step = 0; step < du + dv; ++step) {
    const cache::ResolvedNode here = cache.peek(at);
    if (here.state != cache::NodeState::kSplit) break;
    cache::NodeId next = cache::kNone;
    for (const cache::NodeId child : here.children) {
      if (child >= cache.nodeCount()) continue;
      const cache::PatchNode& n = cache.node(child);
      if (n.du > du || n.dv > dv) continue;
      if ((iu >> (du - n.du)) == n.iu && (iv >> (dv - n.dv)) == n.iv) next = child;
    }
    if (next == cache::kNone) break;
    at = next;
  }
  return at;
}

}  // namespace fr::tracer
