#include "scene_cache/object_content.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>

#include "scene_cache/primitive_source.h"
#include "scene_cache/primvar.h"

namespace fr::cache {
namespace {

/// Feeds values in a fixed order; arrays with their length, so that no two runs of values look alike.
class Content {
 public:
  explicit Content(const Skeleton& skeleton) : s_(skeleton), state_(XXH3_createState()) {
    XXH3_128bits_reset(state_);
  }
  ~Content() { XXH3_freeState(state_); }
  Content(const Content&) = delete;
  Content& operator=(const Content&) = delete;

  template <class... T>
  void values(const T&... v) {
    (value(v), ...);
  }
  void text(std::string_view t) {
    value(uint64_t(t.size()));
    add(t.data(), t.size());
  }
  template <class T>
  void array(const Range& r) {
    const auto a = sourceArray<T>(s_, r);
    value(uint64_t(a.size()));
    add(a.data(), a.size_bytes());
  }
  void transform(TransformId id) {
    const auto all = s_.transforms();
    if (id >= all.size()) return value(kNone);
    array<float>(all[id].times);
    array<DMat4>(all[id].matrices);
  }
  void params(Slice slice) {
    const auto all = s_.params(slice);
    value(uint64_t(all.size()));
    for (const ParamRecord& p : all) {
      text(s_.string(p.name));
      values(p.storage, p.type, p.arrayLength);
      if (p.type == ParamType::kString) {
        value(uint64_t(s_.strings(p).size()));
        for (const StringId id : s_.strings(p)) text(s_.string(id));
      } else if (p.type == ParamType::kInteger) {
        array<int32_t>(p.values);
      } else {
        array<float>(p.values);
      }
    }
  }
  void shader(ShaderId id) {
    const auto all = s_.shaders();
    if (id >= all.size()) return value(kNone);
    const ShaderRecord& r = all[id];
    text(s_.string(r.name));
    values(r.kind, r.lightFlags, r.lightSamples, uint32_t(r.areaLightObject != kNone));
    transform(r.transform);
    params(r.params);
  }
  ContentKey key() const {
    const XXH128_hash_t h = XXH3_128bits_digest(state_);
    return {h.low64, h.high64};
  }

 private:
  template <class T>
  void value(const T& v) {
    static_assert(std::is_arithmetic_v<T> || std::is_enum_v<T>);
    add(&v, sizeof v);
  }
  void add(const void* data, size_t bytes) { XXH3_128bits_update(state_, data, bytes); }

  const Skeleton& s_;
  XXH3_state_t* state_;
};

void addPositions(Content& c, const SourcePositions& p) {
  c.array<float>(p.times);
  c.array<float>(p.values);
  c.values(p.keyCount, p.components, p.perKey);
}

void addSource(Content& c, const Skeleton& s, const ObjectRecord& o) {
  const auto with = [&]<class T>(const T* source, auto&& add) {
    c.values(source != nullptr);
    if (source) add(*source);
  };
  switch (o.type) {
    case PrimitiveType::kSphere:
    case PrimitiveType::kCone:
    case PrimitiveType::kCylinder:
    case PrimitiveType::kHyperboloid:
    case PrimitiveType::kParaboloid:
    case PrimitiveType::kDisk:
    case PrimitiveType::kTorus:
      return with(sourceRecord<QuadricSource>(s, o), [&](const QuadricSource& q) {
        c.array<float>(q.times);
        c.array<double>(q.params);
        c.values(q.keyCount);
      });
    case PrimitiveType::kBilinearPatches:
      if (isPolygon(o))
        return with(sourceRecord<PolygonSource>(s, o), [&](const PolygonSource& p) {
          addPositions(c, p.positions);
          c.array<PolygonPatch>(p.patches);
          c.values(p.undicedEdge);
        });
      [[fallthrough]];
    case PrimitiveType::kBicubicPatches:
      return with(sourceRecord<PatchMeshSource>(s, o), [&](const PatchMeshSource& p) {
        addPositions(c, p.positions);
        c.values(p.nu, p.nv, p.patchesU, p.patchesV, p.stepU, p.stepV, p.wrapU, p.wrapV, p.heightField,
                 p.separate);
        for (const float f : p.basisU) c.values(f);
        for (const float f : p.basisV) c.values(f);
      });
    case PrimitiveType::kSubdivision:
      return with(sourceRecord<SubdivisionSource>(s, o), [&](const SubdivisionSource& p) {
        addPositions(c, p.positions);
        c.values(p.scheme, p.interpolateBoundary, p.faceVaryingInterpolateBoundary,
                 p.faceVaryingPropagateCorners, p.chaikinCreases, p.smoothTriangles, p.pieces);
        for (const Range& r : {p.faceSizes, p.faceVertices, p.creaseVertices, p.cornerVertices, p.holes})
          c.array<uint32_t>(r);
        for (const Range& r : {p.creaseSharpness, p.cornerSharpness}) c.array<float>(r);
        c.array<SubdivisionPatch>(p.patches);
      });
    case PrimitiveType::kMeshlets:
      return with(sourceRecord<MeshletSource>(s, o), [&](const MeshletSource& p) {
        addPositions(c, p.positions);
        c.array<MeshletRecord>(p.meshlets);
        for (const Range& r : {p.vertices, p.corners, p.faces}) c.array<uint32_t>(r);
        c.array<uint8_t>(p.triangles);
      });
    case PrimitiveType::kNurbs:
      return with(sourceRecord<NurbsSource>(s, o), [&](const NurbsSource& p) {
        addPositions(c, p.positions);
        c.values(p.orderU, p.orderV, p.spansU, p.spansV, p.segmentsU, p.segmentsV, p.trimLow, p.trimHigh,
                 p.trimOutside);
        for (const Range& r : {p.spanU, p.spanV}) c.array<NurbsSpan>(r);
        c.array<TrimEdge>(p.trimEdges);
        c.array<uint32_t>(p.trimBands);
      });
    case PrimitiveType::kPoints:
      return with(sourceRecord<PointsSource>(s, o), [&](const PointsSource& p) {
        addPositions(c, p.positions);
        c.array<float>(p.widths);
        c.array<uint32_t>(p.order);
        c.array<PointCluster>(p.clusters);
      });
    case PrimitiveType::kCurves:
      return with(sourceRecord<CurvesSource>(s, o), [&](const CurvesSource& p) {
        addPositions(c, p.positions);
        for (const float f : p.basis) c.values(f);
        c.values(p.cubic, p.periodic, p.step);
        c.array<CurveRecord>(p.curves);
        c.array<CurvePiece>(p.pieces);
        c.array<CurveCluster>(p.clusters);
      });
  }
}

void addBox(Content& c, const Box3f& b) { c.values(b.min.x, b.min.y, b.min.z, b.max.x, b.max.y, b.max.z); }

void addPatches(Content& c, const Skeleton& s, const ObjectRecord& o) {
  const auto roots = s.rootPatches();
  const auto edges = s.edges();
  c.values(o.patchCount);
  for (uint32_t i = 0; i < o.patchCount && uint64_t(o.firstPatch) + i < roots.size(); ++i) {
    const RootPatchRecord& r = roots[o.firstPatch + i];
    c.values(r.face, uint32_t(r.firstEdge != kNone));
    addBox(c, r.bound);
    if (r.firstEdge == kNone || uint64_t(r.firstEdge) + 8 > edges.size()) continue;
    for (uint32_t k = 0; k < 8; ++k) {
      const EdgeRecord& e = edges[r.firstEdge + k];
      // An owner in another object cannot be told by its distance: no two are taken for the same.
      const bool own = e.owner >= o.firstPatch && e.owner - o.firstPatch < o.patchCount;
      c.values(own ? e.owner - o.firstPatch : e.owner, own, e.ownerEdge, e.reversed);
    }
  }
}

void addDicing(Content& c, const Skeleton& s, ObjectId id, bool displacement) {
  const ObjectRecord& o = s.objects()[id];
  const AttributeRecord& a = s.attributes()[o.attributes];
  c.values(o.type, o.keyCount, o.fixedRate, o.prototype != kNone);
  addBox(c, o.bound);
  c.transform(o.transform);
  if (o.prototype != kNone) c.transform(s.objects()[o.prototype].transform);
  c.values(a.shadingRate, a.patchMultiplier, a.displacementBound, a.flatness, a.motionFactor, a.focusFactor,
           a.flags & (kReverseInCacheSpace | kReverseOrientation | kSubtracted));
  addSource(c, s, o);
  addPatches(c, s, o);
  c.values(a.displacement != kNone, a.deformation != 0);
  if (!displacement || (a.displacement == kNone && a.deformation == 0)) return;
  c.shader(a.displacement);
  c.shader(a.deformation - 1);  // 0, none, becomes kNone
  c.params(o.primvars);
  c.params(a.attributes);
  for (const float f : a.textureCoordinates) c.values(f);
  c.values(a.color.x, a.color.y, a.color.z, a.opacity.x, a.opacity.y, a.opacity.z);
}

}  // namespace

ContentKey diceContent(const Skeleton& s, ObjectId object, bool displacement) {
  Content c(s);
  addDicing(c, s, object, displacement);
  return c.key();
}

ContentKey wholeContent(const Skeleton& s, ObjectId object) {
  Content c(s);
  addDicing(c, s, object, true);
  const ObjectRecord& o = s.objects()[object];
  const AttributeRecord& a = s.attributes()[o.attributes];
  c.values(a.thinning[0], a.thinning[1]);
  c.values(o.sides, a.flags, a.sides, a.visibility, a.castsShadows, a.bias, a.areaLight != 0);
  c.values(a.color.x, a.color.y, a.color.z, a.opacity.x, a.opacity.y, a.opacity.z);
  for (const float f : a.textureCoordinates) c.values(f);
  for (const ShaderId id : {a.surface, a.displacement, a.atmosphere, a.interior, a.exterior}) c.shader(id);
  for (const ShaderId id : s.lightList(a.lights)) c.shader(id);
  c.text(s.string(a.name));
  c.text(s.string(a.groups));
  c.params(a.attributes);
  c.params(o.primvars);
  return c.key();
}

ContentKey transformContent(const Skeleton& s, TransformId transform) {
  Content c(s);
  c.transform(transform);
  return c.key();
}

ContentKey frameContent(const Skeleton& s) {
  Content c(s);
  const CameraRecord& k = s.camera();
  c.transform(k.worldToCamera);
  c.values(k.projection, k.fov, k.resolution[0], k.resolution[1], k.pixelAspect, k.frameAspect, k.clipping[0],
           k.clipping[1], k.shutter[0], k.shutter[1]);
  for (const float f : k.screenWindow) c.values(f);
  for (const float f : k.cropWindow) c.values(f);
  for (const float f : k.dof) c.values(f);
  for (uint32_t i = 0; i < std::min(k.clippingPlaneCount, kMaxClippingPlanes); ++i)
    for (const float f : k.clippingPlanes[i]) c.values(f);
  const OptionsRecord& o = s.options();
  for (const float f : {o.pixelSamples[0], o.pixelSamples[1], o.filterWidth[0], o.filterWidth[1],
                        o.exposure[0], o.exposure[1], o.pixelVariance})
    c.values(f);
  for (const float f : o.quantizeRgba) c.values(f);
  for (const float f : o.quantizeZ) c.values(f);
  c.text(s.string(o.filter));
  c.text(s.string(o.hider));
  c.params(o.hiderParams);
  c.params(o.options);
  c.shader(o.imager);
  c.values(o.maxRayLevel);
  for (const DisplayRecord& d : s.displays(o.displays)) {
    c.text(s.string(d.name));
    c.text(s.string(d.type));
    c.text(s.string(d.mode));
    c.params(d.params);
  }
  return c.key();
}

}  // namespace fr::cache
