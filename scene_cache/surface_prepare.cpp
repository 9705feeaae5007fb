// Surfaces from the sources of a finished skeleton.
#include <algorithm>

#include "scene_cache/cache_impl.h"
#include "scene_cache/patch_basis.h"

namespace fr::cache {

PositionKeys positionsAt(const Skeleton& skeleton, const SourcePositions& p, float time) {
  PositionKeys r;
  const auto values = sourceArray<float>(skeleton, p.values);
  if (p.components < 3 || p.components > 4 || p.keyCount < 1 || p.perKey == 0) return r;
  const uint64_t keyFloats = p.perKey * p.components;
  if (p.perKey > values.size() || keyFloats > values.size() ||
      uint64_t(p.keyCount) > values.size() / keyFloats)
    return r;
  const KeySpan k = findKeys(sourceArray<float>(skeleton, p.times), p.keyCount, time);
  r.a = values.data() + k.a * keyFloats;
  r.b = values.data() + k.b * keyFloats;
  r.weight = k.weight;
  r.count = p.perKey;
  r.components = p.components;
  return r;
}

namespace {

void positionValue(const PositionKeys& p, uint64_t i, double* out) {
  const float* a = p.a + i * p.components;
  for (uint32_t c = 0; c < p.components; ++c) out[c] = double(a[c]);
  if (p.weight == 0) return;
  const float* b = p.b + i * p.components;
  for (uint32_t c = 0; c < p.components; ++c) out[c] = out[c] * (1 - p.weight) + double(b[c]) * p.weight;
}

}  // namespace

DVec3 PositionKeys::at(uint64_t i) const {
  double v[4];
  positionValue(*this, i, v);
  return {v[0], v[1], v[2]};
}

bool Surface::prepare(const Skeleton& skeleton, NodeId root, float time, SubdivisionStore* subdivisions) {
  form_ = SurfaceForm::kEmpty;
  const auto roots = skeleton.rootPatches();
  if (root >= roots.size()) return false;
  const RootPatchRecord& patch = roots[root];
  const ObjectRecord& object = skeleton.objects()[patch.object];
  const DMat4 toCache = skeleton.toCache(object.transform, time);
  switch (object.type) {
    case PrimitiveType::kBilinearPatches:
    case PrimitiveType::kBicubicPatches: {
      if (object.type == PrimitiveType::kBilinearPatches && object.source.count == sizeof(PolygonSource)) {
        const auto* s = sourceRecord<PolygonSource>(skeleton, object);
        if (!s) return false;
        const auto patches = sourceArray<PolygonPatch>(skeleton, s->patches);
        const PositionKeys p = positionsAt(skeleton, s->positions, time);
        if (patch.face >= patches.size() || !p.a) return false;
        DVec3 corners[4];
        for (int i = 0; i < 4; ++i) {
          if (patches[patch.face].vertex[i] >= p.count) return false;
          corners[i] = p.at(patches[patch.face].vertex[i]);
        }
        setPolygon(corners, toCache);
        return true;
      }
      const auto* s = sourceRecord<PatchMeshSource>(skeleton, object);
      if (!s || s->patchesU == 0 || s->nu == 0 || s->nv == 0) return false;
      const PositionKeys p = positionsAt(skeleton, s->positions, time);
      if (!p.a || p.count < uint64_t(s->nu) * s->nv) return false;
      const uint32_t pu = patch.face % s->patchesU, pv = patch.face / s->patchesU;
      const bool cubic = object.type == PrimitiveType::kBicubicPatches;
      const uint32_t side = cubic ? 4 : 2;
      double points[16 * 4];
      for (uint32_t j = 0; j < side; ++j) {
        for (uint32_t i = 0; i < side; ++i) {
          const uint64_t u = (uint64_t(pu) * s->stepU + i) % s->nu, v = (uint64_t(pv) * s->stepV + j) % s->nv;
          positionValue(p, v * s->nu + u, points + (j * side + i) * p.components);
        }
      }
      if (cubic) {
        convertToBezier(bezierConversion(s->basisU), bezierConversion(s->basisV), int(p.components), points);
        setBicubic(points, int(p.components), toCache);
      } else {
        setBilinear(points, int(p.components), toCache);
      }
      if (!s->separate) shaderScaleU = float(s->patchesU), shaderScaleV = float(s->patchesV);
      return true;
    }
    case PrimitiveType::kSubdivision: {
      if (!subdivisions) return false;
      subdivision_ = subdivisions->surface(patch.object, time);
      if (!subdivision_ || !subdivision_->hasPatch(patch.face)) return false;
      double points[48];
      if (DMat4 placed; subdivision_->bezier(patch.face, points, &placed)) {
        setBicubic(points, 3, placed);
        return true;
      }
      subdivisionPatch_ = patch.face;
      form_ = SurfaceForm::kSubdivision;
      return true;
    }
    case PrimitiveType::kNurbs: {
      const auto* s = sourceRecord<NurbsSource>(skeleton, object);
      if (!s || s->spansU == 0 || s->orderU < 4 || s->orderV < 4 || s->orderU > kMaxBezierOrder ||
          s->orderV > kMaxBezierOrder)
        return false;
      const PositionKeys p = positionsAt(skeleton, s->positions, time);
      const auto us = sourceArray<NurbsSpan>(skeleton, s->spanU),
                 vs = sourceArray<NurbsSpan>(skeleton, s->spanV);
      const uint64_t perFace = uint64_t(s->orderU) * s->orderV;
      const uint32_t fu = patch.face % s->spansU, fv = patch.face / s->spansU;
      if (!p.a || (uint64_t(patch.face) + 1) * perFace > p.count || fu >= us.size() || fv >= vs.size())
        return false;
      double points[kMaxBezierOrder * kMaxBezierOrder * 4];
      for (uint64_t i = 0; i < perFace; ++i)
        positionValue(p, uint64_t(patch.face) * perFace + i, points + i * p.components);
      setBezier(points, s->orderU, s->orderV, int(p.components), toCache);
      const float du = us[fu].unitHigh - us[fu].unitLow, dv = vs[fv].unitHigh - vs[fv].unitLow;
      shaderScaleU = du > 0 ? 1 / du : 1, shaderScaleV = dv > 0 ? 1 / dv : 1;
      return true;
    }
    case PrimitiveType::kPoints:
    case PrimitiveType::kCurves:
    case PrimitiveType::kMeshlets:
      return false;
    default: {
      const auto* s = sourceRecord<QuadricSource>(skeleton, object);
      if (!s) return false;
      const auto params = sourceArray<double>(skeleton, s->params);
      const KeySpan k = findKeys(sourceArray<float>(skeleton, s->times), s->keyCount, time);
      if (params.size() < (std::max(k.a, k.b) + 1ull) * 8) return false;
      Quadric q{object.type, {}};
      for (int i = 0; i < 8; ++i) {
        const double a = params[k.a * 8 + unsigned(i)], b = params[k.b * 8 + unsigned(i)];
        q.p[i] = k.weight == 0 ? a : a * (1 - k.weight) + b * k.weight;
      }
      setQuadric(q, toCache);
      return true;
    }
  }
}

MeshletView meshletView(const Skeleton& skeleton, const ObjectRecord& object, uint32_t index) {
  MeshletView m;
  m.source = sourceRecord<MeshletSource>(skeleton, object);
  if (!m.source) return m;
  const auto meshlets = sourceArray<MeshletRecord>(skeleton, m.source->meshlets);
  if (index >= meshlets.size()) return m;
  m.record = meshlets[index];
  const auto vertices = sourceArray<uint32_t>(skeleton, m.source->vertices);
  const auto corners = sourceArray<uint32_t>(skeleton, m.source->corners);
  const auto triangles = sourceArray<uint8_t>(skeleton, m.source->triangles);
  const auto faces = sourceArray<uint32_t>(skeleton, m.source->faces);
  const auto inside = [](uint64_t first, uint64_t count, uint64_t size) {
    return first <= size && count <= size - first;
  };
  const MeshletRecord& r = m.record;
  if (r.vertexCount == 0 || r.vertexCount > kMaxMeshletVertices || r.triangleCount > kMaxMeshletTriangles ||
      !inside(r.firstVertex, r.vertexCount, vertices.size()) ||
      !inside(r.firstTriangle, r.triangleCount, triangles.size() / 3))
    return m;
  m.vertices = vertices.subspan(r.firstVertex, r.vertexCount);
  m.triangles = triangles.subspan(r.firstTriangle * 3, r.triangleCount * 3);
  if (inside(r.firstVertex, r.vertexCount, corners.size()))
    m.corners = corners.subspan(r.firstVertex, r.vertexCount);
  if (inside(r.firstTriangle, r.triangleCount, faces.size()))
    m.faces = faces.subspan(r.firstTriangle, r.triangleCount);
  m.valid = true;
  return m;
}

}  // namespace fr::cache
