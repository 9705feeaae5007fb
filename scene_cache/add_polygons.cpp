// Polygons and polygon meshes: large faces become bilinear patches, small ones meshlets.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "scene_cache/add_primitive.h"
#include "scene_cache/dice_metric.h"
#include "scene_cache/meshlet_builder.h"
#include "scene_cache/motion.h"
#include "scene_cache/triangulate.h"

namespace fr::cache {
namespace {

/// The four kinds of polygon requests in one shape: faces of loops of vertices. An empty array means the
/// obvious: one loop a face, vertices in order.
struct Faces {
  std::span<const int> loops, sizes, vertices;
  std::vector<int> own;
  size_t faceCount = 0;
};

Faces facesOf(const ri::Primitive& p, size_t points) {
  Faces f;
  if (std::holds_alternative<ri::Polygon>(p)) {
    f.own = {int(points)};
    f.sizes = f.own;
    f.faceCount = 1;
  } else if (const auto* g = std::get_if<ri::GeneralPolygon>(&p)) {
    f.own = {int(g->nverts.size())};
    f.loops = f.own;
    f.sizes = g->nverts;
    f.faceCount = 1;
  } else if (const auto* m = std::get_if<ri::PointsPolygons>(&p)) {
    f.sizes = m->nverts, f.vertices = m->verts;
    f.faceCount = m->nverts.size();
  } else {
    const auto& n = std::get<ri::PointsGeneralPolygons>(p);
    f.loops = n.nloops, f.sizes = n.nverts, f.vertices = n.verts;
    f.faceCount = n.nloops.size();
  }
  return f;
}

/// Meshes of fewer faces keep the ordinary threshold.
constexpr size_t kDenseFaces = 1000;

/// What dense meshes take for a short edge: the least of a few thresholds that makes nearly all faces small.
/// Looks at a sample.
float undicedEdgeOf(const Faces& f, std::span<const Vec3> points, std::span<const uint8_t> good,
                    const DiceRate& rate) {
  if (!f.loops.empty() || f.vertices.empty()) return kUndicedEdge;
  constexpr size_t kSample = 20000;
  const size_t step = f.faceCount / kSample + 1;
  std::vector<float> longest;
  size_t corner = 0;
  for (size_t face = 0; face < f.faceCount; ++face) {
    const size_t n = size_t(std::max(0, f.sizes[face]));
    const size_t first = corner;
    corner += n;
    if (face % step != 0 || corner > f.vertices.size()) continue;
    float most = 0;
    for (size_t i = 0; i < n; ++i) {
      const size_t a = size_t(f.vertices[first + i]), b = size_t(f.vertices[first + (i + 1) % n]);
      if (good[a] && good[b]) most = std::max(most, rate.segment(points[a], points[b]));
    }
    longest.push_back(most);
  }
  if (longest.empty()) return kUndicedEdge;
  const auto nearlyAll = longest.begin() + ptrdiff_t(longest.size() * 98 / 100);
  std::nth_element(longest.begin(), nearlyAll, longest.end());
  for (const float edge : {kUndicedEdge, 2.0f, 3.0f, 4.0f, kMostUndicedEdge}) {
    if (*nearlyAll <= edge) return edge;
  }
  return kUndicedEdge;
}

/// Corners with equal facevarying values at the same vertex become one, so that meshlets share their
/// vertices.
std::vector<uint32_t> mergeCorners(const ri::ParamList& params, const Faces& faces, size_t corners,
                                   size_t vertices, bool* any) {
  std::vector<const ri::Param*> varying;
  for (const ri::Param& p : params) {
    const auto c = p.declaration.storage;
    if ((c == ri::StorageClass::kFaceVarying || c == ri::StorageClass::kFaceVertex) && !p.floats.empty() &&
        p.valueCount() >= corners)
      varying.push_back(&p);
  }
  *any = !varying.empty();
  std::vector<uint32_t> merged;
  if (!*any) return merged;
  merged.resize(corners);
  std::vector<uint32_t> head(vertices, kNone), next(corners, kNone);
  const auto equal = [&](size_t a, size_t b) {
    for (const ri::Param* p : varying) {
      const size_t w = p->declaration.width();
      if (!std::equal(p->floats.begin() + ptrdiff_t(a * w), p->floats.begin() + ptrdiff_t((a + 1) * w),
                      p->floats.begin() + ptrdiff_t(b * w)))
        return false;
    }
    return true;
  };
  for (size_t c = 0; c < corners; ++c) {
    const size_t v = faces.vertices.empty() ? c : size_t(faces.vertices[c]);
    uint32_t k = head[v];
    int steps = 0;
    for (; k != kNone && steps < 64; k = next[k], ++steps) {
      if (equal(k, c)) break;
    }
    if (k == kNone || steps == 64) {
      k = uint32_t(c);
      next[c] = head[v], head[v] = k;
    }
    merged[c] = k;
  }
  return merged;
}

bool isPlanarConvexQuad(const DVec3 p[4]) {
  const DVec3 n = newellNormal({p, 4});
  const double length = glm::length(n);
  if (!(length > 0)) return false;
  const DVec3 unit = n / length;
  double size = 0;
  for (int i = 0; i < 4; ++i) {
    const DVec3 a = p[(i + 1) % 4] - p[i], b = p[(i + 2) % 4] - p[(i + 1) % 4];
    if (glm::dot(glm::cross(a, b), unit) < 0) return false;
    size = std::max(size, glm::length(a));
  }
  // Corners off the plane by more than a thousandth of the face: two triangles say better what is meant.
  return std::abs(glm::dot(p[2] - p[0], unit) - glm::dot(p[3] - p[1], unit)) +
             std::abs(glm::dot(p[1] - p[0], unit)) + std::abs(glm::dot(p[3] - p[0], unit)) <
         1e-3 * size;
}

}  // namespace

Result<void> addPolygons(Adding& a) {
  const ri::ParamList& params = ri::paramsOf(a.key(0));
  uint32_t components = 3;
  std::vector<std::vector<float>> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) {
    const ri::Param* p = positionParam(ri::paramsOf(a.key(k)), &components);
    if (!p) return a.error(RiError::kMissingData, "no positions (\"P\")");
    std::vector<float> values = p->floats;
    if (components == 4) {  // polygons are flat: divide
      std::vector<float> flat;
      for (size_t i = 0; i + 3 < values.size(); i += 4) {
        for (size_t c = 0; c < 3; ++c) flat.push_back(values[i + c] / values[i + 3]);
      }
      values = std::move(flat);
    }
    values.resize(values.size() / 3 * 3);
    if (!keys.empty() && keys[0].size() != values.size()) {
      return a.error(RiError::kBadMotion, "keys with different numbers of positions");
    }
    keys.push_back(std::move(values));
  }
  const size_t pointCount = keys[0].size() / 3;
  const Faces faces = facesOf(*a.desc.primitive, pointCount);

  size_t cornerCount = 0;
  for (const int n : faces.sizes) cornerCount += size_t(std::max(0, n));
  if (!faces.vertices.empty() && faces.vertices.size() < cornerCount) {
    return a.error(RiError::kConsistency,
                   fmt::format("{} vertex indices, {} are needed", faces.vertices.size(), cornerCount));
  }
  for (const int v : faces.vertices) {
    if (v < 0 || size_t(v) >= pointCount)
      return a.error(RiError::kRange, fmt::format("vertex index {} of {}", v, pointCount));
  }

  // Cache-space points at every grid key, exactly as dicing computes them.
  std::vector<std::vector<Vec3>> points(a.toCache.size(), std::vector<Vec3>(pointCount));
  std::vector<uint8_t> good(pointCount, 1);
  for (size_t t = 0; t < a.toCache.size(); ++t) {
    const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[t]);
    for (size_t i = 0; i < pointCount; ++i) {
      const float *x = keys[k.a].data() + i * 3, *y = keys[k.b].data() + i * 3;
      DVec3 p(x[0], x[1], x[2]);
      if (k.weight != 0) p = p * (1 - k.weight) + DVec3(y[0], y[1], y[2]) * k.weight;
      points[t][i] = Vec3(transformPoint(a.toCache[t], p));
      good[i] = good[i] && isFinite(points[t][i]);
    }
  }

  DiceRate rate = a.rate(PrimitiveType::kMeshlets);
  const std::vector<Vec3>& P = points[0];
  // Scans and film assets come in faces of about a pixel, some a little larger. A few grids for these would
  // outweigh all meshlets: when nearly all faces are small, what counts as small stretches a little.
  if (faces.faceCount >= kDenseFaces) rate.undicedEdge = undicedEdgeOf(faces, P, good, rate);
  const float undiced = rate.undicedEdge;
  const auto isShort = [&](uint32_t i, uint32_t j) {
    // The straight length is never less than the sampled metric, but for rounding.
    if (rate.segment(P[i], P[j]) < undiced * 0.999f) return true;
    float x[9], y[9], z[9];
    for (int k = 0; k <= kMetricSteps; ++k) {
      const float t = float(k) / kMetricSteps, s = 1 - t;
      x[k] = s * P[i].x + t * P[j].x, y[k] = s * P[i].y + t * P[j].y, z[k] = s * P[i].z + t * P[j].z;
    }
    return rate.curve(x, y, z) <= undiced;
  };

  bool faceVarying = false;
  const std::vector<uint32_t> merged = mergeCorners(params, faces, cornerCount, pointCount, &faceVarying);
  bool uniform = false;
  for (const ri::Param& p : params) {
    uniform = uniform || (p.declaration.storage == ri::StorageClass::kUniform && p.valueCount() > 1);
  }

  std::vector<MeshTriangle> small;
  std::vector<PolygonPatch> large;
  size_t bad = 0, corner = 0, loop = 0;
  std::vector<DVec3> shape;
  std::vector<uint32_t> sizes, vertex, corners;
  for (size_t f = 0; f < faces.faceCount; ++f) {
    const size_t loops = faces.loops.empty() ? 1 : size_t(std::max(0, faces.loops[f]));
    vertex.clear(), corners.clear(), sizes.clear();
    bool finite = true, whole = true;
    for (size_t l = 0; l < loops && loop < faces.sizes.size(); ++l, ++loop) {
      const uint32_t n = uint32_t(std::max(0, faces.sizes[loop]));
      sizes.push_back(n);
      const size_t first = vertex.size();
      for (uint32_t i = 0; i < n; ++i, ++corner) {
        const uint32_t v = faces.vertices.empty() ? uint32_t(corner) : uint32_t(faces.vertices[corner]);
        if (v >= pointCount)
          return a.error(RiError::kConsistency, fmt::format("{} positions are too few", pointCount));
        vertex.push_back(v);
        corners.push_back(faceVarying ? merged[corner] : uint32_t(corner));
        finite = finite && good[v];
      }
      for (uint32_t i = 0; i < n && whole && finite; ++i)
        whole = isShort(vertex[first + i], vertex[first + (i + 1) % n]);
    }
    if (!finite) {
      ++bad;
      continue;
    }
    if (vertex.size() < 3) continue;
    const auto add = [&](uint32_t i, uint32_t j, uint32_t k) {
      if (whole) {
        small.push_back(
            {{vertex[i], vertex[j], vertex[k]}, {corners[i], corners[j], corners[k]}, uint32_t(f)});
      } else {
        large.push_back({{vertex[i], vertex[j], vertex[k], vertex[k]},
                         {corners[i], corners[j], corners[k], corners[k]},
                         uint32_t(f)});
      }
    };
    if (vertex.size() == 3) {
      add(0, 1, 2);
      continue;
    }
    shape.clear();
    for (const uint32_t v : vertex)
      shape.emplace_back(keys[0][v * 3], keys[0][v * 3 + 1], keys[0][v * 3 + 2]);
    if (vertex.size() == 4 && sizes.size() == 1 && isPlanarConvexQuad(shape.data())) {
      if (whole) {
        add(0, 1, 2), add(0, 2, 3);
      } else {
        large.push_back({{vertex[0], vertex[1], vertex[3], vertex[2]},
                         {corners[0], corners[1], corners[3], corners[2]},
                         uint32_t(f)});
      }
      continue;
    }
    const std::vector<uint32_t> t = triangulate(shape, sizes);
    for (size_t i = 0; i + 2 < t.size(); i += 3) add(t[i], t[i + 1], t[i + 2]);
  }
  if (bad > 0) {
    if (small.empty() && large.empty()) {
      return a.error(RiError::kRange, "its positions are not finite numbers; the primitive is left out");
    }
    a.warn(RiError::kRange,
           fmt::format("{} of {} faces have positions that are not finite; they are left out", bad,
                       faces.faceCount));
  }
  const SourcePositions positions = a.positions(keys, 3);

  if (!large.empty()) {
    if (large.size() >= kNone) return a.error(RiError::kLimit, "too many faces");
    std::vector<Box3f> bounds(large.size());
    for (size_t i = 0; i < large.size(); ++i) {
      for (const auto& at : points) {
        for (const uint32_t v : large[i].vertex) bounds[i].extend(at[v]);
      }
      const Vec3 size = glm::max(glm::abs(bounds[i].min), glm::abs(bounds[i].max));
      bounds[i].grow(4e-7f * std::max({size.x, size.y, size.z}));
    }
    PolygonSource s{};
    s.positions = positions;
    s.patches = a.writer.addArray<PolygonPatch>(large);
    s.undicedEdge = undiced;
    ObjectRecord o = a.object(PrimitiveType::kBilinearPatches, params);
    o.source = a.record(s);
    a.finish(o, bounds);
  }
  if (!small.empty()) {
    const Meshlets m = buildMeshlets(std::move(small), P, faceVarying, uniform);
    std::vector<Box3f> bounds(m.records.size());
    for (size_t i = 0; i < m.records.size(); ++i) {
      const MeshletRecord& r = m.records[i];
      for (const auto& at : points) {
        for (uint32_t k = 0; k < r.vertexCount; ++k) bounds[i].extend(at[m.vertices[r.firstVertex + k]]);
      }
    }
    MeshletSource s{};
    s.positions = positions;
    s.meshlets = a.writer.addArray<MeshletRecord>(m.records);
    s.vertices = a.writer.addArray<uint32_t>(m.vertices);
    s.corners = a.writer.addArray<uint32_t>(m.corners);
    s.triangles = a.writer.addArray<uint8_t>(m.triangles);
    s.faces = a.writer.addArray<uint32_t>(m.faces);
    ObjectRecord o = a.object(PrimitiveType::kMeshlets, params);
    o.source = a.record(s);
    a.finish(o, bounds);
  }
  return {};
}

}  // namespace fr::cache
