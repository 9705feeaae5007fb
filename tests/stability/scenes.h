// A picture with something of everything, for tests that change nothing that should show.
#pragma once

#include <map>
#include <string>

namespace fr::test {

struct Placement {
  double x = 0, y = 0, z = 0;  // of world and camera
  double scale = 1;
};

/// Quadrics, patches, NURBS, polygons, meshlets, subdivision, curves, points, blobs, a solid, instances; a
/// displacement, ray-traced shadows, a mirror, transparency.
std::string everything(const Placement& placement, const std::string& options = {});
const std::map<std::string, std::string>& everythingsShaders();

}  // namespace fr::test
