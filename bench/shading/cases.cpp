#include "bench/shading/cases.h"

#include <cmath>

namespace fr::bench {
namespace {

ParameterSetting number(const char* name, float value) { return {name, {SlType::kFloat, 0, {value}, {}}}; }
ParameterSetting point(const char* name, float x, float y, float z) {
  return {name, {SlType::kPoint, 0, {x, y, z}, {}}};
}
ParameterSetting text(const char* name, std::string value) {
  return {name, {SlType::kString, 0, {}, {std::move(value)}}};
}

LightCase ambient() {
  HandLight h;
  h.kind = HandLight::kAmbient;
  for (float& c : h.color) c = 0.1f;
  return {"ambientlight", {number("intensity", 0.1f)}, h};
}
LightCase pointLight(float x, float y, float z, float intensity = 3) {
  HandLight h;
  h.kind = HandLight::kPoint;
  for (float& c : h.color) c = intensity;
  h.from[0] = x, h.from[1] = y, h.from[2] = z;
  return {"pointlight", {number("intensity", intensity), point("from", x, y, z)}, h};
}
LightCase distant() {
  HandLight h;
  h.kind = HandLight::kDistant;
  h.axis[0] = 0.2f, h.axis[1] = 0.1f, h.axis[2] = 1;
  return {"distantlight", {point("from", 0, 0, 0), point("to", 0.2f, 0.1f, 1)}, h};
}
LightCase spot(const char* shader) {
  HandLight h;
  h.kind = HandLight::kSpot;
  for (float& c : h.color) c = 5;
  h.from[0] = h.from[1] = 0.5f, h.from[2] = -2;
  h.cosOuter = std::cos(0.4f), h.cosInner = std::cos(0.4f - 0.0872664626f);
  return {shader,
          {number("intensity", 5), point("from", .5f, .5f, -2), point("to", .5f, .5f, 1),
           number("coneangle", 0.4f)},
          h};
}
/// One point at the origin that faces +z, see PointEmitter.
LightCase area() {
  HandLight h;
  h.kind = HandLight::kArea;
  return {"arealight", {}, h};
}

const char* const kFbm = R"(
surface fbm(float octaves = 10; float frequency = 4;)
{
    point Q = frequency * P;
    float sum = 0, a = 1, i;
    for (i = 0; i < octaves; i += 1) {
        sum += a * (2 * noise(Q) - 1);
        a *= .5;
        Q *= 2;
    }
    Oi = Os;
    Ci = Os * (.5 + .5 * sum);
}
)";
const char* const kMarble = R"(
surface marble(float Ka = 1; float Kd = .5; float Ks = .5; float roughness = .1; float octaves = 6;
               float frequency = 4;)
{
    point Q = frequency * P;
    float sum = 0, a = 1, i;
    for (i = 0; i < octaves; i += 1) {
        sum += a * abs(noise(Q) - .5);
        a *= .5;
        Q *= 2;
    }
    color stone = spline(.5 + .5 * sin(4 * xcomp(P) + 8 * sum), color (.1, .1, .2), color (.2, .2, .35),
                         color (.35, .35, .5), color (.7, .7, .75), color (.9, .9, .9), color (1, 1, 1));
    normal Nf = faceforward(normalize(N), I);
    vector V = -normalize(I);
    Oi = Os;
    Ci = Os * (stone * (Ka * ambient() + Kd * diffuse(Nf)) + Ks * specular(Nf, V, roughness));
}
)";
const char* const kBrick = R"(
surface brick(float Ka = 1; float Kd = 1; float frequency = 8; color mortar = color (.5, .5, .45);)
{
    float x = s * frequency, y = t * frequency * 2;
    float row = floor(y);
    if (mod(row, 2) > .5)
        x += .5;
    float column = floor(x);
    x -= column;
    y -= row;
    float inside = smoothstep(.04, .08, x) * (1 - smoothstep(.92, .96, x)) *
                   smoothstep(.04, .08, y) * (1 - smoothstep(.92, .96, y));
    color stone = Cs * (.7 + .3 * cellnoise(column, row));
    normal Nf = faceforward(normalize(N), I);
    Oi = Os;
    Ci = Os * mix(mortar, stone, inside) * (Ka * ambient() + Kd * diffuse(Nf));
}
)";

}  // namespace

std::vector<Case> allCases(const std::string& textureFile) {
  const std::vector<LightCase> standard = {ambient(), pointLight(0.3f, 0.4f, -2)};
  const std::vector<LightCase> four = {pointLight(0.3f, 0.4f, -2), pointLight(-1, 1, -1, 2),
                                       pointLight(2, 0, -1, 4), pointLight(0.5f, -2, -2, 5)};
  std::vector<Case> r;
  const auto add = [&](std::string name, std::vector<LightCase> lights, std::string hand,
                       std::function<void(HandTask&)> tell = {}) -> Case& {
    Case c;
    c.shader = c.name = std::move(name);
    c.lights = std::move(lights);
    c.hand = std::move(hand);
    c.tell = std::move(tell);
    r.push_back(std::move(c));
    return r.back();
  };
  add("constant", {}, "constant");
  add("null", {}, "null");
  add("defaultsurface", {}, "defaultsurface", [](HandTask& t) { t.Kd = .8f, t.Ka = .2f; });
  add("matte", standard, "matte");
  add("metal", standard, "metal", [](HandTask& t) { t.Ks = 1; });
  add("plastic", standard, "plastic", [](HandTask& t) { t.Kd = .5f; });
  add("paintedplastic", standard, "plastic", [](HandTask& t) { t.Kd = .5f; });
  {
    Case& c = add("paintedplastic", standard, "paintedplastic", [](HandTask& t) { t.Kd = .5f; });
    c.name = "paintedplastic, texture";
    c.settings = {text("texturename", textureFile)};
    c.usesTexture = true, c.goal = 1.3;
  }
  add("checker", standard, "checker",
      [](HandTask& t) { t.color[0] = t.color[1] = t.color[2] = .2f, t.frequency = 8; });
  add("bumpy", {}, "bumpy").comparePN = true;
  add("mirror", standard, "mirror", [](HandTask& t) { t.Ka = 0, t.Ks = 0, t.roughness = .05f; });
  add("shiny", standard, "shiny", [](HandTask& t) { t.Kd = .5f, t.Ks = 1, t.Kr = .5f, t.roughness = .05f; });
  {
    Case& c = add("shinymetal", standard, "metal", [](HandTask& t) { t.Ks = 1; });
    c.name = "shinymetal, no map";
  }
  {
    Case& c = add("shinymetal", standard, "shinymetal", [](HandTask& t) { t.Ks = 1; });
    c.name = "shinymetal, raytrace";
    c.settings = {text("texturename", "raytrace")};
  }
  add("glass", standard, "glass", [](HandTask& t) { t.Ka = t.Kd = 0, t.Ks = 1, t.roughness = .02f; });
  add("occluded", {}, "occluded").settings = {number("samples", 4)};
  add("fog", {}, "fog");
  add("depthcue", {}, "depthcue");
  {
    Case& c = add("smoke", {pointLight(0.3f, 0.4f, -2)}, "smoke");
    c.meansOnly = true, c.tolerance = 0.05;
  }
  add("background", {}, "background", [](HandTask& t) { t.color[0] = t.color[1] = t.color[2] = 1; });
  add("clamptoalpha", {}, "clamptoalpha");
  const auto matteUnder = [&](LightCase light) {
    Case& c = add("matte", {light}, light.hand.kind == HandLight::kArea ? "matteByArea" : "matte");
    c.name = light.shader + " (matte)";
  };
  matteUnder(ambient());
  matteUnder(distant());
  matteUnder(pointLight(0.3f, 0.4f, -2));
  matteUnder(spot("spotlight"));
  matteUnder(spot("shadowspot"));
  matteUnder(area());
  {
    Case& c = add("plastic", four, "plastic", [](HandTask& t) { t.Kd = .5f; });
    c.name = "plastic, 4 lights";
  }
  {
    Case& c = add("fbm, 10 octaves", {}, "fbm", [](HandTask& t) { t.octaves = 10, t.frequency = 4; });
    c.source = kFbm, c.goal = 1.3;
  }
  {
    Case& c =
        add("marble", standard, "marble", [](HandTask& t) { t.octaves = 6, t.frequency = 4, t.Kd = .5f; });
    c.source = kMarble, c.goal = 1.3;
  }
  {
    Case& c = add("brick", standard, "brick",
                  [](HandTask& t) { t.frequency = 8, t.color[0] = t.color[1] = .5f, t.color[2] = .45f; });
    c.source = kBrick;
  }
  {
    Case& c = add("texture lookup", {}, "texture");
    c.source = "surface lookup() { Ci = color texture(\"" + textureFile + "\", s, t); Oi = Os; }";
    c.usesTexture = true, c.goal = 1.3;
  }
  return r;
}

}  // namespace fr::bench
