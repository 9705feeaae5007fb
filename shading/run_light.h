// Lights in the light loops of a surface's machine code: written out, or run before it.
#pragma once

#include <cstdint>

#include "shading/ir.h"

namespace fr {

class Executable;

/// One light of a batch, as far as machine code depends on it. Parameter values are no part of it: they are
/// read from the light's frame.
struct RunLight {
  const Executable* exe = nullptr;
  bool plain = false;     // asks no rays, and plainLight(exe)
  bool shadowed = false;  // the renderer asks rays for the points that a loop's body runs for
  bool emitter = false;   // plain, but P and N are points of its geometry
  bool operator==(const RunLight&) const = default;
};

/// Columns behind those of a light's program.
namespace light_column {
/// What a light that is not plain has given its points.
inline constexpr uint32_t kL = 0, kCl = 3, kOl = 6, kLit = 9, kResults = 10;
/// Of an emitter: where it shines from, its normal there, and what dims it.
inline constexpr uint32_t kFrom = 0, kNormal = 3, kDim = 6, kSamples = 7;
inline uint32_t count(const RunLight& l) { return !l.plain ? kResults : l.emitter ? kSamples : 0; }
}  // namespace light_column

/// A difference between neighbours that is known before a run: du_f and its kin of a symbol.
struct RunDifference {
  Op op;
  uint32_t symbol, column;  // the first of as many as the result has components, behind all others
  bool operator==(const RunDifference&) const = default;
};

/// A light that is not plain may run before the code of which the loop is a part: it asks nothing of the
/// shader that it lights but where its points are, and draws no random numbers, which depend on how often it
/// has run for a point.
bool runsAhead(const Executable& light);

/// What a plain light gives a point follows from its parameters, Ps and N alone: no other predefined
/// variables, no loops, and nothing that it remembers from one point or batch to the next.
bool plainLight(const Executable& light);

}  // namespace fr
