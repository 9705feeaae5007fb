// Shared by the files that turn RI primitives into objects.
#pragma once

#include <algorithm>
#include <vector>

#include "scene_cache/dice_metric.h"
#include "scene_cache/primitive.h"
#include "scene_cache/primitive_source.h"
#include "scene_cache/surface.h"

namespace fr::cache {

/// Facts that every kind of primitive needs.
struct Adding {
  SkeletonWriter& writer;
  const PrimitiveDesc& desc;
  std::vector<DMat4> toCache;  // at the grid keys
  std::vector<float> gridTimes;
  float displacementBound = 0;

  Adding(SkeletonWriter& w, const PrimitiveDesc& d);
  size_t keyCount() const { return desc.keys.empty() ? 1 : desc.keys.size(); }
  const ri::Primitive& key(size_t i) const { return desc.keys.empty() ? *desc.primitive : *desc.keys[i]; }
  std::span<const float> keyTimes() const {
    return desc.keys.size() > 1 ? desc.keyTimes : std::span<const float>();
  }
  /// Lengths in cache space to micropolygons, as dicing will see them.
  DiceRate rate(PrimitiveType type) const;
  Error error(RiError code, std::string message) const;
  void warn(RiError code, std::string message) const;
  /// An object record with everything but its patches. Primitive variables of the list are added, positions
  /// left out.
  ObjectRecord object(PrimitiveType type, const ri::ParamList& params);
  /// Adds object, root patches (bounds per patch, faces 0..n-1) and their union; edges are those given, 8 a
  /// patch, or none. `owner` of the edges counts from the first patch of this object.
  ObjectId finish(ObjectRecord record, std::span<const Box3f> bounds, std::vector<EdgeRecord> edges = {});
  /// Stores positions of all keys. `values`: one array a key, all of the same size.
  SourcePositions positions(std::span<const std::vector<float>> values, uint32_t components);
  template <class T>
  Range record(const T& source) {
    return writer.addBlob(std::as_bytes(std::span(&source, 1)), 16);
  }
};

/// Positions of a key: "P" (3) or "Pw" (4); empty when absent.
const ri::Param* positionParam(const ri::ParamList& params, uint32_t* components);
/// The index of the first number that is not finite, or -1.
ptrdiff_t firstNonFinite(std::span<const float> v);

Result<void> addQuadric(Adding& a);
Result<void> addPatches(Adding& a);
Result<void> addNuPatch(Adding& a);
Result<void> addPoints(Adding& a);
Result<void> addCurves(Adding& a);
Result<void> addBlobby(Adding& a);
Result<void> addPolygons(Adding& a);
Result<void> addSubdivision(Adding& a);

}  // namespace fr::cache
