// The functions behind the tables (tables.cpp): one per kind of question, whatever the overload.
//
// argv[0] is the result, then the arguments in the order of the spec. Arguments are shared with the host,
// which may copy every one back: only those that are outputs are written. Inputs are in world space. Outputs
// go back to the space of the last four arguments, the world's origin and axes as the shader sees them; the
// 1998 forms (functions of the table "rayserver") have no such arguments and answer in world space, as they
// did.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/random.h"
#include "frankenray/shadeops/ray_session.h"
#include "frankenray/shadeops/shadeop_abi.h"

namespace fr::shadeops {
namespace {

using Floats = float*;

Floats at(void** argv, int i) { return static_cast<Floats>(argv[i]); }

void load(double out[3], const float* in) {
  for (int c = 0; c < 3; ++c) out[c] = double(in[c]);
}

/// World space to the shader's current space.
struct Frame {
  double origin[3] = {0, 0, 0};
  double axis[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  double normalAxis[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};  // inverse transpose

  Frame() = default;
  /// argv[first] ... argv[first + 3].
  Frame(void** argv, int first) {
    double m[3][3], o[3];
    load(o, at(argv, first));
    for (int a = 0; a < 3; ++a) load(m[a], at(argv, first + 1 + a));
    double n[3][3];
    for (int a = 0; a < 3; ++a) {
      const double* const b = m[(a + 1) % 3];
      const double* const c = m[(a + 2) % 3];
      for (int k = 0; k < 3; ++k) n[a][k] = b[(k + 1) % 3] * c[(k + 2) % 3] - b[(k + 2) % 3] * c[(k + 1) % 3];
    }
    const double determinant = m[0][0] * n[0][0] + m[0][1] * n[0][1] + m[0][2] * n[0][2];
    // A host that does not know "world" gives nothing of use: the answers stay in world space.
    if (!(std::abs(determinant) > 0) || !std::isfinite(determinant)) return;
    std::memcpy(origin, o, sizeof o);
    std::memcpy(axis, m, sizeof m);
    for (int a = 0; a < 3; ++a)
      for (int k = 0; k < 3; ++k) normalAxis[a][k] = n[a][k] / determinant;
  }

  static void apply(const double a[3][3], const double o[3], const double in[3], float* out) {
    for (int k = 0; k < 3; ++k)
      out[k] = float(in[0] * a[0][k] + in[1] * a[1][k] + in[2] * a[2][k] + (o ? o[k] : 0));
  }
  void point(const double p[3], float* out) const { apply(axis, origin, p, out); }
  void vector(const float v[3], float* out) const {
    const double d[3] = {v[0], v[1], v[2]};
    apply(axis, nullptr, d, out);
  }
  void normal(const float v[3], float* out) const {
    const double d[3] = {v[0], v[1], v[2]};
    apply(normalAxis, nullptr, d, out);
  }
  /// A distance along `direction`, which a camera with a scale sees longer or shorter.
  float distance(float t, const double direction[3]) const {
    double length2 = 0, seen2 = 0;
    for (int k = 0; k < 3; ++k) {
      const double s = direction[0] * axis[0][k] + direction[1] * axis[1][k] + direction[2] * axis[2][k];
      seen2 += s * s;
      length2 += direction[k] * direction[k];
    }
    return length2 > 0 ? float(double(t) * std::sqrt(seen2 / length2)) : t;
  }
};

/// Asks about argv[1], argv[2].
frankenray_hit question(int kind, void** argv) {
  frankenray_ray ray = FRANKENRAY_RAY_INIT;
  frankenray_hit hit = FRANKENRAY_HIT_INIT;
  ray.kind = kind;
  load(ray.origin, at(argv, 1));
  load(ray.direction, at(argv, 2));
  ask(ray, hit);
  return hit;
}

void colorOf(int kind, void** argv) {
  const frankenray_hit hit = question(kind, argv);
  std::copy_n(hit.color, 3, at(argv, 0));
}

void hitTest(void** argv, const Frame& frame) {
  const frankenray_hit hit = question(FRANKENRAY_HITTEST, argv);
  if (!(hit.distance < FRANKENRAY_NO_HIT)) {
    *at(argv, 0) = FRANKENRAY_NO_HIT;
    return;
  }
  double direction[3];
  load(direction, at(argv, 2));
  *at(argv, 0) = frame.distance(hit.distance, direction);
  frame.point(hit.position, at(argv, 3));
  frame.normal(hit.normal, at(argv, 4));
}

void fullTrace(void** argv, const Frame& frame) {
  const frankenray_hit hit = question(FRANKENRAY_FULLTRACE, argv);
  double direction[3];
  load(direction, at(argv, 2));
  std::copy_n(hit.color, 3, at(argv, 3));
  if (hit.distance < FRANKENRAY_NO_HIT_TRACE) {
    *at(argv, 4) = frame.distance(hit.distance, direction);
    frame.point(hit.position, at(argv, 5));
    frame.normal(hit.normal, at(argv, 6));
  } else {
    *at(argv, 4) = FRANKENRAY_NO_HIT_TRACE;
  }
  if (hit.miss_depth > 0) {
    frame.point(hit.miss_position, at(argv, 7));
    frame.vector(hit.miss_direction, at(argv, 8));
  }
  *at(argv, 0) = hit.miss_depth;
}

/// Mean of what comes from all sides of the normal, weighted by the cosine: as the built-in rs_indirect().
void indirect(void** argv) {
  constexpr uint32_t kSide = 4, kSamples = kSide * kSide;
  double P[3], N[3];
  load(P, at(argv, 1));
  load(N, at(argv, 2));
  float* const result = at(argv, 0);
  result[0] = result[1] = result[2] = 0;
  const double length = std::sqrt(N[0] * N[0] + N[1] * N[1] + N[2] * N[2]);
  if (!(length > 0) || !std::isfinite(length)) return;
  for (double& n : N) n /= length;
  // A basis around N (Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017).
  const double sign = std::copysign(1.0, N[2]), a = -1.0 / (sign + N[2]), b = N[0] * N[1] * a;
  const double X[3] = {1 + sign * N[0] * N[0] * a, sign * b, -sign * N[0]};
  const double Y[3] = {b, sign + N[1] * N[1] * a, -N[1]};
  const uint64_t seed = seedOf(P, N);
  float directions[kSamples * 3];
  for (uint32_t i = 0; i < kSamples; ++i) {
    const uint64_t h = hashStep(seed, i);
    const double u = (double(i % kSide) + double(h >> 40) * 0x1p-24) / kSide;
    const double v = (double(i / kSide) + double((h >> 8) & 0xffffff) * 0x1p-24) / kSide;
    const double r = std::sqrt(u), phi = 6.283185307179586 * v, z = std::sqrt(std::max(0.0, 1 - u));
    for (int c = 0; c < 3; ++c)
      directions[3 * i + uint32_t(c)] = float(r * std::cos(phi) * X[c] + r * std::sin(phi) * Y[c] + z * N[c]);
  }
  float sum[3];
  if (!sumOfTraces(P, directions, kSamples, sum)) return;
  for (int c = 0; c < 3; ++c) result[c] = sum[c] / float(kSamples);
}

}  // namespace
}  // namespace fr::shadeops

using namespace fr::shadeops;

// What the tables name. Hosts expect int or void to come back: an int that nobody reads harms neither.

FR_SHADEOP_EXPORT void* rayserver_init(int, void*) {
  addUser();
  return nullptr;
}
FR_SHADEOP_EXPORT void rayserver_shutdown(void*) { removeUser(); }

FR_SHADEOP_EXPORT int rayserver_trace(void*, int, void** argv) {
  colorOf(FRANKENRAY_TRACE, argv);
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_visibility(void*, int, void** argv) {
  colorOf(FRANKENRAY_VISIBILITY, argv);
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_rayhittest(void*, int, void** argv) {
  hitTest(argv, Frame(argv, 5));
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_fulltrace(void*, int, void** argv) {
  fullTrace(argv, Frame(argv, 9));
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_indirect(void*, int, void** argv) {
  indirect(argv);
  return 0;
}
/// raylevel() and isshadowray(): shaders of another renderer are never run by a ray.
FR_SHADEOP_EXPORT int rayserver_zero(void*, int, void** argv) {
  *at(argv, 0) = 0;
  return 0;
}

// As the header of 1998-2000 called them: all spaces are world space.

FR_SHADEOP_EXPORT int rayserver_rayhittest_1998(void*, int, void** argv) {
  hitTest(argv, Frame());
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_fulltrace_1998(void*, int, void** argv) {
  fullTrace(argv, Frame());
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_areashadow_1998(void*, int, void** argv) {
  static const char message[] =
      "areashadow() of an old rayserver.h names a light, which the server cannot find: lit. Compile the "
      "shader "
      "with the rayserver.h of frankenrender.";
  sayOnce(message, message);
  std::fill_n(at(argv, 0), 3, 1.0f);
  return 0;
}
FR_SHADEOP_EXPORT int rayserver_photon_1998(void*, int, void** argv) {
  static const char message[] = "rs_caustic(): photon maps are not available; black.";
  sayOnce(message, message);
  std::fill_n(at(argv, 0), 3, 0.0f);
  return 0;
}
