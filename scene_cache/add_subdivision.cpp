// SubdivisionMesh.
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "scene_cache/add_primitive.h"
#include "scene_cache/subdivision.h"

namespace fr::cache {
namespace {

struct Tags {
  std::vector<uint32_t> creaseVertices, cornerVertices, holes;
  std::vector<float> creaseSharpness, cornerSharpness;
  uint32_t interpolateBoundary = 0, faceVaryingInterpolateBoundary = 0;
  bool faceVaryingPropagateCorners = false, chaikinCreases = false, smoothTriangles = false;
};

/// OpenSubdiv's infinitely sharp.
constexpr float kSharpest = 10.0f;

float sharpness(float s) { return std::isnan(s) ? 0.0f : std::clamp(s, 0.0f, kSharpest); }

Tags readTags(Adding& a, const ri::SubdivisionMesh& m, uint32_t vertices, uint32_t faces) {
  Tags t;
  size_t intAt = 0, floatAt = 0, stringAt = 0;
  std::vector<std::string> ignored;
  const size_t perTag = m.hierarchical ? 3 : 2;
  for (size_t k = 0; k < m.tags.size(); ++k) {
    const auto count = [&](size_t i, size_t left) {
      const size_t at = k * perTag + i;
      return at < m.nargs.size() && m.nargs[at] > 0 ? std::min(size_t(m.nargs[at]), left) : 0;
    };
    const std::span<const int> ints(m.intArgs.data() + intAt, count(0, m.intArgs.size() - intAt));
    const std::span<const float> floats(m.floatArgs.data() + floatAt, count(1, m.floatArgs.size() - floatAt));
    const std::span<const std::string> strings(m.stringArgs.data() + stringAt,
                                               m.hierarchical ? count(2, m.stringArgs.size() - stringAt) : 0);
    intAt += ints.size(), floatAt += floats.size(), stringAt += strings.size();
    const std::string& tag = m.tags[k];
    const auto ok = [&](int i, uint32_t limit) {
      if (i >= 0 && uint32_t(i) < limit) return true;
      a.warn(RiError::kRange, fmt::format("tag \"{}\": index {} of {}; it is ignored", tag, i, limit));
      return false;
    };
    // The tag's integer, from 0 to `most`; without one, `absent`.
    const auto choice = [&](int most, uint32_t absent) {
      if (ints.empty()) return absent;
      if (ints[0] < 0 || ints[0] > most) {
        a.warn(RiError::kRange, fmt::format("tag \"{}\" is {}, not 0 to {}", tag, ints[0], most));
      }
      return uint32_t(std::clamp(ints[0], 0, most));
    };
    if (tag == "crease") {
      for (size_t i = 0; i + 1 < ints.size(); ++i) {
        if (floats.empty() || !ok(ints[i], vertices) || !ok(ints[i + 1], vertices)) continue;
        t.creaseVertices.insert(t.creaseVertices.end(), {uint32_t(ints[i]), uint32_t(ints[i + 1])});
        t.creaseSharpness.push_back(sharpness(floats[std::min(i, floats.size() - 1)]));
      }
    } else if (tag == "corner") {
      for (size_t i = 0; i < ints.size(); ++i) {
        if (!ok(ints[i], vertices)) continue;
        t.cornerVertices.push_back(uint32_t(ints[i]));
        t.cornerSharpness.push_back(floats.empty() ? kSharpest
                                                   : sharpness(floats[std::min(i, floats.size() - 1)]));
      }
    } else if (tag == "hole") {
      for (const int i : ints) {
        if (ok(i, faces)) t.holes.push_back(uint32_t(i));
      }
    } else if (tag == "interpolateboundary") {
      t.interpolateBoundary = choice(2, 1);
    } else if (tag == "facevaryinginterpolateboundary") {
      t.faceVaryingInterpolateBoundary = choice(3, 1);
    } else if (tag == "facevaryingpropagatecorners") {
      t.faceVaryingPropagateCorners = choice(1, 1) != 0;
    } else if (tag == "smoothtriangles") {
      t.smoothTriangles = choice(2, 1) != 0;
    } else if (tag == "creasemethod") {
      // A string, where tags have strings; numbers are Hbr's.
      const std::string method = !strings.empty()                  ? strings[0]
                                 : !ints.empty() && (ints[0] == 1) ? "chaikin"
                                                                   : "normal";
      t.chaikinCreases = method == "chaikin";
      if (method != "chaikin" && method != "normal") {
        a.warn(
            RiError::kBadToken,
            fmt::format("tag \"creasemethod\" is \"normal\" or \"chaikin\", not \"{}\"; \"normal\" is used",
                        method));
      }
    } else if (std::find(ignored.begin(), ignored.end(), tag) == ignored.end()) {
      // Files hold hundreds of edits: one message a mesh and kind.
      ignored.push_back(tag);
      const bool edit = tag == "vertexedit" || tag == "edgeedit" || tag == "faceedit";
      a.warn(
          RiError::kUnimplemented,
          edit ? fmt::format("hierarchical edits (\"{}\") are not made; the mesh is drawn without them", tag)
               : fmt::format("subdivision tag \"{}\" is ignored", tag));
    }
  }
  return t;
}

}  // namespace

Result<void> addSubdivision(Adding& a) {
  const auto& m = std::get<ri::SubdivisionMesh>(*a.desc.primitive);
  SubdivisionSource s{};
  if (m.scheme == "catmull-clark") {
    s.scheme = SubdivisionScheme::kCatmullClark;
  } else if (m.scheme == "loop") {
    s.scheme = SubdivisionScheme::kLoop;
  } else if (m.scheme == "bilinear") {
    s.scheme = SubdivisionScheme::kBilinear;
  } else {
    return a.error(RiError::kBadToken, fmt::format("subdivision scheme \"{}\" is not known", m.scheme));
  }
  std::vector<std::vector<float>> keys;
  for (size_t k = 0; k < a.keyCount(); ++k) {
    uint32_t components = 3;
    const ri::Param* p = positionParam(ri::paramsOf(a.key(k)), &components);
    if (!p || components != 3) return a.error(RiError::kMissingData, "no positions (\"P\")");
    if (!keys.empty() && keys[0].size() != p->floats.size()) {
      return a.error(RiError::kBadMotion, "keys with different numbers of positions");
    }
    if (const ptrdiff_t bad = firstNonFinite(p->floats); bad >= 0) {
      return a.error(RiError::kRange,
                     fmt::format("position {} is not finite; the mesh is left out", bad / 3));
    }
    keys.push_back(p->floats);
  }
  const uint32_t vertexCount = uint32_t(keys[0].size() / 3);
  std::vector<uint32_t> sizes, vertices;
  for (const int n : m.nverts) {
    if (n < 3) return a.error(RiError::kConsistency, fmt::format("a face of {} vertices", n));
    if (s.scheme == SubdivisionScheme::kLoop && n != 3) {
      return a.error(RiError::kConsistency,
                     fmt::format("scheme \"loop\" takes triangles, here is a face of {} vertices", n));
    }
    sizes.push_back(uint32_t(n));
    if (n != 4) s.pieces = 1;
  }
  if (s.scheme == SubdivisionScheme::kLoop) s.pieces = 0;
  for (const int v : m.verts) {
    if (v < 0 || uint32_t(v) >= vertexCount)
      return a.error(RiError::kRange, fmt::format("vertex {} of {}", v, vertexCount));
    vertices.push_back(uint32_t(v));
  }
  const Tags tags = readTags(a, m, vertexCount, uint32_t(sizes.size()));
  s.interpolateBoundary = tags.interpolateBoundary;
  s.faceVaryingInterpolateBoundary = tags.faceVaryingInterpolateBoundary;
  s.faceVaryingPropagateCorners = tags.faceVaryingPropagateCorners ? 1 : 0;
  s.chaikinCreases = tags.chaikinCreases ? 1 : 0;
  s.smoothTriangles = tags.smoothTriangles ? 1 : 0;

  SubdivisionMeshData data;
  data.scheme = s.scheme;
  data.interpolateBoundary = s.interpolateBoundary;
  data.chaikinCreases = tags.chaikinCreases, data.smoothTriangles = tags.smoothTriangles;
  data.vertexCount = vertexCount;
  data.pieces = s.pieces;
  data.faceSizes = sizes, data.faceVertices = vertices;
  data.creaseVertices = tags.creaseVertices, data.creaseSharpness = tags.creaseSharpness;
  data.cornerVertices = tags.cornerVertices, data.cornerSharpness = tags.cornerSharpness;
  data.holes = tags.holes;
  uint64_t corners = 0;
  for (const uint32_t n : sizes) corners += n;
  if (corners != vertices.size()) {
    return a.error(RiError::kConsistency,
                   fmt::format("{} vertex indices, {} are needed", vertices.size(), corners));
  }
  const auto topology = SubdivisionTopology::create(data);
  if (!topology) return a.error(RiError::kConsistency, "the mesh is not one that subdivides");

  // The limit of a face lies in the hull of the vertices of all faces around it.
  std::vector<Box3f> around(vertexCount);
  std::vector<Box3f> faceBound(sizes.size());
  for (size_t t = 0; t < a.toCache.size(); ++t) {
    const KeySpan k = findKeys(a.keyTimes(), uint32_t(keys.size()), a.gridTimes[t]);
    std::vector<Vec3> points(vertexCount);
    for (uint32_t i = 0; i < vertexCount; ++i) {
      const float *x = keys[k.a].data() + i * 3, *y = keys[k.b].data() + i * 3;
      DVec3 p(x[0], x[1], x[2]);
      if (k.weight != 0) p = p * (1 - k.weight) + DVec3(y[0], y[1], y[2]) * k.weight;
      points[i] = Vec3(transformPoint(a.toCache[t], p));
      if (!isFinite(points[i]))
        return a.error(RiError::kRange, "the transformed mesh is not finite; it is left out");
    }
    size_t c = 0;
    for (const uint32_t n : sizes) {
      Box3f box;
      for (uint32_t i = 0; i < n; ++i) box.extend(points[vertices[c + i]]);
      for (uint32_t i = 0; i < n; ++i) around[vertices[c + i]].extend(box);
      c += n;
    }
  }
  std::vector<SubdivisionPatch> patches;
  std::vector<Box3f> bounds;
  std::vector<std::array<uint64_t, 4>> cornerIds;
  size_t c = 0;
  for (uint32_t f = 0; f < sizes.size(); ++f) {
    const uint32_t n = sizes[f];
    const uint32_t* v = vertices.data() + c;
    c += n;
    if (!topology->hasLimit(f)) continue;
    Box3f box;
    for (uint32_t i = 0; i < n; ++i) box.extend(around[v[i]]);
    const Vec3 size = glm::max(glm::abs(box.min), glm::abs(box.max));
    box.grow(1e-5f * std::max({size.x, size.y, size.z}));
    // Names of places: vertices, middles of edges, centres of faces.
    const auto middle = [](uint32_t x, uint32_t y) {
      return uint64_t(std::min(x, y) + 1) << 32 | std::max(x, y);
    };
    const uint64_t center = ~uint64_t(f);
    if (s.pieces) {
      for (uint32_t i = 0; i < n; ++i) {
        const uint32_t next = v[(i + 1) % n], last = v[(i + n - 1) % n];
        patches.push_back({f, i});
        bounds.push_back(box);
        cornerIds.push_back({v[i], middle(v[i], next), center, middle(v[i], last)});
      }
    } else {
      patches.push_back({f, 0});
      bounds.push_back(box);
      cornerIds.push_back({v[0], v[1], v[2], n == 3 ? v[2] : v[3]});
    }
  }
  if (patches.empty()) {
    a.warn(RiError::kConsistency,
           "no face has a surface (without \"interpolateboundary\" faces at a border have none)");
    return {};
  }
  // The first patch that meets a border or a corner evaluates it for all.
  struct PairHash {
    size_t operator()(const std::pair<uint64_t, uint64_t>& p) const {
      return size_t((p.first * 0x9e3779b97f4a7c15ull) ^
                    (p.second + 0x632be59bd9b4e019ull) * 0xff51afd7ed558ccdull);
    }
  };
  std::unordered_map<std::pair<uint64_t, uint64_t>, uint32_t, PairHash> owners;
  std::unordered_map<uint64_t, uint32_t> cornerOwners;
  std::vector<EdgeRecord> edges(patches.size() * 8);
  constexpr int kFrom[4] = {0, 1, 3, 0}, kTo[4] = {1, 2, 2, 3};
  for (size_t p = 0; p < patches.size(); ++p) {
    const auto& id = cornerIds[p];
    for (unsigned e = 0; e < 4; ++e) {
      const uint64_t from = id[size_t(kFrom[e])], to = id[size_t(kTo[e])];
      EdgeRecord r{uint32_t(p), uint8_t(e), 0, 0};
      if (from != to) {
        const auto it =
            owners.try_emplace({std::min(from, to), std::max(from, to)}, uint32_t(p * 4 + e)).first;
        const uint32_t owner = it->second / 4, edge = it->second % 4;
        r = {owner, uint8_t(edge), uint8_t(cornerIds[owner][size_t(kFrom[edge])] != from), 0};
      }
      edges[p * 8 + e] = r;
      const uint32_t corner = cornerOwners.try_emplace(id[e], uint32_t(p * 4 + e)).first->second;
      edges[p * 8 + 4 + e] = {corner / 4, uint8_t(corner % 4), 0, 0};
    }
  }

  s.positions = a.positions(keys, 3);
  s.faceSizes = a.writer.addArray<uint32_t>(sizes);
  s.faceVertices = a.writer.addArray<uint32_t>(vertices);
  s.creaseVertices = a.writer.addArray<uint32_t>(tags.creaseVertices);
  s.creaseSharpness = a.writer.addArray<float>(tags.creaseSharpness);
  s.cornerVertices = a.writer.addArray<uint32_t>(tags.cornerVertices);
  s.cornerSharpness = a.writer.addArray<float>(tags.cornerSharpness);
  s.holes = a.writer.addArray<uint32_t>(tags.holes);
  s.patches = a.writer.addArray<SubdivisionPatch>(patches);
  ObjectRecord o = a.object(PrimitiveType::kSubdivision, m.params);
  o.source = a.record(s);
  a.finish(o, bounds, std::move(edges));
  return {};
}

}  // namespace fr::cache
