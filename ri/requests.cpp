// The signature of every request: which arguments its RIB form has, and the call they become.
#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <cmath>
#include <unordered_map>

#include "ri/request_parser.h"

namespace fr::ri {
namespace {

using P = RequestParser;

Bound toBound(const std::array<double, 6>& a) { return a; }

template <size_t N>
std::array<double, N> take(P& p) {
  std::array<double, N> a{};
  p.numbers(a);
  return a;
}

template <ShaderKind K>
void shaderRequest(P& p) {
  std::string name = p.string();
  ParamList params = p.params(shaderKindName(K));
  if (p.ok()) p.renderer().shader(K, std::move(name), std::move(params));
}

/// A light without a handle gets one that nobody can name. `parameter`: what was read for the handle, but is
/// the name of the first parameter, since a number follows.
Handle lightHandle(P& p, std::string& parameter) {
  Handle h;
  const bool text = p.atString();
  if (p.ok() && (text || p.atNumber())) {
    h = p.handle();
    if (!text || !(p.atNumber() || p.atArray())) return h;
    parameter = std::move(h.name);
  }
  if (!p.ok()) return h;
  p.warn(RiError::kMissingData, "there is no handle; the light cannot be switched");
  static std::atomic<int> unnamed{0};
  return {fmt::format("light without a handle {}", ++unnamed), false};
}

void lightSource(P& p) {
  std::string name = p.string(), parameter;
  Handle h = lightHandle(p, parameter);
  ParamList params = p.params("LightSource", false, std::move(parameter));
  if (p.ok()) p.renderer().lightSource(std::move(name), std::move(h), std::move(params));
}

void areaLightSource(P& p) {
  std::string name = p.string(), parameter;
  Handle h;
  if (!name.empty() || p.atNumber() || p.atString()) h = lightHandle(p, parameter);
  ParamList params = p.params("AreaLightSource", false, std::move(parameter));
  if (p.ok()) p.renderer().areaLightSource(std::move(name), std::move(h), std::move(params));
}

void display(P& p) {
  std::string name = p.string(), type = p.string(), mode = p.string();
  ParamList params = p.params("Display");
  if (p.ok()) p.renderer().display(std::move(name), std::move(type), std::move(mode), std::move(params));
}

void projection(P& p) {
  std::string name = p.atString() ? p.string() : std::string();
  ParamList params = p.params("Projection");
  if (p.ok()) p.renderer().projection(std::move(name), std::move(params));
}

BasisArgument basisArgument(P& p) {
  BasisArgument b;
  if (p.atString()) {
    b.name = p.string();
  } else {
    b.matrix = p.matrix();
  }
  b.step = p.integer();
  return b;
}

void basis(P& p) {
  BasisArgument u = basisArgument(p);
  BasisArgument v = basisArgument(p);
  if (p.ok()) p.renderer().basis(std::move(u), std::move(v));
}

void trimCurve(P& p) {
  TrimCurve t;
  t.ncurves = p.ints();
  t.order = p.ints();
  t.knot = p.floats();
  t.min = p.floats();
  t.max = p.floats();
  t.n = p.ints();
  t.u = p.floats();
  t.v = p.floats();
  t.w = p.floats();
  if (p.ok()) p.renderer().trimCurve(std::move(t));
}

void emit(P& p, Primitive primitive) {
  if (p.ok()) p.renderer().primitive(std::move(primitive));
}

void polygon(P& p) {
  Polygon s;
  s.params = p.params("Polygon", true);
  emit(p, std::move(s));
}
void generalPolygon(P& p) {
  GeneralPolygon s;
  s.nverts = p.ints();
  s.params = p.params("GeneralPolygon", true);
  emit(p, std::move(s));
}
void pointsPolygons(P& p) {
  PointsPolygons s;
  s.nverts = p.ints();
  s.verts = p.ints();
  s.params = p.params("PointsPolygons", true);
  emit(p, std::move(s));
}
void pointsGeneralPolygons(P& p) {
  PointsGeneralPolygons s;
  s.nloops = p.ints();
  s.nverts = p.ints();
  s.verts = p.ints();
  s.params = p.params("PointsGeneralPolygons", true);
  emit(p, std::move(s));
}

// One of two words; anything else is kBadToken and the request is dropped.
bool oneOf(P& p, const char* yes, const char* no) {
  const std::string s = p.string();
  if (p.ok() && s != yes && s != no) {
    p.fail(RiError::kBadToken, fmt::format("\"{}\" is neither \"{}\" nor \"{}\"", s, yes, no));
  }
  return s == yes;
}

void patch(P& p) {
  Patch s;
  s.bicubic = oneOf(p, "bicubic", "bilinear");
  s.params = p.params("Patch", true);
  emit(p, std::move(s));
}
void patchMesh(P& p) {
  PatchMesh s;
  s.bicubic = oneOf(p, "bicubic", "bilinear");
  s.nu = p.integer();
  s.uPeriodic = oneOf(p, "periodic", "nonperiodic");
  s.nv = p.integer();
  s.vPeriodic = oneOf(p, "periodic", "nonperiodic");
  s.params = p.params("PatchMesh", true);
  emit(p, std::move(s));
}
void nuPatch(P& p) {
  NuPatch s;
  s.nu = p.integer();
  s.uOrder = p.integer();
  s.uKnot = p.floats();
  s.uMin = float(p.number());
  s.uMax = float(p.number());
  s.nv = p.integer();
  s.vOrder = p.integer();
  s.vKnot = p.floats();
  s.vMin = float(p.number());
  s.vMax = float(p.number());
  s.params = p.params("NuPatch", true);
  emit(p, std::move(s));
}
void subdivision(P& p, bool hierarchical) {
  SubdivisionMesh s;
  s.hierarchical = hierarchical;
  s.scheme = p.string();
  s.nverts = p.ints();
  s.verts = p.ints();
  if (p.ok() && p.atArray()) {
    s.tags = p.strings();
    s.nargs = p.ints();
    s.intArgs = p.ints();
    s.floatArgs = p.floats();
    if (hierarchical) s.stringArgs = p.strings();
  }
  s.params = p.params("SubdivisionMesh", true);
  emit(p, std::move(s));
}
void curves(P& p) {
  Curves s;
  s.cubic = oneOf(p, "cubic", "linear");
  s.nverts = p.ints();
  s.periodic = oneOf(p, "periodic", "nonperiodic");
  s.params = p.params("Curves", true);
  emit(p, std::move(s));
}
void blobby(P& p) {
  Blobby s;
  s.nleaf = p.integer();
  s.code = p.ints();
  s.floats = p.floats();
  s.strings = p.strings();
  s.params = p.params("Blobby", true);
  emit(p, std::move(s));
}

void procedural(P& p) {
  Procedural s;
  s.subdivide = p.string();
  s.kind = s.subdivide == "DelayedReadArchive" ? ProceduralKind::kDelayedReadArchive
           : s.subdivide == "RunProgram"       ? ProceduralKind::kRunProgram
           : s.subdivide == "DynamicLoad"      ? ProceduralKind::kDynamicLoad
                                               : ProceduralKind::kOther;
  s.data = p.strings();
  s.bound = toBound(take<6>(p));
  const size_t wanted = s.kind == ProceduralKind::kDelayedReadArchive ? 1 : 2;
  if (p.ok() && s.kind != ProceduralKind::kOther && s.data.size() < wanted) {
    if (s.data.empty()) return p.fail(RiError::kMissingData, "its data are missing");
    s.data.resize(wanted);
  }
  if (p.ok()) p.renderer().procedural(std::move(s));
}

void procedural2(P& p) {
  Procedural s;
  s.kind = ProceduralKind::kProcedural2;
  s.subdivide = p.string();
  s.boundFunction = p.string();
  s.params = p.params("Procedural2");
  if (p.ok()) p.renderer().procedural(std::move(s));
}

void makeTexture(P& p, MakeKind kind) {
  MakeTextureArgs a;
  if (kind == MakeKind::kOcclusion || kind == MakeKind::kBrickMap) {
    a.pictures = p.strings();
  } else {
    for (int i = 0; i < (kind == MakeKind::kCubeFaceEnvironment ? 6 : 1); ++i)
      a.pictures.push_back(p.string());
  }
  a.texture = p.string();
  if (kind == MakeKind::kCubeFaceEnvironment) a.fov = p.number();
  if (kind == MakeKind::kTexture || kind == MakeKind::kBump) {
    a.sWrap = p.string();
    a.tWrap = p.string();
  }
  if (kind == MakeKind::kTexture || kind == MakeKind::kBump || kind == MakeKind::kLatLongEnvironment ||
      kind == MakeKind::kCubeFaceEnvironment) {
    a.filter = p.string();
    a.sWidth = p.number();
    a.tWidth = p.number();
  }
  a.params = p.params("MakeTexture");
  if (p.ok()) p.renderer().makeTexture(kind, std::move(a));
}

void declare(P& p) {
  std::string name = p.string(), text = p.string();
  if (!p.ok()) return;
  if (Result<void> r = p.renderer().dictionary().declare(name, text); !r) {
    return p.fail(r.error().code, r.error().message);
  }
  p.renderer().declare(std::move(name), std::move(text));
}

void errorHandler(P& p) {
  std::string name = p.string();
  if (!p.ok()) return;
  if (p.reader().options().passThrough) return p.renderer().errorHandler(std::move(name));
  if (name == "ignore") {
    setErrorMode(ErrorMode::kIgnore);
  } else if (name == "print") {
    setErrorMode(ErrorMode::kPrint);
  } else if (name == "abort") {
    setErrorMode(ErrorMode::kAbort);
  } else {
    return p.fail(RiError::kBadToken, fmt::format("\"{}\" is no error handler", name));
  }
  p.renderer().errorHandler(std::move(name));
}

void version(P& p) {
  double v = 0;
  if (p.atString()) {
    const std::string text = p.string();
    std::from_chars(text.data(), text.data() + text.size(), v);
  } else {
    v = p.number();
  }
  if (p.ok() && !(v >= 3 && v < 4)) p.warn(RiError::kVersion, fmt::format("version {} is read as 3.04", v));
  if (p.ok()) p.renderer().version(v);
}

void option(P& p) {
  std::string name = p.string();
  ParamList params = p.params(name);
  if (!p.ok()) return;
  if (name == "ribparse" && params.has("varsubst"))
    p.reader().setSubstitution(params.getString("varsubst", ""));
  p.renderer().option(std::move(name), std::move(params));
}

void readArchive(P& p) {
  std::string name = p.string();
  ParamList params = p.params("ReadArchive");
  if (!p.ok()) return;
  if (!p.reader().options().expandArchives)
    return p.renderer().readArchive(std::move(name), std::move(params));
  if (Result<void> r = p.reader().readArchive(name); !r) {
    // A missing archive costs only itself; a loop, too deep a nest or an abort ends the reading of this file.
    if (r.error().code == RiError::kNoFile || r.error().code == RiError::kSystem) {
      p.fail(r.error().code, r.error().message);
    } else {
      p.stop(r.error());
    }
  }
}

void archiveBegin(P& p) {
  Handle name = p.handle();
  if (!p.ok()) return;
  ParamList params = p.params("ArchiveBegin");
  if (!p.reader().options().expandArchives) {
    if (p.ok()) p.renderer().archiveBegin(std::move(name), std::move(params));
    return;
  }
  p.recordArchive(name.name);
}

void archiveRecord(P& p) {
  const std::string type = p.string();
  std::string text = p.string();
  if (!p.ok()) return;
  const RecordKind kind = type == "structure"  ? RecordKind::kStructure
                          : type == "verbatim" ? RecordKind::kVerbatim
                                               : RecordKind::kComment;
  p.renderer().archiveRecord(kind, std::move(text));
}

void depthOfField(P& p) {
  if (!p.atNumber() && !p.atArray()) return p.renderer().depthOfField();
  const auto a = take<3>(p);
  if (p.ok()) p.renderer().depthOfField(a[0], a[1], a[2]);
}

void colorLike(P& p, void (Renderer::*call)(std::span<const float>)) {
  // Bare numbers as many as stand there: ColorSamples decides, and the state checks.
  std::vector<float> c;
  if (p.atArray()) {
    c = p.floats();
  } else {
    do {
      c.push_back(float(p.number()));
    } while (p.ok() && p.atNumber());
  }
  if (p.ok()) (p.renderer().*call)(c);
}

// Requests that other renderers know and that change nothing here.
void ignored(P& p) {
  if (p.reader().options().passThrough) return p.passVerbatim();
  p.warnOnce(RiError::kUnimplemented, "the request is ignored");
  while (p.lexer().kind() != TokenKind::kRequest && p.lexer().kind() != TokenKind::kEnd) p.lexer().advance();
}

struct Entry {
  const char* name;
  RequestHandler handler;
};

// clang-format off
const Entry kRequests[] = {
    // Blocks
    {"FrameBegin", [](P& p) { const int n = p.integer(); if (p.ok()) p.renderer().frameBegin(n); }},
    {"FrameEnd", [](P& p) { p.renderer().frameEnd(); }},
    {"WorldBegin", [](P& p) { p.renderer().worldBegin(); }},
    {"WorldEnd", [](P& p) { p.renderer().worldEnd(); }},
    {"AttributeBegin", [](P& p) { p.renderer().attributeBegin(); }},
    {"AttributeEnd", [](P& p) { p.renderer().attributeEnd(); }},
    {"TransformBegin", [](P& p) { p.renderer().transformBegin(); }},
    {"TransformEnd", [](P& p) { p.renderer().transformEnd(); }},
    {"SolidBegin", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().solidBegin(std::move(s)); }},
    {"SolidEnd", [](P& p) { p.renderer().solidEnd(); }},
    {"ObjectBegin", [](P& p) {
       Handle h = p.handle();
       if (!p.reader().options().passThrough) (void)p.params("ObjectBegin");  // "__handleid", of later versions
       if (p.ok()) p.renderer().objectBegin(std::move(h)); }},
    {"ObjectEnd", [](P& p) { p.renderer().objectEnd(); }},
    {"ObjectInstance", [](P& p) { Handle h = p.handle(); if (p.ok()) p.renderer().objectInstance(std::move(h)); }},
    {"MotionBegin", [](P& p) {
       std::vector<float> t;
       if (p.atArray()) t = p.floats();
       else do t.push_back(float(p.number())); while (p.ok() && p.atNumber());
       if (p.ok()) p.renderer().motionBegin(std::move(t)); }},
    {"MotionEnd", [](P& p) { p.renderer().motionEnd(); }},
    {"ResourceBegin", [](P& p) { p.renderer().resourceBegin(); }},
    {"ResourceEnd", [](P& p) { p.renderer().resourceEnd(); }},
    // Options
    {"Format", [](P& p) { const auto a = take<3>(p); if (p.ok()) p.renderer().format(int(std::clamp(a[0], -1., 1e6)), int(std::clamp(a[1], -1., 1e6)), a[2]); }},
    {"FrameAspectRatio", [](P& p) { const double a = p.number(); if (p.ok()) p.renderer().frameAspectRatio(a); }},
    {"ScreenWindow", [](P& p) { const auto a = take<4>(p); if (p.ok()) p.renderer().screenWindow(a[0], a[1], a[2], a[3]); }},
    {"CropWindow", [](P& p) { const auto a = take<4>(p); if (p.ok()) p.renderer().cropWindow(a[0], a[1], a[2], a[3]); }},
    {"Projection", projection},
    {"Clipping", [](P& p) { const auto a = take<2>(p); if (p.ok()) p.renderer().clipping(a[0], a[1]); }},
    {"ClippingPlane", [](P& p) { const auto a = take<6>(p); if (p.ok()) p.renderer().clippingPlane({a[0], a[1], a[2]}, {a[3], a[4], a[5]}); }},
    {"DepthOfField", depthOfField},
    {"Shutter", [](P& p) { const auto a = take<2>(p); if (p.ok()) p.renderer().shutter(a[0], a[1]); }},
    {"Camera", [](P& p) { std::string s = p.string(); ParamList l = p.params("Camera"); if (p.ok()) p.renderer().camera(std::move(s), std::move(l)); }},
    {"PixelVariance", [](P& p) { const double v = p.number(); if (p.ok()) p.renderer().pixelVariance(v); }},
    {"PixelSamples", [](P& p) { const auto a = take<2>(p); if (p.ok()) p.renderer().pixelSamples(a[0], a[1]); }},
    {"PixelFilter", [](P& p) { std::string s = p.string(); const auto a = take<2>(p); if (p.ok()) p.renderer().pixelFilter(std::move(s), a[0], a[1]); }},
    {"Exposure", [](P& p) { const auto a = take<2>(p); if (p.ok()) p.renderer().exposure(a[0], a[1]); }},
    {"Imager", shaderRequest<ShaderKind::kImager>},
    {"Quantize", [](P& p) {
       std::string s = p.string(); const auto a = take<4>(p);
       for (size_t i = 0; i < 3; ++i)
         if (a[i] != std::floor(a[i]) || std::abs(a[i]) > 2147483647.0) p.fail(RiError::kSyntax, fmt::format("an integer is expected, not {}", a[i]));
       if (p.ok()) p.renderer().quantize(std::move(s), int(a[0]), int(a[1]), int(a[2]), a[3]); }},
    {"Display", display},
    {"DisplayChannel", [](P& p) { std::string s = p.string(); ParamList l = p.params("Display"); if (p.ok()) p.renderer().displayChannel(std::move(s), std::move(l)); }},
    {"Hider", [](P& p) { std::string s = p.string(); ParamList l = p.params("Hider"); if (p.ok()) p.renderer().hider(std::move(s), std::move(l)); }},
    {"ColorSamples", [](P& p) { std::vector<float> a = p.floats(), b = p.floats(); if (p.ok()) p.renderer().colorSamples(std::move(a), std::move(b)); }},
    {"RelativeDetail", [](P& p) { const double v = p.number(); if (p.ok()) p.renderer().relativeDetail(v); }},
    {"Option", option},
    // Attributes
    {"Color", [](P& p) { colorLike(p, &Renderer::color); }},
    {"Opacity", [](P& p) { colorLike(p, &Renderer::opacity); }},
    {"TextureCoordinates", [](P& p) {
       const auto a = take<8>(p); std::array<float, 8> f{}; std::transform(a.begin(), a.end(), f.begin(), [](double d) { return float(d); });
       if (p.ok()) p.renderer().textureCoordinates(f); }},
    {"LightSource", lightSource},
    {"AreaLightSource", areaLightSource},
    {"Illuminate", [](P& p) { Handle h = p.handle(); const bool on = p.boolean(); if (p.ok()) p.renderer().illuminate(std::move(h), on); }},
    {"Surface", shaderRequest<ShaderKind::kSurface>},
    {"Displacement", shaderRequest<ShaderKind::kDisplacement>},
    {"Atmosphere", shaderRequest<ShaderKind::kAtmosphere>},
    {"Interior", shaderRequest<ShaderKind::kInterior>},
    {"Exterior", shaderRequest<ShaderKind::kExterior>},
    {"Deformation", shaderRequest<ShaderKind::kDeformation>},
    {"ShaderLayer", [](P& p) {
       std::string t = p.string(), n = p.string(), l = p.string(); ParamList a = p.params(t);
       if (p.ok()) p.renderer().shaderLayer(std::move(t), std::move(n), std::move(l), std::move(a)); }},
    {"ConnectShaderLayers", [](P& p) {
       std::string t = p.string(), a = p.string(), b = p.string(), c = p.string(), d = p.string();
       if (p.ok()) p.renderer().connectShaderLayers(std::move(t), std::move(a), std::move(b), std::move(c), std::move(d)); }},
    {"ShadingRate", [](P& p) { const double v = p.number(); if (p.ok()) p.renderer().shadingRate(v); }},
    {"ShadingInterpolation", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().shadingInterpolation(std::move(s)); }},
    {"Matte", [](P& p) { const bool b = p.boolean(); if (p.ok()) p.renderer().matte(b); }},
    {"Bound", [](P& p) { const auto a = take<6>(p); if (p.ok()) p.renderer().bound(a); }},
    {"Detail", [](P& p) { const auto a = take<6>(p); if (p.ok()) p.renderer().detail(a); }},
    {"DetailRange", [](P& p) { const auto a = take<4>(p); if (p.ok()) p.renderer().detailRange(a[0], a[1], a[2], a[3]); }},
    {"GeometricApproximation", [](P& p) { std::string s = p.string(); const double v = p.number(); if (p.ok()) p.renderer().geometricApproximation(std::move(s), v); }},
    {"GeometricRepresentation", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().geometricRepresentation(std::move(s)); }},
    {"Orientation", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().orientation(std::move(s)); }},
    {"ReverseOrientation", [](P& p) { p.renderer().reverseOrientation(); }},
    {"Sides", [](P& p) { const int n = p.integer(); if (p.ok()) p.renderer().sides(n); }},
    {"Attribute", [](P& p) { std::string s = p.string(); ParamList l = p.params(s); if (p.ok()) p.renderer().attribute(std::move(s), std::move(l)); }},
    {"Basis", basis},
    {"TrimCurve", trimCurve},
    {"Resource", [](P& p) { std::string h = p.string(), t = p.string(); ParamList l = p.params("Resource"); if (p.ok()) p.renderer().resource(std::move(h), std::move(t), std::move(l)); }},
    // Transformations
    {"Identity", [](P& p) { p.renderer().identity(); }},
    {"Transform", [](P& p) { const DMat4 m = p.matrix(); if (p.ok()) p.renderer().transform(m); }},
    {"ConcatTransform", [](P& p) { const DMat4 m = p.matrix(); if (p.ok()) p.renderer().concatTransform(m); }},
    {"Perspective", [](P& p) { const double v = p.number(); if (p.ok()) p.renderer().perspective(v); }},
    {"Translate", [](P& p) { const auto a = take<3>(p); if (p.ok()) p.renderer().translate({a[0], a[1], a[2]}); }},
    {"Rotate", [](P& p) { const auto a = take<4>(p); if (p.ok()) p.renderer().rotate(a[0], {a[1], a[2], a[3]}); }},
    {"Scale", [](P& p) { const auto a = take<3>(p); if (p.ok()) p.renderer().scale({a[0], a[1], a[2]}); }},
    {"Skew", [](P& p) { const auto a = take<7>(p); if (p.ok()) p.renderer().skew(a[0], {a[1], a[2], a[3]}, {a[4], a[5], a[6]}); }},
    {"CoordinateSystem", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().coordinateSystem(std::move(s)); }},
    {"ScopedCoordinateSystem", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().scopedCoordinateSystem(std::move(s)); }},
    {"CoordSysTransform", [](P& p) { std::string s = p.string(); if (p.ok()) p.renderer().coordSysTransform(std::move(s)); }},
    // Geometry
    {"Polygon", polygon},
    {"GeneralPolygon", generalPolygon},
    {"PointsPolygons", pointsPolygons},
    {"PointsGeneralPolygons", pointsGeneralPolygons},
    {"Patch", patch},
    {"PatchMesh", patchMesh},
    {"NuPatch", nuPatch},
    {"SubdivisionMesh", [](P& p) { subdivision(p, false); }},
    {"HierarchicalSubdivisionMesh", [](P& p) { subdivision(p, true); }},
    {"Sphere", [](P& p) { const auto a = take<4>(p); emit(p, Sphere{a[0], a[1], a[2], a[3], p.params("Sphere", true)}); }},
    {"Cone", [](P& p) { const auto a = take<3>(p); emit(p, Cone{a[0], a[1], a[2], p.params("Cone", true)}); }},
    {"Cylinder", [](P& p) { const auto a = take<4>(p); emit(p, Cylinder{a[0], a[1], a[2], a[3], p.params("Cylinder", true)}); }},
    {"Hyperboloid", [](P& p) { const auto a = take<7>(p); emit(p, Hyperboloid{{a[0], a[1], a[2]}, {a[3], a[4], a[5]}, a[6], p.params("Hyperboloid", true)}); }},
    {"Paraboloid", [](P& p) { const auto a = take<4>(p); emit(p, Paraboloid{a[0], a[1], a[2], a[3], p.params("Paraboloid", true)}); }},
    {"Disk", [](P& p) { const auto a = take<3>(p); emit(p, Disk{a[0], a[1], a[2], p.params("Disk", true)}); }},
    {"Torus", [](P& p) { const auto a = take<5>(p); emit(p, Torus{a[0], a[1], a[2], a[3], a[4], p.params("Torus", true)}); }},
    {"Points", [](P& p) { emit(p, Points{p.params("Points", true)}); }},
    {"Curves", curves},
    {"Blobby", blobby},
    {"Geometry", [](P& p) { Geometry g; g.type = p.string(); g.params = p.params("Geometry", true); emit(p, std::move(g)); }},
    {"Procedural", procedural},
    {"Procedural2", procedural2},
    // Textures
    {"MakeTexture", [](P& p) { makeTexture(p, MakeKind::kTexture); }},
    {"MakeBump", [](P& p) { makeTexture(p, MakeKind::kBump); }},
    {"MakeLatLongEnvironment", [](P& p) { makeTexture(p, MakeKind::kLatLongEnvironment); }},
    {"MakeCubeFaceEnvironment", [](P& p) { makeTexture(p, MakeKind::kCubeFaceEnvironment); }},
    {"MakeShadow", [](P& p) { makeTexture(p, MakeKind::kShadow); }},
    {"MakeOcclusion", [](P& p) { makeTexture(p, MakeKind::kOcclusion); }},
    {"MakeBrickMap", [](P& p) { makeTexture(p, MakeKind::kBrickMap); }},
    // The rest
    {"Declare", declare},
    {"ErrorHandler", errorHandler},
    {"version", version},
    {"ReadArchive", readArchive},
    {"ArchiveBegin", archiveBegin},
    {"ArchiveEnd", [](P& p) {
       if (p.reader().options().expandArchives) p.fail(RiError::kNesting, "no ArchiveBegin before it");
       else p.renderer().archiveEnd(); }},
    {"ArchiveRecord", archiveRecord},
    {"IfBegin", [](P& p) { const std::string s = p.string(); p.ifBegin(s); p.params(); }},
    {"ElseIf", [](P& p) { const std::string s = p.string(); p.elseIf(s); p.params(); }},
    {"Else", [](P& p) { p.elseBranch(); }},
    {"IfEnd", [](P& p) { p.ifEnd(); }},
    {"EditBegin", ignored},
    {"EditEnd", ignored},
    {"VolumePixelSamples", ignored},
    {"System", ignored},
};
// clang-format on

}  // namespace

RequestHandler findRequest(std::string_view name) {
  static const auto& table = *[] {
    auto* t = new std::unordered_map<std::string_view, RequestHandler>;
    for (const Entry& e : kRequests) t->emplace(e.name, e.handler);
    return t;
  }();
  const auto it = table.find(name);
  return it == table.end() ? nullptr : it->second;
}

std::string_view requestInOtherCase(std::string_view name) {
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? char(c + ('a' - 'A')) : c; };
  for (const Entry& e : kRequests) {
    const std::string_view known = e.name;
    if (std::ranges::equal(known, name, {}, lower, lower)) return known;
  }
  return {};
}

std::vector<std::string_view> requestNames() {
  std::vector<std::string_view> names;
  for (const Entry& e : kRequests) names.emplace_back(e.name);
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace fr::ri
