// StateRenderer: attributes, shaders, lights, and geometry under them.
#include <algorithm>
#include <cmath>

#include "ri/state_renderer.h"

namespace fr::ri {

// Inside an object only the requests that are part of the geometry count; the rest comes from the instance.
bool StateRenderer::attributeAllowed(const char* request) {
  if (object_) {
    reportOnceHere(
        RiError::kNotAttributes, Severity::kWarning,
        fmt::format("{} inside an Object block is ignored; attributes come from ObjectInstance", request));
    return false;
  }
  return motionSample(request);
}

std::optional<Color> StateRenderer::toRgb(std::span<const float> c, const char* request) {
  const Options& o = state_.options();
  const size_t n = o.nRgb.empty() ? 3 : o.nRgb.size() / 3;
  // One number is a grey, a fourth an alpha: what is meant is clear, if not correct.
  if (o.nRgb.empty() && (c.size() == 1 || c.size() == 4)) {
    reportOnceHere(RiError::kConsistency, Severity::kWarning,
                   fmt::format("{}: {} numbers, expected 3; {}", request, c.size(),
                               c.size() == 1 ? "all three are that one" : "the fourth is ignored"));
    return c.size() == 1 ? Color(c[0]) : Color(c[0], c[1], c[2]);
  }
  if (c.size() != n) {
    reportHere(RiError::kConsistency, Severity::kError,
               fmt::format("{}: {} numbers, expected {}; ignored", request, c.size(), n));
    return std::nullopt;
  }
  if (o.nRgb.empty()) return Color(c[0], c[1], c[2]);
  Color rgb(0);
  for (size_t i = 0; i < n; ++i) rgb += c[i] * Color(o.nRgb[3 * i], o.nRgb[3 * i + 1], o.nRgb[3 * i + 2]);
  return rgb;
}

void StateRenderer::color(std::span<const float> c) {
  const bool now = attributeAllowed("Color");
  if (!now && !laterSample("Color")) return;
  const auto rgb = toRgb(c, "Color");
  if (rgb && motion_) motion_->colors.push_back(*rgb);
  if (rgb && now) state_.editAttributes().color = *rgb;
}
void StateRenderer::opacity(std::span<const float> c) {
  const bool now = attributeAllowed("Opacity");
  if (!now && !laterSample("Opacity")) return;
  const auto rgb = toRgb(c, "Opacity");
  if (rgb && motion_) motion_->colors.push_back(*rgb);
  if (rgb && now) state_.editAttributes().opacity = *rgb;
}

void StateRenderer::textureCoordinates(const std::array<float, 8>& st) {
  if (attributeAllowed("TextureCoordinates")) state_.editAttributes().textureCoordinates = st;
}

ShaderPtr StateRenderer::makeShader(ShaderKind kind, std::string name, ParamList params) {
  auto s = std::make_shared<ShaderInstance>();
  s->kind = kind;
  s->name = std::move(name);
  s->params = std::move(params);
  s->shaderSpace = state_.place();
  s->location = location();
  return s;
}

void StateRenderer::shader(ShaderKind kind, std::string name, ParamList params) {
  const char* request = shaderKindName(kind);
  const bool now = kind == ShaderKind::kImager ? optionAllowed(request) : attributeAllowed(request);
  if (!now && (kind == ShaderKind::kImager || !laterSample(request))) return;
  // "null" is a shader of its own for surfaces (nothing is drawn); for the others it is their absence.
  const bool none = name.empty() || (name == "null" && kind != ShaderKind::kSurface);
  ShaderPtr s = none ? nullptr : makeShader(kind, std::move(name), std::move(params));
  if (kind == ShaderKind::kImager) {
    state_.editOptions().imager = std::move(s);
    return;
  }
  if (motion_) motion_->shaders.push_back(s);
  if (now) setShader(kind, std::move(s));
}

void StateRenderer::setShader(ShaderKind kind, ShaderPtr s) {
  AttributeState& a = state_.editAttributes();
  switch (kind) {
    case ShaderKind::kSurface:
      a.surface = std::move(s);
      break;
    case ShaderKind::kDisplacement:
      a.displacement = std::move(s);
      break;
    case ShaderKind::kAtmosphere:
      a.atmosphere = std::move(s);
      break;
    case ShaderKind::kInterior:
      a.interior = std::move(s);
      break;
    case ShaderKind::kExterior:
      a.exterior = std::move(s);
      break;
    case ShaderKind::kDeformation:
      if (s && a.deformation)
        reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                       fmt::format("Deformation \"{}\" takes the place of \"{}\": they are not concatenated",
                                   s->name, a.deformation->name));
      a.deformation = std::move(s);
      break;
    default:
      break;
  }
}

/// True when the request makes a light now; a later key of a motion is only remembered.
bool StateRenderer::lightKey(const char* request, ShaderKind kind, std::string& name, ParamList& params) {
  if (attributeAllowed(request)) return true;
  if (laterSample(request)) motion_->shaders.push_back(makeShader(kind, std::move(name), std::move(params)));
  return false;
}

void StateRenderer::moveLight(const LightInstance& l) {
  if (motion_) motion_->light = l.index, motion_->shaders.push_back(l.shader);
}

void StateRenderer::lightSource(std::string name, Handle handle, ParamList params) {
  if (!lightKey("LightSource", ShaderKind::kLight, name, params)) return;
  const LightInstance& l = state_.addLight(
      std::move(handle), false, makeShader(ShaderKind::kLight, std::move(name), std::move(params)));
  moveLight(l);
  onLight(l);
}

void StateRenderer::areaLightSource(std::string name, Handle handle, ParamList params) {
  if (!lightKey("AreaLightSource", ShaderKind::kAreaLight, name, params)) return;
  if (name.empty() || name == "null") {
    state_.editAttributes().areaLight = -1;
    return;
  }
  const LightInstance& l = state_.addLight(
      std::move(handle), true, makeShader(ShaderKind::kAreaLight, std::move(name), std::move(params)));
  moveLight(l);
  onLight(l);
}

void StateRenderer::illuminate(Handle light, bool on) {
  if (!attributeAllowed("Illuminate")) return;
  const LightInstance* l = state_.findLight(light);
  if (!l) {
    return reportHere(RiError::kBadHandle, Severity::kError,
                      fmt::format("Illuminate: light \"{}\" is not known", light.name));
  }
  state_.illuminate(l->index, on);
}

// The last layer is what the others lead to, so it comes nearest to the whole.
void StateRenderer::shaderLayer(std::string type, std::string name, std::string, ParamList params) {
  reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                 "ShaderLayer: layered shaders are not known; the last layer is used alone");
  if (type == "surface") return shader(ShaderKind::kSurface, std::move(name), std::move(params));
  if (type == "displacement") return shader(ShaderKind::kDisplacement, std::move(name), std::move(params));
}
void StateRenderer::connectShaderLayers(std::string, std::string, std::string, std::string, std::string) {
  reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                 "ConnectShaderLayers is ignored: layered shaders are not known");
}

void StateRenderer::shadingRate(double size) {
  if (!attributeAllowed("ShadingRate")) return;
  if (!(size > 0)) {
    return reportHere(RiError::kRange, Severity::kError, fmt::format("ShadingRate {}; ignored", size));
  }
  state_.editAttributes().shadingRate = float(std::min(size, 1e30));
}

void StateRenderer::shadingInterpolation(std::string type) {
  if (!attributeAllowed("ShadingInterpolation")) return;
  if (type != "constant" && type != "smooth") {
    return reportHere(RiError::kBadToken, Severity::kError,
                      fmt::format("ShadingInterpolation \"{}\" is not known", type));
  }
  state_.editAttributes().smoothShading = type == "smooth";
}

void StateRenderer::matte(bool on) {
  if (attributeAllowed("Matte")) state_.editAttributes().matte = on;
}
void StateRenderer::bound(const Bound& b) {
  const bool now = attributeAllowed("Bound");
  if (motion_ && (now || laterSample("Bound"))) motion_->bounds.push_back(b);
  if (!now) return;
  AttributeState& a = state_.editAttributes();
  a.bound = b, a.boundSpace = state_.shareCtm();
}
void StateRenderer::detail(const Bound& b) {
  const bool now = attributeAllowed("Detail");
  if (motion_ && (now || laterSample("Detail"))) motion_->bounds.push_back(b);
  if (!now) return;
  AttributeState& a = state_.editAttributes();
  a.detail = b, a.detailSpace = state_.shareCtm();
}

void StateRenderer::detailRange(double offLow, double onLow, double onHigh, double offHigh) {
  if (!attributeAllowed("DetailRange")) return;
  if (!(offLow <= onLow && onLow <= onHigh && onHigh <= offHigh)) {
    return reportHere(RiError::kRange, Severity::kError,
                      "DetailRange: the four numbers must not fall; ignored");
  }
  state_.editAttributes().detailRange = {float(offLow), float(onLow), float(onHigh), float(offHigh)};
}

void StateRenderer::geometricApproximation(std::string type, double value) {
  if (!attributeAllowed("GeometricApproximation")) return;
  AttributeState& a = state_.editAttributes();
  if (type == "flatness") {
    if (!(value > 0))
      return reportHere(RiError::kRange, Severity::kError,
                        fmt::format("GeometricApproximation \"flatness\" {}; ignored", value));
    a.flatness = float(value);
  } else if (type == "motionfactor" || type == "focusfactor") {
    if (!(value >= 0))
      return reportHere(RiError::kRange, Severity::kError,
                        fmt::format("GeometricApproximation \"{}\" {}; ignored", type, value));
    (type == "motionfactor" ? a.motionFactor : a.focusFactor) = float(value);
  } else {
    reportOnceHere(RiError::kBadToken, Severity::kWarning,
                   fmt::format("GeometricApproximation \"{}\" is not known", type));
  }
}

void StateRenderer::geometricRepresentation(std::string type) {
  if (type != "primitive") {
    reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                   fmt::format("GeometricRepresentation \"{}\" is not rendered", type));
  }
}

void StateRenderer::orientation(std::string o) {
  if (!attributeAllowed("Orientation")) return;
  AttributeState& a = state_.editAttributes();
  // Object space is left-handed when the way to camera space swaps nothing (camera space is left-handed).
  const auto rightHanded = [&] {
    return isMirrored(state_.ctm().matrices.front()) !=
           (state_.inWorld() && isMirrored(state_.worldToCamera()->matrices.front()));
  };
  if (o == "outside") {
    a.reversed = false;
  } else if (o == "inside") {
    a.reversed = true;
  } else if (o == "lh") {
    a.reversed = rightHanded();
  } else if (o == "rh") {
    a.reversed = !rightHanded();
  } else {
    reportHere(RiError::kBadToken, Severity::kError, fmt::format("Orientation \"{}\" is not known", o));
  }
}

void StateRenderer::reverseOrientation() {
  if (!attributeAllowed("ReverseOrientation")) return;
  AttributeState& a = state_.editAttributes();
  a.reversed = !a.reversed;
}

void StateRenderer::sides(int n) {
  if (!attributeAllowed("Sides")) return;
  if (n != 1 && n != 2)
    return reportHere(RiError::kRange, Severity::kError, fmt::format("Sides {}; ignored", n));
  state_.editAttributes().sides = n;
}

namespace {
/// Attribute "grouping" "membership": "a,b" are the groups; "+a,b" joins groups, "-a,b" leaves them.
std::string groupMembership(const std::string& now, const std::string& change) {
  const auto names = [](std::string_view list) {
    std::vector<std::string> r;
    std::string name;
    for (const char c : list)
      if (c == ',' || c == ' ' || c == '+') {
        if (!name.empty()) r.push_back(std::move(name));
        name.clear();
      } else {
        name += c;
      }
    if (!name.empty()) r.push_back(std::move(name));
    return r;
  };
  const char sign = change.empty() ? 0 : change[0];
  if (sign != '+' && sign != '-') return change;
  std::vector<std::string> groups = names(now);
  for (const std::string& n : names(std::string_view(change).substr(1))) {
    const auto at = std::find(groups.begin(), groups.end(), n);
    if (sign == '-' && at != groups.end()) groups.erase(at);
    if (sign == '+' && at == groups.end()) groups.push_back(n);
  }
  std::string r;
  for (const std::string& g : groups) r += (r.empty() ? "" : ",") + g;
  return r;
}
}  // namespace

void StateRenderer::attribute(std::string category, ParamList params) {
  if (!attributeAllowed("Attribute")) return;
  for (Param& p : params.params()) {
    if (category == "grouping" && p.name == "membership" && p.strings.size() == 1)
      p.strings[0] =
          groupMembership(state_.attributes().values.getString("grouping:membership", ""), p.strings[0]);
    state_.editAttributes().values.set(category, std::move(p));
  }
}

// Basis and TrimCurve are kept with the primitive, so objects may hold them.
void StateRenderer::basis(BasisArgument u, BasisArgument v) {
  Basis b;
  const auto resolve = [&](const BasisArgument& arg, DMat4& m, int& step) {
    std::optional<DMat4> named = arg.name.empty() ? arg.matrix : namedBasis(arg.name);
    if (!named) {
      reportHere(RiError::kBadToken, Severity::kError,
                 fmt::format("Basis \"{}\" is not known; ignored", arg.name));
      return false;
    }
    if (arg.step < 1) {
      reportHere(RiError::kRange, Severity::kError, fmt::format("Basis with step {}; ignored", arg.step));
      return false;
    }
    m = *named;
    step = arg.step;
    return true;
  };
  if (!resolve(u, b.u, b.uStep) || !resolve(v, b.v, b.vStep)) return;
  if (b == *state_.attributes().basis) return;
  state_.editAttributes().basis = std::make_shared<const Basis>(b);
}

void StateRenderer::trimCurve(TrimCurve curves) {
  if (!check(checkTrimCurve(curves))) return;
  AttributeState& a = state_.editAttributes();
  a.trimCurve = curves.ncurves.empty() ? nullptr : std::make_shared<const TrimCurve>(std::move(curves));
}

void StateRenderer::resource(std::string handle, std::string type, ParamList params) {
  if (!attributeAllowed("Resource")) return;
  const std::string operation = params.getString("operation", ""), subset = params.getString("subset", "all");
  if (type != "attributes" || (operation != "save" && operation != "restore")) {
    return reportOnceHere(RiError::kUnimplemented, Severity::kWarning,
                          fmt::format("Resource \"{}\" {} is ignored", type, operation));
  }
  if (operation == "save") {
    resources_.back()[handle] = state_.shareAttributes();
    return;
  }
  const auto block = std::find_if(resources_.rbegin(), resources_.rend(),
                                  [&](const auto& saved) { return saved.contains(handle); });
  if (block == resources_.rend()) {
    return reportHere(RiError::kBadHandle, Severity::kError,
                      fmt::format("Resource: nothing was saved as \"{}\"", handle));
  }
  const AttributeState& saved = *block->find(handle)->second;
  if (subset == "all") {
    state_.editAttributes() = saved;
  } else if (subset == "shading") {
    AttributeState& a = state_.editAttributes();
    a.color = saved.color, a.opacity = saved.opacity, a.textureCoordinates = saved.textureCoordinates;
    a.surface = saved.surface, a.displacement = saved.displacement, a.atmosphere = saved.atmosphere;
    a.interior = saved.interior, a.exterior = saved.exterior;
    a.lights = saved.lights, a.areaLight = saved.areaLight;
    a.shadingRate = saved.shadingRate, a.smoothShading = saved.smoothShading, a.matte = saved.matte;
  } else {
    reportOnceHere(
        RiError::kUnimplemented, Severity::kWarning,
        fmt::format("Resource: subset \"{}\" is not restored; \"all\" and \"shading\" are", subset));
  }
}

// ---- geometry ----

void StateRenderer::primitive(Primitive p) {
  const std::string name = primitiveName(p);
  if (!state_.inWorld() && !object_) {
    return reportOnceHere(RiError::kNotPrimitives, Severity::kError,
                          fmt::format("{} outside WorldBegin and WorldEnd; ignored", name));
  }
  if (motion_) {
    motionSample(name);
    if (motion_->request == name) motion_->primitives.push_back(std::move(p));
    return;
  }
  std::vector<Primitive> one;
  one.push_back(std::move(p));
  emit({}, std::move(one));
}

void StateRenderer::emit(std::vector<float> times, std::vector<Primitive> samples) {
  const AttributeState& a = state_.attributes();
  const BasisSteps steps{a.basis->uStep, a.basis->vStep};
  auto m = std::make_shared<MovingPrimitive>();
  for (size_t i = 0; i < samples.size(); ++i) {
    Result<PrimitiveCheck> c = checkPrimitive(samples[i], steps);
    if (!c) return void(check(c.error()));
    for (const Error& e : c->complaints) reportHere(e.code, e.severity, e.message);
    if (i == 0) m->counts = c->counts;
    if (!(c->counts == m->counts)) {
      return reportHere(RiError::kBadMotion, Severity::kError,
                        fmt::format("{}: motion sample {} has another shape than the first; dropped",
                                    primitiveName(samples[i]), i + 1));
    }
  }
  if (samples.size() > 1) m->times = std::move(times);
  m->samples = std::move(samples);
  m->basis = a.basis;
  if (std::holds_alternative<NuPatch>(m->samples[0])) m->trimCurve = a.trimCurve;
  m->location = location();
  if (object_) return addShape({MovingPrimitivePtr(std::move(m)), nullptr, location()});
  onPrimitive({std::move(m), state_.shareAttributes(), state_.shareCtm()});
}

void StateRenderer::procedural(Procedural p) {
  if (!state_.inWorld() && !object_) {
    return reportOnceHere(RiError::kNotPrimitives, Severity::kError,
                          "Procedural outside WorldBegin and WorldEnd; ignored");
  }
  if (!motionSample("Procedural")) return;
  auto shared = std::make_shared<const Procedural>(std::move(p));
  if (object_) return addShape({std::move(shared), nullptr, location()});
  onProcedural({std::move(shared), state_.shareAttributes(), state_.shareCtm(), location()});
}

// ---- the rest ----

void StateRenderer::makeTexture(MakeKind kind, MakeTextureArgs args) { onMakeTexture(kind, args); }
void StateRenderer::errorHandler(std::string) {}
void StateRenderer::declare(std::string, std::string) {}
void StateRenderer::readArchive(std::string, ParamList) {}
void StateRenderer::archiveBegin(Handle, ParamList) {}
void StateRenderer::archiveEnd() {}
void StateRenderer::archiveRecord(RecordKind, std::string) {}

}  // namespace fr::ri
