// Copying the meaningful part of a RayQuery: the header and [0, count) of its arrays.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "oracle/ray_query.h"

namespace fr {

/// Copies a question: what is needed to ask a block of rays again.
inline void copyQuestion(const RayQuery& from, RayQuery& to) {
  constexpr size_t kHeaderBytes = offsetof(RayQuery, origin);
  std::memcpy(static_cast<void*>(&to), static_cast<const void*>(&from), kHeaderBytes);
  const uint32_t n = std::min(from.count, kMaxRays);
  const auto copy = [n](const auto& a, auto& b) { std::memcpy(b, a, n * sizeof a[0]); };
  for (int c = 0; c < 3; ++c) {
    copy(from.origin[c], to.origin[c]);
    copy(from.direction[c], to.direction[c]);
    copy(from.normal[c], to.normal[c]);
  }
  copy(from.time, to.time), copy(from.radius, to.radius), copy(from.spread, to.spread);
  copy(from.node, to.node), copy(from.cell, to.cell), copy(from.u, to.u), copy(from.v, to.v);
  copy(from.seed, to.seed), copy(from.importance, to.importance), copy(from.point, to.point);
}

/// Floats a ray that `terms` ask for beyond the fixed answers.
inline uint32_t extraAnswers(const RayTerms& terms) {
  uint32_t n = 0;
  for (size_t i = 0; i < sizeof terms.extras && terms.extras[i] != 0;) {
    const uint32_t components = terms.extras[i] == '3' ? 3 : 1;
    if (n + components > kMaxExtraAnswers) break;
    n += components;
    while (i < sizeof terms.extras && terms.extras[i] != 0 && terms.extras[i] != '\n') ++i;
    if (i < sizeof terms.extras && terms.extras[i] == '\n') ++i;
  }
  return n;
}

/// Copies the answers to `count` rays.
inline void copyAnswers(const RayQuery& from, RayQuery& to, uint32_t count) {
  const size_t bytes = std::min(count, kMaxRays) * sizeof(float);
  for (int c = 0; c < 3; ++c) {
    std::memcpy(to.color[c], from.color[c], bytes);
    std::memcpy(to.hitP[c], from.hitP[c], bytes);
    std::memcpy(to.hitN[c], from.hitN[c], bytes);
    std::memcpy(to.missP[c], from.missP[c], bytes);
    std::memcpy(to.missR[c], from.missR[c], bytes);
  }
  std::memcpy(to.hitDistance, from.hitDistance, bytes);
  std::memcpy(to.missDepth, from.missDepth, bytes);
  std::memcpy(to.hitNode, from.hitNode, bytes);
  if (to.terms.extras[0] != 0)
    for (uint32_t k = 0; k < kMaxExtraAnswers; ++k) std::memcpy(to.extra[k], from.extra[k], bytes);
}

}  // namespace fr
