// How finely curves are diced: size over distance, whatever the curve's direction, so that a grid does not
// depend on who asks for it. Orthographic cameras look at everything in one direction, and lengths of flat
// faces in it count less: nothing else would make a wall coarse that leads away from the eye. What lies
// outside the camera's cone is seen by rays alone and is rated coarser, gradually, down to a quarter, and
// less far away from an extremely narrow one: it would otherwise dice many times its own area around the eye.
#pragma once

#include "base/math.h"
#include "scene_cache/format.h"

namespace fr::cache {

/// The eye in cache space and how large a pixel is.
struct DiceEye {
  DVec3 position{0};
  bool perspective = true;
  double pixel = 1e-3;         // edge of a pixel in world units, at distance 1 (orthographic: everywhere)
  double nearDistance = 1e-3;  // distances count as at least this
  DVec3 axis{0, 0, 1};         // where it looks, unit
  double cone = 3.2;     // half angle of the cone around the frustum, radians; above pi: sees everything
  double radius = 1e30;  // orthographic: of the cylinder around what it sees
  // The lens, world units; radius 0: everything is sharp. Perspective alone.
  double lensRadius = 0, focalDistance = 1;
};
/// cacheToCamera at shutter open.
DiceEye diceEye(const CameraRecord& camera, const DMat4& cacheToCamera);

/// Steps of a curve's sampling: 8 equal parameter steps.
inline constexpr int kMetricSteps = 8;
/// Segments come in powers of two. The nearest one is taken: segments are between 1 / kLongestSegment and
/// kLongestSegment micropolygons long, so that micropolygons are as large as ShadingRate says in the mean,
/// not half as large.
inline constexpr float kLongestSegment = 1.41421356f;
/// Edges of polygons that are no longer than this, in micropolygons, are not diced: straight edges need no
/// more points, and faces of such edges alone go into meshlets. Meshes of many faces choose their own
/// (PolygonSource::undicedEdge).
inline constexpr float kUndicedEdge = 1.5f;
/// The longest that a mesh may choose.
inline constexpr float kMostUndicedEdge = 5.0f;

/// Everything that turns lengths into micropolygons for one object.
struct DiceRate {
  Vec3 eye{0};
  bool perspective = true;
  float nearSquared = 0;
  float scale = 1;                      // micropolygons = length / distance * scale
  Vec3 axis{0, 0, 1};                   // of the camera's cone
  float cone = 3.2f;                    // its half angle
  float insideCone = -2;                // what has a larger cosine to the axis lies in the cone
  float radius = 1e30f;                 // orthographic: of the camera's cylinder
  float alongAxis = 1;                  // orthographic: how much lengths along the line of sight count
  float undicedEdge = kLongestSegment;  // an edge up to this many micropolygons stays whole
  // Depth of field: what is out of focus by c = 1 / depth - sharpest may have segments focus * c times as
  // long.
  float focus = 0, sharpest = 0;
  float motionSide = 1;  // what moves may have segments so many times as long
  float flatness = 0;    // micropolygons between a curve and its chords; 0: any
  /// Quadrics close on themselves: with fewer segments a distant sphere would have no area at all.
  int leastLog2 = 0;

  /// Length of a straight piece in micropolygons; symmetric in a and b bit by bit.
  float segment(Vec3 a, Vec3 b) const;
  /// Metric of a curve from its kMetricSteps + 1 points: the largest piece times the number of pieces, or the
  /// number of chords that flatness asks for. Symmetric.
  float curve(const float* x, const float* y, const float* z, size_t stride = 1) const;
  /// The longest of a curve's pieces: segment() of each, bit by bit.
  float longestSegment(const float (&x)[kMetricSteps + 1], const float (&y)[kMetricSteps + 1],
                       const float (&z)[kMetricSteps + 1]) const;
  /// Factor of the metric: 1 where the segment comes into the camera's cone, less outside. a and b relative
  /// to the eye.
  float viewWeight(Vec3 a, Vec3 b) const;
  /// How many times as long segments may be for what lies between two depths before the eye: at least 1.
  float focusSide(float depthA, float depthB) const;
  /// As viewWeight(), for orthographic cameras: 1 in the cylinder, outside as the radius to the distance.
  /// There nothing else makes distant things coarse, and a ground plane may be a thousand times as wide as
  /// the view.
  float cylinderWeight(Vec3 a, Vec3 b) const;
  /// Segments of an edge with this metric, as a power of two; may be above kMaxGridLog2.
  int log2Segments(float metric) const;
};
DiceRate diceRate(const DiceEye& eye, const AttributeRecord& attributes, PrimitiveType type);
/// The same for `object`, whose rate may be fixed.
DiceRate diceRate(const DiceEye& eye, const AttributeRecord& attributes, PrimitiveType type, float fixedRate);

/// How many times as long segments may be on what moves along the raster while the shutter is open. `open`,
/// `close`: where the corners of a box around it are seen at both times, pixels. What is streaked over L
/// pixels may have micropolygons of factor * L / 4 times the area.
float motionSide(const glm::dvec2 (&open)[8], const glm::dvec2 (&close)[8], float factor);

}  // namespace fr::cache
