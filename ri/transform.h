// Transformations with motion keys, in double precision.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "base/error.h"
#include "base/math.h"

namespace fr::ri {

/// Matrices at ascending times; between two keys they are interpolated element by element, before the first
/// and after the last they stand still. Never empty; a still transform has one key.
struct Transform {
  std::vector<float> times{0.f};
  std::vector<DMat4> matrices{DMat4(1)};

  Transform() = default;
  explicit Transform(const DMat4& m) : matrices{m} {}
  bool isMoving() const { return matrices.size() > 1; }
  DMat4 at(float time) const;
  bool operator==(const Transform&) const = default;
};
using TransformPtr = std::shared_ptr<const Transform>;

/// `outer` after `inner` (points go through inner first), with a key at every key of either.
Transform concat(const Transform& outer, const Transform& inner);
/// Key by key; kMath when a key is singular (its cofactors give nothing usable).
Result<Transform> inverse(const Transform& t);

/// One transformation request, before it becomes a matrix: moving requests interpolate their arguments.
struct TransformRequest {
  enum class Kind : uint8_t {
    kIdentity,
    kTransform,
    kConcat,
    kPerspective,
    kTranslate,
    kRotate,
    kScale,
    kSkew
  };
  Kind kind = Kind::kIdentity;
  std::array<double, 16> args{};

  /// True for Identity and Transform, which replace the CTM instead of concatenating.
  bool replaces() const { return kind == Kind::kIdentity || kind == Kind::kTransform; }
  /// kRange for arguments without a meaning (zero axis, skew beyond its axis), kMath for numbers not finite.
  Result<DMat4> matrix() const;
};
/// Name of the RIB request.
const char* transformRequestName(TransformRequest::Kind k);

/// The keys of one moving request. A rotation is cut into steps of at most 10 degrees, so that what turns
/// keeps its size between two keys. Needs as many times as requests, all of one kind, times ascending.
Result<Transform> movingTransform(const std::vector<float>& times,
                                  const std::vector<TransformRequest>& requests);

}  // namespace fr::ri
