// Primitive variables at surface points (RISpec 3.2, "Primitive variables": one rule per storage class and
// primitive).
#pragma once

#include "scene_cache/cache.h"
#include "scene_cache/subdivision.h"

namespace fr::cache {

/// True for objects whose patches are faces of polygons.
bool isPolygon(const ObjectRecord& object);

inline constexpr uint32_t kMaxFloatsPerValue = 4096;
/// Floats of one value, arrays included; 0 for strings, integers and absurd lengths.
uint32_t floatsPerValue(const ParamRecord& param);

/// See SceneCache::evaluatePrimvar; `root` is a root patch. Thread-safe.
bool evaluatePrimvarOf(const Skeleton& skeleton, SubdivisionStore& subdivisions, NodeId root,
                       const ParamRecord& param, size_t n, const uint32_t* cell, const float* u,
                       const float* v, float* const* out);

/// Patches of a mesh: shader u = (root u + offset) / scale. False when shader and root parameters are the
/// same.
bool patchScale(const Skeleton& skeleton, NodeId root, float* scaleU, float* scaleV, float* offsetU = nullptr,
                float* offsetV = nullptr);

/// Object-space x and y of polygon points, at shutter open. s or t may be nullptr.
void objectSpaceXy(const Skeleton& skeleton, NodeId root, size_t n, const uint32_t* cell, const float* u,
                   const float* v, float* s, float* t);

}  // namespace fr::cache
