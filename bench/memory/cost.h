// What a scene costs in memory, by primitive type: everything that both processes hold of it, counted once.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace fr::bench {

struct MemoryCase {
  const char* name;
  std::string rib;
  bool irregular;  // a face is a triangle of a mesh, not a micropolygon
  double goal;     // bytes a face, rays at multiplier 1; 0: none
  double limit;    // what it costs today, and a little: the test fails beyond
};
/// A million faces or a few, each of one primitive type.
std::vector<MemoryCase> memoryCases();

/// Bytes a face.
struct MemoryCost {
  uint64_t faces = 0;
  double facesAGrid = 0;
  double scene = 0;  // sources and tables of the skeleton
  double nodes = 0;
  double vertices = 0;  // grids: records, positions, normals, indices
  double tree = 0;      // Embree's
  double records = 0;   // ours beside it
  double all() const { return scene + nodes + vertices + tree + records; }
};
/// Dices all and builds what rays see at this patch multiplier. Ends the program when it cannot.
MemoryCost memoryCost(const std::string& rib, float patchMultiplier);
/// The same surfaces at full rate as an ordinary mesh of Embree triangles with buffers of its own: vertices
/// shared within a grid, 32-bit indices. Bytes a face (a micropolygon is two triangles).
double embreeTriangles(const std::string& rib, bool compact);

}  // namespace fr::bench
