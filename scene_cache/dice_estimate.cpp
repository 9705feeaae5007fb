#include "scene_cache/dice_estimate.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {
namespace {

/// Boxes around the eye are halved no deeper than this: what is left is about as large as its distance.
constexpr int kDeepest = 12;

double estimate(const DiceRate& rate, const Box3f& box, int depth) {
  const Vec3 size = box.max - box.min;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const Vec3 middle = 0.5f * (box.min + box.max);
  const float distance = glm::length(glm::max(glm::max(box.min - rate.eye, rate.eye - box.max), Vec3(0)));
  if (depth < kDeepest && rate.perspective && glm::length(size) > 2 * distance &&
      size[axis] * size[axis] > rate.nearSquared) {
    Box3f low = box, high = box;
    low.max[axis] = high.min[axis] = middle[axis];
    return estimate(rate, low, depth + 1) + estimate(rate, high, depth + 1);
  }
  // Two sides of the box, as dicing would rate lines through its middle. A box around the eye is taken to be
  // half its size away: how near its surface comes is not known.
  const float half = 0.5f * glm::length(size);
  double sides[3];
  for (int c = 0; c < 3; ++c) {
    Vec3 a = middle, b = middle;
    a[c] = box.min[c], b[c] = box.max[c];
    sides[c] = rate.perspective && distance < half ? double(size[c] / half * rate.scale)
                                                   : double(rate.segment(a, b));
  }
  std::sort(sides, sides + 3);
  return sides[2] * sides[1];
}

}  // namespace

double estimateMicropolygons(const DiceRate& rate, const Box3f& bound, float displacement) {
  if (bound.empty() || !isFinite(bound.min) || !isFinite(bound.max)) return 0;
  const Vec3 less = glm::min(Vec3(std::max(displacement, 0.0f)), 0.5f * (bound.max - bound.min));
  const double n = estimate(rate, {bound.min + less, bound.max - less}, 0);
  return std::isfinite(n) ? std::max(n, 1.0) : 0;
}

}  // namespace fr::cache
