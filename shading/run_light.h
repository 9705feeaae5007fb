// Lights whose shader can be written out in the light loops of a surface's machine code.
#pragma once

namespace fr {

class Executable;

/// One light of a batch, as far as machine code depends on it. Parameter values are no part of it: they are
/// read from the light's frame.
struct RunLight {
  const Executable* exe = nullptr;
  bool plain = false;  // asks no rays, has no geometry, and plainLight(exe)
  bool operator==(const RunLight&) const = default;
};

/// What a plain light gives a point follows from its parameters, Ps and N alone: no other predefined
/// variables, no loops, and nothing that it remembers from one point or batch to the next.
bool plainLight(const Executable& light);

}  // namespace fr
