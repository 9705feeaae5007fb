#include "scene_cache/motion.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

namespace fr::cache {
namespace {

DMat4 blend(const DMat4& a, const DMat4& b, double t) {
  DMat4 r;
  for (int c = 0; c < 4; ++c) r[c] = a[c] * (1 - t) + b[c] * t;
  return r;
}

double entrySum(const DMat3& m) {
  double s = 0;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) s += std::abs(m[c][r]);
  return s;
}

/// Rotation nearest to m: Newton's iteration Q := (Q + Q^-T) / 2. False when m is (nearly) singular.
bool polarRotation(const DMat3& m, DMat3* rotation) {
  DMat3 q = m;
  for (int i = 0; i < 32; ++i) {
    const double det = glm::determinant(q);
    const double size = entrySum(q);
    if (!(std::abs(det) > 1e-12 * size * size * size)) return false;
    const DMat3 next = (q + glm::transpose(glm::inverse(q))) * 0.5;
    const double change = entrySum(next - q);
    q = next;
    if (change < 1e-14 * entrySum(q)) break;
  }
  *rotation = q;
  return true;
}

bool isAffine(const DMat4& m) { return m[0].w == 0 && m[1].w == 0 && m[2].w == 0 && m[3].w == 1; }

}  // namespace

DMat4 interpolateMotion(std::span<const float> times, std::span<const DMat4> matrices, float time) {
  if (matrices.empty()) return DMat4(1);
  if (matrices.size() == 1 || !(time > times[0])) return matrices.front();
  if (time >= times.back()) return matrices.back();
  const size_t k = size_t(std::upper_bound(times.begin(), times.end(), time) - times.begin());
  const DMat4& a = matrices[k - 1];
  const DMat4& b = matrices[k];
  const double t = (double(time) - times[k - 1]) / (double(times[k]) - times[k - 1]);
  const DMat3 la(a), lb(b);
  if (la == lb) return blend(a, b, t);  // moves straight
  DMat3 ra, rb;
  if (!isAffine(a) || !isAffine(b) || isMirrored(a) != isMirrored(b) || !polarRotation(la, &ra) ||
      !polarRotation(lb, &rb))
    return blend(a, b, t);
  const DMat3 sa = glm::transpose(ra) * la, sb = glm::transpose(rb) * lb;
  // A mirroring pair keeps its reflection in the stretch: quaternions hold proper rotations only.
  const double sign = isMirrored(a) ? -1.0 : 1.0;
  const glm::dquat q = glm::slerp(glm::quat_cast(ra * sign), glm::quat_cast(rb * sign), t);
  const DMat3 linear = glm::mat3_cast(q) * ((sa * (1 - t) + sb * t) * sign);
  DMat4 r(linear);
  r[3] = a[3] * (1 - t) + b[3] * t;
  return r;
}

}  // namespace fr::cache
