// A root patch prepared for evaluation at one time, in cache space.
//
// Control points go through the double-precision matrix object -> cache space first and are then rounded
// once; the surface itself is evaluated in float (quadrics: in double, then through the matrix). A point is
// always computed the same way, v first and then u, whether it is asked for alone or as part of a row: so the
// same (u, v) gives the same bits.
#pragma once

#include <cstddef>
#include <vector>

#include "base/math.h"
#include "scene_cache/cache.h"
#include "scene_cache/quadric.h"

namespace fr::cache {

class SubdivisionStore;
class SubdivisionSurface;

enum class SurfaceForm : uint8_t { kEmpty, kBilinear, kPolygon, kBicubic, kBezier, kQuadric, kSubdivision };

/// Not thread-safe to prepare; const afterwards.
class Surface {
 public:
  /// Prepares root patch `root` of `skeleton` at `time`. False when its source is unusable (damaged) or when
  /// it is a meshlet.
  bool prepare(const Skeleton& skeleton, NodeId root, float time, SubdivisionStore* subdivisions);

  // The same from raw data, as addPrimitive() has it. Points: u fastest, `components` (3, or 4: rational)
  // doubles each.
  void setBilinear(const double* points, int components, const DMat4& toCache);
  void setBicubic(const double* bezierPoints, int components, const DMat4& toCache);
  /// Any orders up to kMaxBezierOrder.
  void setBezier(const double* points, uint32_t orderU, uint32_t orderV, int components,
                 const DMat4& toCache);
  /// Corners (0,0) (1,0) (0,1) (1,1) of a plane polygon's patch: one normal everywhere.
  void setPolygon(const DVec3 corners[4], const DMat4& toCache);
  void setQuadric(const Quadric& q, const DMat4& toCache);

  SurfaceForm form() const { return form_; }
  /// False for degenerate control points (NaN, infinity).
  bool finite() const;

  Vec3 point(float u, float v) const;
  /// n points of the line v = const; out: three arrays.
  void row(float v, size_t n, const float* u, float* const P[3]) const;
  /// n points of the line u = const. Metrics only: interior points may differ from row()'s in the last bits;
  /// those of the borders u = 0 and u = 1 are the same.
  void column(float u, size_t n, const float* v, float* const P[3]) const;
  /// (nu + 1) x (nv + 1) points, xyz interleaved, rows rowStride points apart.
  void grid(int nu, const float* u, int nv, const float* v, float* xyz, size_t rowStride) const;
  /// Scattered points with derivatives; any pointer array may be nullptr.
  void evaluate(size_t n, const float* u, const float* v, float* const* P, float* const* dPdu,
                float* const* dPdv) const;
  /// Unit normals dPdu x dPdv (not oriented). Degenerate derivatives are replaced by those of a parameter
  /// nudged inwards.
  void normals(size_t n, const float* u, const float* v, float* const N[3]) const;
  /// Box around the whole root patch.
  Box3f bound() const;
  /// Scale from derivative per root parameter to derivative per shader parameter.
  float shaderScaleU = 1, shaderScaleV = 1;

 private:
  void bezierRow(float v, size_t n, const float* u, float* const P[3]) const;
  void highRow(float v, size_t n, const float* u, float* const P[3]) const;
  void quadricRow(const ProfilePoint& p, size_t n, const double* s, const double* c, float* const P[3]) const;
  /// What a quadric's points of the same u or v share: those of a grid come row by row.
  struct QuadricMemo;
  void derivativesAt(float u, float v, QuadricMemo& memo, Vec3& P, Vec3& du, Vec3& dv) const;

  SurfaceForm form_ = SurfaceForm::kEmpty;
  bool rational_ = false;
  float cp_[4][16] = {};  // [component][v * 4 + u] (bilinear: v * 2 + u)
  // kBezier: control points, orderU_ * orderV_ a component, u fastest.
  uint32_t orderU_ = 0, orderV_ = 0;
  std::vector<float> high_;
  Quadric quadric_{};
  DMat4 toCache_{1};
  const SubdivisionSurface* subdivision_ = nullptr;
  uint32_t subdivisionPatch_ = 0;
};

/// Grid keys of an object: equally spaced over the shutter (GridRecord::keyCount). One when nothing moves.
inline constexpr int kMaxGridKeys = 9;
/// sourceTimes: of the deformation keys (one or none: no deformation); transform, transformTimes: keys of
/// object -> world. So many that each key is one of the grid's (as far as kMaxGridKeys reaches), and that
/// arcs look round.
int gridKeyCount(std::span<const float> sourceTimes, std::span<const DMat4> transform,
                 std::span<const float> transformTimes, const float shutter[2]);
inline float gridKeyTime(int key, int keyCount, const float shutter[2]) {
  return keyCount < 2 ? shutter[0]
                      : shutter[0] + (shutter[1] - shutter[0]) * float(key) / float(keyCount - 1);
}
/// Two deformation keys around a time and the weight of the second.
struct KeySpan {
  uint32_t a = 0, b = 0;
  double weight = 0;
};
KeySpan findKeys(std::span<const float> times, uint32_t keyCount, float time);

}  // namespace fr::cache
