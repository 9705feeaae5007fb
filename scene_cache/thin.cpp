#include "scene_cache/thin.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "scene_cache/bezier.h"
#include "scene_cache/patch_basis.h"

namespace fr::cache {
namespace {

constexpr double kPi = 3.14159265358979323846;

float lengthScale(const DMat4& m) {
  const double s = std::cbrt(std::abs(glm::determinant(DMat3(m))));
  return std::isfinite(s) ? float(s) : 0.0f;
}

Vec3 anyPerpendicular(const Vec3& n) {
  // Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
  const float s = std::copysign(1.0f, n.z), a = -1 / (s + n.z), b = n.x * n.y * a;
  return {1 + s * n.x * n.x * a, s * b, -s * n.x};
}

template <class T>
void takeEye(T& view, const DiceEye& eye, const AttributeRecord& attributes) {
  view.perspective = eye.perspective;
  view.eye = Vec3(eye.position);
  view.axis = Vec3(eye.axis);
  view.sign = normalSign(attributes);
}

Vec3 toEye(bool perspective, const Vec3& eye, const Vec3& axis, const Vec3& p) {
  const Vec3 d = perspective ? eye - p : -axis;
  const float length = glm::length(d);
  return length > 0 && std::isfinite(length) ? d / length : -axis;
}

VariableRows rowsOf(const Skeleton& s, const ObjectRecord& o, std::string_view name, uint32_t width) {
  VariableRows r;
  const ParamRecord* p = s.find(o.primvars, name);
  if (!p) return r;
  const auto values = s.floats(*p);
  if (values.size() < width || p->arrayLength != 1) return r;
  r.data = values, r.width = width, r.storage = p->storage;
  return r;
}

}  // namespace

float equalAreaRadius(uint32_t sides) {
  const double angle = 2 * kPi / sides;
  return float(std::sqrt(angle / std::sin(angle)));
}

// ---- points
// ---------------------------------------------------------------------------------------------------------

bool PointsView::prepare(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time,
                         const DiceEye& diceEye) {
  source = sourceRecord<PointsSource>(s, object);
  if (!source) return false;
  const auto clusters = sourceArray<PointCluster>(s, source->clusters);
  const auto all = sourceArray<uint32_t>(s, source->order);
  widths = sourceArray<float>(s, source->widths);
  positions = positionsAt(s, source->positions, time);
  if (face >= clusters.size() || widths.empty() || positions.count == 0) return false;
  cluster = clusters[face];
  if (cluster.sides < 3 || cluster.sides > 64 || cluster.count == 0 || cluster.count > kMaxMeshletVertices ||
      vertexCount() > kMaxMeshletVertices || triangleCount() > kMaxMeshletTriangles ||
      cluster.first > all.size() || cluster.count > all.size() - cluster.first)
    return false;
  order = all.subspan(cluster.first, cluster.count);
  toCache = s.toCache(object.transform, time);
  scale = lengthScale(toCache);
  takeEye(*this, diceEye, s.attributes()[object.attributes]);
  return true;
}

Vec3 PointsView::center(uint32_t sprite) const {
  return Vec3(transformPoint(toCache, positions.at(std::min<uint64_t>(order[sprite], positions.count - 1))));
}

void PointsView::frame(uint32_t sprite, const Vec3& at, Vec3& u, Vec3& v) const {
  const Vec3 n = toEye(perspective, eye, axis, at);
  const float width = widths[std::min<size_t>(order[sprite], widths.size() - 1)];
  const float radius = std::isfinite(width) ? 0.5f * std::abs(width) * scale : 0.0f;
  u = anyPerpendicular(n);
  v = glm::cross(n, u) * (sign * radius);  // u x v = sign n
  u *= radius;
}

void PointsView::vertices(float* xyz) const {
  const uint32_t k = cluster.sides;
  const float radius = equalAreaRadius(k);
  float c[64], s[64];
  for (uint32_t i = 0; i < k; ++i)
    c[i] = float(std::cos(2 * kPi * i / k)) * radius, s[i] = float(std::sin(2 * kPi * i / k)) * radius;
  for (uint32_t p = 0; p < cluster.count; ++p) {
    const Vec3 at = center(p);
    Vec3 u, v;
    frame(p, at, u, v);
    // Turned by chance: corners of a cloud's many small polygons do not all point the same way.
    const float angle = float(hashStep(0x706f696e74ull, order[p]) >> 40) * float(2 * kPi / (1 << 24));
    const float turnC = std::cos(angle), turnS = std::sin(angle);
    const Vec3 a = u * turnC + v * turnS, b = v * turnC - u * turnS;
    for (uint32_t i = 0; i < k; ++i, xyz += 3) {
      const Vec3 q = at + a * c[i] + b * s[i];
      xyz[0] = q.x, xyz[1] = q.y, xyz[2] = q.z;
    }
  }
}

void PointsView::triangles(uint8_t* indices) const {
  for (uint32_t p = 0; p < cluster.count; ++p) {
    const uint32_t first = p * cluster.sides;
    for (uint32_t i = 1; i + 1 < cluster.sides; ++i, indices += 3)
      indices[0] = uint8_t(first), indices[1] = uint8_t(first + i), indices[2] = uint8_t(first + i + 1);
  }
}

// ---- curves
// ---------------------------------------------------------------------------------------------------------

bool CurvesView::prepare(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time,
                         const DiceEye& diceEye) {
  source = sourceRecord<CurvesSource>(s, object);
  if (!source || (source->cubic && source->step == 0)) return false;
  const auto clusters = sourceArray<CurveCluster>(s, source->clusters);
  const auto all = sourceArray<CurvePiece>(s, source->pieces);
  curves = sourceArray<CurveRecord>(s, source->curves);
  if (source->cubic) conversion = bezierConversion(source->basis);
  positions = positionsAt(s, source->positions, time);
  if (face >= clusters.size() || positions.count == 0) return false;
  cluster = clusters[face];
  if (cluster.pieceCount == 0 || cluster.vertexCount > kMaxMeshletVertices ||
      cluster.triangleCount > kMaxMeshletTriangles || cluster.firstPiece > all.size() ||
      cluster.pieceCount > all.size() - cluster.firstPiece)
    return false;
  pieces = all.subspan(cluster.firstPiece, cluster.pieceCount);
  uint32_t vertices = 0, triangles = 0;
  for (const CurvePiece& p : pieces) {
    if (p.curve >= curves.size() || p.rows == 0 || p.columns == 0 || p.steps == 0 || p.allColumns == 0 ||
        curves[p.curve].segments == 0 || curves[p.curve].vertexCount == 0 || p.firstVertex != vertices ||
        p.firstTriangle != triangles)
      return false;
    vertices += (p.rows + 1u) * (p.columns + 1u), triangles += 2u * p.rows * p.columns;
    if (vertices > cluster.vertexCount || triangles > cluster.triangleCount) return false;
  }
  if (vertices != cluster.vertexCount || triangles != cluster.triangleCount) return false;
  width = rowsOf(s, object, "width", 1);
  if (width.empty()) width = rowsOf(s, object, "constantwidth", 1);
  normal = rowsOf(s, object, "N", 3);
  toCache = s.toCache(object.transform, time);
  normalToCache = Mat3(normalMatrix(toCache));
  scale = lengthScale(toCache);
  takeEye(*this, diceEye, s.attributes()[object.attributes]);
  return true;
}

CurvesView::Place CurvesView::place(uint32_t cell, float u, float v) const {
  const auto after = std::upper_bound(pieces.begin(), pieces.end(), cell,
                                      [](uint32_t c, const CurvePiece& p) { return c < p.firstTriangle; });
  const CurvePiece& p = *(after == pieces.begin() ? after : after - 1);
  const uint32_t local =
      std::min<uint32_t>(cell - std::min<uint32_t>(cell, p.firstTriangle), 2u * p.rows * p.columns - 1u);
  const uint32_t quad = local / 2, row = quad / p.columns, column = quad % p.columns;
  if (local & 1) u = 1 - u, v = 1 - v;
  Place r;
  r.curve = p.curve;
  const uint32_t at = p.firstRow + row;
  r.segment = std::min(at / p.steps, curves[p.curve].segments - 1);
  r.t = (float(at % p.steps) + v) / float(p.steps);
  r.across = (float(p.firstColumn + column) + u) / float(p.allColumns);
  return r;
}

float CurvesView::along(const Place& p) const {
  return (float(p.segment) + p.t) / float(curves[p.curve].segments);
}

void CurvesView::value(const VariableRows& rows, const Place& p, float* out) const {
  const CurveRecord& c = curves[p.curve];
  switch (rows.count() == 1 ? ParamClass::kConstant : rows.storage) {
    case ParamClass::kConstant:
      std::copy_n(rows.row(0), rows.width, out);
      return;
    case ParamClass::kUniform:
      std::copy_n(rows.row(p.curve), rows.width, out);
      return;
    case ParamClass::kVertex: {
      if (!source->cubic) break;
      double b[4];
      bernstein(double(p.t), b);
      for (uint32_t k = 0; k < rows.width; ++k) {
        double sum = 0;
        for (uint32_t i = 0; i < 4; ++i) {
          double ordinate = 0;
          for (uint32_t j = 0; j < 4; ++j)
            ordinate += conversion.m[i][j] * double(rows.row(curveVertex(*source, c, p.segment, j))[k]);
          sum += b[i] * ordinate / conversion.denominator;
        }
        out[k] = float(sum);
      }
      return;
    }
    default:
      break;
  }
  // Varying; vertex variables of linear curves stand at the same places.
  const bool vertex = rows.storage == ParamClass::kVertex;
  const uint64_t first = vertex ? c.firstVertex : c.firstVarying;
  const uint32_t count = source->periodic ? c.segments : c.segments + 1;
  const float* a = rows.row(first + p.segment % count);
  const float* b = rows.row(first + (p.segment + 1) % count);
  for (uint32_t k = 0; k < rows.width; ++k) out[k] = lerpSymmetric(a[k], b[k], 1 - p.t, p.t);
}

void CurvesView::segmentPoints(const CurveRecord& c, uint32_t segment, DVec3 b[4]) const {
  const auto at = [&](uint32_t i) {
    return positions.at(std::min(curveVertex(*source, c, segment, i), positions.count - 1));
  };
  if (!source->cubic) {
    b[0] = transformPoint(toCache, at(0)), b[3] = transformPoint(toCache, at(1));
    b[1] = (b[0] * 2.0 + b[3]) / 3.0, b[2] = (b[0] + b[3] * 2.0) / 3.0;
    return;
  }
  DVec3 g[4];
  for (uint32_t i = 0; i < 4; ++i) g[i] = at(i);
  for (int i = 0; i < 4; ++i) {
    DVec3 sum(0);
    for (int j = 0; j < 4; ++j) sum += conversion.m[i][j] * g[j];
    b[i] = transformPoint(toCache, sum / conversion.denominator);
  }
}

namespace {

DVec3 cubicAt(const DVec3 b[4], double t) {
  double w[4];
  bernstein(t, w);
  return (b[0] * w[0] + b[3] * w[3]) + (b[1] * w[1] + b[2] * w[2]);
}

DVec3 cubicSlope(const DVec3 b[4], double t) {
  double w[3];
  bernsteinDerivative(t, w);
  return ((b[1] - b[0]) * w[0] + (b[3] - b[2]) * w[2]) + (b[2] - b[1]) * w[1];
}

/// Unit direction of the curve, also where its derivative vanishes; 0 when all points are one.
DVec3 directionAt(const DVec3 b[4], double t) {
  DVec3 d = cubicSlope(b, t);
  double length = glm::length(d);
  const double size = glm::length(b[1] - b[0]) + glm::length(b[2] - b[1]) + glm::length(b[3] - b[2]);
  if (!(length > 1e-9 * size)) {
    d = cubicAt(b, std::min(1.0, t + 0.01)) - cubicAt(b, std::max(0.0, t - 0.01));
    length = glm::length(d);
  }
  return length > 0 && std::isfinite(length) ? d / length : DVec3(0);
}

}  // namespace

CurvesView::Frame CurvesView::frameWith(const Place& p, const DVec3& point, const DVec3& derivative,
                                        const DVec3& direction) const {
  Frame f;
  f.center = Vec3(point);
  f.tangent = Vec3(derivative);
  float w = 1;
  if (!width.empty()) value(width, p, &w);
  w = std::isfinite(w) ? std::abs(w) * scale * 0.5f : 0.0f;
  Vec3 T(direction);
  const Vec3 eyeward = toEye(perspective, eye, axis, f.center);
  if (!(glm::dot(T, T) > 0)) T = anyPerpendicular(eyeward);
  Vec3 side(0);
  if (!normal.empty()) {
    Vec3 n;
    value(normal, p, &n.x);
    side = glm::cross(T, normalToCache * n) * sign;
  }
  float length = glm::length(side);
  if (!(length > 0) || !std::isfinite(length)) {
    side = glm::cross(T, eyeward) * sign;
    length = glm::length(side);
    // Looked at along itself: any side is as good.
    if (!(length > 1e-6f)) side = anyPerpendicular(T) * sign, length = glm::length(side);
  }
  side /= length;
  f.half = side * w;
  const Vec3 n = glm::cross(side, T);
  const float size = glm::length(n);
  f.normal = size > 0 ? n / size : eyeward * sign;
  return f;
}

CurvesView::Frame CurvesView::frame(const Place& p) const {
  DVec3 b[4];
  segmentPoints(curves[p.curve], p.segment, b);
  return frameWith(p, cubicAt(b, double(p.t)), cubicSlope(b, double(p.t)), directionAt(b, double(p.t)));
}

CurvesView::Frame CurvesView::frameOfRow(const CurvePiece& piece, uint32_t row, Segment& now) const {
  const CurveRecord& c = curves[piece.curve];
  Place p;
  p.curve = piece.curve;
  p.segment = row / piece.steps;
  const auto take = [&](uint32_t segment) {
    if (now.curve == p.curve && now.segment == segment) return;
    segmentPoints(c, segment, now.b);
    now.curve = p.curve, now.segment = segment;
  };
  if (row % piece.steps != 0) {
    p.segment = std::min(p.segment, c.segments - 1);
    p.t = float(row % piece.steps) / float(piece.steps);
    take(p.segment);
    const double t = double(p.t);
    return frameWith(p, cubicAt(now.b, t), cubicSlope(now.b, t), directionAt(now.b, t));
  }
  // Between two segments: one point and one direction for both, so that the ribbon does not tear.
  if (source->periodic) {
    p.segment %= c.segments;
  } else if (p.segment >= c.segments) {
    p.segment = c.segments - 1, p.t = 1;
    take(p.segment);
    return frameWith(p, now.b[3], cubicSlope(now.b, 1), directionAt(now.b, 1));
  }
  DVec3 before(0);
  if (p.segment > 0 || source->periodic) {
    take(p.segment > 0 ? p.segment - 1 : c.segments - 1);
    before = directionAt(now.b, 1);
  }
  take(p.segment);
  DVec3 direction = directionAt(now.b, 0);
  const DVec3 sum = before + direction;
  if (glm::length(sum) > 1e-3) direction = glm::normalize(sum);
  return frameWith(p, now.b[0], cubicSlope(now.b, 0), direction);
}

void CurvesView::vertices(float* xyz) const {
  Segment now;
  for (const CurvePiece& p : pieces) {
    for (uint32_t r = 0; r <= p.rows; ++r) {
      const Frame f = frameOfRow(p, p.firstRow + r, now);
      for (uint32_t i = 0; i <= p.columns; ++i, xyz += 3) {
        const float x = float(p.firstColumn + i) / float(p.allColumns) * 2 - 1;
        const Vec3 q = f.center + f.half * x;
        xyz[0] = q.x, xyz[1] = q.y, xyz[2] = q.z;
      }
    }
  }
}

void CurvesView::triangles(uint8_t* indices) const {
  for (const CurvePiece& p : pieces) {
    const uint32_t row = p.columns + 1u;
    for (uint32_t r = 0; r < p.rows; ++r) {
      for (uint32_t i = 0; i < p.columns; ++i, indices += 6) {
        const uint32_t a = p.firstVertex + r * row + i;
        const uint32_t corner[6] = {a, a + 1, a + row, a + row + 1, a + row, a + 1};
        for (int k = 0; k < 6; ++k) indices[k] = uint8_t(corner[k]);
      }
    }
  }
}

void thinSurface(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time, const DiceEye& eye,
                 size_t n, const uint32_t* cell, const float* u, const float* v, float* const* P,
                 float* const* dPdu, float* const* dPdv, float* const* N) {
  const auto put = [](float* const* out, size_t i, const Vec3& x) {
    if (!out) return;
    for (int c = 0; c < 3; ++c) out[c][i] = x[c];
  };
  PointsView points;
  CurvesView curves;
  const bool isPoints = object.type == PrimitiveType::kPoints;
  const bool ok =
      isPoints ? points.prepare(s, object, face, time, eye) : curves.prepare(s, object, face, time, eye);
  for (size_t i = 0; i < n; ++i) {
    const uint32_t c = cell ? cell[i] : 0;
    if (!ok) {
      put(P, i, Vec3(0)), put(dPdu, i, Vec3(0)), put(dPdv, i, Vec3(0)), put(N, i, Vec3(0, 0, 1));
    } else if (isPoints) {
      const uint32_t sprite = points.spriteOf(c);
      const Vec3 center = points.center(sprite);
      Vec3 a, b;
      points.frame(sprite, center, a, b);
      const Vec3 normal = glm::cross(a, b);
      const float length = glm::length(normal);
      put(P, i, center), put(dPdu, i, 2.0f * a), put(dPdv, i, 2.0f * b);
      put(N, i, length > 0 ? normal / length : Vec3(0, 0, 1));
    } else {
      const CurvesView::Place p = curves.place(c, u[i], v[i]);
      const CurvesView::Frame f = curves.frame(p);
      put(P, i, f.center + f.half * (2 * p.across - 1));
      put(dPdu, i, 2.0f * f.half), put(dPdv, i, f.tangent * float(curves.curves[p.curve].segments));
      put(N, i, f.normal);
    }
  }
}

bool thinPrimvar(const Skeleton& s, const ObjectRecord& object, uint32_t face, const ParamRecord& param,
                 const VariableRows& rows, size_t n, const uint32_t* cell, const float* u, const float* v,
                 float* const* out) {
  if (object.type == PrimitiveType::kPoints) {
    PointsView view;
    if (!view.prepare(s, object, face, s.camera().shutter[0], {})) return false;
    for (size_t i = 0; i < n; ++i) {
      const float* row = rows.row(view.pointOf(cell ? cell[i] : 0));
      for (uint32_t c = 0; c < rows.width; ++c) out[c][i] = row[c];
    }
    return true;
  }
  CurvesView view;
  if (rows.width > 64 || !view.prepare(s, object, face, s.camera().shutter[0], {})) return false;
  VariableRows r = rows;
  r.storage = param.storage == ParamClass::kFaceVarying ? ParamClass::kVarying : param.storage;
  for (size_t i = 0; i < n; ++i) {
    float value[64];
    view.value(r, view.place(cell ? cell[i] : 0, u[i], v[i]), value);
    for (uint32_t c = 0; c < rows.width; ++c) out[c][i] = value[c];
  }
  return true;
}

}  // namespace fr::cache
