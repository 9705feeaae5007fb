// Blobby: polygons as fine as the shading rate asks for, with exact normals.
#include <algorithm>
#include <cmath>

#include "scene_cache/add_primitive.h"
#include "scene_cache/blobby.h"

namespace fr::cache {
namespace {

/// Sides of cells, in micropolygons.
constexpr double kCellMicropolygons = 1.5;
constexpr size_t kMostVertices = 4'000'000;

ri::Param pointParam(const char* name, ri::ValueType type, const std::vector<DVec3>& values) {
  ri::Param p;
  p.name = name;
  p.declaration.storage = ri::StorageClass::kVertex;
  p.declaration.type = type;
  p.floats.reserve(values.size() * 3);
  for (const DVec3& v : values) p.floats.insert(p.floats.end(), {float(v.x), float(v.y), float(v.z)});
  return p;
}

}  // namespace

Result<void> addBlobby(Adding& a) {
  const auto& blobby = std::get<ri::Blobby>(*a.desc.primitive);
  std::vector<std::string> warnings;
  auto parsed = BlobField::parse(blobby, &warnings);
  if (!parsed) return a.error(parsed.error().code, parsed.error().message);
  std::sort(warnings.begin(), warnings.end());
  warnings.erase(std::unique(warnings.begin(), warnings.end()), warnings.end());
  for (size_t i = 0; i < std::min<size_t>(warnings.size(), 4); ++i) a.warn(RiError::kRange, warnings[i]);
  const BlobField& field = *parsed;
  const Box3d box = field.support();
  if (box.empty()) return {};  // constants alone have no surface

  // As fine as its nearest part needs: length of a micropolygon there, in object space.
  const DiceRate rate = a.rate(PrimitiveType::kMeshlets);
  const double scale = std::cbrt(std::abs(glm::determinant(DMat3(a.toCache[0]))));
  const DVec3 size = box.max - box.min;
  const double largest = std::max({size.x, size.y, size.z});
  if (!(scale > 0) || !std::isfinite(scale) || !std::isfinite(largest) || !(largest > 0))
    return a.error(RiError::kRange, "its extent is not finite or nothing; left out");
  double finest = 0;
  for (int i = 0; i < 9 * 9 * 9; ++i) {
    const DVec3 at = box.min + size * DVec3(i % 9, i / 9 % 9, i / 81) / 8.0;
    const Vec3 p(transformPoint(a.toCache[0], at));
    const float step = float(largest * scale * 0.01);
    if (isFinite(p)) finest = std::max(finest, double(rate.segment(p, p + Vec3(step, 0, 0))) / double(step));
  }
  double cell = finest > 0 ? kCellMicropolygons / (finest * scale) : largest / 32;
  // Small leaves must not fall between the cells, within reason; no finer than a few hundred thousand cells.
  cell = std::min(cell, std::max(0.4 * field.smallestRadius(), largest / 200));
  cell = std::clamp(cell, largest / 2048, largest / 8);
  BlobMesh mesh;
  for (int attempt = 0; attempt < 8 && mesh.points.empty(); ++attempt, cell *= 1.6)
    mesh = polygonise(field, cell, kMostVertices);
  if (mesh.triangles.empty()) return {};  // nothing reaches the threshold

  ri::PointsPolygons polygons;
  polygons.nverts.assign(mesh.triangles.size() / 3, 3);
  polygons.verts.assign(mesh.triangles.begin(), mesh.triangles.end());
  polygons.params.set(pointParam("P", ri::ValueType::kPoint, mesh.points));
  bool blended = false;
  for (const ri::Param& v : ri::paramsOf(a.key(0))) {
    if (v.name == "P") continue;
    ri::Param p = v;
    const bool perLeaf = v.declaration.storage != ri::StorageClass::kConstant &&
                         v.declaration.storage != ri::StorageClass::kUniform;
    if (perLeaf) {
      if (v.floats.empty()) continue;  // strings and integers cannot be blended
      p.declaration.storage = ri::StorageClass::kVertex;
      p.floats.assign(mesh.points.size() * v.declaration.width(), 0.0f);
      blended = true;
    } else if (v.declaration.storage == ri::StorageClass::kUniform) {
      p.declaration.storage = ri::StorageClass::kConstant;
    }
    polygons.params.set(std::move(p));
  }
  if (blended) {
    std::vector<std::pair<uint32_t, double>> weights;
    for (size_t i = 0; i < mesh.points.size(); ++i) {
      field.weights(mesh.points[i], weights);
      double sum = 0;
      for (const auto& [leaf, w] : weights) sum += w;
      if (!(sum > 0)) continue;
      for (const ri::Param& v : ri::paramsOf(a.key(0))) {
        if (v.declaration.storage == ri::StorageClass::kConstant ||
            v.declaration.storage == ri::StorageClass::kUniform || v.floats.empty() || v.name == "P")
          continue;
        const size_t width = v.declaration.width();
        for (ri::Param& p : polygons.params.params()) {
          if (p.name != v.name) continue;
          for (size_t c = 0; c < width; ++c) {
            double x = 0;
            for (const auto& [leaf, w] : weights)
              x += w * double(v.floats[std::min<size_t>(leaf * width + c, v.floats.size() - 1)]);
            p.floats[i * width + c] = float(x / sum);
          }
        }
      }
    }
  }
  if (!polygons.params.has("N")) polygons.params.set(pointParam("N", ri::ValueType::kNormal, mesh.normals));
  const ri::Primitive primitive(std::move(polygons));
  PrimitiveDesc desc = a.desc;
  desc.primitive = &primitive;
  if (desc.keys.size() > 1)
    a.warn(RiError::kUnimplemented, "keeps its first shape: its deformation is not rendered");
  desc.keys = {}, desc.keyTimes = {};
  Adding inner(a.writer, desc);
  return addPolygons(inner);
}

}  // namespace fr::cache
