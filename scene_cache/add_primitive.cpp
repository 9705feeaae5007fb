#include "scene_cache/add_primitive.h"

#include <cmath>

#include "scene_cache/motion.h"

namespace fr::cache {

Adding::Adding(SkeletonWriter& w, const PrimitiveDesc& d) : writer(w), desc(d) {
  const TransformKeys keys = w.transform(d.transform);
  const float* shutter = w.camera().shutter;
  const int count = gridKeyCount(keyTimes(), keys.matrices, keys.times, shutter);
  for (int k = 0; k < count; ++k) {
    const float time = gridKeyTime(k, count, shutter);
    DMat4 m = interpolateMotion(keys.times, keys.matrices, time);
    m[3] -= DVec4(w.cacheOrigin() * m[3].w, 0.0);
    gridTimes.push_back(time);
    toCache.push_back(m);
  }
  displacementBound = std::max(0.0f, w.attributes(d.attributes).displacementBound);
}

DiceRate Adding::rate(PrimitiveType type) const {
  DMat4 cacheToCamera(1);
  const TransformKeys camera = writer.transform(writer.camera().worldToCamera);
  if (!camera.matrices.empty())
    cacheToCamera = interpolateMotion(camera.times, camera.matrices, writer.camera().shutter[0]);
  cacheToCamera[3] = cacheToCamera * DVec4(writer.cacheOrigin(), 1.0);
  return diceRate(diceEye(writer.camera(), cacheToCamera), writer.attributes(desc.attributes), type,
                  desc.fixedRate);
}

Error Adding::error(RiError code, std::string message) const {
  Error e = makeError(code, "{}: {}", ri::primitiveName(*desc.primitive), message);
  e.where = desc.location;
  return e;
}
void Adding::warn(RiError code, std::string message) const {
  Error e = error(code, std::move(message));
  e.severity = Severity::kWarning;
  report(e);
}

namespace {

/// As shaders can read it: they know neither integers nor weights.
ParamRecord variable(SkeletonWriter& writer, const ri::Param& p) {
  const bool integers = p.declaration.type == ri::ValueType::kInteger;
  if (!integers && p.declaration.type != ri::ValueType::kHpoint) return writer.makeParam(p);
  ri::Param read;
  read.name = p.name;
  read.declaration = p.declaration;
  read.declaration.type = integers ? ri::ValueType::kFloat : ri::ValueType::kPoint;
  read.floats.assign(p.ints.begin(), p.ints.end());
  for (size_t i = 0; i + 3 < p.floats.size(); i += 4)
    for (size_t c = 0; c < 3; ++c)
      read.floats.push_back(p.floats[i + 3] != 0 ? p.floats[i + c] / p.floats[i + 3] : p.floats[i + c]);
  return writer.makeParam(read);
}

}  // namespace

ObjectRecord Adding::object(PrimitiveType type, const ri::ParamList& params) {
  ObjectRecord o{};
  o.type = type;
  o.sides = desc.sides;
  o.keyCount = uint16_t(gridTimes.size());
  o.attributes = desc.attributes;
  o.transform = desc.transform;
  o.surfaceGroup = desc.surfaceGroup;
  o.solidPlus1 = desc.solid + 1;  // kNone: 0
  o.locationFile = desc.locationFile;
  o.locationLine = desc.locationLine;
  o.fixedRate = desc.fixedRate;
  std::vector<ParamRecord> records;
  for (const ri::Param& p : params) {
    if (p.name == "P" || p.name == "Pw" || p.name == "Pz") continue;
    records.push_back(variable(writer, p));
  }
  o.primvars = writer.addParams(records);
  return o;
}

ObjectId Adding::finish(ObjectRecord record, std::span<const Box3f> bounds, std::vector<EdgeRecord> edges) {
  record.firstPatch = writer.nextRootPatch();
  record.patchCount = uint32_t(bounds.size());
  record.bound = {};
  const ObjectId id = writer.nextObject();
  uint32_t firstEdge = kNone;
  if (edges.size() == bounds.size() * 8 && !edges.empty()) {
    for (EdgeRecord& e : edges) e.owner += record.firstPatch;
    firstEdge = writer.addEdges(edges);
  }
  std::vector<RootPatchRecord> patches(bounds.size());
  for (size_t i = 0; i < bounds.size(); ++i) {
    RootPatchRecord& p = patches[i];
    p.object = id;
    p.face = uint32_t(i);
    p.firstEdge = firstEdge == kNone ? kNone : firstEdge + uint32_t(i) * 8;
    p.bound = bounds[i];
    p.bound.grow(displacementBound);
    record.bound.extend(p.bound);
  }
  writer.addRootPatches(patches);
  return writer.addObject(record);
}

SourcePositions Adding::positions(std::span<const std::vector<float>> values, uint32_t components) {
  SourcePositions p{};
  p.keyCount = uint32_t(values.size());
  p.components = components;
  p.perKey = values[0].size() / components;
  if (values.size() == 1) {
    p.values = writer.addArray<float>(values[0], 16);
    return p;
  }
  std::vector<float> all;
  all.reserve(values.size() * values[0].size());
  for (const auto& v : values) all.insert(all.end(), v.begin(), v.end());
  p.values = writer.addArray<float>(all, 16);
  p.times = writer.addArray<float>(keyTimes());
  return p;
}

const ri::Param* positionParam(const ri::ParamList& params, uint32_t* components) {
  *components = 3;
  if (const ri::Param* p = params.find("P")) {
    *components = p->declaration.type == ri::ValueType::kHpoint ? 4 : 3;
    return p;
  }
  if (const ri::Param* p = params.find("Pw")) {
    *components = 4;
    return p;
  }
  return nullptr;
}

ptrdiff_t firstNonFinite(std::span<const float> v) {
  for (size_t i = 0; i < v.size(); ++i) {
    if (!std::isfinite(v[i])) return ptrdiff_t(i);
  }
  return -1;
}

Result<void> addPrimitive(SkeletonWriter& writer, const PrimitiveDesc& desc) {
  FR_CHECK(desc.primitive != nullptr);
  const ObjectId objects = writer.nextObject();
  const NodeId patches = writer.nextRootPatch();
  const uint32_t edges = writer.nextEdge();
  Adding a(writer, desc);
  Result<void> r = [&]() -> Result<void> {
    for (const ri::Primitive* k : desc.keys) {
      if (!k || k->index() != desc.primitive->index()) {
        return a.error(RiError::kBadMotion, "the motion block holds different kinds of primitives");
      }
    }
    if (!desc.keys.empty() && desc.keys.size() != desc.keyTimes.size()) {
      return a.error(RiError::kBadMotion,
                     fmt::format("{} keys for {} times", desc.keys.size(), desc.keyTimes.size()));
    }
    return std::visit(
        [&](const auto& p) -> Result<void> {
          using T = std::decay_t<decltype(p)>;
          if constexpr (std::is_same_v<T, ri::Sphere> || std::is_same_v<T, ri::Cone> ||
                        std::is_same_v<T, ri::Cylinder> || std::is_same_v<T, ri::Hyperboloid> ||
                        std::is_same_v<T, ri::Paraboloid> || std::is_same_v<T, ri::Disk> ||
                        std::is_same_v<T, ri::Torus>) {
            return addQuadric(a);
          } else if constexpr (std::is_same_v<T, ri::Patch> || std::is_same_v<T, ri::PatchMesh>) {
            return addPatches(a);
          } else if constexpr (std::is_same_v<T, ri::NuPatch>) {
            return addNuPatch(a);
          } else if constexpr (std::is_same_v<T, ri::Points>) {
            return addPoints(a);
          } else if constexpr (std::is_same_v<T, ri::Blobby>) {
            return addBlobby(a);
          } else if constexpr (std::is_same_v<T, ri::Curves>) {
            return addCurves(a);
          } else if constexpr (std::is_same_v<T, ri::Polygon> || std::is_same_v<T, ri::GeneralPolygon> ||
                               std::is_same_v<T, ri::PointsPolygons> ||
                               std::is_same_v<T, ri::PointsGeneralPolygons>) {
            return addPolygons(a);
          } else if constexpr (std::is_same_v<T, ri::SubdivisionMesh>) {
            return addSubdivision(a);
          } else {
            return a.error(RiError::kUnimplemented, "this kind of primitive cannot be diced yet");
          }
        },
        *desc.primitive);
  }();
  if (!r) writer.rollBack(objects, patches, edges);
  return r;
}

}  // namespace fr::cache
