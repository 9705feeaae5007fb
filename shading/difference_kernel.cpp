// Differences between neighbours.
#include "shading/neighbours.h"

namespace fr::FR_ISA {

void addDifferenceKernel(KernelTable& t);

namespace {
/// Both ends of a vector of differences along one parameter.
struct Ends {
  Neighbours lo, hi;
  V scale;
};
FR_INLINE Ends endsOf(const Difference& d, uint32_t i) {
  VI lo = loadIndices(d.lo + i), hi = loadIndices(d.hi + i);
  V scale = loadLoose(d.scale + i);
  if (d.cell) scale *= loadLoose(d.cell + i);
  if (d.mask) {
    const auto* const mask = reinterpret_cast<const float*>(d.mask);
    const VI self = laneNumbers(i);
    const VI loActive = bits(gather(mask, lo)), hiActive = bits(gather(mask, hi)),
             one = ~(loActive & hiActive);
    scale = select(one & (lo != self) & (hi != self), scale * 2.0f, scale);
    lo = loActive ? lo : self;
    hi = hiActive ? hi : self;
  }
  return {neighbours(lo, d.lo, i), neighbours(hi, d.hi, i), scale};
}

void difference(const Difference& d) {
  for (uint32_t i = 0; i < d.lanes; i += kLanes) {
    const Ends e = endsOf(d, i);
    if (d.components == 3) {
      const V3 change = scale(sub(fetch3(d.x, d.component, e.hi), fetch3(d.x, d.component, e.lo)), e.scale);
      *reinterpret_cast<V*>(d.out + i) = change.x;
      *reinterpret_cast<V*>(d.out + d.outComponent + i) = change.y;
      *reinterpret_cast<V*>(d.out + 2 * size_t(d.outComponent) + i) = change.z;
      continue;
    }
    for (uint32_t c = 0; c < d.components; ++c) {
      const float* const x = d.x + size_t(c) * d.component;
      *reinterpret_cast<V*>(d.out + size_t(c) * d.outComponent + i) =
          (fetch(x, e.hi) - fetch(x, e.lo)) * e.scale;
    }
  }
}

void crossOfDifferences(const Difference& u, const Difference& v, float factor) {
  for (uint32_t i = 0; i < u.lanes; i += kLanes) {
    const Ends a = endsOf(u, i), b = endsOf(v, i);
    const V3 du = scale(sub(fetch3(u.x, u.component, a.hi), fetch3(u.x, u.component, a.lo)), a.scale);
    const V3 dv = scale(sub(fetch3(v.x, v.component, b.hi), fetch3(v.x, v.component, b.lo)), b.scale);
    V3 normal = cross(du, dv);
    if (factor != 1.0f) normal = scale(normal, splat(factor));
    *reinterpret_cast<V*>(u.out + i) = normal.x;
    *reinterpret_cast<V*>(u.out + u.outComponent + i) = normal.y;
    *reinterpret_cast<V*>(u.out + 2 * size_t(u.outComponent) + i) = normal.z;
  }
}
}  // namespace

void addDifferenceKernel(KernelTable& t) {
  t.difference = &difference;
  t.crossOfDifferences = &crossOfDifferences;
}

}  // namespace fr::FR_ISA
