// Rays from registers: seeds, random numbers, footprints, origins and directions, a vector of points at a
// time.
#include "base/sobol_pair.h"
#include "shading/neighbours.h"
#include "shading/noise.h"

namespace fr::FR_ISA {

void addRayKernels(KernelTable& t);

namespace {

typedef uint64_t VL __attribute__((vector_size(kLanes * 4)));
constexpr uint32_t kLongs = kLanes / 2;
typedef uint32_t Half __attribute__((vector_size(kLongs * 4)));

FR_INLINE VL splatLong(uint64_t x) { return x - VL{}; }
template <class T, class S>
FR_INLINE T loadAs(const S* at) {
  T v;
  std::memcpy(&v, at, sizeof v);
  return v;
}
template <class T, class S>
FR_INLINE void storeAs(S* at, T v) {
  std::memcpy(at, &v, sizeof v);
}

/// base/random.h's hashStep().
FR_INLINE VL hashStepOf(VL key, VL next) {
  VL x = key * 0x9e3779b97f4a7c15ull + next + 0x632be59bd9b4e019ull;
  x ^= x >> 33, x *= 0xff51afd7ed558ccdull;
  x ^= x >> 33, x *= 0xc4ceb9fe1a85ec53ull;
  return x ^ (x >> 33);
}

void hashSeeds(const SeedHash& s) {
  for (uint32_t i = 0; i < s.lanes; i += kLongs) {
    VL h = hashStepOf(s.base ? loadAs<VL>(s.base + i) : splatLong(s.one), splatLong(s.site));
    if (s.counter)
      h = hashStepOf(h, __builtin_convertvector(loadAs<Half>(s.counter + i), VL));
    else if (s.hasNext)
      h = hashStepOf(h, splatLong(s.next));
    storeAs(s.out + i, h);
    if (s.high) storeAs(s.high + i, __builtin_convertvector(h >> 32, Half));
  }
}

// base/sobol.h, dimensions 0 and 1: the same numbers (noiseHash() is mix32()).

FR_INLINE V unitFloat(VU x) { return toFloat((VI)(x >> 8)) * 0x1p-24f; }
FR_INLINE void sobolPair(uint32_t index, VU seed, V& x, V& y) {
  VU a, b;
  sobolOwenPair(
      splatUint(index), seed, [](VU n) __attribute__((always_inline)) { return noiseHash(n); }, a, b);
  x = unitFloat(a), y = unitFloat(b);
}
void sobolPairs(const SobolPairs& s) {
  for (uint32_t i = 0; i < s.lanes; i += kLanes) {
    V x, y;
    sobolPair(s.index, loadAs<VU>(s.seed + i), x, y);
    storeLoose(s.x + i, x), storeLoose(s.y + i, y);
  }
}

FR_INLINE VI isFinite(V3 a) { return a.x * 0.0f + a.y * 0.0f + a.z * 0.0f == 0.0f; }
FR_INLINE VI isFinite(V a) { return a * 0.0f == 0.0f; }
FR_INLINE V3 loadLoose3(const float* at, uint32_t component) {
  return {loadLoose(at), loadLoose(at + component), loadLoose(at + 2 * size_t(component))};
}

/// A small step into the surface from the border of a grid along one parameter, or from a vertex of a
/// meshlet.
FR_INLINE V3 stepFrom(const Footprints& f, V3 here, uint32_t i, int d) {
  const VI lo = loadIndices(f.lo[d] + i), hi = loadIndices(f.hi[d] + i);
  const VI self = laneNumbers(i);
  const VI atLow = lo == self, edge = atLow ^ (hi == self);
  const V3 none{V{}, V{}, V{}};
  if (!anyLane(edge)) return none;
  const VI at = atLow ? hi : lo;
  const V3 side = sub({gather(f.P.data, at), gather(f.P.data + f.P.component, at),
                       gather(f.P.data + 2 * size_t(f.P.component), at)},
                      here);
  const V size = rawSqrt(dot(side, side));
  // Of the cell, but not lost in rounding far from the origin.
  const V far = vmax(vabs(here.x), vmax(vabs(here.y), vabs(here.z)));
  const V part = vmin(splat(0.25f), vmax(1e-6f * far / size, splat(0x1p-10f)));
  return select(edge & (size > 0.0f) & isFinite(side), scale(side, part), none);
}
FR_INLINE V squaredSide(const Footprints& f, uint32_t i, int d) {
  const VI lo = loadIndices(f.lo[d] + i), hi = loadIndices(f.hi[d] + i);
  const V3 side = sub(fetch3(f.P.data, f.P.component, neighbours(hi, f.hi[d], i)),
                      fetch3(f.P.data, f.P.component, neighbours(lo, f.lo[d], i)));
  const V3 cell = scale(side, loadLoose(f.scale[d] + i) * loadLoose(f.cell[d] + i));
  return dot(cell, cell);
}
void footprints(const Footprints& f) {
  const bool sides = f.P.data && f.lo[0];
  for (uint32_t i = 0; i < f.lanes; i += kLanes) {
    V radius{}, spread{};
    V3 inward{};
    if (f.givenSpread.data) spread = load(f.givenSpread, i);
    if (f.givenRadius.data)
      radius = load(f.givenRadius, i);
    else if (sides)
      // Half of the cell's larger side: the surroundings that this point stands for.
      radius = 0.5f * rawSqrt(vmax(squaredSide(f, i, 1), squaredSide(f, i, 0)));
    if (sides) {
      const V3 here = load3(f.P, i);
      for (int d = 0; d < 2; ++d) inward = add(inward, stepFrom(f, here, i, d));
    }
    storeLoose(f.radius + i, select(isFinite(radius), radius, V{}));
    storeLoose(f.spread + i, select(isFinite(spread), spread, V{}));
    storeLoose(f.inward + i, inward.x);
    storeLoose(f.inward + f.lanes + i, inward.y);
    storeLoose(f.inward + 2 * size_t(f.lanes) + i, inward.z);
  }
}

/// Two directions perpendicular to the unit vector n and each other (Duff et al. 2017, JCGT 6(1)).
FR_INLINE void basis(V3 n, V3& x, V3& y) {
  const V sign = copySign(splat(1.0f), n.z);
  const V a = -1.0f / (sign + n.z), b = n.x * n.y * a;
  x = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
  y = {b, sign + n.y * n.y * a, -n.y};
}
/// What directions within a cone need to know of it, and the spread of its samples: they share its solid
/// angle.
struct Cone {
  V size, share;
  VI wide;
};
FR_INLINE Cone coneOf(V cone, V samples, bool cosine) {
  return {cosine ? vsin(vmin(cone, splat(1.57079637f))) : 1.0f - vcos(vmin(cone, splat(3.14159274f))),
          rawSqrt(2.0f * (1.0f - vcos(cone)) / samples), cone > 0.0f};
}
/// A unit direction within the cone about the unit vector d; x and y as in basis().
FR_INLINE V3 sampleCone(V3 d, V3 x, V3 y, const Cone& cone, bool cosine, V u, V v) {
  V z, rho;
  if (cosine) {
    rho = cone.size * rawSqrt(u);
    z = vsqrt(1.0f - rho * rho);
  } else {
    z = 1.0f - u * cone.size;
    rho = vsqrt(1.0f - z * z);
  }
  V s, c;
  sinCos(6.2831853f * v, s, c);
  return add(add(scale(x, rho * c), scale(y, rho * s)), scale(d, z));
}
/// The square of how much directions turn over the footprint, along one parameter.
FR_INLINE V squaredTurn(const RayMaking& r, uint32_t i, int d) {
  const VI lo = loadIndices(r.lo[d] + i), hi = loadIndices(r.hi[d] + i);
  const V3 turn = sub(fetch3(r.unit.data, r.unit.component, neighbours(hi, r.hi[d], i)),
                      fetch3(r.unit.data, r.unit.component, neighbours(lo, r.lo[d], i)));
  const V size = loadLoose(r.scale[d] + i) * loadLoose(r.cell[d] + i);
  const V squared = dot(turn, turn) * size * size * 0.25f;
  VI known = isFinite(squared);
  if (r.neighbourMask) {
    const auto* const mask = reinterpret_cast<const float*>(r.neighbourMask);
    known &= bits(gather(mask, lo)) & bits(gather(mask, hi));
  }
  return select(known, squared, V{});
}

FR_INLINE void storeLoose3(float* const to[3], size_t at, V3 v) {
  storeLoose(to[0] + at, v.x), storeLoose(to[1] + at, v.y), storeLoose(to[2] + at, v.z);
}

void makeRays(const RayMaking& r) {
  const bool cones = r.cone.data != nullptr;
  const bool sameCone = cones && !r.cone.varying() && !r.samples.varying();
  Cone cone{};
  if (sameCone) cone = coneOf(load(r.cone, 0), load(r.samples, 0), r.cosine);
  for (uint32_t i = 0; i < r.lanes; i += kLanes) {
    const V3 unit = load3(r.unit, i), zero{};
    V3 from = load3(r.from, i), to = load3(r.direction, i);
    if (r.toPoint) to = sub(to, from);
    if (r.shift) {
      const V3 shift = loadLoose3(r.shift + i, r.shiftComponent);
      from = add(from, shift);
      if (r.toPoint) to = sub(to, shift);
    }
    // What is not finite hits nothing.
    const VI finite = isFinite(from) & isFinite(to);
    from = select(finite, from, zero), to = select(finite, to, zero);
    const V radius = loadLoose(r.radius + i);
    VI on{};
    if (r.P.data) {
      const V3 P = load3(r.P, i);
      const auto near = [&](V3 p) __attribute__((always_inline)) {
        const V3 off = sub(p, P);
        const V limit = 2.0f * radius + 1e-6f * (1.0f + rawSqrt(dot(p, p)));
        return dot(off, off) <= limit * limit;
      };
      on = near(from);
      if (r.segment) {
        // The same question from the other end: then the tracer knows which surface the ray must not hit by
        // mistake.
        const V3 end = add(from, to);
        const VI turned = ~on & near(end);
        from = select(turned, end, from);
        to = select(turned, V3{-to.x, -to.y, -to.z}, to);
        on |= turned;
      }
      if (r.inward) {
        // Where surfaces meet in an edge, a point of the one lies exactly on the other: its rays must start
        // on the near side of that, or half of them would leave through the corner of a closed room.
        const V3 inward = select(on, loadLoose3(r.inward + i, r.inwardComponent), zero);
        from = add(from, inward);
        if (r.segment) to = sub(to, inward);
      }
    }
    if (!r.segment) to = unit;
    V spread = loadLoose(r.spread + i);
    if (r.lo[0]) {
      const V turn = rawSqrt(vmax(squaredTurn(r, i, 1), squaredTurn(r, i, 0)));
      const VI inGrid = loadLoose(r.scale[0] + i) != 0.0f;
      spread = select(inGrid, vmin(splat(1.0f), vmax(turn, spread)), spread);
    }
    storeLoose3(r.origin, i, from);
    if (cones) {
      if (!sameCone) cone = coneOf(load(r.cone, i), load(r.samples, i), r.cosine);
      spread = select(cone.wide, vmin(splat(1.0f), vmax(cone.share, spread)), spread);
      V3 axis = to, x, y;
      V size = splat(1.0f);
      if (r.segment) size = length(to), axis = normalize(to);
      basis(axis, x, y);
      const VU seed = loadAs<VU>(r.seed + i);
      for (uint32_t k = 0; k < r.many; ++k) {
        V u, v;
        sobolPair(r.sample + k, seed, u, v);
        const V3 chosen = scale(sampleCone(axis, x, y, cone, r.cosine, u, v), size);
        storeLoose3(r.to, k * r.next + i, select(cone.wide, chosen, to));
        if (!r.pair[0]) continue;
        storeLoose(r.pair[0] + k * r.next + i, select(cone.wide, u, splat(0.5f)));
        storeLoose(r.pair[1] + k * r.next + i, select(cone.wide, v, splat(0.5f)));
      }
    } else {
      for (uint32_t k = 0; k < r.many; ++k) {
        storeLoose3(r.to, k * r.next + i, to);
        for (int d = 0; d < 2 && r.pair[0]; ++d) storeLoose(r.pair[d] + k * r.next + i, splat(0.5f));
      }
    }
    storeLoose(r.rayRadius + i, radius);
    storeLoose(r.raySpread + i, spread);
    storeAs(r.onSurface + i, on);
  }
}

}  // namespace

void addRayKernels(KernelTable& t) {
  t.hashSeeds = &hashSeeds;
  t.sobolPairs = &sobolPairs;
  t.footprints = &footprints;
  t.makeRays = &makeRays;
}

}  // namespace fr::FR_ISA
