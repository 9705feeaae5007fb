#include "scene_cache/skeleton_check.h"

#include <bit>
#include <cmath>
#include <cstring>

#include "scene_cache/cache.h"

namespace fr::cache {
namespace {

uint32_t swapped(uint32_t x) { return __builtin_bswap32(x); }

template <class... Args>
Error bad(fmt::format_string<Args...> f, Args&&... args) {
  return makeError(RiError::kBadFile, "damaged scene cache: {}", fmt::format(f, std::forward<Args>(args)...));
}

/// The first problem wins; later checks are skipped.
class Checker {
 public:
  explicit Checker(std::span<const std::byte> bytes)
      : base_(bytes.data()),
        total_(bytes.size()),
        h_(*reinterpret_cast<const SkeletonHeader*>(bytes.data())) {}

  Result<void> run() {
    const bool tables =
        table<StringRecord>(h_.strings, "strings") && table<ParamRecord>(h_.params, "params") &&
        table<TransformRecord>(h_.transforms, "transforms") && table<ShaderRecord>(h_.shaders, "shaders") &&
        table<ShaderId>(h_.lightLists, "light lists") &&
        table<NamedSpaceRecord>(h_.namedSpaces, "named spaces") &&
        table<AttributeRecord>(h_.attributes, "attributes") && table<ObjectRecord>(h_.objects, "objects") &&
        table<RootPatchRecord>(h_.rootPatches, "root patches") && table<EdgeRecord>(h_.edges, "edges") &&
        table<DisplayRecord>(h_.displays, "displays") && table<CameraRecord>(h_.camera, "camera") &&
        table<OptionsRecord>(h_.options, "options") && table<StringId>(h_.searchPaths, "search paths") &&
        table<SolidRecord>(h_.solids, "solids");
    if (tables && h_.camera.count != 1) fail("it has {} cameras instead of 1", h_.camera.count);
    if (ok() && tables && h_.options.count != 1)
      fail("it has {} option records instead of 1", h_.options.count);
    if (ok() && !(finite(h_.cacheOrigin.x) && finite(h_.cacheOrigin.y) && finite(h_.cacheOrigin.z)))
      fail("the cache origin is not finite");
    if (ok()) strings();
    if (ok()) params();
    if (ok()) transforms();
    if (ok()) shaders();
    if (ok()) attributes();
    if (ok()) solids();
    if (ok()) objects();
    if (ok()) patches();
    if (ok()) frame();
    if (error_) return *error_;
    return {};
  }

 private:
  bool ok() const { return !error_; }
  template <class... Args>
  bool fail(fmt::format_string<Args...> f, Args&&... args) {
    if (!error_) error_ = bad(f, std::forward<Args>(args)...);
    return false;
  }
  static bool finite(double x) { return std::isfinite(x); }
  template <class T>
  std::span<const T> at(const Range& r) const {
    return {reinterpret_cast<const T*>(base_ + r.offset), size_t(r.count)};
  }
  template <class T>
  bool inside(const Range& r) const {
    // The offset of nothing is checked too: it is made into a pointer all the same.
    if (r.offset > total_ || r.offset % alignof(T) != 0) return false;
    return r.count == 0 || (r.offset >= sizeof(SkeletonHeader) && r.count <= (total_ - r.offset) / sizeof(T));
  }
  template <class T>
  bool table(const Range& r, const char* what) {
    if (!inside<T>(r))
      return fail("table of {} ({} entries at byte {}) does not lie inside the {} bytes", what, r.count,
                  r.offset, total_);
    if (r.count >= kNone) return fail("table of {} has {} entries", what, r.count);
    return true;
  }
  bool slice(const Slice& s, const Range& table, const char* what, size_t index, const char* member) {
    if (uint64_t(s.first) + s.count <= table.count) return true;
    return fail("{} {}: {} [{}, +{}) of {}", what, index, member, s.first, s.count, table.count);
  }
  bool id(uint32_t value, const Range& table, bool mayBeNone, const char* what, size_t index,
          const char* member) {
    if (value < table.count || (mayBeNone && value == kNone)) return true;
    return fail("{} {}: {} {} of {}", what, index, member, value, table.count);
  }

  void strings() {
    const auto all = at<StringRecord>(h_.strings);
    if (all.empty() || all[0].size != 0) return void(fail("string 0 is not empty"));
    for (size_t i = 0; i < all.size(); ++i)
      if (!inside<char>({all[i].offset, all[i].size})) {
        fail("string {} ({} bytes at byte {}) does not lie inside the {} bytes", i, all[i].size,
             all[i].offset, total_);
        return;
      }
  }

  void params() {
    const auto all = at<ParamRecord>(h_.params);
    for (size_t i = 0; i < all.size(); ++i) {
      const ParamRecord& p = all[i];
      if (!id(p.name, h_.strings, false, "parameter", i, "name")) return;
      if (p.storage > ParamClass::kFaceVertex) return void(fail("parameter {}: class {}", i, int(p.storage)));
      if (p.type > ParamType::kMatrix) return void(fail("parameter {}: type {}", i, int(p.type)));
      if (p.arrayLength == 0) return void(fail("parameter {}: array of length 0", i));
      if (!inside<float>(p.values))
        return void(fail("parameter {}: {} numbers at byte {} do not lie inside the {} bytes", i,
                         p.values.count, p.values.offset, total_));
      static constexpr uint32_t kComponents[] = {1, 1, 1, 3, 3, 3, 3, 4, 16};
      if (p.values.count % (uint64_t(kComponents[int(p.type)]) * p.arrayLength) != 0)
        return void(fail("parameter {}: {} numbers do not make whole values", i, p.values.count));
      if (p.type == ParamType::kString)
        for (const StringId s : at<StringId>(p.values))
          if (!id(s, h_.strings, false, "parameter", i, "string")) return;
    }
  }

  void transforms() {
    const auto all = at<TransformRecord>(h_.transforms);
    for (size_t i = 0; i < all.size(); ++i) {
      const TransformRecord& t = all[i];
      if (t.times.count == 0 || t.times.count != t.matrices.count || t.times.count > kMaxKeys)
        return void(fail("transform {}: {} times and {} matrices", i, t.times.count, t.matrices.count));
      if (!inside<float>(t.times) || !inside<DMat4>(t.matrices))
        return void(fail("transform {}: its keys do not lie inside the {} bytes", i, total_));
      const auto times = at<float>(t.times);
      for (size_t k = 0; k < times.size(); ++k)
        if (!finite(times[k]) || (k > 0 && !(times[k - 1] < times[k])))
          return void(fail("transform {}: key times do not ascend", i));
      for (const DMat4& m : at<DMat4>(t.matrices))
        for (int c = 0; c < 4; ++c)
          for (int r = 0; r < 4; ++r)
            if (!finite(m[c][r])) return void(fail("transform {}: a matrix is not finite", i));
    }
  }

  void shaders() {
    const auto all = at<ShaderRecord>(h_.shaders);
    for (size_t i = 0; i < all.size(); ++i) {
      const ShaderRecord& s = all[i];
      if (s.kind > ShaderKind::kDeformation) return void(fail("shader {}: kind {}", i, uint32_t(s.kind)));
      if (!(id(s.name, h_.strings, false, "shader", i, "name") &&
            id(s.transform, h_.transforms, false, "shader", i, "transform") &&
            slice(s.params, h_.params, "shader", i, "parameters") &&
            id(s.areaLightObject, h_.objects, true, "shader", i, "area light object") &&
            id(s.handle, h_.strings, false, "shader", i, "handle") &&
            id(s.locationFile, h_.strings, false, "shader", i, "location") &&
            id(s.attributes, h_.attributes, true, "shader", i, "attributes")))
        return;
    }
    const auto spaces = at<NamedSpaceRecord>(h_.namedSpaces);
    for (size_t i = 0; i < spaces.size(); ++i)
      if (!id(spaces[i].name, h_.strings, false, "coordinate system", i, "name") ||
          !id(spaces[i].transform, h_.transforms, false, "coordinate system", i, "transform"))
        return;
  }

  bool shaderOfKind(ShaderId s, ShaderKind kind, const char* what, size_t index, const char* member) {
    if (!id(s, h_.shaders, true, what, index, member)) return false;
    if (s == kNone || at<ShaderRecord>(h_.shaders)[s].kind == kind) return true;
    return fail("{} {}: {} {} is a shader of kind {}", what, index, member, s,
                uint32_t(at<ShaderRecord>(h_.shaders)[s].kind));
  }

  void attributes() {
    const auto lights = at<ShaderId>(h_.lightLists);
    for (size_t i = 0; i < lights.size(); ++i)
      if (!id(lights[i], h_.shaders, false, "light list entry", i, "shader") ||
          !shaderOfKind(lights[i], ShaderKind::kLight, "light list entry", i, "shader"))
        return;
    const auto all = at<AttributeRecord>(h_.attributes);
    for (size_t i = 0; i < all.size(); ++i) {
      const AttributeRecord& a = all[i];
      const char* what = "attribute state";
      if (!(shaderOfKind(a.surface, ShaderKind::kSurface, what, i, "surface") &&
            (a.displacement == a.surface ||
             shaderOfKind(a.displacement, ShaderKind::kDisplacement, what, i, "displacement")) &&
            shaderOfKind(a.atmosphere, ShaderKind::kVolume, what, i, "atmosphere") &&
            shaderOfKind(a.interior, ShaderKind::kVolume, what, i, "interior") &&
            shaderOfKind(a.exterior, ShaderKind::kVolume, what, i, "exterior") &&
            shaderOfKind(a.deformation == 0 ? kNone : a.deformation - 1, ShaderKind::kDeformation, what, i,
                         "deformation") &&
            shaderOfKind(a.areaLight == 0 ? kNone : a.areaLight - 1, ShaderKind::kLight, what, i,
                         "area light") &&
            slice(a.lights, h_.lightLists, what, i, "lights") &&
            id(a.name, h_.strings, false, what, i, "name") &&
            slice(a.attributes, h_.params, what, i, "attributes") &&
            id(a.groups, h_.strings, false, what, i, "groups")))
        return;
      if (a.castsShadows > CastsShadows::kShade)
        return void(fail("attribute state {}: casts_shadows {}", i, int(a.castsShadows)));
      if (a.sides != 1 && a.sides != 2) return void(fail("attribute state {}: {} sides", i, a.sides));
      if (!(a.shadingRate > 0) || !finite(a.shadingRate) || !finite(a.patchMultiplier) || !finite(a.bias) ||
          !(a.displacementBound >= 0) || !finite(a.displacementBound) || !(a.flatness >= 0) ||
          !finite(a.flatness) || !(a.motionFactor >= 0) || !finite(a.motionFactor) || !(a.focusFactor >= 0) ||
          !finite(a.focusFactor) || !(a.thinning[0] >= 0 && a.thinning[0] <= 1) ||
          !(a.thinning[1] >= 0 && a.thinning[1] <= 1))
        return void(fail("attribute state {}: a rate or bound is out of range", i));
    }
  }

  void solids() {
    const auto all = at<SolidRecord>(h_.solids);
    for (size_t i = 0; i < all.size(); ++i) {
      const SolidRecord& s = all[i];
      if (s.operation > SolidOperation::kDifference)
        return void(fail("solid {}: operation {}", i, uint32_t(s.operation)));
      if (s.isFirst > 1) return void(fail("solid {}: first {}", i, s.isFirst));
      if (s.parent == kNone) continue;
      // Parents come first, so that there are no loops; leaves have no parts.
      if (s.parent >= i) return void(fail("solid {}: parent {}", i, s.parent));
      if (all[s.parent].operation == SolidOperation::kPrimitive)
        return void(fail("solid {}: parent {} is no operation", i, s.parent));
    }
  }

  void objects() {
    const auto solids = at<SolidRecord>(h_.solids);
    const auto all = at<ObjectRecord>(h_.objects);
    for (size_t i = 0; i < all.size(); ++i) {
      const ObjectRecord& o = all[i];
      if (o.type > PrimitiveType::kCurves) return void(fail("object {}: type {}", i, int(o.type)));
      if (o.keyCount == 0 || o.keyCount > kMaxKeys)
        return void(fail("object {}: {} motion keys", i, o.keyCount));
      if (!(id(o.attributes, h_.attributes, false, "object", i, "attributes") &&
            id(o.transform, h_.transforms, false, "object", i, "transform") &&
            slice(o.primvars, h_.params, "object", i, "primitive variables") &&
            slice({o.firstPatch, o.patchCount}, h_.rootPatches, "object", i, "patches") &&
            id(o.locationFile, h_.strings, false, "object", i, "file") &&
            id(o.prototype, h_.objects, true, "object", i, "prototype")))
        return;
      if (o.solidPlus1 != 0 && (!id(solidOf(o), h_.solids, false, "object", i, "solid") ||
                                solids[solidOf(o)].operation != SolidOperation::kPrimitive))
        return void(fail("object {}: solid {} is no leaf", i, solidOf(o)));
      if (!(o.fixedRate >= 0) || !finite(o.fixedRate))
        return void(fail("object {}: a fixed rate of {}", i, o.fixedRate));
      if (o.prototype != kNone) {
        const ObjectRecord& p = all[o.prototype];
        if (p.prototype != kNone || p.fixedRate == 0 || o.fixedRate != 0 || p.type != o.type ||
            p.patchCount != o.patchCount || p.keyCount != o.keyCount)
          return void(fail("object {}: object {} cannot be its prototype", i, o.prototype));
      }
      // 16: the alignment that primitive sources are written with.
      if (!inside<std::byte>(o.source) || (o.source.count != 0 && o.source.offset % 16 != 0))
        return void(fail("object {}: its source ({} bytes at byte {}) does not lie inside the {} bytes", i,
                         o.source.count, o.source.offset, total_));
    }
  }

  void patches() {
    const auto edges = at<EdgeRecord>(h_.edges);
    for (size_t i = 0; i < edges.size(); ++i) {
      if (!id(edges[i].owner, h_.rootPatches, false, "edge", i, "owner")) return;
      if (edges[i].ownerEdge > 3 || edges[i].reversed > 1)
        return void(
            fail("edge {}: side {}, reversed {}", i, int(edges[i].ownerEdge), int(edges[i].reversed)));
    }
    const auto objects = at<ObjectRecord>(h_.objects);
    const auto all = at<RootPatchRecord>(h_.rootPatches);
    for (size_t i = 0; i < all.size(); ++i) {
      const RootPatchRecord& p = all[i];
      if (!id(p.object, h_.objects, false, "root patch", i, "object")) return;
      const ObjectRecord& o = objects[p.object];
      if (i < o.firstPatch || i - o.firstPatch >= o.patchCount)
        return void(fail("root patch {}: object {} does not list it", i, p.object));
      if (p.firstEdge != kNone && uint64_t(p.firstEdge) + 8 > edges.size())
        return void(fail("root patch {}: edges [{}, +8) of {}", i, p.firstEdge, edges.size()));
    }
  }

  void frame() {
    const CameraRecord& c = at<CameraRecord>(h_.camera)[0];
    if (!id(c.worldToCamera, h_.transforms, false, "camera", 0, "transform")) return;
    if (c.projection > ProjectionType::kPerspective)
      return void(fail("camera: projection {}", uint32_t(c.projection)));
    for (int k = 0; k < 2; ++k) {
      if (c.resolution[k] < 1 || c.resolution[k] > kMaxResolution)
        return void(fail("camera: a resolution of {} x {}", c.resolution[0], c.resolution[1]));
      const int lo = c.cropPixels[2 * k], hi = c.cropPixels[2 * k + 1];
      if (lo < 0 || hi >= c.resolution[k])
        return void(fail("camera: crop window [{}, {}] outside the image", lo, hi));
    }
    bool numbers = finite(c.fov) && c.fov > 0 && c.fov < 180 && finite(c.pixelAspect) && c.pixelAspect > 0 &&
                   finite(c.frameAspect) && c.frameAspect > 0 && c.clipping[0] < c.clipping[1];
    for (const float x : c.screenWindow) numbers = numbers && finite(x);
    for (const float x : c.cropWindow) numbers = numbers && finite(x);
    for (const float x : c.clipping) numbers = numbers && finite(x);
    for (const float x : c.shutter) numbers = numbers && finite(x);
    for (const float x : c.dof) numbers = numbers && finite(x);
    numbers = numbers && c.clippingPlaneCount <= kMaxClippingPlanes;
    for (const auto& plane : c.clippingPlanes)
      for (const float x : plane) numbers = numbers && finite(x);
    if (!numbers || !(c.screenWindow[0] != c.screenWindow[1] && c.screenWindow[2] != c.screenWindow[3]))
      return void(fail("camera: a number is out of range"));

    const OptionsRecord& o = at<OptionsRecord>(h_.options)[0];
    if (!(id(o.filter, h_.strings, false, "options", 0, "filter") &&
          id(o.hider, h_.strings, false, "options", 0, "hider") &&
          slice(o.hiderParams, h_.params, "options", 0, "hider parameters") &&
          shaderOfKind(o.imager, ShaderKind::kImager, "options", 0, "imager") &&
          slice(o.displays, h_.displays, "options", 0, "displays") &&
          slice(o.options, h_.params, "options", 0, "options")))
      return;
    for (int k = 0; k < 2; ++k)
      if (!(o.pixelSamples[k] >= 1 && o.pixelSamples[k] <= kMaxPixelSamples) ||
          !(o.filterWidth[k] > 0 && o.filterWidth[k] <= kMaxFilterWidth) || !finite(o.exposure[k]))
        return void(fail("options: samples, filter width or exposure out of range"));
    const auto displays = at<DisplayRecord>(h_.displays);
    for (size_t i = 0; i < displays.size(); ++i)
      if (!(id(displays[i].name, h_.strings, false, "display", i, "name") &&
            id(displays[i].type, h_.strings, false, "display", i, "type") &&
            id(displays[i].mode, h_.strings, false, "display", i, "mode") &&
            slice(displays[i].params, h_.params, "display", i, "parameters")))
        return;
    for (const StringId s : at<StringId>(h_.searchPaths))
      if (!id(s, h_.strings, false, "search paths", 0, "string")) return;
  }

  const std::byte* base_;
  uint64_t total_;
  const SkeletonHeader& h_;
  std::optional<Error> error_;
};

}  // namespace

Result<void> checkSkeleton(std::span<const std::byte> bytes, bool verifyChecksum) {
  if (bytes.size() < sizeof(SkeletonHeader))
    return makeError(RiError::kBadFile, "not a scene cache: {} bytes, less than the header's {}",
                     bytes.size(), sizeof(SkeletonHeader));
  FR_CHECK(reinterpret_cast<uintptr_t>(bytes.data()) % 64 == 0);
  const SkeletonHeader& h = *reinterpret_cast<const SkeletonHeader*>(bytes.data());
  if (h.byteOrder == swapped(0x01020304u))
    return makeError(RiError::kVersion, "scene cache of a machine with the other byte order");
  if (h.magic != kSkeletonMagic) return makeError(RiError::kBadFile, "not a scene cache: wrong magic number");
  if (h.version != kFormatVersion)
    return makeError(RiError::kVersion, "scene cache of format version {}; this program reads version {}",
                     h.version, kFormatVersion);
  if (h.byteOrder != 0x01020304u) return bad("byte order mark {:#010x}", h.byteOrder);
  if (h.layout != layoutFingerprint())
    return makeError(RiError::kVersion,
                     "scene cache of an incompatible build: record layout {:016x}, this program's is {:016x}",
                     h.layout, layoutFingerprint());
  if (h.totalBytes < sizeof(SkeletonHeader) || h.totalBytes > bytes.size())
    return makeError(RiError::kBadFile, "truncated scene cache: {} bytes of {}", bytes.size(), h.totalBytes);
  bytes = bytes.first(size_t(h.totalBytes));
  if (verifyChecksum) {
    const uint64_t sum = skeletonChecksum(bytes);
    if (sum != h.checksum)
      return makeError(RiError::kBadFile, "damaged scene cache: checksum {:016x}, expected {:016x}", sum,
                       h.checksum);
  }
  return Checker(bytes).run();
}

}  // namespace fr::cache
