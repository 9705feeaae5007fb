// texture, environment, shadow, bump, textureinfo: operands in, one call of the texture module for the whole
// batch.
#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "shading/machine.h"
#include "shading/texture_library.h"

namespace fr {

namespace {

/// Columns of scratch: changes of up to three components in u and in v, coordinates of corners, results,
/// slopes.
enum Column : uint32_t {
  kDx = 0,
  kDy = 3,
  kMiddle = 6,
  kResult = 9,
  kSum = 12,
  kSeen = 13,
  kSlope = 14,
  kColumns = 16
};

struct Shape {
  uint32_t place;       // operand of the first coordinate
  uint32_t components;  // floats of one place
  bool corners;         // four places instead of one
  uint32_t fixed;       // operands before the optional ones
  bool triples;         // coordinates are triples, else floats
};
Shape shapeOf(Op op) {
  switch (op) {
    case Op::texture_f:
    case Op::texture_t:
      return {3, 2, false, 5, false};
    case Op::texture4_f:
    case Op::texture4_t:
      return {3, 2, true, 11, false};
    case Op::environment_f:
    case Op::environment_t:
    case Op::shadow_f:
    case Op::shadow_t:
      return {3, 3, false, 4, true};
    case Op::environment4_f:
    case Op::environment4_t:
    case Op::shadow4_f:
    case Op::shadow4_t:
      return {3, 3, true, 7, true};
    default:
      return {5, 2, false, 7, false};  // bump
  }
}

enum class Kind { kTexture, kEnvironment, kShadow, kBump };
Kind kindOf(Op op) {
  switch (op) {
    case Op::texture_f:
    case Op::texture_t:
    case Op::texture4_f:
    case Op::texture4_t:
      return Kind::kTexture;
    case Op::environment_f:
    case Op::environment_t:
    case Op::environment4_f:
    case Op::environment4_t:
      return Kind::kEnvironment;
    case Op::bump:
      return Kind::kBump;
    default:
      return Kind::kShadow;
  }
}

FrLanes lanesOf(const Operand& o, uint32_t component = 0) {
  return {o.data ? o.comp(component) : nullptr, o.indexMask};
}

FrTextureFilter filterOf(std::string_view name) {
  if (name == "gaussian" || name == "radial-bspline" || name == "bspline" || name == "b-spline" ||
      name == "bicubic" || name == "mitchell" || name == "catmull-rom")
    return FR_TEXTURE_SMOOTH;
  if (name == "nearest" || name == "point") return FR_TEXTURE_NEAREST;
  return FR_TEXTURE_BOX;
}

}  // namespace

/// Four corners become a middle and two sides. Their order may be that of a patch (0,0 1,0 0,1 1,1) or go
/// around: whichever makes the better parallelogram. `corner`: four triples, or eight floats.
void Machine::cornersToPlace(const Frame& f, const Operand* corner, bool triples, uint32_t lanes) {
  const size_t n = f.lanes();
  float* const scratch = texture_.data();
  const uint32_t components = triples ? 3 : 2;
  for (uint32_t i = 0; i < lanes; ++i) {
    float p[4][3] = {};
    float asPatch = 0, around = 0;
    for (uint32_t c = 0; c < components; ++c) {
      for (uint32_t k = 0; k < 4; ++k) p[k][c] = triples ? corner[k].at(i, c) : corner[2 * k + c].at(i);
      const float a = p[0][c] + p[3][c] - p[1][c] - p[2][c], b = p[0][c] + p[2][c] - p[1][c] - p[3][c];
      asPatch += a * a, around += b * b;
    }
    const uint32_t third = around < asPatch ? 3 : 2, fourth = 5 - third;
    for (uint32_t c = 0; c < components; ++c) {
      scratch[(kMiddle + c) * n + i] = 0.25f * (p[0][c] + p[1][c] + p[2][c] + p[3][c]);
      scratch[(kDx + c) * n + i] = 0.5f * (p[1][c] - p[0][c] + p[fourth][c] - p[third][c]);
      scratch[(kDy + c) * n + i] = 0.5f * (p[third][c] - p[0][c] + p[fourth][c] - p[1][c]);
    }
  }
}

void Machine::textureOp(Frame& f, const Step& s) {
  const TextureLibrary* const library = host_.textures();
  switch (s.op) {
    case Op::texture3d:
    case Op::bake3d:
    case Op::bake:
    case Op::photonmap:
      host_.textureCallUnavailable(opInfo(s.op).name);
      return neutralTexture(f, s);
    case Op::textureinfo:
      if (!library) return neutralTexture(f, s);
      return textureInfo(f, s, *library);
    default:
      break;
  }
  const Kind kind = kindOf(s.op);
  const std::string_view name = text(f, s, 1);
  if (!library) {
    host_.textureCallUnavailable(opInfo(s.op).name);
    return neutralTexture(f, s);
  }
  // The maps of ray tracing never come from files; who answers them does so before this.
  if (name == "raytrace" && (kind == Kind::kShadow || kind == Kind::kEnvironment)) {
    host_.textureCallUnavailable(kind == Kind::kShadow ? "shadow(\"raytrace\")"
                                                       : "environment(\"raytrace\")");
    return neutralTexture(f, s);
  }
  const Texture& texture = kind == Kind::kShadow ? library->findList(name) : library->find(name);
  if (!texture.file && texture.parts.empty()) return neutralTexture(f, s);

  const Operand* const a = f.args(s);
  const Operand& out = a[0];
  const Shape shape = shapeOf(s.op);
  const size_t n = f.lanes();
  texture_.reserve(n * kColumns);
  float* const scratch = texture_.data();
  const auto column = [&](uint32_t c) { return scratch + size_t(c) * n; };

  FrTextureCall call{};
  // A uniform result is one lookup.
  call.lanes = out.varying() ? uint32_t(n) : 1;
  call.active = out.varying() ? f.mask : nullptr;
  call.firstChannel = kind == Kind::kBump ? 0 : int(std::clamp(a[2].at(0), 0.0f, 1e6f));
  const uint32_t outputs = slTypeFloats(f.exe().program().symbols[symbolOf(f, s, 0)].type);
  call.channelCount = kind == Kind::kBump || kind == Kind::kShadow ? 1 : int(outputs);
  call.filter = kind == Kind::kBump ? FR_TEXTURE_SMOOTH : FR_TEXTURE_BOX;
  call.sWidth = call.tWidth = 1;
  call.samples = 16;
  textureOptions(f, s, shape.fixed, call);

  if (shape.corners) cornersToPlace(f, a + shape.place, shape.triples, call.lanes);
  for (uint32_t c = 0; c < shape.components; ++c) {
    const Operand& place = a[shape.triples ? shape.place : shape.place + c];
    const uint32_t component = shape.triples ? c : 0;
    if (!shape.corners) {
      const Operand changing{place.comp(component), place.component, place.indexMask};
      difference(f, changing, 1, false, true, {column(kDx + c), f.lanes(), ~0u});
      difference(f, changing, 1, true, true, {column(kDy + c), f.lanes(), ~0u});
    }
    call.place[c] = shape.corners ? FrLanes{column(kMiddle + c), ~0u} : lanesOf(place, component);
    call.placeDx[c] = {column(kDx + c), ~0u};
    call.placeDy[c] = {column(kDy + c), ~0u};
  }
  if (kind == Kind::kShadow) return shadowMaps(f, s, *library, texture, call);

  call.result = column(kResult), call.resultStride = uint32_t(n);
  if (kind == Kind::kBump) call.slope[0] = column(kSlope), call.slope[1] = column(kSlope + 1);
  // What cannot be read gives zeros.
  for (uint32_t c = 0; c < 3; ++c) std::fill_n(column(kResult + c), call.lanes, 0.0f);
  for (uint32_t c = 0; c < 2; ++c) std::fill_n(column(kSlope + c), call.lanes, 0.0f);
  library->call(texture, [&](const FrTextureModule& m, char* message, size_t size) {
    return kind == Kind::kEnvironment ? m.environment(texture.file, &call, message, size)
                                      : m.texture(texture.file, &call, message, size);
  });
  if (kind == Kind::kBump) return bumpNormals(f, s, column(kSlope), column(kSlope + 1));
  for (uint32_t c = 0; c < outputs; ++c) storeResult(f, out, c, column(kResult + c));
}

/// Copies a column of results to a register; one value for a uniform register.
void Machine::storeResult(const Frame& f, const Operand& out, uint32_t component, const float* values) {
  float* const to = out.comp(component);
  if (out.varying())
    for (uint32_t i = 0; i < f.lanes(); ++i) to[i] = f.mask[i] ? values[i] : to[i];
  else
    std::fill_n(to, kLanePad, values[0]);
}

void Machine::textureOptions(Frame& f, const Step& s, uint32_t fixed, FrTextureCall& call) {
  const Operand* const a = f.args(s);
  const ShaderProgram& p = f.exe().program();
  for (uint32_t k = fixed; k + 1 < s.argCount; k += 2) {
    if (p.symbols[symbolOf(f, s, k)].type != SlType::kString) continue;
    const std::string_view name = text(f, s, k);
    const Operand& value = a[k + 1];
    if (p.symbols[symbolOf(f, s, k + 1)].type == SlType::kString) {
      if (name == "filter") call.filter = filterOf(text(f, s, k + 1));
      continue;
    }
    if (!value.data) continue;
    uint32_t lane = 0;
    if (value.varying())
      while (lane + 1 < f.lanes() && !f.mask[lane]) ++lane;
    const float one = value.at(lane);
    if (name == "blur")
      call.sBlur = call.tBlur = lanesOf(value);
    else if (name == "sblur")
      call.sBlur = lanesOf(value);
    else if (name == "tblur")
      call.tBlur = lanesOf(value);
    else if (name == "width")
      call.sWidth = call.tWidth = one;
    else if (name == "swidth")
      call.sWidth = one;
    else if (name == "twidth")
      call.tWidth = one;
    else if (name == "fill")
      call.hasFill = 1, call.fill = one;
    else if (name == "samples")
      call.samples = int(std::clamp(one, 1.0f, 65536.0f));
    else if (name == "bias")
      call.bias = lanesOf(value);
    else if (name.starts_with("source") && call.sourceCount < 4 &&
             isTriple(p.symbols[symbolOf(f, s, k + 1)].type))
      for (uint32_t c = 0, corner = uint32_t(call.sourceCount++); c < 3; ++c)
        call.source[corner][c] = lanesOf(value, c);
    // Unknown parameters are for other renderers.
  }
}

/// The fraction in shadow: the mean of all maps that see the point.
void Machine::shadowMaps(Frame& f, const Step& s, const TextureLibrary& library, const Texture& list,
                         FrTextureCall& call) {
  const size_t n = f.lanes();
  float* const scratch = texture_.data();
  float *const result = scratch + kResult * n, *const sum = scratch + kSum * n,
               *const seen = scratch + kSeen * n;
  std::fill_n(sum, call.lanes, 0.0f), std::fill_n(seen, call.lanes, 0.0f);
  DMat4 world(1.0);
  host_.spaceToCurrent("world", world);
  const DMat4 currentToWorld = glm::inverse(world);
  call.currentToWorld = &currentToWorld[0][0];
  const Vec2 bias = host_.shadowBias();
  call.biasLow = bias.x, call.biasHigh = bias.y;
  call.seed = batch_.seed;
  call.result = result, call.resultStride = uint32_t(n);
  for (const Texture* map : list.parts) {
    if (!map->file) continue;
    std::fill_n(result, call.lanes, -1.0f);
    library.call(*map, [&](const FrTextureModule& m, char* message, size_t size) {
      return m.shadow(map->file, &call, message, size);
    });
    for (uint32_t i = 0; i < call.lanes; ++i)
      if (result[i] >= 0) sum[i] += result[i], seen[i] += 1;
  }
  for (uint32_t i = 0; i < call.lanes; ++i) sum[i] = seen[i] > 0 ? sum[i] / seen[i] : 0.0f;
  const Operand& out = f.args(s)[0];
  const uint32_t outputs = slTypeFloats(f.exe().program().symbols[symbolOf(f, s, 0)].type);
  for (uint32_t c = 0; c < outputs; ++c) storeResult(f, out, c, sum);
}

/// Blinn's bump mapping ("Simulation of Wrinkled Surfaces", SIGGRAPH 1978): the normal of the surface moved
/// along N by the texture's value, as long as N was. dPdu and dPdv are changes with the texture's s and t.
void Machine::bumpNormals(Frame& f, const Step& s, const float* bySide, const float* byHeight) {
  const Operand* const a = f.args(s);
  const Operand& out = a[0];
  const uint32_t lanes = out.varying() ? f.lanes() : 1;
  for (uint32_t i = 0; i < lanes; ++i) {
    if (out.varying() && !f.mask[i]) continue;
    const auto triple = [&](uint32_t k) { return Vec3(a[k].at(i, 0), a[k].at(i, 1), a[k].at(i, 2)); };
    const Vec3 N = triple(2), Ps = triple(3), Pt = triple(4);
    const Vec3 area = glm::cross(Ps, Pt);
    const float length = glm::length(N), size = glm::length(area);
    Vec3 bumped = N;
    if (length > 0 && size > 0) {
      const Vec3 unit = N / length;
      const float side = glm::dot(area, unit) < 0 ? -1.0f : 1.0f;
      bumped = N + (glm::cross(unit, Pt) * bySide[i] - glm::cross(unit, Ps) * byHeight[i]) *
                       (side * length / size);
      if (!isFinite(bumped)) bumped = N;
    }
    for (uint32_t c = 0; c < 3; ++c)
      if (out.varying())
        out.comp(c)[i] = bumped[int(c)];
      else
        std::fill_n(out.comp(c), kLanePad, bumped[int(c)]);
  }
}

namespace {
DMat4 matrixOf(const float m[16]) {
  DMat4 r;
  for (int k = 0; k < 16; ++k) (&r[0][0])[k] = m[k];
  return r;
}
void setMatrix(ShaderValue& v, const DMat4& m) {
  v.type = SlType::kMatrix;
  for (int k = 0; k < 16; ++k) v.floats.push_back(float((&m[0][0])[k]));
}
const char* typeName(int kind) {
  return kind == FR_TEXTURE_SHADOW ? "shadow" : kind == FR_TEXTURE_PLAIN ? "texture" : "environment";
}
}  // namespace

void Machine::textureInfo(Frame& f, const Step& s, const TextureLibrary& library) {
  const Operand* const a = f.args(s);  // found, file, what, variable
  const std::string_view what = text(f, s, 2);
  const Texture& t = library.find(text(f, s, 1));
  const FrTextureInfo& info = t.info;
  ShaderValue v;
  bool known = t.file != nullptr;
  if (what == "exists") {
    v.floats = {known ? 1.0f : 0.0f};
    known = true;
  } else if (!known) {
  } else if (what == "resolution") {
    v.floats = {float(info.width), float(info.height)};
    v.arrayLength = 2;
  } else if (what == "type") {
    v.type = SlType::kString;
    v.strings = {typeName(info.kind)};
  } else if (what == "channels") {
    v.floats = {float(info.channels)};
  } else if (what == "bitsperchannel") {
    v.floats = {float(info.bits)};
  } else if (what == "filename" || what == "fileName") {
    v.type = SlType::kString;
    v.strings = {t.path};
  } else if (what == "viewingmatrix" && info.hasCamera) {
    setMatrix(v, matrixOf(info.worldToCamera));
  } else if (what == "projectionmatrix" && info.hasCamera) {
    setMatrix(v, matrixOf(info.worldToScreen) * glm::inverse(matrixOf(info.worldToCamera)));
  } else if (what == "min" || what == "max") {
    std::vector<float> smallest(size_t(info.channels)), largest(size_t(info.channels));
    known = library.call(t, [&](const FrTextureModule& m, char* message, size_t size) {
      return m.range(t.file, info.channels, smallest.data(), largest.data(), message, size);
    });
    v.floats = what == "min" ? smallest : largest;
    v.arrayLength = info.channels > 1 ? uint32_t(info.channels) : 0;
  } else {
    known = false;
  }
  const uint32_t arg = symbolOf(f, s, 3);
  // Matrices may be asked for as 16 floats, colours as three.
  const Symbol& symbol = f.exe().program().symbols[arg];
  if (known && v.type == SlType::kMatrix && symbol.type == SlType::kFloat)
    v.type = SlType::kFloat, v.arrayLength = 16;
  if (known && isTriple(symbol.type) && v.type == SlType::kFloat && v.floats.size() >= 3)
    v.type = SlType::kColor, v.arrayLength = 0;
  setFloat(f, a[0], known && writeValue(f, arg, a[3], v) ? 1.0f : 0.0f);
}

/// What a call gives when there is no map: white, no environment, no shadow, the normal itself.
void Machine::neutralTexture(Frame& f, const Step& s) {
  const ShaderProgram& p = f.exe().program();
  if (s.argCount == 0 || !isWritten(f, s, 0)) return;
  const uint32_t symbol = symbolOf(f, s, 0);
  const Operand& out = f.args(s)[0];
  if (s.op == Op::bump) {
    const Operand& N = f.args(s)[2];
    for (uint32_t c = 0; c < 3; ++c)
      for (uint32_t i = 0; i < (out.varying() ? f.lanes() : kLanePad); ++i) out.comp(c)[i] = N.at(i, c);
    return;
  }
  const float value = s.op != Op::textureinfo && kindOf(s.op) == Kind::kTexture ? 1.0f : 0.0f;
  for (uint32_t c = 0; c < slTypeFloats(p.symbols[symbol].type); ++c)
    setFloat(f, Operand{out.comp(c), out.component, out.indexMask}, value);
}

}  // namespace fr
