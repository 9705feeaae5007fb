// Who answers ray questions. One interface for every transport; the answers are bit-identical.
#pragma once

#include <memory>

#include "base/error.h"
#include "oracle/ray_query.h"
#include "oracle/single_ray.h"

namespace fr {

/// A client thread's line to the oracle. Not thread-safe: one per thread.
///
/// A block is acquired, filled, submitted, answered, read and released. Several blocks may be in flight.
class RayOracle {
 public:
  virtual ~RayOracle() = default;
  /// A block to fill, or nullptr when all are in flight (wait for one, then release it).
  virtual RayQuery* acquire() = 0;
  /// Hands a filled block over. Errors: the oracle is gone (kSystem).
  virtual Result<void> submit(RayQuery* q) = 0;
  /// True once the answers stand in the block.
  virtual bool answered(const RayQuery* q) const = 0;
  /// Returns when at least one submitted, unreleased block is answered. Errors: the oracle is gone; never
  /// hangs.
  virtual Result<void> wait() = 0;
  virtual void release(RayQuery* q) = 0;

  /// One ray, answered before this returns: for callers that have no batch. Blocks in flight stay in flight.
  /// Here: through a block; transports have faster ways. Errors: the oracle is gone (kSystem), the ray's kind
  /// is none (kRange), all blocks are in use (kLimit; faster ways need none).
  virtual Result<SingleAnswer> ask(const SingleRayMail& ray);
  /// The same with something to say about the ray, through a block.
  Result<SingleAnswer> ask(const SingleRayMail& ray, const RayTerms& terms);
};

/// Opens lines. connect() is thread-safe.
/// The oracle itself (process, BVH) is started by the first connection or question, not before.
class RayOracleService {
 public:
  virtual ~RayOracleService() = default;
  virtual Result<std::unique_ptr<RayOracle>> connect() = 0;
};

}  // namespace fr
