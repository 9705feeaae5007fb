// The fingerprint of the byte layout and the checksum of a skeleton.
#include <cstddef>

#include "base/random.h"
#include "scene_cache/cache.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace fr::cache {
namespace {

struct Fingerprint {
  uint64_t key = 0;
  constexpr void add(uint64_t x) { key = hashStep(key, x); }
};

// One line per record: its size and the offset of each member, so that a member that moved changes the number
// even if the size stays.
#define FR_SIZE(T) f.add(sizeof(T)), f.add(alignof(T))
#define FR_AT(T, m) f.add(offsetof(T, m)), f.add(sizeof(T::m))

uint64_t compute() {
  Fingerprint f;
  FR_SIZE(Range), FR_AT(Range, offset), FR_AT(Range, count);
  FR_SIZE(Slice), FR_AT(Slice, first), FR_AT(Slice, count);
  FR_SIZE(StringRecord), FR_AT(StringRecord, offset), FR_AT(StringRecord, size);
  FR_SIZE(ParamRecord), FR_AT(ParamRecord, name), FR_AT(ParamRecord, storage), FR_AT(ParamRecord, type);
  FR_AT(ParamRecord, arrayLength), FR_AT(ParamRecord, values);
  FR_SIZE(TransformRecord), FR_AT(TransformRecord, times), FR_AT(TransformRecord, matrices);
  FR_SIZE(ShaderRecord), FR_AT(ShaderRecord, name), FR_AT(ShaderRecord, kind), FR_AT(ShaderRecord, transform);
  FR_AT(ShaderRecord, params), FR_AT(ShaderRecord, lightFlags), FR_AT(ShaderRecord, lightSamples);
  FR_AT(ShaderRecord, areaLightObject), FR_AT(ShaderRecord, handle), FR_AT(ShaderRecord, attributes);
  FR_AT(ShaderRecord, locationFile), FR_AT(ShaderRecord, locationLine);
  FR_SIZE(NamedSpaceRecord), FR_AT(NamedSpaceRecord, name), FR_AT(NamedSpaceRecord, transform);
  FR_SIZE(AttributeRecord), FR_AT(AttributeRecord, color), FR_AT(AttributeRecord, opacity);
  FR_AT(AttributeRecord, shadingRate), FR_AT(AttributeRecord, patchMultiplier);
  FR_AT(AttributeRecord, displacementBound), FR_AT(AttributeRecord, flags), FR_AT(AttributeRecord, sides);
  FR_AT(AttributeRecord, visibility), FR_AT(AttributeRecord, castsShadows), FR_AT(AttributeRecord, surface);
  FR_AT(AttributeRecord, displacement), FR_AT(AttributeRecord, atmosphere), FR_AT(AttributeRecord, interior);
  FR_AT(AttributeRecord, exterior), FR_AT(AttributeRecord, lights), FR_AT(AttributeRecord, name);
  FR_AT(AttributeRecord, attributes), FR_AT(AttributeRecord, textureCoordinates),
      FR_AT(AttributeRecord, bias);
  FR_AT(AttributeRecord, groups), FR_AT(AttributeRecord, areaLight), FR_AT(AttributeRecord, flatness);
  FR_AT(AttributeRecord, motionFactor), FR_AT(AttributeRecord, focusFactor), FR_AT(AttributeRecord, thinning),
      FR_AT(AttributeRecord, deformation);
  FR_SIZE(ObjectRecord), FR_AT(ObjectRecord, type), FR_AT(ObjectRecord, sides), FR_AT(ObjectRecord, keyCount);
  FR_AT(ObjectRecord, attributes), FR_AT(ObjectRecord, transform), FR_AT(ObjectRecord, surfaceGroup);
  FR_AT(ObjectRecord, primvars), FR_AT(ObjectRecord, firstPatch), FR_AT(ObjectRecord, patchCount);
  FR_AT(ObjectRecord, bound), FR_AT(ObjectRecord, source), FR_AT(ObjectRecord, locationFile);
  FR_AT(ObjectRecord, locationLine), FR_AT(ObjectRecord, prototype), FR_AT(ObjectRecord, instance);
  FR_AT(ObjectRecord, fixedRate), FR_AT(ObjectRecord, solidPlus1);
  FR_SIZE(SolidRecord), FR_AT(SolidRecord, operation), FR_AT(SolidRecord, parent);
  FR_AT(SolidRecord, isFirst);
  FR_SIZE(EdgeRecord), FR_AT(EdgeRecord, owner), FR_AT(EdgeRecord, ownerEdge), FR_AT(EdgeRecord, reversed);
  FR_SIZE(RootPatchRecord), FR_AT(RootPatchRecord, object), FR_AT(RootPatchRecord, face);
  FR_AT(RootPatchRecord, firstEdge), FR_AT(RootPatchRecord, bound);
  FR_SIZE(PatchNode), FR_AT(PatchNode, state), FR_AT(PatchNode, root), FR_AT(PatchNode, iu),
      FR_AT(PatchNode, iv);
  FR_AT(PatchNode, du), FR_AT(PatchNode, dv), FR_AT(PatchNode, edgeRootDepth), FR_AT(PatchNode, bound);
  FR_AT(PatchNode, prototype);
  FR_SIZE(GridRecord), FR_AT(GridRecord, node), FR_AT(GridRecord, kind), FR_AT(GridRecord, keyCount);
  FR_AT(GridRecord, levels), FR_AT(GridRecord, flags), FR_AT(GridRecord, nu), FR_AT(GridRecord, nv);
  FR_AT(GridRecord, rowStride), FR_AT(GridRecord, positions), FR_AT(GridRecord, keyBytes);
  FR_AT(GridRecord, normals), FR_AT(GridRecord, indices), FR_AT(GridRecord, deviation);
  FR_AT(GridRecord, cellSize), FR_AT(GridRecord, bound), FR_AT(GridRecord, edgeShift),
      FR_AT(GridRecord, placement);
  FR_SIZE(CameraRecord), FR_AT(CameraRecord, worldToCamera), FR_AT(CameraRecord, projection);
  FR_AT(CameraRecord, fov), FR_AT(CameraRecord, screenWindow), FR_AT(CameraRecord, resolution);
  FR_AT(CameraRecord, pixelAspect), FR_AT(CameraRecord, frameAspect), FR_AT(CameraRecord, cropWindow);
  FR_AT(CameraRecord, cropPixels), FR_AT(CameraRecord, clipping), FR_AT(CameraRecord, shutter);
  FR_AT(CameraRecord, dof), FR_AT(CameraRecord, clippingPlaneCount), FR_AT(CameraRecord, clippingPlanes);
  FR_SIZE(DisplayRecord), FR_AT(DisplayRecord, name), FR_AT(DisplayRecord, type), FR_AT(DisplayRecord, mode);
  FR_AT(DisplayRecord, params), FR_AT(DisplayRecord, quantize), FR_AT(DisplayRecord, exposure);
  FR_SIZE(OptionsRecord), FR_AT(OptionsRecord, pixelSamples), FR_AT(OptionsRecord, filter);
  FR_AT(OptionsRecord, filterWidth), FR_AT(OptionsRecord, exposure), FR_AT(OptionsRecord, quantizeRgba);
  FR_AT(OptionsRecord, quantizeZ), FR_AT(OptionsRecord, pixelVariance), FR_AT(OptionsRecord, hider);
  FR_AT(OptionsRecord, hiderParams), FR_AT(OptionsRecord, imager), FR_AT(OptionsRecord, displays);
  FR_AT(OptionsRecord, options), FR_AT(OptionsRecord, maxRayLevel), FR_AT(OptionsRecord, frameNumber);
  FR_SIZE(SkeletonHeader), FR_AT(SkeletonHeader, magic), FR_AT(SkeletonHeader, version);
  FR_AT(SkeletonHeader, byteOrder), FR_AT(SkeletonHeader, layout), FR_AT(SkeletonHeader, totalBytes);
  FR_AT(SkeletonHeader, checksum), FR_AT(SkeletonHeader, cacheOrigin), FR_AT(SkeletonHeader, strings);
  FR_AT(SkeletonHeader, params), FR_AT(SkeletonHeader, transforms), FR_AT(SkeletonHeader, shaders);
  FR_AT(SkeletonHeader, lightLists), FR_AT(SkeletonHeader, namedSpaces), FR_AT(SkeletonHeader, attributes);
  FR_AT(SkeletonHeader, objects), FR_AT(SkeletonHeader, rootPatches), FR_AT(SkeletonHeader, edges);
  FR_AT(SkeletonHeader, displays), FR_AT(SkeletonHeader, camera), FR_AT(SkeletonHeader, options);
  FR_AT(SkeletonHeader, searchPaths), FR_AT(SkeletonHeader, solids);
  f.add(uint64_t(kMaxGridLog2)), f.add(uint64_t(kMaxMeshletVertices)), f.add(uint64_t(kMaxMeshletTriangles));
  return f.key;
}

}  // namespace

uint64_t layoutFingerprint() {
  static const uint64_t value = compute();
  return value;
}

uint64_t skeletonChecksum(std::span<const std::byte> skeleton) {
  if (skeleton.size() <= sizeof(SkeletonHeader)) return 0;
  const auto body = skeleton.subspan(sizeof(SkeletonHeader));
  return XXH3_64bits(body.data(), body.size());
}

}  // namespace fr::cache
