// Copying the meaningful part of a RayQuery: the header and [0, count) of its arrays.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <span>
#include <vector>

#include "oracle/ray_query.h"

namespace fr {

inline constexpr size_t kQueryHeaderBytes = offsetof(RayQuery, origin);

/// Calls f(array) for the first element of each array of questions. Q: RayQuery, const or not.
template <class Q, class F>
void forEachQuestionArray(Q& q, F&& f) {
  for (int c = 0; c < 3; ++c) f(q.origin[c]);
  for (int c = 0; c < 3; ++c) f(q.direction[c]);
  f(q.time), f(q.radius), f(q.spread);
  for (int c = 0; c < 3; ++c) f(q.normal[c]);
  f(q.node), f(q.cell), f(q.u), f(q.v), f(q.seed), f(q.importance), f(q.point);
}

/// What is needed to ask a block of rays again, packed. Reuses its memory.
class KeptQuestions {
 public:
  /// About 80 bytes a ray.
  void keep(const RayQuery& q) {
    const uint32_t n = std::min(q.count, kMaxRays);
    size_t bytes = kQueryHeaderBytes;
    forEachQuestionArray(q, [&](const auto& a) { bytes += n * sizeof a[0]; });
    if (bytes_.size() < bytes) bytes_.resize(bytes);
    std::byte* to = bytes_.data();
    std::memcpy(to, static_cast<const void*>(&q), kQueryHeaderBytes);
    to += kQueryHeaderBytes;
    forEachQuestionArray(q, [&](const auto& a) {
      std::memcpy(to, a, n * sizeof a[0]);
      to += n * sizeof a[0];
    });
  }
  /// REQUIRES keep().
  void writeTo(RayQuery& q) const {
    const std::byte* from = bytes_.data();
    std::memcpy(static_cast<void*>(&q), from, kQueryHeaderBytes);
    from += kQueryHeaderBytes;
    const uint32_t n = std::min(q.count, kMaxRays);
    forEachQuestionArray(q, [&](auto& a) {
      std::memcpy(a, from, n * sizeof a[0]);
      from += n * sizeof a[0];
    });
  }

 private:
  std::vector<std::byte> bytes_;
};

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
  if (to.terms.extras[0] != 0)
    for (uint32_t k = 0; k < kMaxExtraAnswers; ++k) std::memcpy(to.extra[k], from.extra[k], bytes);
}

}  // namespace fr
