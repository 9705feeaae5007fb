// Blobby implicit surfaces (RISpec 3.2, "Blobby"; opcodes as in its table): the field, its gradient and its
// range over a box, and polygons on the surface.
#pragma once

#include <string>
#include <vector>

#include "base/error.h"
#include "base/math.h"
#include "ri/primitives.h"

namespace fr::cache {

/// The surface is where the field has this value: (1 - 1/4)^3.
inline constexpr double kBlobThreshold = 0.421875;

struct BlobRange {
  double low = 0, high = 0;
};
struct BlobSample {
  double value = 0;
  DVec3 gradient{0};
};

/// A checked program of opcodes. Const and thread-safe once parsed.
class BlobField {
 public:
  /// Fails when an operand, a float or a string is missing or refers to a later result.
  /// `warnings`: leaves that mean nothing (a matrix without inverse, a radius of 0) and what is not
  /// supported.
  static Result<BlobField> parse(const ri::Blobby& blobby, std::vector<std::string>* warnings);

  BlobSample at(const DVec3& p) const;
  /// Everything that the field can be inside the box, and perhaps more.
  BlobRange over(const Box3d& box) const;
  /// The same field inside `box`, without the leaves that are 0 there. at() gives the same bits.
  BlobField inside(const Box3d& box) const;
  /// Leaves (numbered as they come) that are not 0 at `p`, with their weights.
  void weights(const DVec3& p, std::vector<std::pair<uint32_t, double>>& out) const;

  /// Outside of this box the field is constant.
  Box3d support() const;
  /// Half the smallest diameter of a leaf.
  double smallestRadius() const;
  uint32_t leafCount() const { return leaves_; }

 private:
  enum class Op : uint8_t {
    kAdd,
    kMultiply,
    kMaximum,
    kMinimum,
    kSubtract,
    kDivide,
    kNegate,
    kIdentity,
    kConstant,
    kEllipsoid,
    kSegment
  };
  struct Instruction {
    Op op;
    uint32_t first = 0, count = 0;  // operands
    uint32_t leaf = 0;              // number of the leaf
    uint32_t shape = 0;             // of shapes_
    double constant = 0;
  };
  struct Shape {
    DMat4 toUnit{1};
    DVec3 a{0}, b{0};
    double radius = 1;
    Box3d bound;
    double size = 0;
  };
  static BlobRange shapeRange(const Instruction& i, const Shape& s, const Box3d& box);
  static BlobSample shapeAt(const Instruction& i, const Shape& s, const DVec3& p);

  std::vector<Instruction> code_;
  std::vector<uint32_t> operands_;
  std::vector<Shape> shapes_;
  uint32_t leaves_ = 0;
};

struct BlobMesh {
  std::vector<DVec3> points;
  std::vector<DVec3> normals;       // unit, outwards
  std::vector<uint32_t> triangles;  // three a triangle, (b - a) x (c - a) outwards
};
/// Closed polygons on the surface: one vertex in each cell of a grid of cells `cell` wide that the surface
/// crosses (surface nets: Gibson, "Constrained Elastic Surface Nets", 1998), brought onto the surface by
/// Newton's method, with normals from the gradient. Only cells near the surface are visited. Empty when it
/// would take more than `mostCells` vertices.
BlobMesh polygonise(const BlobField& field, double cell, size_t mostCells);

}  // namespace fr::cache
