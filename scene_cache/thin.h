// Points and Curves as meshlets: disks and ribbons that face the eye.
//
// Both renderers see the same polygons. A point is a polygon of the disk's area, as round as its size on the
// raster asks for. A curve is a ribbon, one or more cells wide, perpendicular to N where "N" is given and
// facing the eye otherwise. Nothing is widened: what is thinner than a pixel covers as many samples as it
// should, on average.
#pragma once

#include "scene_cache/cache_impl.h"
#include "scene_cache/patch_basis.h"

namespace fr::cache {

/// A primitive variable as rows of `width` floats.
struct VariableRows {
  std::span<const float> data;
  uint32_t width = 1;
  ParamClass storage = ParamClass::kConstant;
  uint64_t count() const { return data.size() / width; }
  bool empty() const { return data.size() < width; }
  const float* row(uint64_t i) const { return data.data() + std::min(i, count() - 1) * width; }
};

/// Radii of the polygon with k corners that has the area of a unit disk.
float equalAreaRadius(uint32_t sides);
/// Points of one cluster; (cell) -> point.
struct PointsView {
  const PointsSource* source = nullptr;
  PointCluster cluster{};
  std::span<const uint32_t> order;
  std::span<const float> widths;
  PositionKeys positions;
  DMat4 toCache{1};
  float scale = 1;  // of lengths
  bool perspective = true;
  Vec3 eye{0}, axis{0, 0, 1};
  float sign = 1;  // of dPdu x dPdv, so that the oriented normal faces the eye

  bool prepare(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time, const DiceEye& eye);
  uint32_t vertexCount() const { return cluster.count * cluster.sides; }
  uint32_t triangleCount() const { return cluster.count * (cluster.sides - 2); }
  uint32_t spriteOf(uint32_t cell) const { return std::min(cell / (cluster.sides - 2), cluster.count - 1); }
  /// Index of the point among those of the request.
  uint32_t pointOf(uint32_t cell) const { return order[spriteOf(cell)]; }
  Vec3 center(uint32_t sprite) const;
  /// Directions of the disk's u and v, as long as its radius.
  void frame(uint32_t sprite, const Vec3& center, Vec3& u, Vec3& v) const;
  void vertices(float* xyz) const;
  void triangles(uint8_t* indices) const;
};

/// Curves of one cluster.
struct CurvesView {
  const CurvesSource* source = nullptr;
  CurveCluster cluster{};
  std::span<const CurveRecord> curves;
  std::span<const CurvePiece> pieces;
  PositionKeys positions;
  VariableRows width, normal;
  BezierConversion conversion{};
  DMat4 toCache{1};
  Mat3 normalToCache{1};
  float scale = 1;
  bool perspective = true;
  Vec3 eye{0}, axis{0, 0, 1};
  float sign = 1;

  /// A place on a ribbon.
  struct Place {
    uint32_t curve = 0, segment = 0;
    float t = 0;       // within the segment
    float across = 0;  // u
  };
  struct Frame {
    Vec3 center, tangent;  // tangent: derivative by t
    Vec3 half;             // from the middle to the edge u = 1
    Vec3 normal;           // unit, of dPdu x dPdv
  };

  bool prepare(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time, const DiceEye& eye);
  Place place(uint32_t cell, float u, float v) const;
  /// The shader's v.
  float along(const Place& p) const;
  Frame frame(const Place& p) const;
  void vertices(float* xyz) const;
  void triangles(uint8_t* indices) const;
  /// A variable at a place.
  void value(const VariableRows& rows, const Place& p, float* out) const;

 private:
  void segmentPoints(const CurveRecord& c, uint32_t segment, DVec3 b[4]) const;
  /// A segment's Bezier points, kept from row to row.
  struct Segment {
    uint32_t curve = kNone, segment = 0;
    DVec3 b[4];
  };
  Frame frameOfRow(const CurvePiece& piece, uint32_t row, Segment& now) const;
  Frame frameWith(const Place& p, const DVec3& point, const DVec3& derivative, const DVec3& direction) const;
};

/// Index of geometry value i (0..3, linear 0..1) of a segment.
inline uint64_t curveVertex(const CurvesSource& s, const CurveRecord& c, uint32_t segment, uint32_t i) {
  const uint64_t at = uint64_t(segment) * (s.cubic ? s.step : 1) + i;
  return c.firstVertex + (c.vertexCount ? at % c.vertexCount : 0);
}

/// Variables of the two kinds at (cell, u, v); as evaluatePrimvarOf.
bool thinPrimvar(const Skeleton& s, const ObjectRecord& object, uint32_t face, const ParamRecord& param,
                 const VariableRows& rows, size_t n, const uint32_t* cell, const float* u, const float* v,
                 float* const* out);

/// Undisplaced surface at n places; arrays of three planes, nullptr: not wanted. N is the unit direction of
/// dPdu x dPdv.
void thinSurface(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time, const DiceEye& eye,
                 size_t n, const uint32_t* cell, const float* u, const float* v, float* const* P,
                 float* const* dPdu, float* const* dPdv, float* const* N);

inline bool isThin(const ObjectRecord& o) {
  return o.type == PrimitiveType::kPoints || o.type == PrimitiveType::kCurves;
}

}  // namespace fr::cache
