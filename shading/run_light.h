// Lights in the light loops of a surface's machine code: written out, or run before it.
#pragma once

#include <cstdint>

namespace fr {

class Executable;

/// One light of a batch, as far as machine code depends on it. Parameter values are no part of it: they are
/// read from the light's frame.
struct RunLight {
  const Executable* exe = nullptr;
  bool plain = false;     // asks no rays, has no geometry, and plainLight(exe)
  bool shadowed = false;  // the renderer asks rays for the points that a loop's body runs for
  bool operator==(const RunLight&) const = default;
};

/// What a light that is not plain has given its points, in columns behind those of its program.
namespace light_column {
inline constexpr uint32_t kL = 0, kCl = 3, kOl = 6, kLit = 9, kCount = 10;
}

/// A light that is not plain may run before the code of which the loop is a part: it asks nothing of the
/// shader that it lights but where its points are.
bool runsAhead(const Executable& light);

/// What a plain light gives a point follows from its parameters, Ps and N alone: no other predefined
/// variables, no loops, and nothing that it remembers from one point or batch to the next.
bool plainLight(const Executable& light);

}  // namespace fr
