#include "scene_cache/quadric.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fr::cache {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

// Latitude limits of a sphere in degrees. A negative radius turns the sphere inside out.
void sphereLatitudes(const Quadric& q, double& lo, double& hi) {
  const double r = std::abs(q.p[0]);
  lo = q.p[1] > -r ? std::asin(std::clamp(q.p[1] / r, -1.0, 1.0)) / kDegree : -90.0;
  hi = q.p[2] < r ? std::asin(std::clamp(q.p[2] / r, -1.0, 1.0)) / kDegree : 90.0;
}

}  // namespace

void sinCosDegrees(double degrees, double& s, double& c) {
  // Exact, [-180, 180]; without std::remainder() where one subtraction does the same.
  const double size = std::abs(degrees);
  const double turn = size < 180.0                   ? degrees
                      : size < 540.0 && size > 180.0 ? degrees - std::copysign(360.0, degrees)
                                                     : std::remainder(degrees, 360.0);
  const double quarter = std::nearbyint(turn / 90.0);
  const double rest = (turn - quarter * 90.0) * kDegree;
  double rs, rc;
  // sincos of the same argument, so +-x give mirrored bits.
  rs = std::sin(rest), rc = std::cos(rest);
  switch (int(quarter) & 3) {
    case 0:
      s = rs, c = rc;
      break;
    case 1:
      s = rc, c = -rs;
      break;
    case 2:
      s = -rs, c = -rc;
      break;
    default:
      s = -rc, c = rs;
      break;
  }
}

int quadricParameterCount(PrimitiveType type) {
  switch (type) {
    case PrimitiveType::kSphere:
      return 4;
    case PrimitiveType::kCone:
      return 3;
    case PrimitiveType::kCylinder:
      return 4;
    case PrimitiveType::kHyperboloid:
      return 7;
    case PrimitiveType::kParaboloid:
      return 4;
    case PrimitiveType::kDisk:
      return 3;
    case PrimitiveType::kTorus:
      return 5;
    default:
      return 0;
  }
}

double quadricSweep(const Quadric& q) {
  const int n = quadricParameterCount(q.type);
  return n ? q.p[n - 1] : 0.0;
}

ProfilePoint quadricProfile(const Quadric& q, double v) {
  const double* p = q.p;
  const double w = 1 - v;
  switch (q.type) {
    case PrimitiveType::kSphere: {
      double lo, hi, s, c;
      sphereLatitudes(q, lo, hi);
      sinCosDegrees(w * lo + v * hi, s, c);
      const double d = (hi - lo) * kDegree * p[0];
      return {p[0] * c, 0, p[0] * s, -d * s, 0, d * c};
    }
    case PrimitiveType::kCone:
      return {p[1] * w, 0, v * p[0], -p[1], 0, p[0]};
    case PrimitiveType::kCylinder:
      return {p[0], 0, w * p[1] + v * p[2], 0, 0, p[2] - p[1]};
    case PrimitiveType::kHyperboloid:
      return {w * p[0] + v * p[3], w * p[1] + v * p[4], w * p[2] + v * p[5],
              p[3] - p[0],         p[4] - p[1],         p[5] - p[2]};
    case PrimitiveType::kParaboloid: {
      const double z = w * p[1] + v * p[2], dz = p[2] - p[1];
      const double ratio = p[2] != 0 ? std::max(0.0, z / p[2]) : 0.0;
      const double r = p[0] * std::sqrt(ratio);
      // dr/dz = rmax / (2 sqrt(z zmax)); at the apex it is infinite, which the caller's nudge avoids.
      const double root = std::sqrt(std::max(ratio, 1e-14));
      return {r, 0, z, p[2] != 0 ? p[0] * 0.5 / root * (dz / p[2]) : 0.0, 0, dz};
    }
    case PrimitiveType::kDisk:
      return {w * p[1], 0, p[0], -p[1], 0, 0};
    case PrimitiveType::kTorus: {
      double s, c;
      sinCosDegrees(w * p[2] + v * p[3], s, c);
      const double d = (p[3] - p[2]) * kDegree * p[1];
      return {p[0] + p[1] * c, 0, p[1] * s, -d * s, 0, d * c};
    }
    default:
      return {};
  }
}

Box3d quadricBound(const Quadric& q) {
  // Profile extremes: radius and z over v. All profiles but those of the sphere and torus are monotonic or
  // convex between their ends.
  double rmax = 0, zlo = 0, zhi = 0;
  double rmin = 0;
  const double* p = q.p;
  switch (q.type) {
    case PrimitiveType::kSphere: {
      double lo, hi;
      sphereLatitudes(q, lo, hi);
      if (lo > hi) std::swap(lo, hi);
      const double r = std::abs(p[0]);
      zlo = r * std::sin(lo * kDegree), zhi = r * std::sin(hi * kDegree);
      rmax = lo <= 0 && hi >= 0 ? r : r * std::max(std::cos(lo * kDegree), std::cos(hi * kDegree));
      if (p[0] < 0) std::swap(zlo, zhi), zlo = -zlo, zhi = -zhi;
      break;
    }
    case PrimitiveType::kTorus:
      rmax = std::abs(p[0]) + std::abs(p[1]);
      zlo = -std::abs(p[1]), zhi = std::abs(p[1]);
      break;
    default: {
      const ProfilePoint e0 = quadricProfile(q, 0), e1 = quadricProfile(q, 1);
      rmax = std::max(std::hypot(e0.a, e0.b), std::hypot(e1.a, e1.b));
      zlo = std::min(e0.z, e1.z), zhi = std::max(e0.z, e1.z);
      break;
    }
  }
  (void)rmin;
  Box3d box;
  const double sweep = quadricSweep(q);
  const bool straight = q.type != PrimitiveType::kHyperboloid && p[0] >= 0 && std::abs(sweep) < 360 &&
                        (q.type != PrimitiveType::kCone || p[1] >= 0) &&
                        (q.type != PrimitiveType::kDisk || p[1] >= 0) && q.type != PrimitiveType::kTorus;
  if (straight) {
    // Radii run over [0, rmax]: the sector's extremes are its corner, its two ends and the axes that it
    // crosses.
    box.extend(DVec3(0, 0, zlo));
    const auto add = [&](double degrees) {
      double s, c;
      sinCosDegrees(degrees, s, c);
      box.extend(DVec3(rmax * c, rmax * s, zhi));
    };
    add(0), add(sweep);
    for (double a = 90; a < std::abs(sweep); a += 90) add(std::copysign(a, sweep));
  } else {
    box.extend(DVec3(-rmax, -rmax, zlo));
    box.extend(DVec3(rmax, rmax, zhi));
  }
  // Rounding of the profile formulas.
  box.grow(1e-12 * (rmax + std::abs(zlo) + std::abs(zhi)));
  return box;
}

}  // namespace fr::cache
