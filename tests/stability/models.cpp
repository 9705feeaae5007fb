#include "tests/stability/models.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>
#include <ostream>

namespace fr::test {

std::ostream& operator<<(std::ostream& out, const Model& m) { return out << m.name; }

std::string ballOfPolygons(int n) {
  std::string counts, vertices, points;
  const int around = 2 * n;
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < around; ++i) {
      const int next = (i + 1) % around;
      const auto at = [&](int row, int column) {
        return row == 0 ? 0 : row == n ? 1 : 2 + (row - 1) * around + column;
      };
      if (j == 0) {
        counts += "3 ", vertices += fmt::format("{} {} {} ", at(0, 0), at(1, next), at(1, i));
      } else if (j == n - 1) {
        counts += "3 ", vertices += fmt::format("{} {} {} ", at(j, i), at(j, next), at(n, 0));
      } else {
        // Triangles: the four corners of a face would not lie in a plane after rounding.
        counts += "3 3 ";
        vertices += fmt::format("{} {} {}  {} {} {} ", at(j, i), at(j, next), at(j + 1, next), at(j, i),
                                at(j + 1, next), at(j + 1, i));
      }
    }
  points = "0 0 1 0 0 -1 ";
  for (int j = 1; j < n; ++j)
    for (int i = 0; i < around; ++i) {
      const double a = std::numbers::pi * j / n, b = std::numbers::pi * 2 * i / around;
      points += fmt::format("{:.9g} {:.9g} {:.9g} ", std::sin(a) * std::cos(b), std::sin(a) * std::sin(b),
                            std::cos(a));
    }
  return "PointsPolygons [" + counts + "] [" + vertices + "] \"P\" [" + points + "]";
}

namespace {

/// A cube of quadrilaterals.
constexpr const char* kCubeMesh = "[4 4 4 4 4 4] [0 1 3 2  4 6 7 5  0 4 5 1  2 3 7 6  0 2 6 4  1 5 7 3]";
constexpr const char* kCubePoints = "\"P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1]";

std::string cube(const std::string& more) {
  return fmt::format("SubdivisionMesh \"catmull-clark\" {} {} {}", kCubeMesh, more, kCubePoints);
}

/// A sphere exactly, as a product of two rational quadratics: a half circle swept by a whole one.
std::string nurbsSphere() {
  const double h = std::sqrt(0.5);
  const double circle[9][3] = {{1, 0, 1},   {h, h, h},  {0, 1, 1},  {-h, h, h}, {-1, 0, 1},
                               {-h, -h, h}, {0, -1, 1}, {h, -h, h}, {1, 0, 1}};
  const double half[5][3] = {{0, -1, 1}, {h, -h, h}, {1, 0, 1}, {h, h, h}, {0, 1, 1}};
  std::string p;
  for (const auto& m : half)
    for (const auto& c : circle)
      p += fmt::format("{:.9g} {:.9g} {:.9g} {:.9g} ", m[0] * c[0], m[0] * c[1], m[1] * c[2], m[2] * c[2]);
  return "NuPatch 9 3 [0 0 0 1 1 2 2 3 3 4 4 4] 0 4 5 3 [0 0 0 1 1 2 2 2] 0 2 \"Pw\" [" + p + "]";
}

/// Twelve edges of a unit cube as a convex pillow of six bicubic patches: each face bulges.
std::string bicubicPillow() {
  std::string all;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = -1; side <= 1; side += 2) {
      std::string p;
      for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i) {
          const double u = (i / 1.5 - 1) * side, v = j / 1.5 - 1;
          const bool inner = i % 3 != 0 && j % 3 != 0;
          double c[3];
          c[axis] = side * (inner ? 1.6 : 1.0), c[(axis + 1) % 3] = u, c[(axis + 2) % 3] = v;
          p += fmt::format("{:.9g} {:.9g} {:.9g} ", c[0], c[1], c[2]);
        }
      all += "Patch \"bicubic\" \"P\" [" + p + "] ";
    }
  return "Basis \"bezier\" 3 \"bezier\" 3 " + all;
}

std::string bilinearCube() {
  std::string all;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = -1; side <= 1; side += 2) {
      std::string p;
      for (int j = -1; j <= 1; j += 2)
        for (int i = -1; i <= 1; i += 2) {
          int c[3];
          c[axis] = side, c[(axis + 1) % 3] = i * side, c[(axis + 2) % 3] = j;
          p += fmt::format("{} {} {} ", c[0], c[1], c[2]);
        }
      all += "Patch \"bilinear\" \"P\" [" + p + "] ";
    }
  return all;
}

}  // namespace

const std::vector<Model>& closedModels() {
  static const std::vector<Model> models = {
      {"Sphere", "Rotate 40 1 1 0 Sphere 1 -1 1 360", DVec3(0.1, 0.05, 0), 1.3, 2, true},
      {"CoarseSphere", "Rotate 40 1 1 0 Sphere 1 -1 1 360", DVec3(0.1, 0.05, 0), 6, 60, true},
      {"StretchedSphere", "Rotate 20 0 1 1 Scale 0.2 0.4 3 Sphere 1 -1 1 360", DVec3(0), 3.3, 1, true},
      {"Torus", "Rotate 70 1 0 0 Torus 1 0.35 0 360 360", DVec3(1, 0, 0), 1.6, 2},
      {"Cylinder", "Rotate 60 1 1 0 Cylinder 0.7 -0.8 0.9 360 Disk 0.9 0.7 360 Disk -0.8 0.7 -360",
       DVec3(0.1, 0, 0), 2, 2, true},
      {"Cone", "Rotate 100 1 0 0 Cone 1.5 0.7 360 Disk 0 0.7 360", DVec3(0, -0.5, 0), 2.2, 1, true},
      {"Paraboloid", "Rotate 130 1 0.3 0 Paraboloid 0.8 0 1.1 360 Disk 1.1 0.8 360",
       DVec3(0.13, -0.44, -0.39), 2.2, 1, true},
      {"Hyperboloid",
       "Rotate 80 1 0.2 0 Hyperboloid 0.7 0 -0.8 0 0.7 0.8 360 Disk -0.8 0.7 -360 Rotate 90 0 0 1 Disk 0.8 "
       "0.7 "
       "360",
       DVec3(0.05, 0, 0), 2.4, 1},
      {"Bicubic", "Rotate 30 1 1 0 " + bicubicPillow(), DVec3(0.1, 0, 0), 2.6, 2},
      {"Bilinear", "Rotate 30 1 1 0 " + bilinearCube(), DVec3(0.1, 0, 0), 2.6, 2, true},
      {"Nurbs", "Rotate 30 1 1 0 " + nurbsSphere(), DVec3(0.1, 0, 0), 1.7, 2, true},
      {"Polygons", fmt::format("Rotate 30 1 1 0 PointsPolygons {} {}", kCubeMesh, kCubePoints),
       DVec3(0.1, 0, 0), 2.6, 2, true},
      {"DensePolygons", "Rotate 30 1 1 0 " + ballOfPolygons(64), DVec3(0.1, 0, 0), 4, 4, true},
      {"CatmullClark", "Rotate 30 1 1 0 " + cube("[\"interpolateboundary\"] [0 0] [] []"), DVec3(0.1, 0, 0),
       1.7, 2, true},
      {"Creased",
       "Rotate 30 1 1 0 " +
           cube("[\"crease\" \"crease\" \"corner\"] [5 1 3 1 1 1] [0 1 3 2 0 4 5 7 6] [3.5 2 4]"),
       DVec3(0.1, 0, 0), 1.9, 1},
      // A tall box: long edges opposite short ones.
      {"Stretched", "Scale 0.2 0.3 2 " + cube("[\"interpolateboundary\"] [0 0] [] []"), DVec3(0, 0, 0), 2.6,
       0.5, true},
      {"Blobby",
       "Rotate 30 1 1 0 Blobby 2 [1001 0 1001 16 0 2 0 1] [1.2 0 0 0 0 1.2 0 0 0 0 1.2 0 -0.3 0 0 1  1 0 0 0 "
       "0 1 0 0 0 0 1 0 0.4 0.2 0 1] [\"\"]",
       DVec3(0, 0, 0), 1.9, 16, false, 0, true},
      {"Displaced", "Rotate 30 1 1 0 Sphere 1 -1 1 360", DVec3(0.1, 0, 0), 1.9, 1, false, 0.1},
  };
  return models;
}

}  // namespace fr::test
