// Trim curves of NuPatch (RISpec 3.2, section 5.2.3): which parts of a surface are cut away.
//
// Loops are flattened once, when the scene is read, to chords that are closer to them than a 60,000th of the
// patch, and sorted into bands of v. A point is inside when a line from it crosses an odd number of chords.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "base/error.h"
#include "scene_cache/primitive_source.h"

namespace fr::ri {
struct TrimCurve;
}

namespace fr::cache {

struct TrimLoops {
  std::vector<TrimEdge> edges;  // by band
  std::vector<uint32_t> bands;
  float low = 0, high = 1;
  std::vector<std::string> problems;  // what was wrong with loops that were left out or repaired
};
/// Flattens loops; `size` is the larger side of the patch's parameter range. The arrays have passed
/// ri::checkTrimCurve.
TrimLoops flattenTrimCurves(const ri::TrimCurve& curves, double size);

/// The test, over arrays of a skeleton or of TrimLoops. Thread-safe.
class TrimTest {
 public:
  TrimTest() = default;
  TrimTest(std::span<const TrimEdge> edges, std::span<const uint32_t> bands, float low, float high,
           bool outside)
      : edges_(edges), bands_(bands), low_(low), high_(high), outside_(outside) {}

  bool any() const { return bands_.size() > 1; }
  /// True when the point is cut away. u, v: of the NuPatch's own parameters.
  bool removed(double u, double v) const;
  /// For a rectangle of parameters: true or false where all of it is or is not cut away; nothing where it
  /// is mixed.
  std::optional<bool> removed(double u0, double u1, double v0, double v1) const;

 private:
  std::span<const TrimEdge> band(size_t i) const;
  size_t bandOf(double v) const;

  std::span<const TrimEdge> edges_;
  std::span<const uint32_t> bands_;
  float low_ = 0, high_ = 1;
  bool outside_ = false;
};

/// The test of one root patch in its own (u, v), 0..1.
struct PatchTrim {
  TrimTest test;
  double u0 = 0, uSize = 1, v0 = 0, vSize = 1;
  bool any() const { return test.any(); }
  bool removed(float u, float v) const {
    return test.removed(u0 + uSize * double(u), v0 + vSize * double(v));
  }
  std::optional<bool> removed(float ua, float ub, float va, float vb) const {
    return test.removed(u0 + uSize * double(ua), u0 + uSize * double(ub), v0 + vSize * double(va),
                        v0 + vSize * double(vb));
  }
};
/// Of root patch `root`; nothing cut where it is not a trimmed NuPatch.
PatchTrim patchTrim(const Skeleton& skeleton, NodeId root);

}  // namespace fr::cache
