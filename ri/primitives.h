// The geometric primitives of the RI as plain data, and how many values their variables must have.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "base/error.h"
#include "ri/param_list.h"

namespace fr::ri {

/// Order of bounds everywhere in the RI: xmin xmax ymin ymax zmin zmax.
using Bound = std::array<double, 6>;

struct Polygon {
  ParamList params;
};
struct GeneralPolygon {
  std::vector<int> nverts;
  ParamList params;
};
struct PointsPolygons {
  std::vector<int> nverts, verts;
  ParamList params;
};
struct PointsGeneralPolygons {
  std::vector<int> nloops, nverts, verts;
  ParamList params;
};
struct Patch {
  bool bicubic = false;
  ParamList params;
};
struct PatchMesh {
  bool bicubic = false;
  int nu = 0;
  bool uPeriodic = false;
  int nv = 0;
  bool vPeriodic = false;
  /// Patches that share nothing, side by side in u, in a mesh that no request has made: each has values of
  /// its own (4 x 4 or 2 x 2, varying ones 2 x 2) and parameters from 0 to 1.
  bool separate = false;
  ParamList params;
};
struct NuPatch {
  int nu = 0, uOrder = 0;
  std::vector<float> uKnot;
  float uMin = 0, uMax = 0;
  int nv = 0, vOrder = 0;
  std::vector<float> vKnot;
  float vMin = 0, vMax = 0;
  ParamList params;
};
/// nargs holds two counts per tag (ints, floats), or three (and strings) for a hierarchical mesh.
struct SubdivisionMesh {
  std::string scheme;
  std::vector<int> nverts, verts;
  std::vector<std::string> tags;
  std::vector<int> nargs, intArgs;
  std::vector<float> floatArgs;
  std::vector<std::string> stringArgs;
  bool hierarchical = false;
  ParamList params;
};
struct Sphere {
  double radius = 1, zmin = -1, zmax = 1, thetaMax = 360;
  ParamList params;
};
struct Cone {
  double height = 1, radius = 1, thetaMax = 360;
  ParamList params;
};
struct Cylinder {
  double radius = 1, zmin = -1, zmax = 1, thetaMax = 360;
  ParamList params;
};
struct Hyperboloid {
  std::array<double, 3> p1{}, p2{};
  double thetaMax = 360;
  ParamList params;
};
struct Paraboloid {
  double rmax = 1, zmin = 0, zmax = 1, thetaMax = 360;
  ParamList params;
};
struct Disk {
  double height = 0, radius = 1, thetaMax = 360;
  ParamList params;
};
struct Torus {
  double majorRadius = 1, minorRadius = 0.25, phiMin = 0, phiMax = 360, thetaMax = 360;
  ParamList params;
};
struct Points {
  ParamList params;
};
struct Curves {
  bool cubic = false;
  std::vector<int> nverts;
  bool periodic = false;
  ParamList params;
};
struct Blobby {
  int nleaf = 0;
  std::vector<int> code;
  std::vector<float> floats;
  std::vector<std::string> strings;
  ParamList params;
};
/// Geometry request: "teapot" and other renderer-specific shapes.
struct Geometry {
  std::string type;
  ParamList params;
};

using Primitive = std::variant<Polygon, GeneralPolygon, PointsPolygons, PointsGeneralPolygons, Patch,
                               PatchMesh, NuPatch, SubdivisionMesh, Sphere, Cone, Cylinder, Hyperboloid,
                               Paraboloid, Disk, Torus, Points, Curves, Blobby, Geometry>;

/// Name of the RIB request that made it.
const char* primitiveName(const Primitive& p);
const ParamList& paramsOf(const Primitive& p);
ParamList& paramsOf(Primitive& p);

/// Steps of the current Basis, which decide the shape of bicubic meshes and cubic curves.
struct BasisSteps {
  int u = 3, v = 3;
};

/// Values per storage class.
struct ValueCounts {
  uint64_t constant = 1, uniform = 1, varying = 1, vertex = 1, faceVarying = 1;
  uint64_t of(StorageClass c) const;
  bool operator==(const ValueCounts&) const = default;
};

/// How many values each class of variable of `p` must have (RISpec 3.2, section 5). For primitives whose
/// vertices are counted by their positions (Polygon, Points, indexed meshes with unused trailing vertices)
/// the count of P decides. Fails when the topology contradicts itself: kConsistency with the numbers.
/// Safe on any input; cost is one pass over the index arrays.
Result<ValueCounts> expectedCounts(const Primitive& p, BasisSteps steps);

/// Full check of a primitive before anything uses it: topology, indices, ranges of its scalar arguments,
/// presence of positions (kMissingData), the count of every variable (kConsistency, with the expected and the
/// actual number). Variables with a wrong count other than positions do not fail, so that a bad texture
/// coordinate does not lose the shape: they get the class whose count they have, or are dropped. `complaints`
/// says which.
struct PrimitiveCheck {
  ValueCounts counts;
  std::vector<Error> complaints;
};
Result<PrimitiveCheck> checkPrimitive(Primitive& p, BasisSteps steps);

}  // namespace fr::ri
