// Differences between neighbours.
#include "shading/neighbours.h"

namespace fr::FR_ISA {

void addDifferenceKernel(KernelTable& t);

namespace {
void difference(const Difference& d) {
  for (uint32_t i = 0; i < d.lanes; i += kLanes) {
    VI lo = loadIndices(d.lo + i), hi = loadIndices(d.hi + i);
    V scale = loadLoose(d.scale + i);
    if (d.cell) scale *= loadLoose(d.cell + i);
    if (d.mask) {
      const auto* const mask = reinterpret_cast<const float*>(d.mask);
      const VI loActive = bits(gather(mask, lo)), hiActive = bits(gather(mask, hi));
      const VI self = laneNumbers(i), one = ~(loActive & hiActive);
      scale = select(one & (lo != self) & (hi != self), scale * 2.0f, scale);
      lo = loActive ? lo : self;
      hi = hiActive ? hi : self;
    }
    *reinterpret_cast<V*>(d.out + i) = (fetch(d.x, neighbours(hi)) - fetch(d.x, neighbours(lo))) * scale;
  }
}
}  // namespace

void addDifferenceKernel(KernelTable& t) { t.difference = &difference; }

}  // namespace fr::FR_ISA
