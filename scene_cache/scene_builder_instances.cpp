// SceneBuilder: instances of retained objects (RISpec 3.2, section 5.8).
//
// The first instance of an object becomes objects like any other. The next ones show prototypes: the same
// objects made once in object space, at one of a few fixed rates, the one nearest to what the instance's
// distance from the eye asks for. They cost records, no geometry and no grids. What depends on the place
// itself keeps grids of its own: what is displaced (shader space differs), moves, faces the eye, is squeezed,
// or is so near that one rate would not do.
#include <algorithm>
#include <cmath>

#include "scene_cache/building_world.h"
#include "scene_cache/cache_impl.h"
#include "scene_cache/motion.h"

namespace fr::cache {
namespace {

/// Rates are this many to a factor of two: an instance's micropolygons are at most 19 % too long or too
/// short.
constexpr double kRatesPerOctave = 2;
/// The farthest point of an instance is at most so many times as far as its nearest.
constexpr double kMostDepth = 2;
/// Scales along different axes differ by no more than this factor.
constexpr double kMostSqueezed = 2;
/// Fewer micropolygons than this are not worth the records and the second level of the ray tracer's tree.
constexpr double kLeastMicropolygons = 512;

bool isShareable(const ri::Primitive& p) {
  // Points and curves face the eye; blobs are polygons for one distance.
  return !std::holds_alternative<ri::Points>(p) && !std::holds_alternative<ri::Curves>(p) &&
         !std::holds_alternative<ri::Blobby>(p) && !std::holds_alternative<ri::Geometry>(p);
}

bool isInvertible(const DMat4& m) {
  const double det = glm::determinant(DMat3(m));
  return std::isfinite(det) && std::abs(det) > 1e-30;
}

Box3d placed(const DMat4& m, const Box3d& box) {
  Box3d r;
  for (int i = 0; i < 8; ++i) r.extend(transformPoint(m, box.corner(i)));
  return r;
}

bool hasSolids(const ri::RetainedObject& object) {
  return std::any_of(object.shapes.begin(), object.shapes.end(), [](const ri::RetainedObject::Shape& s) {
    const auto* nested = std::get_if<std::shared_ptr<const ri::RetainedObject>>(&s.what);
    return std::holds_alternative<ri::RetainedObject::SolidStart>(s.what) || (nested && hasSolids(**nested));
  });
}

DMat4 translation(const DVec3& t) {
  DMat4 m(1);
  m[3] = DVec4(t, 1);
  return m;
}

}  // namespace

void SceneBuilder::onInstance(const ri::RetainedObject& object, const ri::AttributePtr& attributes,
                              const ri::TransformPtr& objectToWorld) {
  if (!adding()) return;
  endRun();
  World& w = *world_;
  ++w.counts.instances;
  // Right inside a set operation an instance is one solid.
  std::optional<SolidBlocks::Whole> whole;
  if (!hasSolids(object)) whole.emplace(w.solids);
  if (!canShare(object, *attributes, *objectToWorld))
    return StateRenderer::onInstance(object, attributes, objectToWorld);
  const auto& first = std::get<ri::MovingPrimitivePtr>(object.shapes.front().what);
  const DMat4 toCache = translation(-w.writer.cacheOrigin()) * objectToWorld->matrices.front();
  const auto [at, fresh] = w.retained.try_emplace(&object);
  Retained& known = at->second;
  if (fresh || known.first != first) {
    known = {};
    known.first = first;
    const ObjectId begin = w.writer.nextObject();
    StateRenderer::onInstance(object, attributes, objectToWorld);
    endRun();
    Box3f all;
    for (ObjectId i = begin; i < w.writer.nextObject(); ++i) {
      const ObjectRecord& o = w.writer.object(i);
      all.extend(o.bound);
      known.faces += uint64_t(o.patchCount) * (o.type == PrimitiveType::kMeshlets ? kMaxMeshletVertices : 1);
    }
    if (!all.empty()) known.bound = placed(glm::inverse(toCache), {DVec3(all.min), DVec3(all.max)});
    return;
  }
  const AttributeId id = w.records.attributes(attributes, objectToWorld, detailThinning(*attributes));
  const float rate = w.writer.ok() ? sharedRate(known, w.writer.attributes(id), toCache) : 0.0f;
  if (!(rate > 0)) return StateRenderer::onInstance(object, attributes, objectToWorld);
  addInstance(object, attributes, *objectToWorld, &known, rate);
}

bool SceneBuilder::canShare(const ri::RetainedObject& object, const ri::AttributeState& a,
                            const ri::Transform& objectToWorld) const {
  if (objectToWorld.matrices.size() != 1 || !isInvertible(objectToWorld.matrices.front())) return false;
  if (a.displacement || world_->records.movingSurface(a) || a.areaLight >= 0 || a.bound || a.deformation ||
      !detailThinning(a).seen() || world_->solids.open() || object.shapes.empty())
    return false;
  const DMat4& m = objectToWorld.matrices.front();
  if (!(largestStretch(m) * largestStretch(glm::inverse(m)) <= kMostSqueezed)) return false;
  return std::all_of(object.shapes.begin(), object.shapes.end(), [](const ri::RetainedObject::Shape& s) {
    const auto* p = std::get_if<ri::MovingPrimitivePtr>(&s.what);
    return p && isShareable((*p)->samples.front()) && s.toObject->matrices.size() == 1 &&
           isInvertible(s.toObject->matrices.front());
  });
}

float SceneBuilder::sharedRate(const Retained& known, const AttributeRecord& attributes,
                               const DMat4& objectToCache) const {
  if (known.bound.empty()) return 0;
  World& w = *world_;
  if (!w.eye) {
    const TransformKeys camera = w.writer.transform(w.writer.camera().worldToCamera);
    DMat4 cacheToCamera = interpolateMotion(camera.times, camera.matrices, w.writer.camera().shutter[0]);
    cacheToCamera[3] = cacheToCamera * DVec4(w.writer.cacheOrigin(), 1.0);
    w.eye = diceEye(w.writer.camera(), cacheToCamera);
  }
  const DiceRate rate = diceRate(*w.eye, attributes, PrimitiveType::kMeshlets);
  const Box3d box = placed(objectToCache, known.bound);
  double wanted = double(rate.scale);
  if (rate.perspective) {
    const DVec3& eye = w.eye->position;
    const DVec3 inside = glm::clamp(eye, box.min, box.max);
    const double near = glm::length(inside - eye);
    const double far = glm::length(glm::max(glm::abs(box.min - eye), glm::abs(box.max - eye)));
    if (!(near > w.eye->nearDistance) || !(far <= kMostDepth * near)) return 0;
    const Vec3 middle(box.center() - eye);
    wanted *= double(rate.viewWeight(middle, middle)) / std::sqrt(near * far);
  }
  const DVec3 size = box.max - box.min;
  if (!rate.perspective) {
    const Vec3 middle(box.center() - w.eye->position);
    wanted *= double(rate.cylinderWeight(middle, middle));
  }
  const double across = std::sqrt(glm::dot(size, size)) * wanted;
  if (!(std::max(double(known.faces), 0.25 * across * across) >= kLeastMicropolygons)) return 0;
  wanted *= largestStretch(objectToCache);
  const double step = std::nearbyint(kRatesPerOctave * std::log2(wanted));
  const double fixed = std::exp2(step / kRatesPerOctave);
  return std::isfinite(fixed) && fixed > 1e-30 && fixed < 1e30 ? float(fixed) : 0.0f;
}

void SceneBuilder::addInstance(const ri::RetainedObject& object, const ri::AttributePtr& attributes,
                               const ri::Transform& objectToWorld, Retained* known, float rate) {
  World& w = *world_;
  const bool outside = attributes->values.getString("trimcurve:sense", "inside") == "outside";
  const auto [at, fresh] = known->prototypes.try_emplace(Retained::Key{rate, attributes->flatness, outside});
  std::vector<Retained::Part>& parts = at->second;
  if (fresh) {
    const ri::Transform toWorld(translation(w.writer.cacheOrigin()));
    for (size_t i = 0; i < object.shapes.size(); ++i) {
      const ri::RetainedObject::Shape& s = object.shapes[i];
      const ObjectId begin = w.writer.nextObject();
      const auto place = std::make_shared<const ri::Transform>(concat(toWorld, *s.toObject));
      if (!add({std::get<ri::MovingPrimitivePtr>(s.what), attributes, place}, rate)) continue;
      for (ObjectId id = begin; id < w.writer.nextObject(); ++id) parts.push_back({id, i});
    }
  }
  w.counts.primitives += object.shapes.size();
  ++w.counts.sharedInstances;
  const DMat4 placement = translation(-w.writer.cacheOrigin()) * objectToWorld.matrices.front();
  const uint32_t instance = w.writer.nextObject();
  size_t shape = object.shapes.size();
  ri::TransformPtr place;
  ri::AttributePtr own;
  std::vector<RootPatchRecord> patches;
  for (const Retained::Part& part : parts) {
    if (part.shape != shape) {
      shape = part.shape;
      place = std::make_shared<const ri::Transform>(concat(objectToWorld, *object.shapes[shape].toObject));
      const auto& source = std::get<ri::MovingPrimitivePtr>(object.shapes[shape].what);
      own = w.records.withStrings(attributes, ri::paramsOf(source->samples.front()));
    }
    ObjectRecord o = w.writer.object(part.prototype);
    const NodeId from = o.firstPatch;
    o.prototype = part.prototype, o.instance = instance, o.fixedRate = 0;
    o.sides = sides_;
    o.transform = w.records.transform(place);
    o.attributes = w.records.attributes(own, place, detailThinning(*attributes));
    o.surfaceGroup = w.writer.surfaceGroup(o.attributes, o.transform);
    o.firstPatch = w.writer.nextRootPatch();
    o.bound = {};
    patches.clear();
    for (uint32_t i = 0; i < o.patchCount; ++i) {
      RootPatchRecord p = w.writer.rootPatch(from + i);
      p.object = w.writer.nextObject();
      p.firstEdge = kNone;
      p.bound = placedBound(placement, p.bound);
      o.bound.extend(p.bound);
      patches.push_back(p);
    }
    w.writer.addRootPatches(patches);
    w.writer.addObject(o);
    if (!w.writer.ok()) return;
  }
}

}  // namespace fr::cache
