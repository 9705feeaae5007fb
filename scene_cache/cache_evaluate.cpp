// Attributes of surface points: positions, normals, derivatives, primitive variables, parameters.
#include <algorithm>
#include <cmath>

#include "scene_cache/bezier.h"
#include "scene_cache/cache_impl.h"
#include "scene_cache/packed_normal.h"
#include "scene_cache/primvar.h"
#include "scene_cache/thin.h"
#include "scene_cache/trim.h"

namespace fr::cache {
namespace {

constexpr size_t kBatch = 64;

void normalizeOr(Vec3& n, const Vec3& otherwise) {
  const float square = glm::dot(n, n);
  n = square > 0 && std::isfinite(square) ? n / std::sqrt(square) : otherwise;
}

/// Corners of a meshlet's triangle in cache space.
struct MeshletPoints {
  MeshletView view;
  PositionKeys positions;
  DMat4 toCache;
  bool prepare(const Skeleton& s, const ObjectRecord& object, uint32_t face, float time) {
    view = meshletView(s, object, face);
    if (!view.valid || view.triangles.empty()) return false;
    positions = positionsAt(s, view.source->positions, time);
    toCache = s.toCache(object.transform, time);
    return positions.count > 0;
  }
  void triangle(uint32_t cell, Vec3 p[3]) const {
    const uint32_t t = std::min<uint32_t>(cell, view.record.triangleCount - 1);
    for (uint32_t c = 0; c < 3; ++c) {
      const uint32_t i = std::min<uint32_t>(view.triangles[t * 3 + c], view.record.vertexCount - 1);
      p[c] = Vec3(
          transformPoint(toCache, positions.at(std::min<uint64_t>(view.vertices[i], positions.count - 1))));
    }
  }
};

Vec3 triangleNormal(const Vec3 p[3]) {
  const DVec3 n = glm::cross(DVec3(p[1]) - DVec3(p[0]), DVec3(p[2]) - DVec3(p[0]));
  const double length = glm::length(n);
  return length > 0 ? Vec3(n / length) : Vec3(0, 0, 1);
}

/// The "N" (or, for faces, "Np") variable that overrides the surface's own normal.
const ParamRecord* givenNormals(const Skeleton& s, const ObjectRecord& o) {
  for (const char* name : {"N", "Np"}) {
    const ParamRecord* p = s.find(o.primvars, name);
    if (p && p->arrayLength == 1 &&
        (p->type == ParamType::kNormal || p->type == ParamType::kVector || p->type == ParamType::kPoint ||
         p->type == ParamType::kColor))
      return p;
  }
  return nullptr;
}

}  // namespace

void SceneCache::Impl::surfaceNormals(const Skeleton& s, NodeId root, float time, size_t n,
                                      const uint32_t* cell, const float* u, const float* v, float* const* N,
                                      float* const* Ng) const {
  const RootPatchRecord& patch = s.rootPatches()[root];
  const ObjectRecord& object = s.objects()[patch.object];
  const float sign = normalSign(s.attributes()[object.attributes]);
  float* const* first = Ng ? Ng : N;
  if (object.type == PrimitiveType::kMeshlets) {
    MeshletPoints m;
    const bool ok = m.prepare(s, object, patch.face, time);
    for (size_t i = 0; i < n; ++i) {
      Vec3 normal(0, 0, 1);
      if (ok) {
        Vec3 p[3];
        m.triangle(cell ? cell[i] : 0, p);
        normal = triangleNormal(p) * sign;
      }
      for (int c = 0; c < 3; ++c) first[c][i] = normal[c];
    }
  } else if (isThin(object)) {
    thinSurface(s, object, patch.face, time, eye, n, cell, u, v, nullptr, nullptr, nullptr, first);
    if (sign < 0) {
      for (int c = 0; c < 3; ++c) {
        for (size_t i = 0; i < n; ++i) first[c][i] = -first[c][i];
      }
    }
  } else {
    Surface surface;
    if (surface.prepare(s, root, time, subdivisions.get())) {
      surface.normals(n, u, v, first);
      if (sign < 0) {
        for (int c = 0; c < 3; ++c) {
          for (size_t i = 0; i < n; ++i) first[c][i] = -first[c][i];
        }
      }
    } else {
      for (int c = 0; c < 3; ++c) std::fill_n(first[c], n, c == 2 ? 1.0f : 0.0f);
    }
  }
  if (!N) return;
  if (N != first) {
    for (int c = 0; c < 3; ++c) std::copy_n(first[c], n, N[c]);
  }
  const ParamRecord* given = givenNormals(s, object);
  if (!given) return;
  const Mat3 m(normalMatrix(s.toCache(object.transform, time)));
  for (size_t at = 0; at < n; at += kBatch) {
    const size_t count = std::min(kBatch, n - at);
    float values[3][kBatch];
    float* const out[3] = {values[0], values[1], values[2]};
    if (!evaluatePrimvarOf(s, *subdivisions, root, *given, count, cell ? cell + at : nullptr, u + at, v + at,
                           out))
      return;
    for (size_t i = 0; i < count; ++i) {
      Vec3 normal = m * Vec3(values[0][i], values[1][i], values[2][i]);
      normalizeOr(normal, Vec3(N[0][at + i], N[1][at + i], N[2][at + i]));
      for (int c = 0; c < 3; ++c) N[c][at + i] = normal[c];
    }
  }
}

void SceneCache::evaluateSurface(NodeId id, size_t n, const uint32_t* cell, const float* u, const float* v,
                                 const SurfaceOut& out) const {
  const Impl& d = *impl_;
  const NodeId root = node(id).root;
  const RootPatchRecord& patch = rootOf(id);
  const ObjectRecord& object = skeleton_.objects()[patch.object];
  const float time = skeleton_.camera().shutter[0];
  const bool wantDerivatives = out.dPdu[0] || out.dPdv[0];
  if (object.type == PrimitiveType::kMeshlets) {
    if (out.P[0] || wantDerivatives) {
      MeshletPoints m;
      const bool ok = m.prepare(skeleton_, object, patch.face, time);
      for (size_t i = 0; i < n; ++i) {
        Vec3 p[3] = {};
        if (ok) m.triangle(cell ? cell[i] : 0, p);
        const Vec3 at = p[0] * (1 - u[i] - v[i]) + p[1] * u[i] + p[2] * v[i];
        for (int c = 0; c < 3; ++c) {
          if (out.P[0]) out.P[c][i] = at[c];
          if (out.dPdu[0]) out.dPdu[c][i] = p[1][c] - p[0][c];
          if (out.dPdv[0]) out.dPdv[c][i] = p[2][c] - p[0][c];
        }
      }
    }
  } else if (isThin(object)) {
    if (out.P[0] || wantDerivatives)
      thinSurface(skeleton_, object, patch.face, time, d.eye, n, cell, u, v, out.P[0] ? out.P : nullptr,
                  out.dPdu[0] ? out.dPdu : nullptr, out.dPdv[0] ? out.dPdv : nullptr, nullptr);
  } else if (out.P[0] || wantDerivatives) {
    Surface surface;
    if (surface.prepare(skeleton_, root, time, d.subdivisions.get())) {
      surface.evaluate(n, u, v, out.P[0] ? out.P : nullptr, out.dPdu[0] ? out.dPdu : nullptr,
                       out.dPdv[0] ? out.dPdv : nullptr);
    } else {
      for (int c = 0; c < 3; ++c) {
        for (float* a : {out.P[c], out.dPdu[c], out.dPdv[c]}) {
          if (a) std::fill_n(a, n, 0.0f);
        }
      }
    }
  }
  if (out.N[0] || out.Ng[0]) {
    d.surfaceNormals(skeleton_, root, time, n, cell, u, v, out.N[0] ? out.N : nullptr,
                     out.Ng[0] ? out.Ng : nullptr);
  }
}

void SceneCache::evaluateDiced(NodeId id, size_t n, const uint32_t* cell, const float* u, const float* v,
                               const SurfaceOut& out) const {
  const ResolvedNode r = peek(id);
  const GridRecord* g = r.state == NodeState::kGrid ? r.grid : nullptr;
  if (!g) return evaluateSurface(id, n, cell, u, v, out);
  const GridView grid = view(*g);
  const bool displaced = grid.normals != nullptr;
  SurfaceOut smooth = out;
  for (int c = 0; c < 3; ++c) {
    smooth.P[c] = nullptr;
    if (displaced) smooth.N[c] = smooth.Ng[c] = smooth.dPdu[c] = smooth.dPdv[c] = nullptr;
  }
  if (smooth.N[0] || smooth.Ng[0] || smooth.dPdu[0] || smooth.dPdv[0])
    evaluateSurface(id, n, cell, u, v, smooth);
  if (!displaced && !out.P[0]) return;

  const float sign = normalSign(attributesOf(id));
  const PatchNode& place = node(id);
  const double scaleU = std::ldexp(double(g->nu), place.du), scaleV = std::ldexp(double(g->nv), place.dv);
  for (size_t i = 0; i < n; ++i) {
    Vec3 P, normal, du, dv;
    if (g->kind == GridKind::kMeshlet) {
      const uint32_t t = std::min<uint32_t>(cell ? cell[i] : 0, g->nv - 1u);
      Vec3 p[3], m[3];
      for (uint32_t c = 0; c < 3; ++c) {
        const uint32_t k = std::min<uint32_t>(grid.indices[t * 3 + c], g->nu - 1u);
        for (int x = 0; x < 3; ++x) p[c][x] = grid.positions[k * 3 + unsigned(x)];
        m[c] = displaced ? unpackNormal(grid.normals[k]) : Vec3(0);
      }
      const float w = 1 - u[i] - v[i];
      P = p[0] * w + p[1] * u[i] + p[2] * v[i];
      normal = m[0] * w + m[1] * u[i] + m[2] * v[i];
      du = p[1] - p[0], dv = p[2] - p[0];
    } else {
      const double x = std::clamp(double(u[i]) * scaleU - double(place.iu) * g->nu, 0.0, double(g->nu));
      const double y = std::clamp(double(v[i]) * scaleV - double(place.iv) * g->nv, 0.0, double(g->nv));
      const int ci = std::min(int(x), g->nu - 1), cj = std::min(int(y), g->nv - 1);
      const float fu = float(x - ci), fv = float(y - cj);
      const auto at = [&](const float* data, size_t stride, int a, int b) {
        const float* p = data + (size_t(b) * stride + size_t(a)) * 3;
        return Vec3(p[0], p[1], p[2]);
      };
      const auto mix = [&](auto&& corner) {
        const Vec3 low = corner(ci, cj) * (1 - fu) + corner(ci + 1, cj) * fu;
        const Vec3 high = corner(ci, cj + 1) * (1 - fu) + corner(ci + 1, cj + 1) * fu;
        return low * (1 - fv) + high * fv;
      };
      P = mix([&](int a, int b) { return at(grid.positions, g->rowStride, a, b); });
      normal = Vec3(0);
      if (displaced) {
        normal = mix(
            [&](int a, int b) { return unpackNormal(grid.normals[size_t(b) * (g->nu + 1u) + size_t(a)]); });
        const size_t stride = g->rowStride;
        const float* p = grid.positions;
        du = (at(p, stride, ci + 1, cj) - at(p, stride, ci, cj)) * (1 - fv) +
             (at(p, stride, ci + 1, cj + 1) - at(p, stride, ci, cj + 1)) * fv;
        dv = (at(p, stride, ci, cj + 1) - at(p, stride, ci, cj)) * (1 - fu) +
             (at(p, stride, ci + 1, cj + 1) - at(p, stride, ci + 1, cj)) * fu;
      }
    }
    Vec3 face = displaced ? glm::cross(du, dv) * sign : Vec3(0);
    if (displaced) {
      normalizeOr(face, Vec3(0, 0, 1));
      normalizeOr(normal, face);
      normalizeOr(face, normal);
      if (g->kind == GridKind::kGrid) {
        float sx = 1, sy = 1;
        patchScale(skeleton_, place.root, &sx, &sy);
        du *= float(scaleU) * sx, dv *= float(scaleV) * sy;
      }
    }
    if (grid.placement) P = grid.placed(&P.x);
    for (int c = 0; c < 3; ++c) {
      if (out.P[c]) out.P[c][i] = P[c];
      if (!displaced) continue;
      if (out.N[c]) out.N[c][i] = normal[c];
      if (out.Ng[c]) out.Ng[c][i] = face[c];
      if (out.dPdu[c]) out.dPdu[c][i] = du[c];
      if (out.dPdv[c]) out.dPdv[c][i] = dv[c];
    }
  }
}

void SceneCache::vertexParameters(const GridRecord& g, uint32_t* cell, float* u, float* v) const {
  if (g.flags & kGridSprites) {
    const uint32_t count = g.nu / g.rowStride;
    for (uint32_t i = 0; i < count; ++i) cell[i] = i * (g.rowStride - 2), u[i] = v[i] = 1.0f / 3;
    return;
  }
  if (g.kind == GridKind::kMeshlet) {
    const GridView m = view(g);
    for (uint32_t i = 0; i < g.nu; ++i) cell[i] = 0, u[i] = v[i] = 0;
    for (uint32_t t = g.nv; t-- > 0;) {
      for (uint32_t c = 0; c < 3; ++c) {
        const uint32_t i = std::min<uint32_t>(m.indices[t * 3 + c], g.nu - 1u);
        cell[i] = t, u[i] = c == 1 ? 1.0f : 0.0f, v[i] = c == 2 ? 1.0f : 0.0f;
      }
    }
    return;
  }
  const NodeRect rect = rectOf(node(g.node));
  const int log2Nu = log2Ceil(g.nu), log2Nv = log2Ceil(g.nv);
  size_t k = 0;
  for (int j = 0; j <= g.nv; ++j) {
    for (int i = 0; i <= g.nu; ++i, ++k) {
      if (cell) cell[k] = 0;
      collapsedParameters(rect, log2Nu, log2Nv, g.edgeShift, i, j, u + k, v + k);
    }
  }
}

bool SceneCache::evaluatePrimvar(NodeId id, const ParamRecord& param, size_t n, const uint32_t* cell,
                                 const float* u, const float* v, float* const* out) const {
  return evaluatePrimvarOf(skeleton_, *impl_->subdivisions, node(id).root, param, n, cell, u, v, out);
}

void SceneCache::evaluateParameters(NodeId id, size_t n, const uint32_t* cell, const float* u, const float* v,
                                    float* uOut, float* vOut, float* s, float* t) const {
  const NodeId root = node(id).root;
  const RootPatchRecord& patch = rootOf(id);
  const ObjectRecord& object = skeleton_.objects()[patch.object];
  float scaleU = 1, scaleV = 1, offsetU = 0, offsetV = 0;
  if (isThin(object)) {
    CurvesView curves;
    const bool isCurves =
        object.type == PrimitiveType::kCurves &&
        curves.prepare(skeleton_, object, patch.face, skeleton_.camera().shutter[0], impl_->eye);
    for (size_t i = 0; i < n; ++i) {
      // A point has one place: the middle of its disk.
      float a = 0.5f, b = 0.5f;
      if (isCurves) {
        const CurvesView::Place p = curves.place(cell ? cell[i] : 0, u[i], v[i]);
        a = p.across, b = curves.along(p);
      }
      if (uOut) uOut[i] = a;
      if (vOut) vOut[i] = b;
      if (s) s[i] = a;
      if (t) t[i] = b;
    }
  } else if (patchScale(skeleton_, root, &scaleU, &scaleV, &offsetU, &offsetV)) {
    for (size_t i = 0; i < n; ++i) {
      const float a = (u[i] + offsetU) / scaleU, b = (v[i] + offsetV) / scaleV;
      if (uOut) uOut[i] = a;
      if (vOut) vOut[i] = b;
      if (s) s[i] = a;
      if (t) t[i] = b;
    }
  } else {
    for (size_t i = 0; i < n; ++i) {
      if (uOut) uOut[i] = u[i];
      if (vOut) vOut[i] = v[i];
      if (s) s[i] = u[i];
      if (t) t[i] = v[i];
    }
  }
  if (!s && !t) return;
  const auto isFloats = [](const ParamRecord* p, uint32_t length) {
    return p && p->type == ParamType::kFloat && p->arrayLength == length;
  };
  const ParamRecord* st = skeleton_.find(object.primvars, "st");
  const ParamRecord* ps = skeleton_.find(object.primvars, "s");
  const ParamRecord* pt = skeleton_.find(object.primvars, "t");
  if (!isFloats(st, 2)) st = nullptr;
  if (!isFloats(ps, 1)) ps = nullptr;
  if (!isFloats(pt, 1)) pt = nullptr;
  if (!st && (!ps || !pt)) {
    // Polygons: from x and y in object space (RISpec 3.2, "Polygons").
    if (object.type == PrimitiveType::kMeshlets || isPolygon(object)) {
      objectSpaceXy(skeleton_, root, n, cell, u, v, s, t);
    }
    const float* c = attributesOf(id).textureCoordinates;
    for (size_t i = 0; i < n; ++i) {
      const float a = s ? s[i] : 0, b = t ? t[i] : 0;
      const float w[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
      if (s && t) {
        s[i] = w[0] * c[0] + w[1] * c[2] + w[2] * c[4] + w[3] * c[6];
        t[i] = w[0] * c[1] + w[1] * c[3] + w[2] * c[5] + w[3] * c[7];
      }
    }
  }
  for (size_t at = 0; at < n; at += kBatch) {
    const size_t count = std::min(kBatch, n - at);
    const uint32_t* cells = cell ? cell + at : nullptr;
    if (st) {
      float unused[kBatch];
      float* const out[2] = {s ? s + at : unused, t ? t + at : unused};
      evaluatePrimvarOf(skeleton_, *impl_->subdivisions, root, *st, count, cells, u + at, v + at, out);
      continue;
    }
    float* const outS[1] = {s + at};
    float* const outT[1] = {t + at};
    if (ps && s)
      evaluatePrimvarOf(skeleton_, *impl_->subdivisions, root, *ps, count, cells, u + at, v + at, outS);
    if (pt && t)
      evaluatePrimvarOf(skeleton_, *impl_->subdivisions, root, *pt, count, cells, u + at, v + at, outT);
  }
}

PatchTrim SceneCache::trimOf(NodeId id) const { return patchTrim(skeleton_, node(id).root); }

}  // namespace fr::cache
