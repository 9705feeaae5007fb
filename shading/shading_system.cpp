// Loading shaders: from the attribute states of a scene to bound instances.
#include "shading/shading_system.h"

#include <algorithm>

#include "base/random.h"
#include "shading/area_light.h"
#include "shading/compile.h"
#include "shading/passes.h"
#include "shading/system_impl.h"

namespace fr {

using cache::kNone;

namespace {
/// What RenderMan draws without a surface shader: lit from the eye.
constexpr const char* kDefaultSurface =
    "surface defaultsurface(float Kd = 0.8, Ka = 0.2) {\n"
    "  float d = I . N;\n"
    "  d = d * d / max((I . I) * (N . N), 1e-30);\n"
    "  Oi = Os;\n"
    "  Ci = Os * Cs * (Ka + Kd * d);\n"
    "}\n";

ShaderLibrary::Options libraryOptions(const ShadingSystem::Options& o) {
  ShaderLibrary::Options r;
  r.folders = o.shaderPath;
  r.standardShaders = o.standardShaders;
  return r;
}
const char* kindName(ShaderType t) { return shaderTypeName(t); }
std::string joined(const std::vector<std::string>& names) {
  std::string r;
  for (const std::string& n : names) r += n + ",";
  return r;
}

// RIB files may set parameters without declaring them: the reader keeps them as floats, and only here is it
// known that three of them are a colour, or a point to be transformed.
cache::ParamRecord typedAs(const ShaderProgram& program, std::string_view name, cache::ParamRecord given) {
  if (given.type != cache::ParamType::kFloat) return given;
  constexpr cache::ParamType kTypes[] = {cache::ParamType::kFloat,  cache::ParamType::kColor,
                                         cache::ParamType::kPoint,  cache::ParamType::kVector,
                                         cache::ParamType::kNormal, cache::ParamType::kMatrix};
  static_assert(size_t(SlType::kFloat) == 0 && size_t(SlType::kMatrix) == 5);
  for (const Parameter& parameter : program.parameters) {
    if (program.symbolName(parameter.symbol) != name) continue;
    const Symbol& s = program.symbols[parameter.symbol];
    if (s.type > SlType::kMatrix || s.floats() != given.values.count) break;
    given.type = kTypes[size_t(s.type)];
    given.arrayLength = std::max(1u, s.arrayLength);
    break;
  }
  return given;
}

uint32_t floatsOf(const cache::ParamRecord& p) {
  const uint32_t length = std::max(1u, p.arrayLength);
  return p.type == cache::ParamType::kFloat    ? length
         : p.type == cache::ParamType::kMatrix ? 16 * length
                                               : 3 * length;
}

/// `program` may read by displacement("x", v) what `displacement` computes: an output parameter.
bool asksForOutputs(const ShaderProgram& program, const ShaderProgram& displacement) {
  const auto computed = [&](std::string_view name) {
    for (const Parameter& p : displacement.parameters)
      if (displacement.symbols[p.symbol].storage == Storage::kOutputParameter &&
          (name.empty() || displacement.symbolName(p.symbol) == name))
        return true;
    return false;
  };
  for (const Instruction& in : program.code) {
    if (in.op != Op::msg_displacement) continue;
    const Symbol& name = program.symbol(program.operands(in)[1]);
    const bool known = name.storage == Storage::kConstant;
    if (computed(known ? std::string_view(program.strings[name.data]) : std::string_view())) return true;
  }
  return false;
}
}  // namespace

ShadingSystem::Impl::Impl(cache::SceneCache& c, Options o)
    : scene(c),
      options(std::move(o)),
      host(c.skeleton(), options.textureKilobytes),
      library(libraryOptions(options)),
      setups(c.skeleton().attributes().size()) {
  prmanSpecular = host.optionFloat("render:prmanspecular", 0.0f);
  specularThreshold = host.optionFloat("trace:specularthreshold", 10.0f) * 0.017453293f;
  cacheToCurrent = Mat4(host.cacheToCurrent());
  currentToCache = Mat4(host.currentToCache());
  cacheToCurrentNormal = Mat3(normalMatrix(host.cacheToCurrent()));
  currentToCacheNormal = Mat3(normalMatrix(host.currentToCache()));
  for (const cache::ObjectRecord& object : scene.skeleton().objects())
    if (object.attributes != kNone) objectsOf[object.attributes].push_back(&object);
  displacement = makeDisplacer(*this);
}

std::shared_ptr<const Executable> ShadingSystem::Impl::executable(
    const std::shared_ptr<const ShaderProgram>& program, const std::vector<std::string>& varying) {
  auto& e = executables[{program.get(), joined(varying)}];
  if (!e) {
    e = std::make_shared<Executable>(program, varying);
    if (const std::string name = dividedString(*program, varying); !name.empty())
      reportOnce(
          "shader.strings." + program->name,
          Error{RiError::kUnimplemented,
                Severity::kWarning,
                {},
                fmt::format("shader \"{}\": the string {} differs from point to point, but strings are the "
                            "same for all points that are shaded together: the picture may be wrong",
                            program->name, name)});
  }
  return e;
}

std::shared_ptr<const ShaderInstance> ShadingSystem::Impl::fallbackSurface() {
  if (!defaultSurface) {
    auto found = library.find("defaultsurface");
    if (found && (*found)->type == ShaderType::kSurface) {
      defaultSurface = *found;
    } else {
      Diagnostics diagnostics;
      auto compiled = compileShaderString(kDefaultSurface, {}, diagnostics, "defaultsurface.sl");
      FR_CHECK(compiled.ok());
      defaultSurface = std::make_shared<const ShaderProgram>(std::move(*compiled));
    }
  }
  return bindShader(executable(defaultSurface, {}), host.transformToCurrent(kNone), {}, host);
}

/// Once per shader and name: a mistyped name, or a shader that has changed since the scene was exported.
/// Names that start with two underscores are messages of exporters to programs that know them.
void ShadingSystem::Impl::reportUnknownParameter(const std::string& shader, const std::string& parameter,
                                                 const cache::ShaderRecord& record) const {
  if (parameter.starts_with("__")) return;
  reportOnce("shader.unknown." + shader + "." + parameter,
             Error{RiError::kBadToken,
                   Severity::kWarning,
                   {std::string(scene.skeleton().string(record.locationFile)), int(record.locationLine), 0},
                   fmt::format("shader \"{}\" has no parameter \"{}\"; ignored", shader, parameter)});
}

void ShadingSystem::Impl::reportOtherType(const cache::ObjectRecord& object, const std::string& variable,
                                          const std::string& shader) const {
  reportOnce(
      "primvar." + shader + "." + variable,
      Error{RiError::kConsistency,
            Severity::kWarning,
            {std::string(scene.skeleton().string(object.locationFile)), int(object.locationLine), 0},
            fmt::format("variable \"{}\" of a primitive has another type or length than the parameter of "
                        "shader \"{}\"; there the parameter stays",
                        variable, shader)});
}

std::shared_ptr<const ShaderInstance> ShadingSystem::Impl::loadInstance(
    cache::ShaderId id, ShaderType type, const std::vector<std::string>& varyingParameters) {
  const cache::ShaderRecord& record = scene.skeleton().shaders()[id];
  const std::string name(scene.skeleton().string(record.name));
  auto found = library.find(name);
  if (!found) {
    Error e = found.error();
    if (e.code == RiError::kNone) e.code = RiError::kNoShader;
    reportOnce("shader." + name, e);
    return nullptr;
  }
  if ((*found)->type != type) {
    reportOnce("shader.type." + name, makeError(RiError::kNoShader, "\"{}\" is a {} shader, not a {} shader",
                                                name, kindName((*found)->type), kindName(type)));
    return nullptr;
  }
  const DMat4 toCurrent = host.transformToCurrent(record.transform);
  std::vector<ParameterSetting> settings;
  for (const cache::ParamRecord& p : scene.skeleton().params(record.params)) {
    const std::string parameter(scene.skeleton().string(p.name));
    if ((*found)->findParameter(parameter) == kNoIndex) {
      reportUnknownParameter(name, parameter, record);
      continue;
    }
    settings.push_back({parameter, host.value(typedAs(**found, parameter, p), &toCurrent)});
  }
  auto bound = bindShader(executable(*found, varyingParameters), toCurrent, settings, host);
  auto instance = std::make_shared<ShaderInstance>(*bound);
  instance->attributes = record.attributes;
  instance->shadows = type == ShaderType::kLight && (record.lightFlags & cache::kLightShadows);
  instance->samples = std::max(1u, record.lightSamples);
  instance->id = id;
  if (type == ShaderType::kLight && record.areaLightObject != kNone)
    instance->emitter = std::make_shared<const AreaLight>(scene, host, id);
  return instance;
}

std::shared_ptr<const ShaderInstance> ShadingSystem::Impl::instance(cache::ShaderId id, ShaderType type,
                                                                    const std::vector<std::string>& varying) {
  if (id == kNone || id >= scene.skeleton().shaders().size()) return nullptr;
  const auto key = std::make_pair(id, joined(varying));
  const auto it = instances.find(key);
  if (it != instances.end()) return it->second;
  return instances[key] = loadInstance(id, type, varying);
}

std::unique_ptr<ShadeSetup> ShadingSystem::Impl::load(cache::AttributeId attributes) {
  const cache::Skeleton& s = scene.skeleton();
  const cache::AttributeRecord& a = s.attributes()[attributes];
  auto setup = std::make_unique<ShadeSetup>();
  setup->attributes = attributes;

  // Primitive variables of all objects of this state; those that name a parameter override it per point.
  std::vector<std::string> names;
  for (const cache::ObjectRecord* object : objectsOf[attributes])
    for (const cache::ParamRecord& p : s.params(object->primvars)) {
      if (p.type == cache::ParamType::kString || p.type == cache::ParamType::kInteger) continue;
      const std::string name(s.string(p.name));
      if (name == "Cs")
        setup->colorPrimvar = true;
      else if (name == "Os")
        setup->opacityPrimvar = true;
      else if (std::find(names.begin(), names.end(), name) == names.end())
        names.push_back(name);
    }
  std::sort(names.begin(), names.end());
  const auto overridden = [&](cache::ShaderId id, ShaderType type, std::shared_ptr<const ShaderInstance>& out,
                              std::vector<ShadeSetup::PrimvarParameter>& overrides) {
    out = instance(id, type, {});
    if (!out) return;
    std::vector<std::string> used;
    for (const std::string& n : names) {
      const uint32_t k = out->program().findParameter(n);
      if (k == kNoIndex ||
          out->program().symbols[out->program().parameters[k].symbol].type == SlType::kString)
        continue;
      used.push_back(n);
      overrides.push_back({n, k});
      const uint32_t takes = out->program().symbols[out->program().parameters[k].symbol].floats();
      for (const cache::ObjectRecord* object : objectsOf[attributes])
        if (const cache::ParamRecord* p = s.find(object->primvars, n);
            p && p->type != cache::ParamType::kString && floatsOf(*p) != takes)
          reportOtherType(*object, n, out->program().name);
    }
    if (!used.empty()) out = instance(id, type, used);
  };
  overridden(a.surface, ShaderType::kSurface, setup->surface, setup->surfaceOverrides);
  if (!setup->surface) setup->surface = fallbackSurface();
  if (a.displacement != a.surface) {
    overridden(a.displacement, ShaderType::kDisplacement, setup->displacement, setup->displacementOverrides);
  } else if (a.displacement != cache::kNone && setup->surface->exe->has(kProgramMovesPoints)) {
    setup->displacement = setup->surface, setup->displacementOverrides = setup->surfaceOverrides;
    setup->surfaceDisplaces = true;
  }
  if (a.deformation != 0) setup->deformation = instance(a.deformation - 1, ShaderType::kTransformation, {});
  setup->atmosphere = instance(a.atmosphere, ShaderType::kVolume, {});
  setup->interior = instance(a.interior, ShaderType::kVolume, {});
  setup->exterior = instance(a.exterior, ShaderType::kVolume, {});
  const auto usesLights = [](const std::shared_ptr<const ShaderInstance>& i) {
    return i && i->exe->has(kProgramUsesLights);
  };
  if (usesLights(setup->surface) || usesLights(setup->atmosphere) || usesLights(setup->interior) ||
      usesLights(setup->exterior))
    for (cache::ShaderId id : s.lightList(a.lights))
      if (auto light = instance(id, ShaderType::kLight, {})) {
        setup->lights.push_back(light.get());
        setup->lightOwners.push_back(std::move(light));
      }
  setup->bumpOnly = setup->displacement && !setup->displacement->exe->has(kProgramMovesPoints);

  const auto add = [&](const ShaderInstance* i) {
    if (!i) return;
    setup->usesDerivatives |= i->exe->has(kProgramUsesDerivatives);
    setup->canAskRays |= i->exe->has(kProgramCanAskRays) || i->exe->has(kProgramRaysByMapName) || i->shadows;
    setup->readsGlobals |= i->program().readsGlobals;
  };
  add(setup->surface.get());
  add(setup->atmosphere.get());
  // Interior and Exterior run on rays alone: their derivatives are 0.
  for (const ShaderInstance* i : {setup->interior.get(), setup->exterior.get()})
    if (i) setup->canAskRays |= i->exe->has(kProgramCanAskRays) || i->exe->has(kProgramRaysByMapName);
  if (const float depth = host.attributeFloat(a, "trace:maxdiffusedepth", 1); depth >= 0)
    setup->maxDiffuseDepth = uint32_t(std::min(depth, 1e6f));
  if (const float depth = host.attributeFloat(a, "trace:maxspeculardepth", -1); depth >= 0)
    setup->maxSpecularDepth = uint32_t(std::min(depth, 1e6f));
  if (setup->bumpOnly) {
    setup->readsGlobals |= setup->displacement->program().readsGlobals;
    setup->usesDerivatives |= setup->displacement->exe->has(kProgramUsesDerivatives);
  }
  for (const ShaderInstance* l : setup->lights) add(l);
  setup->displaced = (setup->displacement && !setup->bumpOnly) || setup->deformation;
  const auto asksDisplacement = [&](const ShaderInstance* i) {
    return i && setup->displacement && !setup->surfaceDisplaces &&
           asksForOutputs(i->program(), setup->displacement->program());
  };
  if (setup->displaced) {
    setup->displacementIsAsked = asksDisplacement(setup->surface.get());
    for (const ShaderInstance* l : setup->lights) setup->displacementIsAsked |= asksDisplacement(l);
    if (setup->displacementIsAsked) {
      setup->readsGlobals |= setup->displacement->program().readsGlobals;
      setup->usesDerivatives |= setup->displacement->exe->has(kProgramUsesDerivatives);
    }
  }
  const auto namesObject = [](const ShaderInstance* i) {
    if (!i) return false;
    // A parameter may hold the name too.
    for (const std::string& text : i->program().strings)
      if (text == "object") return true;
    for (const ShaderValue& v : i->values)
      for (const std::string& text : v.strings)
        if (text == "object") return true;
    return false;
  };
  for (const ShaderInstance* i :
       {setup->surface.get(), setup->displacement.get(), setup->deformation.get(), setup->atmosphere.get()})
    setup->usesObjectSpace |= namesObject(i);
  for (const ShaderInstance* l : setup->lights) setup->usesObjectSpace |= namesObject(l);
  return setup;
}

const ShadeSetup& ShadingSystem::Impl::setup(cache::AttributeId attributes) {
  FR_CHECK(attributes < setups.size());
  if (const ShadeSetup* s = setups[attributes].load(std::memory_order_acquire)) return *s;
  const std::lock_guard lock(mutex);
  if (const ShadeSetup* s = setups[attributes].load(std::memory_order_relaxed)) return *s;
  owned.push_back(load(attributes));
  setups[attributes].store(owned.back().get(), std::memory_order_release);
  return *owned.back();
}

void ShadingSystem::Impl::addStatistics(MachineStatistics& s, uint64_t shaded) {
  points.fetch_add(shaded, std::memory_order_relaxed);
  lightPoints.fetch_add(s.lightPoints, std::memory_order_relaxed);
  ops.fetch_add(s.steps, std::memory_order_relaxed);
  lanesActive.fetch_add(s.lanesActive, std::memory_order_relaxed);
  lanesTotal.fetch_add(s.lanesTotal, std::memory_order_relaxed);
  s = {};
}

ShadingSystem::ShadingSystem(cache::SceneCache& cache, Options options)
    : impl_(std::make_unique<Impl>(cache, std::move(options))) {}
ShadingSystem::~ShadingSystem() = default;

void ShadingSystem::loadShaders(uint32_t side) {
  const uint32_t visible = side == cache::kForReyes
                               ? cache::kVisibleCamera
                               : cache::kVisibleCamera | cache::kVisibleReflection | cache::kVisibleShadow;
  for (const cache::ObjectRecord& object : impl_->scene.skeleton().objects()) {
    if (!(object.sides & side) || object.attributes == kNone) continue;
    const cache::AttributeRecord& a = impl_->scene.skeleton().attributes()[object.attributes];
    if (a.visibility & visible) impl_->setup(object.attributes);
  }
}

bool ShadingSystem::canAskRays() const {
  for (const auto& s : impl_->setups)
    if (const ShadeSetup* setup = s.load(std::memory_order_acquire); setup && setup->canAskRays) return true;
  return false;
}

bool ShadingSystem::isOpaque(cache::AttributeId attributes) const {
  if (attributes >= impl_->setups.size()) return false;
  const cache::AttributeRecord& a = impl_->scene.skeleton().attributes()[attributes];
  const ShadeSetup& s = impl_->setup(attributes);
  return a.opacity == Color(1) && !s.opacityPrimvar && s.surface->exe->has(kProgramOpaque);
}

int ShadingSystem::outputComponents(std::string_view name) const {
  for (const auto& s : impl_->setups) {
    const ShadeSetup* setup = s.load(std::memory_order_acquire);
    if (!setup || !setup->surface) continue;
    const ShaderProgram& p = setup->surface->program();
    if (const uint32_t i = p.findParameter(name); i != kNoIndex)
      return int(p.symbols[p.parameters[i].symbol].floats());
  }
  for (size_t g = 0; g < size_t(GlobalId::kCount); ++g)
    if (name == globalInfo(GlobalId(g)).name) return int(slTypeFloats(globalInfo(GlobalId(g)).type));
  return 0;
}

uint32_t ShadingSystem::shadeGroup(cache::AttributeId attributes) const { return attributes; }

cache::Displacer& ShadingSystem::displacer() { return *impl_->displacement; }

ShadingStatistics ShadingSystem::statistics() const {
  ShadingStatistics r;
  r.pointsShaded = impl_->points.load();
  r.lightPoints = impl_->lightPoints.load();
  r.opsExecuted = impl_->ops.load();
  r.lanesActive = impl_->lanesActive.load();
  r.lanesTotal = impl_->lanesTotal.load();
  const auto l = impl_->library.statistics();
  r.shadersLoaded = l.loaded;
  r.shadersCompiled = l.compiled;
  r.compileSeconds = l.compileSeconds;
  {
    const std::lock_guard lock(impl_->mutex);
    r.programs = impl_->executables.size();
    for (const auto& [key, exe] : impl_->executables) r.machineCodes += exe->nativeCount();
  }
  const FrTextureStatistics t = impl_->host.textures()->statistics();
  r.textureFiles = t.files, r.textureLookups = t.lookups;
  r.textureBytesRead = t.bytesRead, r.textureMemory = t.heldBytes;
  return r;
}

bool ShadingSystem::runImager(size_t n, const float* rasterX, const float* rasterY, float* const color[3],
                              float* const opacity[3], float* alpha) {
  {
    const std::lock_guard lock(impl_->mutex);
    if (!impl_->imagerLoaded) {
      impl_->imager = impl_->instance(impl_->scene.skeleton().options().imager, ShaderType::kImager, {});
      impl_->imagerLoaded = true;
    }
  }
  if (!impl_->imager) return false;
  Machine machine(impl_->host);
  AlignedFloats memory;
  std::vector<int32_t> maskStorage;
  for (size_t first = 0; first < n; first += kMaxShadePoints) {
    const uint32_t count = uint32_t(std::min(kMaxShadePoints, n - first));
    const uint32_t lanes = padLanes(count);
    memory.reserve(size_t(lanes) * 11 + lanes);
    std::fill_n(memory.data(), size_t(lanes) * 12, 0.0f);
    float* at = memory.data();
    auto* mask = reinterpret_cast<int32_t*>(at + size_t(lanes) * 11);
    std::fill_n(mask, count, -1);
    Batch b;
    b.lanes = lanes, b.points = b.asking = count, b.mask = mask, b.raysAllowed = false;
    const auto column = [&](GlobalId g, uint32_t components) {
      Operand& o = b.globals[size_t(g)];
      o = Operand{at, lanes, ~0u};
      at += size_t(components) * lanes;
      return o;
    };
    const Operand P = column(GlobalId::k_P, 3), Ci = column(GlobalId::k_Ci, 3),
                  Oi = column(GlobalId::k_Oi, 3);
    const Operand A = column(GlobalId::k_alpha, 1);
    for (uint32_t i = 0; i < count; ++i) {
      P.comp(0)[i] = rasterX[first + i], P.comp(1)[i] = rasterY[first + i];
      for (uint32_t c = 0; c < 3; ++c)
        Ci.comp(c)[i] = color[c][first + i],
        Oi.comp(c)[i] = opacity ? opacity[c][first + i] : alpha[first + i];
      A.data[i] = alpha[first + i];
    }
    machine.begin(b, *impl_->imager, {}, {});
    machine.run();
    const auto back = [&](GlobalId g, uint32_t c, float* to) {
      const Operand r = machine.result(g);
      if (r.data && to)
        for (uint32_t i = 0; i < count; ++i) to[first + i] = std::isfinite(r.at(i, c)) ? r.at(i, c) : 0.0f;
    };
    for (uint32_t c = 0; c < 3; ++c) {
      back(GlobalId::k_Ci, c, color[c]);
      if (opacity) back(GlobalId::k_Oi, c, opacity[c]);
    }
    back(GlobalId::k_alpha, 0, alpha);
  }
  return true;
}

}  // namespace fr
