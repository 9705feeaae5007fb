#include "scene_cache/surface.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "scene_cache/bezier.h"
#include "scene_cache/primitive_source.h"
#include "scene_cache/subdivision.h"

namespace fr::cache {
namespace {

// How far a degenerate derivative's parameter moves inwards.
constexpr float kNudge = 1.0f / 1024;

}  // namespace

void Surface::setBilinear(const double* points, int components, const DMat4& toCache) {
  form_ = SurfaceForm::kBilinear;
  rational_ = components == 4;
  for (int i = 0; i < 4; ++i) {
    const double* p = points + i * components;
    const DVec4 h = toCache * DVec4(p[0], p[1], p[2], rational_ ? p[3] : 1.0);
    for (int c = 0; c < 3; ++c) cp_[c][i] = float(rational_ || h.w == 1 ? h[c] : h[c] / h.w);
    cp_[3][i] = rational_ ? float(h.w) : 1.0f;
  }
}

void Surface::setPolygon(const DVec3 corners[4], const DMat4& toCache) {
  double points[12];
  for (int i = 0; i < 4; ++i)
    points[i * 3] = corners[i].x, points[i * 3 + 1] = corners[i].y, points[i * 3 + 2] = corners[i].z;
  setBilinear(points, 3, toCache);
  form_ = SurfaceForm::kPolygon;
}

void Surface::setBicubic(const double* points, int components, const DMat4& toCache) {
  form_ = SurfaceForm::kBicubic;
  rational_ = components == 4;
  for (int i = 0; i < 16; ++i) {
    const double* p = points + i * components;
    const DVec4 h = toCache * DVec4(p[0], p[1], p[2], rational_ ? p[3] : 1.0);
    for (int c = 0; c < 3; ++c) cp_[c][i] = float(rational_ || h.w == 1 ? h[c] : h[c] / h.w);
    cp_[3][i] = rational_ ? float(h.w) : 1.0f;
  }
}

void Surface::setBezier(const double* points, uint32_t orderU, uint32_t orderV, int components,
                        const DMat4& toCache) {
  if (orderU == 4 && orderV == 4) return setBicubic(points, components, toCache);
  form_ = SurfaceForm::kBezier;
  rational_ = components == 4;
  orderU_ = orderU, orderV_ = orderV;
  const size_t n = size_t(orderU) * orderV;
  high_.assign(n * 4, 1.0f);
  for (size_t i = 0; i < n; ++i) {
    const double* p = points + i * size_t(components);
    const DVec4 h = toCache * DVec4(p[0], p[1], p[2], rational_ ? p[3] : 1.0);
    for (int c = 0; c < 3; ++c) high_[size_t(c) * n + i] = float(rational_ || h.w == 1 ? h[c] : h[c] / h.w);
    if (rational_) high_[3 * n + i] = float(h.w);
  }
}

void Surface::setQuadric(const Quadric& q, const DMat4& toCache) {
  form_ = SurfaceForm::kQuadric;
  rational_ = false;
  quadric_ = q;
  toCache_ = toCache;
}

bool Surface::finite() const {
  switch (form_) {
    case SurfaceForm::kEmpty:
      return false;
    case SurfaceForm::kSubdivision:
      return true;
    case SurfaceForm::kQuadric: {
      for (const double x : quadric_.p) {
        if (!std::isfinite(x)) return false;
      }
      const Box3f b = bound();
      return isFinite(b.min) && isFinite(b.max);
    }
    case SurfaceForm::kBezier:
      return std::all_of(high_.begin(), high_.end(), [](float x) { return std::isfinite(x); });
    default:
      break;
  }
  const int count = form_ == SurfaceForm::kBicubic ? 16 : 4;
  for (int c = 0; c < 4; ++c) {
    for (int i = 0; i < count; ++i) {
      if (!std::isfinite(cp_[c][i])) return false;
    }
  }
  return true;
}

void Surface::bezierRow(float v, size_t n, const float* u, float* const P[3]) const {
  float bv[4];
  bernstein(v, bv);
  float q[4][4];
  const int components = rational_ ? 4 : 3;
  for (int c = 0; c < components; ++c) {
    for (int i = 0; i < 4; ++i)
      q[c][i] = cubicPoint(cp_[c][i], cp_[c][4 + i], cp_[c][8 + i], cp_[c][12 + i], bv);
  }
  float* const x = P[0];
  float* const y = P[1];
  float* const z = P[2];
  if (!rational_) {
    for (size_t k = 0; k < n; ++k) {
      float bu[4];
      bernstein(u[k], bu);
      x[k] = cubicPoint(q[0][0], q[0][1], q[0][2], q[0][3], bu);
      y[k] = cubicPoint(q[1][0], q[1][1], q[1][2], q[1][3], bu);
      z[k] = cubicPoint(q[2][0], q[2][1], q[2][2], q[2][3], bu);
    }
    return;
  }
  for (size_t k = 0; k < n; ++k) {
    float bu[4];
    bernstein(u[k], bu);
    const float w = cubicPoint(q[3][0], q[3][1], q[3][2], q[3][3], bu);
    x[k] = cubicPoint(q[0][0], q[0][1], q[0][2], q[0][3], bu) / w;
    y[k] = cubicPoint(q[1][0], q[1][1], q[1][2], q[1][3], bu) / w;
    z[k] = cubicPoint(q[2][0], q[2][1], q[2][2], q[2][3], bu) / w;
  }
}

namespace {

/// De Casteljau's algorithm in place on `order` values `stride` apart: the point, and the difference that its
/// derivative is degree times. Symmetric as bezier.h asks for.
float casteljau(float* p, uint32_t order, float t, float* difference) {
  const float s = 1 - t;
  for (uint32_t r = order - 1; r > 1; --r) {
    for (uint32_t i = 0; i < r; ++i) p[i] = lerpSymmetric(p[i], p[i + 1], s, t);
  }
  if (difference) *difference = p[1] - p[0];
  return lerpSymmetric(p[0], p[1], s, t);
}

}  // namespace

void Surface::highRow(float v, size_t n, const float* u, float* const P[3]) const {
  const size_t all = size_t(orderU_) * orderV_;
  const uint32_t components = rational_ ? 4 : 3;
  float q[4][kMaxBezierOrder], line[kMaxBezierOrder];
  for (uint32_t c = 0; c < components; ++c) {
    for (uint32_t i = 0; i < orderU_; ++i) {
      for (uint32_t j = 0; j < orderV_; ++j) line[j] = high_[c * all + j * orderU_ + i];
      q[c][i] = casteljau(line, orderV_, v, nullptr);
    }
  }
  for (size_t k = 0; k < n; ++k) {
    float p[4] = {0, 0, 0, 1};
    for (uint32_t c = 0; c < components; ++c) {
      std::copy_n(q[c], orderU_, line);
      p[c] = casteljau(line, orderU_, u[k], nullptr);
    }
    for (int c = 0; c < 3; ++c) P[c][k] = rational_ ? p[c] / p[3] : p[c];
  }
}

void Surface::quadricRow(const ProfilePoint& p, size_t n, const double* s, const double* c,
                         float* const P[3]) const {
  const DMat4& m = toCache_;
  const DVec3 base(m[2].x * p.z + m[3].x, m[2].y * p.z + m[3].y, m[2].z * p.z + m[3].z);
  for (size_t k = 0; k < n; ++k) {
    const double x = p.a * c[k] - p.b * s[k];
    const double y = p.a * s[k] + p.b * c[k];
    P[0][k] = float((m[0].x * x + m[1].x * y) + base.x);
    P[1][k] = float((m[0].y * x + m[1].y * y) + base.y);
    P[2][k] = float((m[0].z * x + m[1].z * y) + base.z);
  }
}

void Surface::row(float v, size_t n, const float* u, float* const P[3]) const {
  switch (form_) {
    case SurfaceForm::kBilinear:
    case SurfaceForm::kPolygon: {
      const float s = 1 - v;
      float q[4][2];
      const int components = rational_ ? 4 : 3;
      for (int c = 0; c < components; ++c) {
        q[c][0] = lerpSymmetric(cp_[c][0], cp_[c][2], s, v);
        q[c][1] = lerpSymmetric(cp_[c][1], cp_[c][3], s, v);
      }
      for (size_t k = 0; k < n; ++k) {
        const float su = 1 - u[k];
        for (int c = 0; c < 3; ++c) P[c][k] = lerpSymmetric(q[c][0], q[c][1], su, u[k]);
        if (rational_) {
          const float w = lerpSymmetric(q[3][0], q[3][1], su, u[k]);
          for (int c = 0; c < 3; ++c) P[c][k] /= w;
        }
      }
      return;
    }
    case SurfaceForm::kBicubic:
      bezierRow(v, n, u, P);
      return;
    case SurfaceForm::kBezier:
      highRow(v, n, u, P);
      return;
    case SurfaceForm::kQuadric: {
      const ProfilePoint p = quadricProfile(quadric_, double(v));
      const double sweep = quadricSweep(quadric_);
      constexpr size_t kBlock = 32;
      for (size_t first = 0; first < n; first += kBlock) {
        double s[kBlock], c[kBlock];
        const size_t count = std::min(kBlock, n - first);
        for (size_t k = 0; k < count; ++k) sinCosDegrees(double(u[first + k]) * sweep, s[k], c[k]);
        float* const block[3] = {P[0] + first, P[1] + first, P[2] + first};
        quadricRow(p, count, s, c, block);
      }
      return;
    }
    case SurfaceForm::kSubdivision:
      for (size_t k = 0; k < n; ++k) {
        const Vec3 p = subdivision_->point(subdivisionPatch_, u[k], v);
        P[0][k] = p.x, P[1][k] = p.y, P[2][k] = p.z;
      }
      return;
    case SurfaceForm::kEmpty:
      break;
  }
  for (int c = 0; c < 3; ++c) std::fill_n(P[c], n, 0.0f);
}

void Surface::column(float u, size_t n, const float* v, float* const P[3]) const {
  if (form_ == SurfaceForm::kQuadric) {
    double s, c;
    sinCosDegrees(double(u) * quadricSweep(quadric_), s, c);
    for (size_t k = 0; k < n; ++k) {
      float* const one[3] = {P[0] + k, P[1] + k, P[2] + k};
      quadricRow(quadricProfile(quadric_, double(v[k])), 1, &s, &c, one);
    }
    return;
  }
  if (form_ == SurfaceForm::kBicubic) {
    // The transposed patch, evaluated as a row.
    Surface t;
    t.form_ = form_, t.rational_ = rational_;
    for (int c = 0; c < 4; ++c) {
      for (int j = 0; j < 4; ++j) {
        for (int i = 0; i < 4; ++i) t.cp_[c][i * 4 + j] = cp_[c][j * 4 + i];
      }
    }
    t.bezierRow(u, n, v, P);
    return;
  }
  for (size_t k = 0; k < n; ++k) {
    float* const one[3] = {P[0] + k, P[1] + k, P[2] + k};
    row(v[k], 1, &u, one);
  }
}

Vec3 Surface::point(float u, float v) const {
  Vec3 p;
  float* const out[3] = {&p.x, &p.y, &p.z};
  row(v, 1, &u, out);
  return p;
}

void Surface::grid(int nu, const float* u, int nv, const float* v, float* xyz, size_t rowStride) const {
  const size_t n = size_t(nu) + 1;
  float x[kMaxGridSide + 1], y[kMaxGridSide + 1], z[kMaxGridSide + 1];
  float* const P[3] = {x, y, z};
  double s[kMaxGridSide + 1], c[kMaxGridSide + 1];
  if (form_ == SurfaceForm::kQuadric) {
    const double sweep = quadricSweep(quadric_);
    for (size_t k = 0; k < n; ++k) sinCosDegrees(double(u[k]) * sweep, s[k], c[k]);
  }
  for (int j = 0; j <= nv; ++j) {
    if (form_ == SurfaceForm::kQuadric) {
      quadricRow(quadricProfile(quadric_, double(v[j])), n, s, c, P);
    } else {
      row(v[j], n, u, P);
    }
    float* out = xyz + size_t(j) * rowStride * 3;
    for (size_t k = 0; k < n; ++k) out[k * 3] = x[k], out[k * 3 + 1] = y[k], out[k * 3 + 2] = z[k];
  }
}

struct Surface::QuadricMemo {
  static constexpr size_t kColumns = 64;
  float v = std::numeric_limits<float>::quiet_NaN();
  ProfilePoint profile{};
  float u[kColumns];
  double s[kColumns], c[kColumns];
  QuadricMemo() { std::fill_n(u, kColumns, std::numeric_limits<float>::quiet_NaN()); }

  const ProfilePoint& profileAt(const Quadric& q, float at) {
    if (v != at) v = at, profile = quadricProfile(q, double(at));
    return profile;
  }
  void angleAt(float at, double sweep, double& sine, double& cosine) {
    const size_t k = std::bit_cast<uint32_t>(at) * 0x9e3779b9u >> 26;
    if (u[k] != at) u[k] = at, sinCosDegrees(double(at) * sweep, s[k], c[k]);
    sine = s[k], cosine = c[k];
  }
};

void Surface::derivativesAt(float u, float v, QuadricMemo& memo, Vec3& P, Vec3& du, Vec3& dv) const {
  switch (form_) {
    case SurfaceForm::kBilinear:
    case SurfaceForm::kPolygon: {
      float p[4], a[4], b[4];
      for (int c = 0; c < 4; ++c) {
        const float* k = cp_[c];
        const float q0 = lerpSymmetric(k[0], k[2], 1 - v, v), q1 = lerpSymmetric(k[1], k[3], 1 - v, v);
        p[c] = lerpSymmetric(q0, q1, 1 - u, u);
        a[c] = q1 - q0;
        b[c] = lerpSymmetric(k[2] - k[0], k[3] - k[1], 1 - u, u);
      }
      P = Vec3(p[0], p[1], p[2]), du = Vec3(a[0], a[1], a[2]), dv = Vec3(b[0], b[1], b[2]);
      if (rational_) P /= p[3], du = (du - P * a[3]) / p[3], dv = (dv - P * b[3]) / p[3];
      return;
    }
    case SurfaceForm::kBicubic: {
      float bu[4], bv[4], eu[3], ev[3];
      bernstein(u, bu), bernstein(v, bv);
      bernsteinDerivative(u, eu), bernsteinDerivative(v, ev);
      float p[4], a[4], b[4];
      const int components = rational_ ? 4 : 3;
      p[3] = 1, a[3] = b[3] = 0;
      for (int c = 0; c < components; ++c) {
        float q[4], d[4];
        for (int i = 0; i < 4; ++i) {
          q[i] = cubicPoint(cp_[c][i], cp_[c][4 + i], cp_[c][8 + i], cp_[c][12 + i], bv);
          d[i] = cubicDerivative(cp_[c][i], cp_[c][4 + i], cp_[c][8 + i], cp_[c][12 + i], ev);
        }
        p[c] = cubicPoint(q[0], q[1], q[2], q[3], bu);
        a[c] = cubicDerivative(q[0], q[1], q[2], q[3], eu);
        b[c] = cubicPoint(d[0], d[1], d[2], d[3], bu);
      }
      P = Vec3(p[0], p[1], p[2]), du = Vec3(a[0], a[1], a[2]), dv = Vec3(b[0], b[1], b[2]);
      if (rational_) P /= p[3], du = (du - P * a[3]) / p[3], dv = (dv - P * b[3]) / p[3];
      return;
    }
    case SurfaceForm::kBezier: {
      const size_t all = size_t(orderU_) * orderV_;
      float p[4] = {0, 0, 0, 1}, a[4] = {}, b[4] = {};
      for (uint32_t c = 0; c < (rational_ ? 4u : 3u); ++c) {
        float q[kMaxBezierOrder], d[kMaxBezierOrder], line[kMaxBezierOrder];
        for (uint32_t i = 0; i < orderU_; ++i) {
          for (uint32_t j = 0; j < orderV_; ++j) line[j] = high_[c * all + j * orderU_ + i];
          q[i] = casteljau(line, orderV_, v, &d[i]);
        }
        p[c] = casteljau(q, orderU_, u, &a[c]);
        b[c] = casteljau(d, orderU_, u, nullptr);
        a[c] *= float(orderU_ - 1), b[c] *= float(orderV_ - 1);
      }
      P = Vec3(p[0], p[1], p[2]), du = Vec3(a[0], a[1], a[2]), dv = Vec3(b[0], b[1], b[2]);
      if (rational_) P /= p[3], du = (du - P * a[3]) / p[3], dv = (dv - P * b[3]) / p[3];
      return;
    }
    case SurfaceForm::kQuadric: {
      const ProfilePoint& q = memo.profileAt(quadric_, v);
      const double sweep = quadricSweep(quadric_);
      double s, c;
      memo.angleAt(u, sweep, s, c);
      float* const out[3] = {&P.x, &P.y, &P.z};
      quadricRow(q, 1, &s, &c, out);
      const double radians = sweep * (3.14159265358979323846 / 180);
      const DMat3 m(toCache_);
      du = Vec3(m * DVec3(radians * (-q.a * s - q.b * c), radians * (q.a * c - q.b * s), 0));
      dv = Vec3(m * DVec3(q.da * c - q.db * s, q.da * s + q.db * c, q.dz));
      return;
    }
    case SurfaceForm::kSubdivision:
      P = subdivision_->derivatives(subdivisionPatch_, u, v, du, dv);
      return;
    case SurfaceForm::kEmpty:
      break;
  }
  P = du = dv = Vec3(0);
}

void Surface::evaluate(size_t n, const float* u, const float* v, float* const* P, float* const* dPdu,
                       float* const* dPdv) const {
  QuadricMemo memo;
  for (size_t k = 0; k < n; ++k) {
    Vec3 p, du, dv;
    if (!dPdu && !dPdv) {
      float* const out[3] = {&p.x, &p.y, &p.z};
      row(v[k], 1, u + k, out);
    } else {
      derivativesAt(u[k], v[k], memo, p, du, dv);
    }
    for (int c = 0; c < 3; ++c) {
      if (P && P[c]) P[c][k] = p[c];
      if (dPdu && dPdu[c]) dPdu[c][k] = du[c] * shaderScaleU;
      if (dPdv && dPdv[c]) dPdv[c][k] = dv[c] * shaderScaleV;
    }
  }
}

void Surface::normals(size_t n, const float* u, const float* v, float* const N[3]) const {
  if (form_ == SurfaceForm::kPolygon) {
    // The plane's normal; the diagonals are never parallel in a face with an area.
    const auto corner = [this](int i) { return DVec3(cp_[0][i], cp_[1][i], cp_[2][i]); };
    DVec3 normal = glm::cross(corner(3) - corner(0), corner(2) - corner(1));
    const double length = glm::length(normal);
    normal = length > 0 ? normal / length : DVec3(0, 0, 1);
    for (int c = 0; c < 3; ++c) std::fill_n(N[c], n, float(normal[c]));
    return;
  }
  QuadricMemo memo;
  for (size_t k = 0; k < n; ++k) {
    Vec3 p, du, dv;
    derivativesAt(u[k], v[k], memo, p, du, dv);
    DVec3 normal = glm::cross(DVec3(du), DVec3(dv));
    double square = glm::dot(normal, normal);
    // Poles and collapsed edges: the sine of the angle, not the size, tells a degenerate frame.
    const double limit = 1e-10 * double(glm::dot(du, du)) * double(glm::dot(dv, dv));
    // And a derivative that is no more than the rounding of the coordinates has no direction.
    const float rounding = 4e-12f * glm::dot(p, p);
    if (!(square > limit) || glm::dot(du, du) < rounding || glm::dot(dv, dv) < rounding) {
      const float un = u[k] + (u[k] < 0.5f ? kNudge : -kNudge), vn = v[k] + (v[k] < 0.5f ? kNudge : -kNudge);
      for (int attempt = 0; attempt < 3 && (attempt == 0 || !(square > 0)); ++attempt) {
        derivativesAt(attempt == 1 ? u[k] : un, attempt == 0 ? u[k] == un ? v[k] : vn : vn, memo, p, du, dv);
        normal = glm::cross(DVec3(du), DVec3(dv));
        square = glm::dot(normal, normal);
      }
    }
    normal = square > 0 ? normal / std::sqrt(square) : DVec3(0, 0, 1);
    for (int c = 0; c < 3; ++c) N[c][k] = float(normal[c]);
  }
}

Box3f Surface::bound() const {
  Box3f box;
  switch (form_) {
    case SurfaceForm::kQuadric: {
      const Box3d b = transformBox(toCache_, quadricBound(quadric_));
      box = {Vec3(b.min), Vec3(b.max)};
      break;
    }
    case SurfaceForm::kSubdivision:  // addSubdivision() bounds by control points
    case SurfaceForm::kEmpty:
      return box;
    case SurfaceForm::kBezier: {
      const size_t n = size_t(orderU_) * orderV_;
      for (size_t i = 0; i < n; ++i)
        box.extend(Vec3(high_[i], high_[n + i], high_[2 * n + i]) / high_[3 * n + i]);
      break;
    }
    default: {
      const int count = form_ == SurfaceForm::kBicubic ? 16 : 4;
      for (int i = 0; i < count; ++i) box.extend(Vec3(cp_[0][i], cp_[1][i], cp_[2][i]) / cp_[3][i]);
      break;
    }
  }
  // Rounding to float, here and while evaluating.
  const Vec3 size = glm::max(glm::abs(box.min), glm::abs(box.max));
  box.grow(4e-7f * std::max({size.x, size.y, size.z}));
  return box;
}

namespace {

/// Whether all times inside the shutter are among `keys` equally spaced ones.
bool timesFit(std::span<const float> times, int keys, const float shutter[2]) {
  for (const float time : times) {
    const double at = (double(time) - shutter[0]) / (double(shutter[1]) - shutter[0]) * (keys - 1);
    if (at > 0 && at < keys - 1 && std::abs(at - std::round(at)) > 1e-3) return false;
  }
  return true;
}

}  // namespace

int gridKeyCount(std::span<const float> sourceTimes, std::span<const DMat4> transform,
                 std::span<const float> transformTimes, const float shutter[2]) {
  if (!(shutter[1] > shutter[0]) || (sourceTimes.size() < 2 && transform.size() < 2)) return 1;
  int fewest = 2;
  for (size_t i = 1; i < transform.size(); ++i)
    if (DMat3(transform[i]) != DMat3(transform[0])) fewest = 5;  // what turns moves on arcs
  if (sourceTimes.size() < 2) sourceTimes = {};
  if (transform.size() < 2) transformTimes = {};
  for (int keys = fewest; keys < kMaxGridKeys; ++keys)
    if (timesFit(sourceTimes, keys, shutter) && timesFit(transformTimes, keys, shutter)) return keys;
  return kMaxGridKeys;
}

KeySpan findKeys(std::span<const float> times, uint32_t keyCount, float time) {
  KeySpan r;
  const size_t n = std::min<size_t>(times.size(), keyCount);
  if (n < 2 || !(time > times[0])) return r;
  if (time >= times[n - 1]) return {uint32_t(n - 1), uint32_t(n - 1), 0};
  const size_t k =
      size_t(std::upper_bound(times.begin(), times.begin() + ptrdiff_t(n), time) - times.begin());
  return {uint32_t(k - 1), uint32_t(k), (double(time) - times[k - 1]) / (double(times[k]) - times[k - 1])};
}

}  // namespace fr::cache
