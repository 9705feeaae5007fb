#include "oracle/ray_oracle.h"

#include <thread>

namespace fr {

Result<SingleAnswer> RayOracle::ask(const SingleRayMail& ray) { return ask(ray, RayTerms{}); }

Result<SingleAnswer> RayOracle::ask(const SingleRayMail& ray, const RayTerms& terms) {
  if (ray.ray.kind > uint32_t(RayKind::kFullTrace))
    return makeError(RiError::kRange, "{} is no kind of ray", ray.ray.kind);
  const RayKind kind = RayKind(ray.ray.kind);
  RayQuery* q = acquire();
  if (!q) return makeError(RiError::kLimit, "a single ray was asked while all blocks are in use");
  q->kind = kind, q->count = 1, q->level = ray.ray.level;
  q->terms = terms;
  q->terms.flags |= RayTerms::kWantsNode;
  putRay(*q, 0, ray);
  if (Result<void> s = submit(q); !s) {
    release(q);
    return std::move(s).error();
  }
  while (!answered(q)) {
    if (Result<void> w = wait(); !w) return std::move(w).error();
    if (!answered(q)) std::this_thread::yield();  // another block, which its owner has not looked at yet
  }
  const SingleAnswer answer = singleAnswerOf(*q, 0, kind);
  release(q);
  return answer;
}

}  // namespace fr
