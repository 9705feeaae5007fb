#include "shading/scene_host.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "base/error.h"
#include "base/log.h"
#include "ri/search_path.h"

namespace fr {

using cache::ParamType;

namespace {

constexpr size_t kTexturePath = 1;  // of Skeleton::searchPaths()

float numberOption(const cache::Skeleton& s, std::string_view name, float otherwise) {
  const cache::ParamRecord* p = s.find(s.options().options, name);
  if (!p) return otherwise;
  if (const auto f = s.floats(*p); !f.empty()) return f[0];
  if (const auto i = s.integers(*p); !i.empty()) return float(i[0]);
  return otherwise;
}

TextureLibrary::Options textureOptions(const cache::Skeleton& s, uint32_t mostKilobytes) {
  TextureLibrary::Options o;
  const auto add = [&](std::string_view list) {
    for (std::string& folder : ri::parseSearchPath(list, {}, {})) o.folders.push_back(std::move(folder));
  };
  if (s.searchPaths().size() > kTexturePath) add(s.string(s.searchPaths()[kTexturePath]));
  if (const char* standard = std::getenv("TEXTURES")) add(standard);
  const float kilobytes = numberOption(s, "limits:texturememory", float(o.memoryKilobytes));
  o.memoryKilobytes = uint32_t(std::clamp(kilobytes, 1.0f, 1e9f));
  if (mostKilobytes > 0) o.memoryKilobytes = std::min(o.memoryKilobytes, mostKilobytes);
  return o;
}

}  // namespace

SceneHost::SceneHost(const cache::Skeleton& skeleton, uint32_t textureKilobytes)
    : skeleton_(skeleton), textures_(textureOptions(skeleton, textureKilobytes)) {
  // One of the two stands for both.
  const float bias = numberOption(skeleton_, "shadow:bias", -1.0f);
  shadowBias_ = {numberOption(skeleton_, "shadow:bias0", bias),
                 numberOption(skeleton_, "shadow:bias1", bias)};
  if (shadowBias_.x < 0) shadowBias_.x = std::max(0.0f, shadowBias_.y);
  if (shadowBias_.y < 0 && numberOption(skeleton_, "shadow:bias0", -1.0f) >= 0) shadowBias_.y = shadowBias_.x;
  const cache::CameraRecord& c = skeleton_.camera();
  shutterOpen_ = c.shutter[0];
  perspective_ = c.projection == cache::ProjectionType::kPerspective;
  worldToCurrent_ = skeleton_.worldToCamera(shutterOpen_);
  cacheToCurrent_ = skeleton_.cacheToCamera(shutterOpen_);
  currentToCache_ = glm::inverse(cacheToCurrent_);

  const double near = c.clipping[0], far = std::max(double(c.clipping[1]), near * (1 + 1e-6));
  DMat4 screen(1.0);
  if (perspective_) {
    const double f = 1.0 / std::tan(double(c.fov) * 3.14159265358979 / 360.0);
    screen = DMat4(0.0);
    screen[0][0] = screen[1][1] = f;
    screen[2][2] = far / (far - near);
    screen[2][3] = 1.0;
    screen[3][2] = -far * near / (far - near);
  } else {
    screen[2][2] = 1.0 / (far - near);
    screen[3][2] = -near / (far - near);
  }
  currentToScreen_ = screen;
  const double left = c.screenWindow[0], right = c.screenWindow[1], bottom = c.screenWindow[2],
               top = c.screenWindow[3];
  const double width = right != left ? right - left : 1.0, height = top != bottom ? top - bottom : 1.0;
  DMat4 ndc(1.0);
  ndc[0][0] = 1.0 / width, ndc[3][0] = -left / width;
  ndc[1][1] = -1.0 / height, ndc[3][1] = top / height;
  currentToNdc_ = ndc * currentToScreen_;
  DMat4 raster(1.0);
  raster[0][0] = c.resolution[0], raster[1][1] = c.resolution[1];
  currentToRaster_ = raster * currentToNdc_;

  Box3f box;
  for (const cache::ObjectRecord& o : skeleton_.objects())
    if (!o.bound.empty()) box.extend(o.bound);
  const Vec3 eye = Vec3(currentToCache_[3]);
  if (isFinite(eye)) box.extend(eye);
  const float diagonal = box.diagonal();
  sceneDiameter_ = std::isfinite(diagonal) && diagonal > 0 ? 1.01f * diagonal : 1e6f;
}

DMat4 SceneHost::transformToCurrent(cache::TransformId t) const {
  if (t == cache::kNone) return worldToCurrent_;
  return worldToCurrent_ * skeleton_.toWorld(t, shutterOpen_);
}

ShaderValue SceneHost::value(const cache::ParamRecord& p, const DMat4* toCurrent) const {
  ShaderValue v;
  v.arrayLength = p.arrayLength > 1 ? p.arrayLength : 0;
  const auto floats = skeleton_.floats(p);
  v.floats.assign(floats.begin(), floats.end());
  const auto eachTriple = [&](auto&& f) {
    for (size_t k = 0; k + 2 < v.floats.size(); k += 3) {
      const DVec3 r = f(DVec3(v.floats[k], v.floats[k + 1], v.floats[k + 2]));
      for (int c = 0; c < 3; ++c) v.floats[k + size_t(c)] = float(r[c]);
    }
  };
  switch (p.type) {
    case ParamType::kFloat:
      v.type = SlType::kFloat;
      break;
    case ParamType::kInteger:
      v.type = SlType::kFloat;
      for (int32_t i : skeleton_.integers(p)) v.floats.push_back(float(i));
      break;
    case ParamType::kString:
      v.type = SlType::kString;
      for (cache::StringId s : skeleton_.strings(p)) v.strings.emplace_back(skeleton_.string(s));
      break;
    case ParamType::kColor:
      v.type = SlType::kColor;
      break;
    case ParamType::kHPoint: {
      std::vector<float> points;
      for (size_t k = 0; k + 3 < v.floats.size(); k += 4)
        for (size_t c = 0; c < 3; ++c)
          points.push_back(v.floats[k + 3] != 0 ? v.floats[k + c] / v.floats[k + 3] : v.floats[k + c]);
      v.floats = std::move(points);
      [[fallthrough]];
    }
    case ParamType::kPoint:
      v.type = SlType::kPoint;
      if (toCurrent) eachTriple([&](const DVec3& x) { return transformPoint(*toCurrent, x); });
      break;
    case ParamType::kVector:
      v.type = SlType::kVector;
      if (toCurrent) eachTriple([&](const DVec3& x) { return transformVector(*toCurrent, x); });
      break;
    case ParamType::kNormal: {
      v.type = SlType::kNormal;
      if (!toCurrent) break;
      const DMat3 n = normalMatrix(*toCurrent);
      eachTriple([&](const DVec3& x) { return n * x; });
      break;
    }
    case ParamType::kMatrix:
      v.type = SlType::kMatrix;
      // matrix "shader" (...): from current to shader space, then the matrix.
      for (size_t k = 0; toCurrent && k + 15 < v.floats.size(); k += 16) {
        DMat4 m;
        for (int e = 0; e < 16; ++e) (&m[0][0])[e] = v.floats[k + size_t(e)];
        m = m * glm::inverse(*toCurrent);
        for (int e = 0; e < 16; ++e) v.floats[k + size_t(e)] = float((&m[0][0])[e]);
      }
      break;
  }
  return v;
}

float SceneHost::optionFloat(std::string_view name, float fallback) const {
  return numberOption(skeleton_, name, fallback);
}

float SceneHost::attributeFloat(const cache::AttributeRecord& a, std::string_view name,
                                float fallback) const {
  const cache::ParamRecord* p = skeleton_.find(a.attributes, name);
  if (!p) return fallback;
  const ShaderValue v = value(*p, nullptr);
  return v.floats.empty() ? fallback : v.floats[0];
}

bool SceneHost::spaceToCurrent(std::string_view name, DMat4& m) const {
  if (name == "camera")
    m = DMat4(1.0);
  else if (name == "world")
    m = worldToCurrent_;
  else if (name == "screen")
    m = glm::inverse(currentToScreen_);
  else if (name == "NDC" || name == "ndc")
    m = glm::inverse(currentToNdc_);
  else if (name == "raster")
    m = glm::inverse(currentToRaster_);
  else {
    // The last declaration of a name counts.
    const auto spaces = skeleton_.namedSpaces();
    for (size_t i = spaces.size(); i-- > 0;)
      if (skeleton_.string(spaces[i].name) == name) {
        m = transformToCurrent(spaces[i].transform);
        return true;
      }
    // What shaders of the first years call the camera.
    if (name != "eye") return false;
    m = DMat4(1.0);
  }
  return true;
}

bool SceneHost::objectToCurrent(uint32_t object, DMat4& m) const {
  if (object >= skeleton_.objects().size()) return false;
  m = transformToCurrent(skeleton_.objects()[object].transform);
  return true;
}

namespace {
void setFloats(ShaderValue& v, std::initializer_list<float> f) {
  v.type = SlType::kFloat;
  v.floats.assign(f);
  v.arrayLength = f.size() > 1 ? uint32_t(f.size()) : 0;
}
void setColor(ShaderValue& v, const Color& c) {
  v.type = SlType::kColor;
  v.arrayLength = 0;
  v.floats = {c.x, c.y, c.z};
}
void setString(ShaderValue& v, std::string_view s) {
  v.type = SlType::kString;
  v.strings = {std::string(s)};
}
std::string_view withoutRi(std::string_view name) {
  return name.substr(0, 3) == "Ri:" ? name.substr(3) : name;
}
}  // namespace

bool SceneHost::attribute(std::string_view fullName, uint32_t attributes, ShaderValue& v) const {
  if (attributes >= skeleton_.attributes().size()) return false;
  const cache::AttributeRecord& a = skeleton_.attributes()[attributes];
  const std::string_view name = withoutRi(fullName);
  if (name == "ShadingRate")
    setFloats(v, {a.shadingRate});
  else if (name == "Sides")
    setFloats(v, {float(a.sides)});
  else if (name == "Matte")
    setFloats(v, {a.flags & cache::kMatte ? 1.0f : 0.0f});
  else if (name == "Color")
    setColor(v, a.color);
  else if (name == "Opacity")
    setColor(v, a.opacity);
  else if (name == "ShadingInterpolation")
    setString(v, a.flags & cache::kSmoothShading ? "smooth" : "constant");
  else if (name == "Transformation") {
    // Of the attribute state, not of one object: where its surface shader stands.
    const DMat4 m = a.surface == cache::kNone ? worldToCurrent_
                                              : transformToCurrent(skeleton_.shaders()[a.surface].transform);
    v.type = SlType::kMatrix;
    for (int e = 0; e < 16; ++e) v.floats.push_back(float((&m[0][0])[e]));
  } else if (name == "Orientation")
    setString(v, a.flags & cache::kReverseOrientation ? "inside" : "outside");
  else if (name == "DetailRange")
    setFloats(v, {0, 0, kRiInfinity, kRiInfinity});
  else if (name == "GeometricApproximation:motionfactor")
    setFloats(v, {a.motionFactor});
  else if (name == "GeometricApproximation:focusfactor")
    setFloats(v, {a.focusFactor});
  else if (name == "grouping:membership")
    setString(v, skeleton_.string(a.groups));
  else if (name == "displacementbound:sphere")
    setFloats(v, {a.displacementBound});
  else if (name == "displacementbound:coordinatesystem")
    setString(v, "world");
  else if (name == "identifier:name")
    setString(v, skeleton_.string(a.name));
  else if (name == "TextureCoordinates") {
    v.type = SlType::kFloat, v.arrayLength = 8;
    v.floats.assign(a.textureCoordinates, a.textureCoordinates + 8);
  } else if (const cache::ParamRecord* p = skeleton_.find(a.attributes, name)) {
    v = value(*p, nullptr);
  } else {
    return false;
  }
  return true;
}

bool SceneHost::option(std::string_view fullName, ShaderValue& v) const {
  const cache::CameraRecord& c = skeleton_.camera();
  const std::string_view name = withoutRi(fullName);
  if (name == "Format" || name == "DeviceResolution")
    setFloats(v, {float(c.resolution[0]), float(c.resolution[1]), c.pixelAspect});
  else if (name == "FrameAspectRatio")
    setFloats(v, {c.frameAspect});
  else if (name == "CropWindow")
    setFloats(v, {c.cropWindow[0], c.cropWindow[1], c.cropWindow[2], c.cropWindow[3]});
  else if (name == "DepthOfField")
    setFloats(v, {c.dof[0], c.dof[1], c.dof[2]});
  else if (name == "Shutter")
    setFloats(v, {c.shutter[0], c.shutter[1]});
  else if (name == "Clipping")
    setFloats(v, {c.clipping[0], c.clipping[1]});
  else if (name == "Frame")
    setFloats(v, {float(skeleton_.options().frameNumber)});
  else if (name == "PixelSamples")
    setFloats(v, {skeleton_.options().pixelSamples[0], skeleton_.options().pixelSamples[1]});
  else if (name == "PixelFilter")
    setString(v, skeleton_.string(skeleton_.options().filter));
  else if (name == "FilterWidth")
    setFloats(v, {skeleton_.options().filterWidth[0], skeleton_.options().filterWidth[1]});
  else if (name == "Exposure")
    setFloats(v, {skeleton_.options().exposure[0], skeleton_.options().exposure[1]});
  else if (name == "PixelVariance")
    setFloats(v, {skeleton_.options().pixelVariance});
  else if (name == "ScreenWindow")
    setFloats(v, {c.screenWindow[0], c.screenWindow[1], c.screenWindow[2], c.screenWindow[3]});
  else if (name == "FieldOfView")
    setFloats(v, {c.fov});
  else if (name == "Projection")
    setString(v, perspective_ ? "perspective" : "orthographic");
  else if (name == "Hider")
    setString(v, skeleton_.string(skeleton_.options().hider));
  else if (const cache::ParamRecord* p = skeleton_.find(skeleton_.options().options, name))
    v = value(*p, nullptr);
  else
    return false;
  return true;
}

bool SceneHost::rendererInfo(std::string_view name, ShaderValue& v) const {
  if (name == "renderer")
    setString(v, "frankenrender");
  else if (name == "version")
    setFloats(v, {0, 1, 0, 0});
  else if (name == "versionstring")
    setString(v, "0.1.0");
  else
    return false;
  return true;
}

/// Modes of displays are "rgba", "z", "name", "varying color name", or several of them with commas between.
bool SceneHost::isDisplayed(std::string_view name) const {
  if (name.empty()) return false;
  for (const cache::DisplayRecord& d : skeleton_.displays(skeleton_.options().displays)) {
    std::string_view rest = skeleton_.string(d.mode);
    while (!rest.empty()) {
      std::string_view part = rest.substr(0, rest.find(','));
      rest.remove_prefix(std::min(part.size() + 1, rest.size()));
      while (!part.empty() && part.back() == ' ') part.remove_suffix(1);
      const std::string_view word = part.substr(part.find_last_of(" \t") + 1);
      if (word == name || (name == "Ci" && word.substr(0, 3) == "rgb") ||
          (name == "Oi" && (word == "rgba" || word == "rgbaz" || word == "a")))
        return true;
    }
  }
  return false;
}

Vec2 SceneHost::clipping() const { return {skeleton_.camera().clipping[0], skeleton_.camera().clipping[1]}; }

void SceneHost::print(std::string_view text) const {
  while (!text.empty() && text.back() == '\n') text.remove_suffix(1);
  logMessage(Severity::kInfo, text);
}

int SceneHost::textureCallUnavailable(std::string_view what) const {
  reportOnce("shading.texture." + std::string(what),
             Error{RiError::kUnimplemented,
                   Severity::kWarning,
                   {},
                   fmt::format("{} is not available; a neutral value is used", what)});
  return 0;
}

}  // namespace fr
