// Quadrics as surfaces of revolution: u around, v along (RISpec 3.2, "Quadrics").
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/math.h"
#include "scene_cache/format.h"

namespace fr::cache {

/// sin and cos of an angle in degrees, exact at multiples of 90 and periodic bit by bit.
void sinCosDegrees(double degrees, double& s, double& c);

/// A quadric's numbers in the order of its RIB request, angles in degrees.
///   sphere radius zmin zmax thetamax | cone height radius thetamax | cylinder radius zmin zmax thetamax
///   hyperboloid p1(3) p2(3) thetamax | paraboloid rmax zmin zmax thetamax | disk height radius thetamax
///   torus majorradius minorradius phimin phimax thetamax
struct Quadric {
  PrimitiveType type;
  double p[8];
};
/// How many numbers a quadric has (the rest of p is 0); 0 when `type` is not a quadric.
int quadricParameterCount(PrimitiveType type);

/// The profile at one v. The surface is (a c - b s, a s + b c, z) with (s, c) of the angle u * thetamax.
struct ProfilePoint {
  double a, b, z;     // position at angle 0
  double da, db, dz;  // its derivative in v
};
ProfilePoint quadricProfile(const Quadric& q, double v);
/// thetamax in degrees.
double quadricSweep(const Quadric& q);

/// Box around the whole quadric in object space; conservative (sweeps are taken as full turns of the larger
/// radius unless they are shorter than 90 degrees' multiples allow).
Box3d quadricBound(const Quadric& q);

}  // namespace fr::cache
