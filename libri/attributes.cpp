// Attributes and transformations.
#include "libri/context.h"
#include "ri/camera.h"

using namespace fr;
using namespace fr::libri;
using ri::Renderer;

namespace {

void shader(ri::ShaderKind kind, const char* request, RtToken name, RtInt n, RtToken tokens[],
            RtPointer parms[]) {
  withContext(request, [&](Context& c) {
    c.out().shader(kind, text(name), c.params(request, request + 2, n, tokens, parms));
  });
}

/// Light handles: a number, or the string of PRMan's "__handleid".
RtLightHandle light(const char* request, RtToken name, RtInt n, RtToken tokens[], RtPointer parms[],
                    void (Renderer::*call)(std::string, ri::Handle, ri::ParamList)) {
  RtLightHandle handle = nullptr;
  withContext(request, [&](Context& c) {
    const ri::ParamList p = c.params(request, request + 2, n, tokens, parms);
    const ri::Param* id = p.find("__handleid");
    HandleRecord* h = id && !id->strings.empty()
                          ? c.newHandle(HandleRecord::Kind::kLight, ri::Handle{id->strings[0], false})
                          : c.newHandle(HandleRecord::Kind::kLight);
    handle = h;
    (c.out().*call)(text(name), h->handle, p);
  });
  return handle;
}

/// As many numbers as RiColorSamples said.
void color(const char* request, const RtFloat* values, void (Renderer::*call)(std::span<const float>)) {
  withContext(request, [&](Context& c) {
    if (!values) return complain(RiError::kMissingData, Severity::kError, request, "the colour is NULL");
    const size_t n = c.state().state().options().nRgb.size() / 3;
    (c.out().*call)({values, n == 0 ? 3 : n});
  });
}

void bound(const char* request, const RtFloat* values, void (Renderer::*call)(const ri::Bound&)) {
  send(request, [&](Renderer& r) {
    if (!values) return complain(RiError::kMissingData, Severity::kError, request, "the bound is NULL");
    ri::Bound b;
    std::transform(values, values + 6, b.begin(), decimal);
    (r.*call)(b);
  });
}

DMat4 matrixOf(const RtFloat m[4][4]) {
  DMat4 d;
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j) d[i][j] = decimal(m[i][j]);
  return d;
}

void matrix(const char* request, const RtFloat m[4][4], void (Renderer::*call)(const DMat4&)) {
  if (!m) return complain(RiError::kMissingData, Severity::kError, request, "the matrix is NULL");
  sendTracked(request, [&](Renderer& r) { (r.*call)(matrixOf(m)); });
}

ri::BasisArgument basisArgument(const RtFloat (*m)[4], RtInt step) {
  ri::BasisArgument b;
  b.step = step;
  const std::pair<const RtFloat(*)[4], const char*> named[] = {{RiBezierBasis, "bezier"},
                                                               {RiBSplineBasis, "b-spline"},
                                                               {RiCatmullRomBasis, "catmull-rom"},
                                                               {RiHermiteBasis, "hermite"},
                                                               {RiPowerBasis, "power"}};
  for (const auto& [basis, name] : named)
    if (m == basis || std::equal(&m[0][0], &m[0][0] + 16, &basis[0][0])) {
      b.name = name;
      return b;
    }
  b.matrix = matrixOf(m);
  return b;
}

}  // namespace

extern "C" {

RtVoid RiColor(RtColor c) { color("RiColor", c, &Renderer::color); }
RtVoid RiOpacity(RtColor c) { color("RiOpacity", c, &Renderer::opacity); }
RtVoid RiTextureCoordinates(RtFloat s1, RtFloat t1, RtFloat s2, RtFloat t2, RtFloat s3, RtFloat t3,
                            RtFloat s4, RtFloat t4) {
  send("RiTextureCoordinates", [&](Renderer& r) { r.textureCoordinates({s1, t1, s2, t2, s3, t3, s4, t4}); });
}

RtLightHandle RiLightSourceV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  return light("RiLightSource", name, n, tokens, parms, &Renderer::lightSource);
}
RtLightHandle RiLightSource(RtToken name, ...) { FR_RI_LIST(name, RiLightSourceV(name, FR_RI_TAIL)); }
RtLightHandle RiAreaLightSourceV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  return light("RiAreaLightSource", name, n, tokens, parms, &Renderer::areaLightSource);
}
RtLightHandle RiAreaLightSource(RtToken name, ...) { FR_RI_LIST(name, RiAreaLightSourceV(name, FR_RI_TAIL)); }
RtVoid RiIlluminate(RtLightHandle handle, RtBoolean onoff) {
  withContext("RiIlluminate", [&](Context& c) {
    if (const HandleRecord* h = c.findHandle("RiIlluminate", handle, HandleRecord::Kind::kLight))
      c.out().illuminate(h->handle, onoff != RI_FALSE);
  });
}

#define FR_RI_SHADER(name, kind)                                                     \
  RtVoid name##V(RtToken shaderName, RtInt n, RtToken tokens[], RtPointer parms[]) { \
    shader(ri::ShaderKind::kind, #name, shaderName, n, tokens, parms);               \
  }                                                                                  \
  RtVoid name(RtToken shaderName, ...) { FR_RI_LIST(shaderName, name##V(shaderName, FR_RI_TAIL)); }
FR_RI_SHADER(RiSurface, kSurface)
FR_RI_SHADER(RiDisplacement, kDisplacement)
FR_RI_SHADER(RiAtmosphere, kAtmosphere)
FR_RI_SHADER(RiInterior, kInterior)
FR_RI_SHADER(RiExterior, kExterior)
FR_RI_SHADER(RiDeformation, kDeformation)

RtVoid RiShaderLayerV(RtToken type, RtToken name, RtToken layername, RtInt n, RtToken tokens[],
                      RtPointer parms[]) {
  withContext("RiShaderLayer", [&](Context& c) {
    c.out().shaderLayer(text(type), text(name), text(layername),
                        c.params("RiShaderLayer", text(type), n, tokens, parms));
  });
}
RtVoid RiShaderLayer(RtToken type, RtToken name, RtToken layername, ...) {
  FR_RI_LIST(layername, RiShaderLayerV(type, name, layername, FR_RI_TAIL));
}
RtVoid RiConnectShaderLayers(RtToken type, RtToken layer1, RtToken variable1, RtToken layer2,
                             RtToken variable2) {
  send("RiConnectShaderLayers", [&](Renderer& r) {
    r.connectShaderLayers(text(type), text(layer1), text(variable1), text(layer2), text(variable2));
  });
}

RtVoid RiShadingRate(RtFloat size) {
  send("RiShadingRate", [&](Renderer& r) { r.shadingRate(decimal(size)); });
}
RtVoid RiShadingInterpolation(RtToken type) {
  send("RiShadingInterpolation", [&](Renderer& r) { r.shadingInterpolation(text(type)); });
}
RtVoid RiMatte(RtBoolean onoff) {
  send("RiMatte", [&](Renderer& r) { r.matte(onoff != RI_FALSE); });
}
RtVoid RiBound(RtBound b) { bound("RiBound", b, &Renderer::bound); }
RtVoid RiDetail(RtBound b) { bound("RiDetail", b, &Renderer::detail); }
RtVoid RiDetailRange(RtFloat minvisible, RtFloat lowertransition, RtFloat uppertransition,
                     RtFloat maxvisible) {
  send("RiDetailRange", [&](Renderer& r) {
    r.detailRange(decimal(minvisible), decimal(lowertransition), decimal(uppertransition),
                  decimal(maxvisible));
  });
}
RtVoid RiGeometricApproximation(RtToken type, RtFloat value) {
  send("RiGeometricApproximation",
       [&](Renderer& r) { r.geometricApproximation(text(type), decimal(value)); });
}
RtVoid RiGeometricRepresentation(RtToken type) {
  send("RiGeometricRepresentation", [&](Renderer& r) { r.geometricRepresentation(text(type)); });
}
RtVoid RiOrientation(RtToken orientation) {
  send("RiOrientation", [&](Renderer& r) { r.orientation(text(orientation)); });
}
RtVoid RiReverseOrientation(void) {
  send("RiReverseOrientation", [](Renderer& r) { r.reverseOrientation(); });
}
RtVoid RiSides(RtInt sides) {
  send("RiSides", [&](Renderer& r) { r.sides(sides); });
}
RtVoid RiAttributeV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]) {
  withContext("RiAttribute", [&](Context& c) {
    const ri::ParamList p = c.params("RiAttribute", text(name), n, tokens, parms);
    sendTracked("RiAttribute", [&](Renderer& r) { r.attribute(text(name), p); });
  });
}
RtVoid RiAttribute(RtToken name, ...) { FR_RI_LIST(name, RiAttributeV(name, FR_RI_TAIL)); }
RtVoid RiResourceV(RtToken handle, RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]) {
  withContext("RiResource", [&](Context& c) {
    c.out().resource(text(handle), text(type), c.params("RiResource", "Resource", n, tokens, parms));
  });
}
RtVoid RiResource(RtToken handle, RtToken type, ...) {
  FR_RI_LIST(type, RiResourceV(handle, type, FR_RI_TAIL));
}

RtVoid RiBasis(RtBasis ubasis, RtInt ustep, RtBasis vbasis, RtInt vstep) {
  if (!ubasis || !vbasis)
    return complain(RiError::kMissingData, Severity::kError, "RiBasis", "a basis is NULL");
  sendTracked("RiBasis",
              [&](Renderer& r) { r.basis(basisArgument(ubasis, ustep), basisArgument(vbasis, vstep)); });
}

RtVoid RiIdentity(void) {
  sendTracked("RiIdentity", [](Renderer& r) { r.identity(); });
}
RtVoid RiTransform(RtMatrix m) { matrix("RiTransform", m, &Renderer::transform); }
RtVoid RiConcatTransform(RtMatrix m) { matrix("RiConcatTransform", m, &Renderer::concatTransform); }
RtVoid RiPerspective(RtFloat fov) {
  sendTracked("RiPerspective", [&](Renderer& r) { r.perspective(decimal(fov)); });
}
RtVoid RiTranslate(RtFloat dx, RtFloat dy, RtFloat dz) {
  sendTracked("RiTranslate", [&](Renderer& r) { r.translate({decimal(dx), decimal(dy), decimal(dz)}); });
}
RtVoid RiRotate(RtFloat angle, RtFloat dx, RtFloat dy, RtFloat dz) {
  sendTracked("RiRotate", [&](Renderer& r) {
    r.rotate(decimal(angle), {decimal(dx), decimal(dy), decimal(dz)});
  });
}
RtVoid RiScale(RtFloat sx, RtFloat sy, RtFloat sz) {
  sendTracked("RiScale", [&](Renderer& r) { r.scale({decimal(sx), decimal(sy), decimal(sz)}); });
}
RtVoid RiSkew(RtFloat angle, RtFloat dx1, RtFloat dy1, RtFloat dz1, RtFloat dx2, RtFloat dy2, RtFloat dz2) {
  sendTracked("RiSkew", [&](Renderer& r) {
    r.skew(decimal(angle), {decimal(dx1), decimal(dy1), decimal(dz1)},
           {decimal(dx2), decimal(dy2), decimal(dz2)});
  });
}
RtVoid RiCoordinateSystem(RtToken space) {
  sendTracked("RiCoordinateSystem", [&](Renderer& r) { r.coordinateSystem(text(space)); });
}
RtVoid RiScopedCoordinateSystem(RtToken space) {
  sendTracked("RiScopedCoordinateSystem", [&](Renderer& r) { r.scopedCoordinateSystem(text(space)); });
}
RtVoid RiCoordSysTransform(RtToken space) {
  sendTracked("RiCoordSysTransform", [&](Renderer& r) { r.coordSysTransform(text(space)); });
}

}  // extern "C"

namespace {

/// From a named space to camera space, with the first key of what moves.
Result<DMat4> toCamera(const ri::GraphicsState& s, const std::string& name) {
  const auto first = [](const ri::TransformPtr& t) { return t ? t->matrices.front() : DMat4(1); };
  const bool raster = name == "raster" || name == "NDC";
  if (raster || name == "screen") {
    const ri::Camera camera = ri::makeCamera(s.options(), s.worldToCamera());
    DMat4 m = raster ? camera.cameraToRaster : camera.cameraToScreen;
    if (name == "NDC") {
      DMat4 ndc(1);
      ndc[0][0] = 1.0 / camera.xres, ndc[1][1] = 1.0 / camera.yres;
      m = ndc * m;
    }
    if (!(std::abs(glm::determinant(m)) > 0))
      return makeError(RiError::kMath, "the projection cannot be undone");
    return glm::inverse(m);
  }
  // Outside of shaders "object" and "current" are where geometry would stand now.
  Result<ri::PlacedTransform> space = name == "object" || name == "current" || name == "shader"
                                          ? Result<ri::PlacedTransform>(s.place())
                                          : s.findSpace(name);
  if (!space) return space.error();
  const DMat4 m = first(space->keys);
  return space->base == ri::SpaceBase::kWorld ? first(s.worldToCamera()) * m : m;
}

}  // namespace

extern "C" RtPoint* RiTransformPoints(RtToken fromspace, RtToken tospace, RtInt n, RtPoint points[]) {
  RtPoint* result = nullptr;
  withContext("RiTransformPoints", [&](Context& c) {
    const ri::GraphicsState& s = c.state().state();
    const Result<DMat4> from = toCamera(s, text(fromspace)), to = toCamera(s, text(tospace));
    for (const auto* m : {&from, &to})
      if (!*m) return complain(m->error().code, Severity::kError, "RiTransformPoints", m->error().message);
    if (!(std::abs(glm::determinant(*to)) > 0))
      return complain(RiError::kMath, Severity::kError, "RiTransformPoints",
                      fmt::format("\"{}\" has no inverse", text(tospace)));
    const DMat4 m = glm::inverse(*to) * *from;
    for (RtInt i = 0; points && i < n; ++i) {
      const glm::dvec4 p = m * glm::dvec4(points[i][0], points[i][1], points[i][2], 1);
      for (int k = 0; k < 3; ++k) points[i][k] = RtFloat(p[k] / p.w);
    }
    result = points;
  });
  return result;
}
