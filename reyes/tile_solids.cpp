#include "reyes/tile_solids.h"

#include "reyes/tile_hider.h"

namespace fr::reyes {

void TileSolids::begin() {
  roots_.clear();
  crossings_.clear();
}

float* TileSolids::unlimited(size_t samples) {
  if (unlimited_.size() < samples) unlimited_.resize(samples, kInfinity);
  return unlimited_.data();
}

bool TileSolids::resolve(TileView& view) {
  SampleBuffer& samples = view.samples;
  first_.resize(samples.size(), kNothing);
  size_t lowest = samples.size(), highest = 0;
  for (size_t i = 0; i < crossings_.size(); ++i) {
    Fragment& f = crossings_[i];
    f.next = first_[f.sample];
    first_[f.sample] = uint32_t(i);
    lowest = std::min<size_t>(lowest, f.sample), highest = std::max<size_t>(highest, f.sample);
  }
  resolved_ += crossings_.size();
  bool opaque = false;
  for (size_t sample = lowest; sample <= highest && sample < samples.size(); ++sample) {
    if (first_[sample] == kNothing) continue;
    line_.clear();
    for (uint32_t i = first_[sample]; i != kNothing; i = crossings_[i].next) {
      const Fragment& f = crossings_[i];
      const uint32_t slot = f.hit >> kTriangleBits;
      line_.push_back({f.depth, view.grids[slot].solid, view.ranks[slot], i});
    }
    first_[sample] = kNothing;
    const auto surface = [&](const cache::SolidCrossing& c) {
      const Fragment& f = crossings_[c.item];
      const TileGrid& g = view.grids[f.hit >> kTriangleBits];
      if (!g.shows) return true;
      if (f.depth > samples.depth[sample]) return false;
      if (f.depth < samples.start(sample)) return true;
      if (!g.traits.opaque) {
        view.fragments.push_back({f.sample, f.hit, f.depth, 0});
        return true;
      }
      if (f.depth == samples.depth[sample] && samples.hit[sample] != kNothing) {
        // As among ordinary surfaces: the lower rank wins, whichever came first.
        const uint32_t other = samples.hit[sample];
        const uint64_t mine = c.rank, theirs = view.ranks[other >> kTriangleBits];
        if (mine > theirs || (mine == theirs && (f.hit & kTriangleMask) > (other & kTriangleMask)))
          return false;
      }
      samples.depth[sample] = f.depth, samples.hit[sample] = f.hit;
      opaque = true;
      return false;
    };
    cache::forEachSurface(std::span(line_), state_, cache::kSamePlace, 0.0f, surface);
  }
  crossings_.clear();
  return opaque;
}

}  // namespace fr::reyes
