#include "scene_cache/attribute_records.h"

#include <algorithm>
#include <cmath>

namespace fr::cache {
namespace {

ShaderKind kindOf(ri::ShaderKind k) {
  switch (k) {
    case ri::ShaderKind::kDisplacement:
      return ShaderKind::kDisplacement;
    case ri::ShaderKind::kLight:
    case ri::ShaderKind::kAreaLight:
      return ShaderKind::kLight;
    case ri::ShaderKind::kAtmosphere:
    case ri::ShaderKind::kInterior:
    case ri::ShaderKind::kExterior:
      return ShaderKind::kVolume;
    case ri::ShaderKind::kImager:
      return ShaderKind::kImager;
    case ri::ShaderKind::kDeformation:
      return ShaderKind::kDeformation;
    case ri::ShaderKind::kSurface:
      break;
  }
  return ShaderKind::kSurface;
}

void badValue(const char* name, std::string_view value) {
  reportOnce(fmt::format("attribute {} {}", name, value),
             {RiError::kBadToken,
              Severity::kWarning,
              {},
              fmt::format("Attribute {} has no value \"{}\"; ignored", name, value)});
}

float finiteOr(float x, float otherwise) { return std::isfinite(x) ? x : otherwise; }

}  // namespace

RayVisibility rayVisibility(const ri::NamedValues& a) {
  RayVisibility v;
  const auto set = [&](uint32_t bit, bool on) { v.bits = on ? v.bits | bit : v.bits & ~bit; };
  v.bits = uint32_t(a.getInt("render:visibility", 7)) & 7u;

  if (const std::string mode = a.getString("render:casts_shadows", "Os"); mode == "none")
    v.castsShadows = CastsShadows::kNever;
  else if (mode == "opaque")
    v.castsShadows = CastsShadows::kOpaque;
  else if (mode == "shade")
    v.castsShadows = CastsShadows::kShade;
  else if (mode != "Os")
    badValue("\"render\" \"casts_shadows\"", mode);

  if (a.find("visibility:camera")) set(kVisibleCamera, a.getInt("visibility:camera", 1) != 0);
  // Diffuse and specular are both reflection rays; the older "trace" means both.
  const bool trace = a.getInt("visibility:trace", (v.bits & kVisibleReflection) != 0) != 0;
  const bool specular = a.getInt("visibility:specular", trace) != 0;
  const bool diffuse = a.getInt("visibility:diffuse", trace) != 0;
  set(kVisibleReflection, specular || diffuse);
  if (diffuse && !specular) v.flags |= kNoSpecularRays;
  if (specular && !diffuse) v.flags |= kNoDiffuseRays;
  const auto hitMode = [&](const char* name, uint32_t flag) {
    const std::string mode = a.getString(name, "");
    if (mode == "primitive")
      v.flags |= flag;
    else if (!mode.empty() && mode != "shader")
      badValue(name, mode);
  };
  hitMode("shade:camerahitmode", kCameraHitsPrimitive);
  hitMode("shade:specularhitmode", kSpecularHitsPrimitive);
  hitMode("shade:diffusehitmode", kDiffuseHitsPrimitive);

  if (const ri::Param* t = a.find("visibility:transmission")) {
    if (t->declaration.type == ri::ValueType::kString) {  // the older form
      const std::string mode = a.getString("visibility:transmission", "");
      set(kVisibleShadow, mode != "transparent");
      if (mode == "opaque")
        v.castsShadows = CastsShadows::kOpaque;
      else if (mode == "Os")
        v.castsShadows = CastsShadows::kOs;
      else if (mode == "shader")
        v.castsShadows = CastsShadows::kShade;
      else if (mode != "transparent")
        badValue("\"visibility\" \"transmission\"", mode);
    } else {
      set(kVisibleShadow, a.getInt("visibility:transmission", 1) != 0);
    }
  }
  if (const std::string mode = a.getString("shade:transmissionhitmode", ""); mode == "primitive")
    v.castsShadows = CastsShadows::kOs;
  else if (mode == "shader")
    v.castsShadows = CastsShadows::kShade;
  else if (!mode.empty())
    badValue("\"shade\" \"transmissionhitmode\"", mode);

  if (v.castsShadows == CastsShadows::kNever) set(kVisibleShadow, false);
  return v;
}

double largestStretch(const DMat4& m) {
  // Power iteration on A^T A; 3x3, so few steps are enough, and the column norms guard the result from below.
  const DMat3 a(m), s = glm::transpose(a) * a;
  DVec3 x(1, 0.61803, 0.38197);
  double value = 0;
  for (int i = 0; i < 64; ++i) {
    const DVec3 y = s * x;
    const double n = glm::length(y);
    if (!(n > 0) || !std::isfinite(n)) break;
    value = n / glm::length(x);
    x = y / n;
  }
  double r = std::sqrt(value);
  for (int c = 0; c < 3; ++c) r = std::max(r, glm::length(a[c]));
  return std::isfinite(r) ? r : 0;
}

AttributeRecords::AttributeRecords(SkeletonWriter& writer, const ri::GraphicsState& state,
                                   bool cameraMirrored, const Rates& rates, const MovesPoints& movesPoints,
                                   const TakesString& takesString)
    : writer_(writer),
      state_(state),
      cameraMirrored_(cameraMirrored),
      rates_(rates),
      movesPoints_(movesPoints),
      takesString_(takesString) {}

std::vector<std::string> AttributeRecords::shaderFolders() const {
  const auto& paths = state_.options().searchPaths;
  const auto folders = paths.find("shader");
  return folders == paths.end() ? std::vector<std::string>() : folders->second;
}

ri::ShaderPtr AttributeRecords::movingSurface(const ri::AttributeState& a) {
  const float radius = a.values.getFloat("displacementbound:sphere", 0);
  if (a.displacement || !a.surface || !(radius > 0) || !std::isfinite(radius)) return nullptr;
  if (movesPoints_) {
    const auto [known, fresh] = moves_.try_emplace(a.surface->name);
    if (fresh) known->second = movesPoints_(a.surface->name, shaderFolders());
    if (!known->second) return nullptr;
  }
  return a.surface;
}

ri::ShaderPtr AttributeRecords::withStrings(const ri::ShaderPtr& s,
                                            const std::vector<const ri::Param*>& strings) {
  if (!s) return s;
  std::shared_ptr<ri::ShaderInstance> changed;
  for (const ri::Param* p : strings) {
    if (!takesString_(s->name, shaderFolders(), p->name)) continue;
    if (p->valueCount() != 1) {
      reportOnce(
          "strings " + p->name,
          {RiError::kUnimplemented,
           Severity::kWarning,
           {},
           fmt::format("string \"{}\" of a primitive has {} values, and shaders see one for all of it; "
                       "the parameter of shader \"{}\" stays",
                       p->name, p->valueCount(), s->name)});
      continue;
    }
    if (!changed) changed = std::make_shared<ri::ShaderInstance>(*s);
    ri::Param parameter = *p;
    parameter.declaration.storage = ri::StorageClass::kUniform;
    changed->params.set(std::move(parameter));
  }
  return changed ? changed : s;
}

ri::AttributePtr AttributeRecords::withStrings(const ri::AttributePtr& a, const ri::ParamList& variables) {
  if (!takesString_ || (!a->surface && !a->displacement)) return a;
  std::vector<const ri::Param*> strings;
  for (const ri::Param& p : variables)
    if (p.declaration.type == ri::ValueType::kString) strings.push_back(&p);
  if (strings.empty()) return a;
  const auto same = [](const ri::Param* p, const ri::Param& q) { return *p == q; };
  if (last_.from == a &&
      std::equal(strings.begin(), strings.end(), last_.strings.begin(), last_.strings.end(), same))
    return last_.to;
  auto changed = std::make_shared<ri::AttributeState>(*a);
  changed->surface = withStrings(a->surface, strings);
  changed->displacement = withStrings(a->displacement, strings);
  last_.from = a;
  last_.to = changed->surface == a->surface && changed->displacement == a->displacement
                 ? a
                 : ri::AttributePtr(std::move(changed));
  last_.strings.clear();
  for (const ri::Param* p : strings) last_.strings.push_back(*p);
  return last_.to;
}

TransformId AttributeRecords::transform(const ri::TransformPtr& t) {
  if (!t) return writer_.addTransform({{0.0f}, {DMat4(1)}});
  if (const TransformId* id = transforms_.find(t)) return *id;
  return transforms_.add(t, writer_.addTransform({t->times, t->matrices}));
}

ShaderRecord AttributeRecords::shaderRecord(const ri::ShaderInstance& s) {
  ShaderRecord r{};
  r.name = writer_.intern(s.name);
  r.kind = kindOf(s.kind);
  auto space = state_.toWorld(s.shaderSpace);
  if (space)
    r.transform = transform(*space);
  else {
    report(std::move(space).error().context(fmt::format("space of shader \"{}\"", s.name)));
    r.transform = transform(ri::TransformPtr());
  }
  r.params = writer_.addParams(s.params);
  r.areaLightObject = r.attributes = kNone;
  r.locationFile = writer_.intern(s.location.file);
  r.locationLine = uint32_t(std::max(s.location.line, 0));
  return r;
}

ShaderId AttributeRecords::shader(const ri::ShaderPtr& s) {
  if (!s) return kNone;
  if (const ShaderId* id = shaders_.find(s)) return *id;
  return shaders_.add(s, writer_.addShader(shaderRecord(*s)));
}

ShaderId AttributeRecords::light(int index) {
  const auto& all = state_.lights();
  if (index < 0 || size_t(index) >= all.size() || !all[size_t(index)].shader) return kNone;
  const ri::LightInstance& light = all[size_t(index)];
  if (const auto it = lights_.find(index); it != lights_.end() && it->second.first == light.shader)
    return it->second.second;
  ShaderRecord r = shaderRecord(*light.shader);
  r.kind = ShaderKind::kLight;
  r.handle = writer_.intern(light.handle.name);
  r.lightSamples = 1;
  if (light.attributes) {
    const ri::NamedValues& v = light.attributes->values;
    const std::string shadows = v.getString("light:shadows", "off");
    if (shadows == "on")
      r.lightFlags |= kLightShadows;
    else if (shadows != "off")
      badValue("\"light\" \"shadows\"", shadows);
    r.lightSamples = uint32_t(std::clamp(v.getInt("light:nsamples", 1), 1, 65536));
    // Without its light list: that may name this very light.
    r.attributes = writer_.addAttributes(baseRecord(*light.attributes, false));
  }
  const ShaderId id = writer_.addShader(r);
  lights_[index] = {light.shader, id};
  return id;
}

AttributeRecord AttributeRecords::baseRecord(const ri::AttributeState& a, bool withLights) {
  const ri::NamedValues& v = a.values;
  AttributeRecord r{};
  r.color = a.color;
  r.opacity = a.opacity;
  r.shadingRate = rates_.shadingRate.value_or(a.shadingRate);
  if (!(r.shadingRate > 0) || !std::isfinite(r.shadingRate)) r.shadingRate = 1;
  r.patchMultiplier =
      finiteOr(v.getFloat("render:patch_multiplier", rates_.patchMultiplier.value_or(-1)), -1);
  r.bias = finiteOr(v.getFloat("trace:bias", -1), -1);
  r.flatness = std::max(0.0f, finiteOr(a.flatness, 0));
  r.motionFactor = std::max(0.0f, finiteOr(a.motionFactor, 1));
  r.focusFactor = std::max(0.0f, finiteOr(a.focusFactor, 1));
  r.sides = a.sides == 1 ? 1 : 2;
  if (a.matte) r.flags |= kMatte;
  if (a.smoothShading) r.flags |= kSmoothShading;
  if (v.getInt("sides:doubleshaded", 0) != 0) r.flags |= kDoubleShaded;
  if (v.getInt("trace:displacements", 1) != 0 && v.getInt("render:truedisplacement", 1) != 0)
    r.flags |= kRayDisplacements;
  const RayVisibility visibility = rayVisibility(v);
  r.visibility = visibility.bits;
  r.castsShadows = visibility.castsShadows;
  r.flags |= visibility.flags;
  if (withLights)
    if (const ShaderId id = light(a.areaLight); id != kNone) r.areaLight = id + 1;
  r.surface = shader(a.surface);
  r.displacement = shader(a.displacement ? a.displacement : movingSurface(a));
  if (const ShaderId id = shader(a.deformation); id != kNone) r.deformation = id + 1;
  r.atmosphere = shader(a.atmosphere);
  r.interior = shader(a.interior);
  r.exterior = shader(a.exterior);
  if (withLights && a.lights) {
    std::vector<ShaderId> on;
    on.reserve(a.lights->size());
    for (const int index : *a.lights)
      if (const ShaderId id = light(index); id != kNone) on.push_back(id);
    r.lights = writer_.addLightList(on);
  }
  r.name = writer_.intern(v.getString("identifier:name", ""));
  r.groups = writer_.intern(v.getString("grouping:membership", ""));
  std::vector<ParamRecord> params;
  params.reserve(v.all().size());
  for (const auto& [name, p] : v.all()) params.push_back(writer_.makeParam(p, name));
  r.attributes = writer_.addParams(params);
  std::copy(a.textureCoordinates.begin(), a.textureCoordinates.end(), r.textureCoordinates);
  return r;
}

float AttributeRecords::displacementBound(const ri::AttributeState& a,
                                          const ri::TransformPtr& objectToWorld) {
  ri::ShaderPtr shader = a.displacement ? a.displacement : a.deformation;
  if (!shader) shader = movingSurface(a);
  if (!shader) return 0;
  const double radius = a.values.getFloat("displacementbound:sphere", 0);
  if (!(radius > 0) || !std::isfinite(radius)) return 0;
  const std::string space = a.values.getString("displacementbound:coordinatesystem", "object");
  ri::TransformPtr toWorld = objectToWorld;
  if (space == "world") return float(radius);
  if (space == "shader") {
    if (auto t = state_.toWorld(shader->shaderSpace)) toWorld = *t;
  } else if (space != "object" && space != "current") {
    auto found = state_.findSpace(space);
    Result<ri::TransformPtr> t =
        found ? state_.toWorld(*found) : Result<ri::TransformPtr>(std::move(found).error());
    if (t)
      toWorld = *t;
    else
      reportOnce(
          "displacementbound " + space,
          {RiError::kBadToken,
           Severity::kWarning,
           {},
           fmt::format("Attribute \"displacementbound\": no coordinate system \"{}\"; taken as \"object\"",
                       space)});
  }
  double stretch = 0;
  if (toWorld)
    for (const DMat4& m : toWorld->matrices) stretch = std::max(stretch, largestStretch(m));
  return float(std::min(radius * stretch, double(kRiInfinity)));
}

AttributeId AttributeRecords::attributes(const ri::AttributePtr& a, const ri::TransformPtr& objectToWorld,
                                         Thinning thinning, bool subtracted) {
  const AttributeRecord* known = states_.find(a);
  AttributeRecord r = known ? *known : states_.add(a, baseRecord(*a, true));
  r.displacementBound = displacementBound(*a, objectToWorld);
  r.thinning[0] = thinning.below, r.thinning[1] = thinning.above;
  // RISpec 3.2, "Orientation and Sides": camera space is left-handed, and the normal of a surface in a space
  // is dPdu x dPdv computed there, turned over when orientation and handedness disagree. The graphics state
  // says whether they disagree in *object* space (`reversed`). The same cross product in camera space has the
  // other sign when the way from object to camera is mirrored.
  const bool objectMirrored = objectToWorld && isMirrored(objectToWorld->matrices.front());
  if (a->reversed != objectMirrored) r.flags |= kReverseInCacheSpace;
  if (a->reversed != (objectMirrored != cameraMirrored_)) r.flags |= kReverseOrientation;
  // The outside of a hole is the inside of what made it.
  if (subtracted) r.flags = (r.flags | kSubtracted) ^ (kReverseInCacheSpace | kReverseOrientation);
  return writer_.addAttributes(r);
}

}  // namespace fr::cache
