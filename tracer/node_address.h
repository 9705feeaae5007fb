// Patches by place instead of number. Root patches have the same numbers in every process that loaded the
// same scene; halves of split patches are numbered in the order in which they were first needed.
#pragma once

#include "scene_cache/cache.h"

namespace fr::tracer {

struct NodeAddress {
  uint32_t root = cache::kNone;
  uint32_t place = 0x00010001u;  // (1 << du | iu) in the low half, (1 << dv | iv) in the high half
};

/// Depths beyond 15 are cut: the address is an ancestor's then. kNone for numbers that mean nothing.
/// Thread-safe.
NodeAddress addressOf(const cache::SceneCache& cache, cache::NodeId node);
/// The node there, as far as it has been split here; kNone for addresses that mean nothing. Never makes
/// anything. Thread-safe. Trusts nothing.
cache::NodeId nodeAt(const cache::SceneCache& cache, const NodeAddress& address);

}  // namespace fr::tracer
