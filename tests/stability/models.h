// Closed models, one of every kind of surface that closes: what every test of this folder shoots at.
#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include "base/math.h"

namespace fr::test {

struct Model {
  std::string name, rib;
  DVec3 inside;            // a point inside, in world space
  double distance = 4;     // of the camera, which looks along z, from the world's origin
  double shadingRate = 4;  // at 512 pixels
  bool convex = false;     // the true surface is
  double bumps = 0;        // displaced along its normals by waves of this height
  bool oneLevel = false;   // traced the same at any stride
};
std::ostream& operator<<(std::ostream& out, const Model& m);

/// Spheres, sweeps, patches, NURBS, subdivision meshes, polygons, dense polygon meshes, implicit surfaces.
const std::vector<Model>& closedModels();

/// Faces and vertices of a round, convex polyhedron with n rows of faces: "PointsPolygons ...".
std::string ballOfPolygons(int n);

}  // namespace fr::test
