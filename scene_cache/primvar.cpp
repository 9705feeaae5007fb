#include "scene_cache/primvar.h"

#include <algorithm>
#include <array>

#include "scene_cache/bezier.h"
#include "scene_cache/cache_impl.h"
#include "scene_cache/patch_basis.h"
#include "scene_cache/thin.h"

namespace fr::cache {
namespace {

uint32_t componentsOf(ParamType t) {
  switch (t) {
    case ParamType::kFloat:
      return 1;
    case ParamType::kColor:
    case ParamType::kPoint:
    case ParamType::kVector:
    case ParamType::kNormal:
      return 3;
    case ParamType::kHPoint:
      return 4;
    case ParamType::kMatrix:
      return 16;
    default:
      return 0;
  }
}

}  // namespace

uint32_t floatsPerValue(const ParamRecord& param) {
  const uint64_t width = uint64_t(componentsOf(param.type)) * std::max(1u, param.arrayLength);
  return width > kMaxFloatsPerValue ? 0 : uint32_t(width);
}

namespace {

/// A variable as rows of `width` floats.
struct Values {
  std::span<const float> data;
  uint32_t width = 0;
  uint64_t count() const { return data.size() / width; }
  const float* row(uint64_t i) const { return data.data() + std::min(i, count() - 1) * width; }
};

void fill(const float* row, uint32_t width, size_t n, float* const* out) {
  for (uint32_t c = 0; c < width; ++c) std::fill_n(out[c], n, row[c]);
}

void bilinear(const float* const corner[4], uint32_t width, size_t n, const float* u, const float* v,
              float* const* out) {
  for (uint32_t c = 0; c < width; ++c) {
    const float a = corner[0][c], b = corner[1][c], d = corner[2][c], e = corner[3][c];
    for (size_t i = 0; i < n; ++i) {
      const float su = 1 - u[i], sv = 1 - v[i];
      out[c][i] = lerpSymmetric(lerpSymmetric(a, d, sv, v[i]), lerpSymmetric(b, e, sv, v[i]), su, u[i]);
    }
  }
}

const PatchMeshSource* patchMesh(const Skeleton& s, const ObjectRecord& o) {
  if (o.type != PrimitiveType::kBicubicPatches && (o.type != PrimitiveType::kBilinearPatches || isPolygon(o)))
    return nullptr;
  const auto* m = sourceRecord<PatchMeshSource>(s, o);
  return m && m->patchesU > 0 && m->patchesV > 0 && m->nu > 0 && m->nv > 0 ? m : nullptr;
}

bool patchPrimvar(const PatchMeshSource& m, bool cubic, uint32_t face, ParamClass storage,
                  const Values& values, size_t n, const float* u, const float* v, float* const* out) {
  const uint32_t pu = face % m.patchesU, pv = face / m.patchesU;
  if (storage == ParamClass::kUniform) return fill(values.row(face), values.width, n, out), true;
  if (storage == ParamClass::kVertex && cubic) {
    constexpr uint32_t kPart = 4;
    for (uint32_t first = 0; first < values.width; first += kPart) {
      const uint32_t part = std::min(kPart, values.width - first);
      double g[16 * kPart];
      for (uint32_t j = 0; j < 4; ++j) {
        for (uint32_t i = 0; i < 4; ++i) {
          const uint64_t a = (uint64_t(pu) * m.stepU + i) % m.nu, b = (uint64_t(pv) * m.stepV + j) % m.nv;
          const float* row = values.row(b * m.nu + a) + first;
          for (uint32_t c = 0; c < part; ++c) g[(j * 4 + i) * part + c] = double(row[c]);
        }
      }
      convertToBezier(bezierConversion(m.basisU), bezierConversion(m.basisV), int(part), g);
      for (size_t k = 0; k < n; ++k) {
        float bu[4], bv[4];
        bernstein(u[k], bu), bernstein(v[k], bv);
        for (uint32_t c = 0; c < part; ++c) {
          float q[4];
          for (uint32_t i = 0; i < 4; ++i) {
            q[i] = cubicPoint(float(g[i * part + c]), float(g[(4 + i) * part + c]),
                              float(g[(8 + i) * part + c]), float(g[(12 + i) * part + c]), bv);
          }
          out[first + c][k] = cubicPoint(q[0], q[1], q[2], q[3], bu);
        }
      }
    }
    return true;
  }
  const float* corner[4];
  if (storage == ParamClass::kFaceVarying) {
    for (uint32_t k = 0; k < 4; ++k) corner[k] = values.row(uint64_t(face) * 4 + k);
  } else {
    // Varying: one value a corner of the mesh of patches; bilinear vertex values stand at the same places.
    // Separate patches have two each.
    const uint32_t step = m.separate ? 2 : 1;
    const uint32_t uu = m.separate ? 2 * m.patchesU : m.wrapU ? m.patchesU : m.patchesU + 1;
    const uint32_t vv = m.separate ? 2 * m.patchesV : m.wrapV ? m.patchesV : m.patchesV + 1;
    for (uint32_t k = 0; k < 4; ++k)
      corner[k] = values.row(uint64_t((step * pv + k / 2) % vv) * uu + (step * pu + k % 2) % uu);
  }
  bilinear(corner, values.width, n, u, v, out);
  return true;
}

const NurbsSource* nurbsOf(const Skeleton& s, const ObjectRecord& o) {
  if (o.type != PrimitiveType::kNurbs) return nullptr;
  const auto* n = sourceRecord<NurbsSource>(s, o);
  return n && n->spansU > 0 && n->orderU >= 4 && n->orderU <= kMaxBezierOrder && n->orderV >= 4 &&
                 n->orderV <= kMaxBezierOrder
             ? n
             : nullptr;
}

bool nurbsPrimvar(const Skeleton& s, const NurbsSource& m, uint32_t face, ParamClass storage,
                  const Values& values, size_t n, const float* u, const float* v, float* const* out) {
  const auto us = sourceArray<NurbsSpan>(s, m.spanU), vs = sourceArray<NurbsSpan>(s, m.spanV);
  const uint32_t fu = face % m.spansU, fv = face / m.spansU;
  if (fu >= us.size() || fv >= vs.size()) return false;
  const NurbsSpan &a = us[fu], &b = vs[fv];
  const uint64_t segment = uint64_t(b.segment) * m.segmentsU + a.segment;
  if (storage == ParamClass::kUniform) return fill(values.row(segment), values.width, n, out), true;
  if (storage == ParamClass::kVertex) {
    const uint32_t ou = m.orderU, ov = m.orderV;
    for (size_t k = 0; k < n; ++k) {
      for (uint32_t c = 0; c < values.width; ++c) {
        float q[kMaxBezierOrder], line[kMaxBezierOrder];
        const auto reduce = [](float* p, uint32_t order, float t) {
          for (uint32_t r = order - 1; r > 0; --r) {
            for (uint32_t i = 0; i < r; ++i) p[i] = lerpSymmetric(p[i], p[i + 1], 1 - t, t);
          }
          return p[0];
        };
        for (uint32_t i = 0; i < ou; ++i) {
          for (uint32_t j = 0; j < ov; ++j) line[j] = values.row((uint64_t(face) * ov + j) * ou + i)[c];
          q[i] = reduce(line, ov, v[k]);
        }
        out[c][k] = reduce(q, ou, u[k]);
      }
    }
    return true;
  }
  const float* corner[4];
  for (uint32_t k = 0; k < 4; ++k) {
    corner[k] =
        storage == ParamClass::kFaceVarying
            ? values.row(segment * 4 + k)
            : values.row((uint64_t(b.segment) + k / 2) * (uint64_t(m.segmentsU) + 1) + a.segment + k % 2);
  }
  for (size_t k = 0; k < n; ++k) {
    const float x = a.segLow + (a.segHigh - a.segLow) * u[k], y = b.segLow + (b.segHigh - b.segLow) * v[k];
    for (uint32_t c = 0; c < values.width; ++c) {
      out[c][k] = lerpSymmetric(lerpSymmetric(corner[0][c], corner[2][c], 1 - y, y),
                                lerpSymmetric(corner[1][c], corner[3][c], 1 - y, y), 1 - x, x);
    }
  }
  return true;
}

}  // namespace

bool isPolygon(const ObjectRecord& o) {
  return o.type == PrimitiveType::kBilinearPatches && o.source.count == sizeof(PolygonSource);
}

bool patchScale(const Skeleton& s, NodeId root, float* scaleU, float* scaleV, float* offsetU,
                float* offsetV) {
  const RootPatchRecord& patch = s.rootPatches()[root];
  const ObjectRecord& object = s.objects()[patch.object];
  if (const NurbsSource* nurbs = nurbsOf(s, object)) {
    const auto us = sourceArray<NurbsSpan>(s, nurbs->spanU), vs = sourceArray<NurbsSpan>(s, nurbs->spanV);
    const uint32_t fu = patch.face % nurbs->spansU, fv = patch.face / nurbs->spansU;
    if (fu >= us.size() || fv >= vs.size()) return false;
    const float du = us[fu].unitHigh - us[fu].unitLow, dv = vs[fv].unitHigh - vs[fv].unitLow;
    if (!(du > 0) || !(dv > 0)) return false;
    *scaleU = 1 / du, *scaleV = 1 / dv;
    if (offsetU) *offsetU = us[fu].unitLow / du;
    if (offsetV) *offsetV = vs[fv].unitLow / dv;
    return true;
  }
  const PatchMeshSource* m = patchMesh(s, object);
  if (!m || m->separate) return false;
  *scaleU = float(m->patchesU), *scaleV = float(m->patchesV);
  if (offsetU) *offsetU = float(patch.face % m->patchesU);
  if (offsetV) *offsetV = float(patch.face / m->patchesU);
  return true;
}

void objectSpaceXy(const Skeleton& s, NodeId root, size_t n, const uint32_t* cell, const float* u,
                   const float* v, float* outS, float* outT) {
  const RootPatchRecord& patch = s.rootPatches()[root];
  const ObjectRecord& object = s.objects()[patch.object];
  const float time = s.camera().shutter[0];
  if (object.type == PrimitiveType::kMeshlets) {
    const MeshletView m = meshletView(s, object, patch.face);
    if (!m.valid || m.triangles.empty()) return;
    const PositionKeys p = positionsAt(s, m.source->positions, time);
    if (p.count == 0) return;
    for (size_t i = 0; i < n; ++i) {
      const uint32_t t = std::min(cell ? cell[i] : 0, m.record.triangleCount - 1);
      double x = 0, y = 0;
      const double w[3] = {1.0 - u[i] - v[i], u[i], v[i]};
      for (uint32_t c = 0; c < 3; ++c) {
        const uint32_t k = std::min<uint32_t>(m.triangles[t * 3 + c], m.record.vertexCount - 1);
        const DVec3 q = p.at(std::min<uint64_t>(m.vertices[k], p.count - 1));
        x += w[c] * q.x, y += w[c] * q.y;
      }
      if (outS) outS[i] = float(x);
      if (outT) outT[i] = float(y);
    }
    return;
  }
  const auto* source = sourceRecord<PolygonSource>(s, object);
  if (!source) return;
  const auto patches = sourceArray<PolygonPatch>(s, source->patches);
  const PositionKeys p = positionsAt(s, source->positions, time);
  if (patch.face >= patches.size() || p.count == 0) return;
  float xy[4][2];
  for (int k = 0; k < 4; ++k) {
    const DVec3 q = p.at(std::min<uint64_t>(patches[patch.face].vertex[k], p.count - 1));
    xy[k][0] = float(q.x), xy[k][1] = float(q.y);
  }
  for (size_t i = 0; i < n; ++i) {
    const float a = u[i], b = v[i];
    const float w[4] = {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
    float sum[2] = {};
    for (int k = 0; k < 4; ++k) sum[0] += w[k] * xy[k][0], sum[1] += w[k] * xy[k][1];
    if (outS) outS[i] = sum[0];
    if (outT) outT[i] = sum[1];
  }
}

bool evaluatePrimvarOf(const Skeleton& s, SubdivisionStore& subdivisions, NodeId root,
                       const ParamRecord& given, size_t n, const uint32_t* cell, const float* u,
                       const float* v, float* const* out) {
  Values values;
  values.data = s.floats(given);
  const uint32_t width = floatsPerValue(given);
  if (width == 0 || values.data.size() < width) return false;
  values.width = width;
  if (given.storage == ParamClass::kConstant || values.count() == 1)
    return fill(values.row(0), values.width, n, out), true;

  const RootPatchRecord& patch = s.rootPatches()[root];
  const ObjectRecord& object = s.objects()[patch.object];
  // Only subdivision tells the two apart.
  ParamRecord param = given;
  if (param.storage == ParamClass::kFaceVertex && object.type != PrimitiveType::kSubdivision)
    param.storage = ParamClass::kFaceVarying;
  if (object.type == PrimitiveType::kMeshlets) {
    const MeshletView m = meshletView(s, object, patch.face);
    if (!m.valid || m.triangles.empty()) return false;
    const auto index = param.storage == ParamClass::kFaceVarying ? m.corners : m.vertices;
    if (index.empty()) return false;
    for (size_t i = 0; i < n; ++i) {
      const uint32_t t = std::min(cell ? cell[i] : 0, m.record.triangleCount - 1);
      if (param.storage == ParamClass::kUniform) {
        const float* row = values.row(m.faces.empty() ? 0 : m.faces[t]);
        for (uint32_t c = 0; c < values.width; ++c) out[c][i] = row[c];
        continue;
      }
      const float* row[3];
      for (uint32_t c = 0; c < 3; ++c)
        row[c] = values.row(index[std::min<uint32_t>(m.triangles[t * 3 + c], m.record.vertexCount - 1)]);
      const float w = 1 - u[i] - v[i];
      for (uint32_t c = 0; c < values.width; ++c)
        out[c][i] = row[0][c] * w + row[1][c] * u[i] + row[2][c] * v[i];
    }
    return true;
  }
  if (isThin(object))
    return thinPrimvar(s, object, patch.face, param, {values.data, values.width, param.storage}, n, cell, u,
                       v, out);
  if (isPolygon(object)) {
    const auto* source = sourceRecord<PolygonSource>(s, object);
    if (!source) return false;
    const auto patches = sourceArray<PolygonPatch>(s, source->patches);
    if (patch.face >= patches.size()) return false;
    const PolygonPatch& p = patches[patch.face];
    if (param.storage == ParamClass::kUniform) return fill(values.row(p.face), values.width, n, out), true;
    const uint32_t* index = param.storage == ParamClass::kFaceVarying ? p.corner : p.vertex;
    const float* const corner[4] = {values.row(index[0]), values.row(index[1]), values.row(index[2]),
                                    values.row(index[3])};
    return bilinear(corner, values.width, n, u, v, out), true;
  }
  if (const PatchMeshSource* m = patchMesh(s, object)) {
    return patchPrimvar(*m, object.type == PrimitiveType::kBicubicPatches, patch.face, param.storage, values,
                        n, u, v, out);
  }
  if (const NurbsSource* m = nurbsOf(s, object))
    return nurbsPrimvar(s, *m, patch.face, param.storage, values, n, u, v, out);
  if (object.type == PrimitiveType::kSubdivision) {
    return subdivisions.evaluate(patch.object, patch.face, param, values.data, values.width, n, u, v, out);
  }
  // Quadrics: four corners.
  if (param.storage == ParamClass::kUniform) return fill(values.row(0), values.width, n, out), true;
  const float* const corner[4] = {values.row(0), values.row(1), values.row(2), values.row(3)};
  return bilinear(corner, values.width, n, u, v, out), true;
}

}  // namespace fr::cache
