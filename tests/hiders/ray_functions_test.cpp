// The ray functions of RSL, volumes on rays and area lights, through camera rays over real scenes, against
// closed forms.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

constexpr int kSize = 8;
using Shaders = std::map<std::string, std::string>;

// An orthographic camera looks along z at what stands around z = 0; "up" from there is -z. What must not be
// seen is hidden from camera rays.
std::string scene(const std::string& world, const std::string& options) {
  return fmt::format("Format {} {} 1\nPixelSamples 1 1\nPixelFilter \"box\" 1 1\nScreenWindow -1 1 -1 1\n",
                     kSize, kSize) +
         options + "Projection \"orthographic\"\nTranslate 0 0 50\nWorldBegin\n" + world + "WorldEnd\n";
}
Channels picture(const std::string& world, const Shaders& shaders, const std::string& options = "") {
  return renderByRays(scene(world, options), shaders);
}
/// Mean of a channel over the picture.
double mean(const Channels& c, size_t channel = 0) {
  double sum = 0;
  for (float v : c.values[channel]) sum += double(v);
  return sum / double(c.values[channel].size());
}
/// A surface shader of one expression.
std::string shows(const std::string& what) {
  return "surface probe() { vector up = vector \"world\" (0, 0, -1); Ci = " + what + "; Oi = 1; }\n";
}
const std::string kFloor =
    "AttributeBegin Attribute \"render\" \"int visibility\" [1] Surface \"probe\" Polygon \"P\" [-2 -2 0 -2 "
    "2 0 2 2 0 2 -2 0] AttributeEnd\n";
const std::string kUnseen = "Attribute \"visibility\" \"int camera\" [0]\n";
std::string square(double z, double half = 6) {
  return fmt::format("Polygon \"P\" [{1} {1} {0} {1} {2} {0} {2} {2} {0} {2} {1} {0}]\n", z, -half, half);
}

// --- volumes ---

TEST(RayVolumes, AtmosphereOfTheHitSurfaceOnTracedRays) {
  const Channels c =
      picture("AttributeBegin " + kUnseen +
                  "Surface \"constant\" Atmosphere \"fog\" \"distance\" [2] \"background\" [0 1 0]\n" +
                  square(-3) + "AttributeEnd\n" + kFloor,
              {{"probe", shows("trace(P, up)")}});
  const double clear = std::exp(-1.5);
  EXPECT_NEAR(mean(c, 0), clear, 1e-4);
  EXPECT_NEAR(mean(c, 1), 1, 1e-4);
}

TEST(RayVolumes, AtmosphereOfOrthographicCameraRaysHasTheirLength) {
  const Channels c = picture("Surface \"constant\" Atmosphere \"fog\" \"distance\" [50]\n" + square(0), {});
  EXPECT_NEAR(mean(c), std::exp(-1.0), 1e-4);
}

TEST(RayVolumes, InteriorBetweenEntryAndExit) {
  // Straight through a ball: divided by what the length of the chord says.
  const std::string glass =
      "surface probe() { if (raylevel() > 0) { Ci = 1; } else {\n"
      "  float chord = 2 * abs(zcomp(transform(\"world\", P)));\n"
      "  Ci = trace(P, normalize(I)) * exp(chord / 1.5); } Oi = 1; }\n";
  const Channels c = picture(
      "ShadingRate 0.05 Surface \"probe\" Interior \"fog\" \"distance\" [1.5] Exterior \"fog\" \"distance\" "
      "[0.01]\n"
      "Sphere 2 -2 2 360\n",
      {{"probe", glass}});
  for (float v : c.values[0]) EXPECT_NEAR(v, 1, 0.01);
}

TEST(RayVolumes, ExteriorAlsoWhereNothingIsHit) {
  const Channels c = picture(
      "Attribute \"visibility\" \"int camera\" [1] Exterior \"fog\" \"distance\" [0.1] \"background\" [0 0.5 "
      "1]\n" +
          kFloor,
      {{"probe", shows("trace(P, up)")}});
  EXPECT_NEAR(mean(c, 0), 0, 1e-5);
  EXPECT_NEAR(mean(c, 1), 0.5, 1e-5);
  EXPECT_NEAR(mean(c, 2), 1, 1e-5);
}

TEST(RayVolumes, SegmentsBehindATransparentSurface) {
  // A block from -2 to -1 whose faces let half through: its interior dims what lies behind by its own length.
  const std::string faces = "AttributeBegin " + kUnseen +
                            "Surface \"faces\" Interior \"fog\" \"distance\" [2]\n" + square(-2) +
                            "ReverseOrientation " + square(-1) + "AttributeEnd\n";
  const std::string lamp =
      "AttributeBegin " + kUnseen + "Surface \"constant\" " + square(-5) + "AttributeEnd\n";
  const Channels c = picture(faces + lamp + kFloor, {{"probe", shows("trace(P, up)")},
                                                     {"faces", "surface faces() { Ci = 0; Oi = 0.5; }\n"}});
  // Fog turns the far face's opacity of 1/2 into mix(1/2, 1, d).
  const double d = 1 - std::exp(-0.5);
  EXPECT_NEAR(mean(c), 0.5 * (1 - (0.5 + 0.5 * d)), 2e-3);
}

TEST(RayVolumes, IncidentAndOpposite) {
  const std::string both =
      "surface probe() {\n"
      "  float a = 0, b = 0, c = 0; float found = incident(\"distance\", a) + opposite(\"distance\", b);\n"
      "  found += atmosphere(\"distance\", c);\n"
      "  Ci = color(a, b, found); Oi = 1;\n"
      "}\n";
  const std::string volumes =
      "Surface \"probe\" Interior \"fog\" \"distance\" [3] Exterior \"fog\" \"distance\" [7]\n";
  const Channels front = picture(volumes + "Sphere 2 -2 2 360\n", {{"probe", both}});
  EXPECT_NEAR(mean(front, 0), 7, 1e-5);
  EXPECT_NEAR(mean(front, 1), 3, 1e-5);
  EXPECT_NEAR(mean(front, 2), 2, 1e-5);
  const Channels back = picture(volumes + "ReverseOrientation Sphere 2 -2 2 360\n", {{"probe", both}});
  EXPECT_NEAR(mean(back, 0), 3, 1e-5);
  EXPECT_NEAR(mean(back, 1), 7, 1e-5);
}

// --- transmission, occlusion, indirect light ---

TEST(RayFunctions, TransmissionThroughLayers) {
  for (int n : {0, 1, 3, 6}) {
    std::string layers = "AttributeBegin Opacity [0.3 0.6 0] " + kUnseen;
    for (int i = 0; i < n; ++i) layers += square(-1 - 0.25 * i);
    const Channels c =
        picture(layers + "AttributeEnd\n" + kFloor, {{"probe", shows("transmission(P, P + 9 * up)")}});
    EXPECT_NEAR(mean(c, 0), std::pow(0.7, n), 1e-5);
    // Less than 1/1024 is darkness.
    EXPECT_NEAR(mean(c, 1), std::pow(0.4, n), 1e-3);
    EXPECT_NEAR(mean(c, 2), 1, 1e-5);
  }
}

TEST(RayFunctions, OthresholdEndsRays) {
  // Three sheets, each half opaque and of a colour of its own.
  std::string sheets;
  for (int k = 1; k <= 3; ++k)
    sheets += fmt::format("AttributeBegin {} Surface \"sheet\" \"float k\" [{}] {} AttributeEnd\n", kUnseen,
                          k, square(-k));
  const std::string sheet =
      "surface sheet(float k = 0) { Oi = 0.5; Ci = 0.5 * color(k == 1, k == 2, k == 3); }\n";
  const auto seen = [&](const std::string& terms) {
    const Channels c =
        picture(sheets + kFloor, {{"probe", shows("trace(P, up" + terms + ")")}, {"sheet", sheet}});
    return Vec3(float(mean(c, 0)), float(mean(c, 1)), float(mean(c, 2)));
  };
  const Vec3 all = seen(""), one = seen(", \"othreshold\", color(0)"),
             two = seen(", \"othreshold\", color(0.7)");
  EXPECT_NEAR(all.x, 0.5, 1e-5);
  EXPECT_NEAR(all.y, 0.25, 1e-5);
  EXPECT_NEAR(all.z, 0.125, 1e-5);
  EXPECT_NEAR(one.x, 0.5, 1e-5);
  EXPECT_EQ(one.y, 0);
  EXPECT_NEAR(two.y, 0.25, 1e-5);
  EXPECT_EQ(two.z, 0);
}

TEST(RayFunctions, TransmissionHitModes) {
  const std::string layer = "AttributeBegin Surface \"layer\" Opacity [0.25 0.25 0.25] " + kUnseen +
                            square(-1) + "AttributeEnd\n" + kFloor;
  const Shaders base = {{"layer", "surface layer() { Ci = 0; Oi = 0.6; }\n"}};
  const auto through = [&](const std::string& world, const std::string& mode) {
    Shaders s = base;
    s["probe"] = shows("transmission(P, P + 9 * up, \"hitmode\", \"" + mode + "\")");
    return mean(picture(world, s));
  };
  EXPECT_NEAR(through(layer, "default"), 0.75, 1e-5);
  EXPECT_NEAR(through(layer, "primitive"), 0.75, 1e-5);
  EXPECT_NEAR(through(layer, "shader"), 0.4, 1e-5);
  EXPECT_NEAR(through("Attribute \"shade\" \"transmissionhitmode\" \"shader\"\n" + layer, "default"), 0.4,
              1e-5);
  EXPECT_NEAR(through("Attribute \"shade\" \"transmissionhitmode\" \"shader\"\n" + layer, "primitive"), 0.75,
              1e-5);
}

TEST(RayFunctions, OcclusionUnderADisk) {
  // Cosine-weighted: the form factor of a coaxial disk, R^2 / (R^2 + h^2); at the very middle of the picture.
  const std::string disk = "AttributeBegin " + kUnseen + "Disk -1 1 360 AttributeEnd\n";
  const std::string probe = shows("occlusion(point \"world\" (0, 0, 0), normal \"world\" (0, 0, -1), 256)");
  EXPECT_NEAR(mean(picture(disk + kFloor, {{"probe", probe}})), 0.5, 0.01);
  const std::string falls = shows(
      "occlusion(point \"world\" (0, 0, 0), normal \"world\" (0, 0, -1), 256, \"coneangle\", 0.02, "
      "\"falloff\", 0.7)");
  EXPECT_NEAR(mean(picture(disk + kFloor, {{"probe", falls}})), std::exp(-0.7), 1e-3);
  const std::string far =
      shows("occlusion(point \"world\" (0, 0, 0), normal \"world\" (0, 0, -1), 64, \"maxdist\", 0.9)");
  EXPECT_EQ(mean(picture(disk + kFloor, {{"probe", far}})), 0);
}

TEST(RayFunctions, OcclusionInACorner) {
  // The foot of an endless wall hides half of the sky.
  const std::string wall =
      "AttributeBegin " + kUnseen +
      "Polygon \"P\" [0.001 -60 0.5 0.001 60 0.5 0.001 60 -60 0.001 -60 -60] AttributeEnd\n";
  const std::string probe = shows("occlusion(point \"world\" (0, 0, 0), normal \"world\" (0, 0, -1), 1024)");
  EXPECT_NEAR(mean(picture(wall + kFloor, {{"probe", probe}})), 0.5, 0.01);
}

TEST(RayFunctions, IndirectDiffuseInAFurnace) {
  // Inside a sphere of radiance 1/2 and albedo 1/2, with b bounces: 1/2 (1 + 1/2 + ... + 1/2^b).
  const std::string wall =
      "surface probe() { normal n = normalize(faceforward(N, I));\n"
      "  Ci = 0.5 + 0.5 * indirectdiffuse(P, n, 4); Oi = 1; }\n";
  // Fine enough that what the facets of a small picture lose does not count.
  const std::string ball = "ShadingRate 0.5 Surface \"probe\" Sphere 3 -3 3 360\n";
  const std::string inside = "Clipping 50.5 1000\n";
  EXPECT_NEAR(mean(picture(ball, {{"probe", wall}}, inside)), 0.75, 1e-3);
  EXPECT_NEAR(
      mean(picture("Attribute \"trace\" \"int maxdiffusedepth\" [2]\n" + ball, {{"probe", wall}}, inside)),
      0.875, 1e-3);
  EXPECT_NEAR(
      mean(picture("Attribute \"trace\" \"int maxdiffusedepth\" [0]\n" + ball, {{"probe", wall}}, inside)),
      0.5, 1e-4);
}

TEST(RayFunctions, StandardShadersThatUseThem) {
  const std::string sky =
      "AttributeBegin Surface \"occluded\" \"samples\" [64]\n" + square(0) + "AttributeEnd\n";
  EXPECT_NEAR(mean(picture(sky, {})), 1, 1e-5);
  // Smoke without lights only dims: exp(-density length).
  EXPECT_NEAR(mean(picture("Surface \"constant\" Atmosphere \"smoke\" \"density\" [0.02]\n" + square(0), {})),
              std::exp(-1.0), 1e-4);
}

// --- what limits rays ---

TEST(RayFunctions, SubsetsSidesAndDistances) {
  const std::string things =
      "AttributeBegin " + kUnseen + "Surface \"constant\"\n" +
      "AttributeBegin Attribute \"grouping\" \"string membership\" [\"a,b\"] Color [1 0 0] " + square(-1) +
      "AttributeEnd\n" + "Attribute \"grouping\" \"string membership\" [\"b\"]\n" +
      "AttributeBegin Attribute \"grouping\" \"string membership\" [\"+c\"] Color [0 1 0] " + square(-2) +
      "AttributeEnd\n" +
      "AttributeBegin Attribute \"grouping\" \"string membership\" [\"-b\"] Color [0 0 1] " + square(-3) +
      "AttributeEnd\n" + "AttributeEnd\n" + kFloor;
  const auto seen = [&](const std::string& terms) {
    const Channels c = picture(things, {{"probe", shows("color trace(P, up" + terms + ")")}});
    return Vec3(float(mean(c, 0)), float(mean(c, 1)), float(mean(c, 2)));
  };
  EXPECT_EQ(seen(""), Vec3(1, 0, 0));
  EXPECT_EQ(seen(", \"subset\", \"c\""), Vec3(0, 1, 0));
  EXPECT_EQ(seen(", \"subset\", \"b\""), Vec3(1, 0, 0));
  EXPECT_EQ(seen(", \"subset\", \"b\", \"excludesubset\", \"a\""), Vec3(0, 1, 0));
  EXPECT_EQ(seen(", \"excludesubset\", \"a,b\""), Vec3(0, 0, 1));
  EXPECT_EQ(seen(", \"excludesubset\", \"b,c\""), Vec3(0, 0, 1));
  EXPECT_EQ(seen(", \"maxdist\", 0.5"), Vec3(0));
  EXPECT_EQ(seen(", \"bias\", 1.5"), Vec3(0, 1, 0));
  EXPECT_EQ(seen(", \"bias\", 1.5, \"maxdist\", 1.9"), Vec3(0));
  // Polygons of this winding show one side to the floor and the other to the camera.
  const Vec3 front = seen(", \"hitsides\", \"front\""), back = seen(", \"hitsides\", \"back\"");
  EXPECT_EQ(front + back, Vec3(1, 0, 0));
}

TEST(RayFunctions, VisibilityOfEachRayClass) {
  const auto seen = [&](const std::string& attribute, const std::string& what) {
    return mean(picture("AttributeBegin " + kUnseen + attribute + "Surface \"constant\" " + square(-1) +
                            "AttributeEnd\n" + kFloor,
                        {{"probe", shows(what)}}));
  };
  const std::string specular = "trace(P, up)", diffuse = "occlusion(P, normal up, 64, \"coneangle\", 1.2)",
                    shadow = "1 - transmission(P, P + 5 * up)";
  const std::string noSpecular = "Attribute \"visibility\" \"int specular\" [0]\n",
                    noDiffuse = "Attribute \"visibility\" \"int diffuse\" [0]\n",
                    noTransmission = "Attribute \"visibility\" \"int transmission\" [0]\n",
                    onlyCamera = "Attribute \"render\" \"int visibility\" [1]\n";
  for (const auto& [attribute, s, d, t] :
       {std::tuple(std::string(), 1, 1, 1), std::tuple(noSpecular, 0, 1, 1), std::tuple(noDiffuse, 1, 0, 1),
        std::tuple(noTransmission, 1, 1, 0), std::tuple(onlyCamera, 0, 0, 0)}) {
    EXPECT_NEAR(seen(attribute, specular), s, 1e-5) << attribute;
    EXPECT_NEAR(seen(attribute, diffuse), d, 1e-3) << attribute;
    EXPECT_NEAR(seen(attribute, shadow), t, 1e-5) << attribute;
  }
}

TEST(RayFunctions, HitModes) {
  const auto seen = [&](const std::string& attribute, const std::string& what) {
    return mean(picture("AttributeBegin " + kUnseen + attribute +
                            "Color [0.25 0.25 0.25] Surface \"other\" " + square(-1) + "AttributeEnd\n" +
                            kFloor,
                        {{"probe", shows(what)}, {"other", "surface other() { Ci = 0.75; Oi = 1; }\n"}}));
  };
  const std::string specular = "trace(P, up)",
                    diffuse = "indirectdiffuse(P, normal up, 16, \"coneangle\", 1.2)";
  EXPECT_NEAR(seen("", specular), 0.75, 1e-5);
  EXPECT_NEAR(seen("Attribute \"shade\" \"specularhitmode\" \"primitive\"\n", specular), 0.25, 1e-5);
  EXPECT_NEAR(seen("Attribute \"shade\" \"specularhitmode\" \"primitive\"\n", diffuse), 0.75, 1e-3);
  EXPECT_NEAR(seen("Attribute \"shade\" \"diffusehitmode\" \"primitive\"\n", diffuse), 0.25, 1e-3);
  EXPECT_NEAR(seen("", "trace(P, up, \"hitmode\", \"primitive\")"), 0.25, 1e-5);
}

// --- what hits learn, and what they tell ---

TEST(RayFunctions, HitsKnowTheirRays) {
  const std::string other =
      "surface other() {\n"
      "  string type = \"\"; float depth = -1, dd = -1, sd = -1, far = 0; color told = 0;\n"
      "  rayinfo(\"type\", type); rayinfo(\"depth\", depth); rayinfo(\"diffusedepth\", dd);\n"
      "  rayinfo(\"speculardepth\", sd); rayinfo(\"length\", far);\n"
      "  if (type == \"specular\" && raylabel() == \"here\" && isindirectray() == 0) told[0] = depth + 10 * "
      "sd + 100 * dd;\n"
      "  if (type == \"diffuse\" && raylabel() == \"\" && isindirectray() == 1) told[1] = depth + 10 * sd + "
      "100 * dd;\n"
      "  told[2] = far; Ci = told; Oi = 1;\n"
      "}\n";
  const std::string world =
      "AttributeBegin " + kUnseen + "Surface \"other\" " + square(-2) + "AttributeEnd\n" + kFloor;
  const Channels s =
      picture(world, {{"probe", shows("trace(P, up, \"label\", \"here\")")}, {"other", other}});
  EXPECT_NEAR(mean(s, 0), 11, 1e-5);
  EXPECT_NEAR(mean(s, 1), 0, 1e-5);
  EXPECT_NEAR(mean(s, 2), 2, 1e-4);
  const Channels d = picture(
      world, {{"probe", shows("indirectdiffuse(P, normal up, 1, \"coneangle\", 0.01)")}, {"other", other}});
  EXPECT_NEAR(mean(d, 0), 0, 1e-5);
  EXPECT_NEAR(mean(d, 1), 101, 1e-3);
}

TEST(RayFunctions, GatherTellsOfItsHits) {
  const std::string other =
      "surface other(output varying color told = 0; float plain = 0.125) { told = color(u, 0.5, raylevel()); "
      "Ci = 0.25; Oi = 0.5; }\n";
  const auto gathered = [&](const std::string& declared, const std::string& pairs,
                            const std::string& result) {
    const std::string probe =
        "surface probe() { vector up = vector \"world\" (0, 0, -1); color sum = 0;\n  " + declared +
        "\n  gather(\"illuminance\", P, up, 0, 1, " + pairs + ") { sum += " + result +
        "; } else { sum += 100; }\n  Ci = sum; Oi = 1; }\n";
    return picture("AttributeBegin " + kUnseen +
                       "Surface \"other\" Attribute \"user\" \"float weight\" [0.375]\n"
                       "Polygon \"P\" [-2 -2 -1 2 -2 -1 2 2 -1 -2 2 -1] \"varying float mine\" [3 3 3 3]\n"
                       "AttributeEnd\n" +
                       kFloor,
                   {{"probe", probe}, {"other", other}});
  };
  const Channels told = gathered("color x = 0;", "\"surface:told\", x", "x");
  EXPECT_NEAR(mean(told, 1), 0.5, 1e-5);
  EXPECT_NEAR(mean(told, 2), 1, 1e-5);
  EXPECT_NEAR(mean(gathered("float x = 0;", "\"surface:plain\", x", "color x")), 0.125, 1e-5);
  EXPECT_NEAR(mean(gathered("color x = 0;", "\"surface:Oi\", x", "x")), 0.5, 1e-5);
  EXPECT_NEAR(mean(gathered("color x = 0;", "\"surface:Ci\", x", "x")), 0.25, 1e-5);
  EXPECT_NEAR(mean(gathered("float x = 0;", "\"attribute:user:weight\", x", "color x")), 0.375, 1e-5);
  EXPECT_NEAR(mean(gathered("float x = 0;", "\"primitive:mine\", x", "color x")), 3, 1e-5);
  EXPECT_NEAR(mean(gathered("point x = 0;", "\"primitive:P\", x", "color zcomp(transform(\"world\", x))")),
              -1, 1e-4);
  EXPECT_NEAR(
      mean(gathered("float x = 0, y = 0;", "\"ray:length\", x, \"effectivesamples\", y", "color (x * y)")), 1,
      1e-4);
  // s of the polygon runs as x does: symmetric over the picture.
  EXPECT_NEAR(std::fabs(mean(gathered("float x = 0;", "\"primitive:s\", x", "color x"))), 0.0, 0.05);
}

TEST(RayFunctions, TraceTellsWhatComesThrough) {
  const std::string world = "AttributeBegin " + kUnseen + "Surface \"constant\" Opacity [0.25 0.25 0.25] " +
                            square(-1) + square(-2) + "AttributeEnd\n" + kFloor;
  const std::string probe =
      "surface probe() { color through = 0; color c = trace(P, vector \"world\" (0, 0, -1), "
      "\"transmission\", through);\n"
      "  Ci = through; Oi = 1; }\n";
  EXPECT_NEAR(mean(picture(world, {{"probe", probe}})), 0.5625, 1e-5);
  EXPECT_NEAR(mean(picture(kFloor, {{"probe", probe}})), 1, 1e-5);
}

TEST(RayFunctions, RaysByTheNameOfAMap) {
  const std::string lamp = "AttributeBegin " + kUnseen + "Surface \"constant\" Color [0.25 0.5 0.75] " +
                           square(-3) + "AttributeEnd\n" + kFloor;
  const Channels c = picture(lamp, {{"probe", shows("environment(\"raytrace\", up)")}});
  EXPECT_NEAR(mean(c, 0), 0.25, 1e-5);
  EXPECT_NEAR(mean(c, 2), 0.75, 1e-5);
  EXPECT_NEAR(mean(picture(lamp, {{"probe", shows("color float environment(\"raytrace\"[1], up)")}})), 0.5,
              1e-5);
  // A light that asks shadow() about itself.
  const std::string lit =
      "LightSource \"spy\" 1 \"from\" [0 0 -8]\n"
      "AttributeBegin " +
      kUnseen + "Opacity [0.25 0.25 0.25] " + square(-3) + "AttributeEnd\n" + kFloor;
  const std::string spy =
      "light spy(point from = point \"shader\" (0,0,0);) { illuminate(from) { Cl = 1 - shadow(\"raytrace\", "
      "Ps); } }\n";
  const std::string sum = "surface probe() { color c = 0; illuminance(P) { c += Cl; } Ci = c; Oi = 1; }\n";
  EXPECT_NEAR(mean(picture("TransformBegin Translate 0 0 -8 LightSource \"spy\" 1 TransformEnd\n" +
                               lit.substr(lit.find("AttributeBegin")),
                           {{"probe", sum}, {"spy", spy}})),
              0.75, 1e-5);
}

TEST(RayFunctions, GlassInGlassEnds) {
  // Two rays at every hit: never more than 2 + 4 + ... + 2^max of them a sample.
  const std::string glass =
      "surface probe() { Ci = 0.4 * trace(P, reflect(normalize(I), normalize(N))) + 0.5 * trace(P, "
      "normalize(I)) + 0.1;\n"
      "  Oi = 1; }\n";
  const std::string world = "Surface \"probe\" Sphere 3 -3 3 360 Sphere 2.5 -2.5 2.5 360 Sphere 2 -2 2 360\n";
  const Channels c = picture(world, {{"probe", glass}}, "Option \"render\" \"int max_raylevel\" [5]\n");
  EXPECT_GT(mean(c), 0.1);
  EXPECT_LT(mean(c), 1.0);
}

// --- area lights ---

const std::string kLit = "surface probe() { Ci = diffuse(normal \"world\" (0, 0, -1)); Oi = 1; }\n";
std::string areaLight(int samples, const std::string& shape, const std::string& more = "") {
  return fmt::format(
             "AttributeBegin {} Attribute \"light\" \"int nsamples\" [{}] {}\nAreaLightSource \"arealight\" "
             "7 \"intensity\" [1]\n",
             kUnseen, samples, more) +
         shape + "AttributeEnd\nIlluminate 7 1\n";
}
/// A disk of radius 1 in z = -2 that shines down on the floor.
const std::string kDisk = "Surface \"constant\" Translate 0 0 -2 Disk 0 1 360\n";
const std::string kMiddle =
    "surface probe() { P = point \"world\" (0, 0, 0); color c = 0; vector up = vector \"world\" (0, 0, -1);\n"
    "  illuminance(P, up, PI/2) { c += Cl * (normalize(L) . up); } Ci = c; Oi = 1; }\n";

TEST(AreaLights, DiskOverItsMiddle) {
  // intensity / (R^2 + h^2): see arealight.sl; 64 pixels with their own samples each.
  EXPECT_NEAR(mean(picture(areaLight(64, kDisk) + kFloor, {{"probe", kMiddle}})), 1.0 / 5, 1e-3);
}

TEST(AreaLights, ErrorsFallAsLowDiscrepancyDoes) {
  double error[2];
  int k = 0;
  for (int n : {4, 64}) {
    const Channels c = picture(areaLight(n, kDisk) + kFloor, {{"probe", kMiddle}});
    // About their own mean: the disk is lit as diced, a polygon.
    double sum = 0;
    for (float v : c.values[0]) sum += (double(v) - mean(c)) * (double(v) - mean(c));
    error[k++] = std::sqrt(sum / double(c.values[0].size()));
  }
  EXPECT_LT(error[1], error[0] / 6);  // independent samples would fall by 4
  EXPECT_GT(error[0], 0);
}

TEST(AreaLights, ShadowsOfAreaLightsAreSoftAndRight) {
  const auto lit = [&](double half) {
    // A square shutter half way: covers a disk of twice its width.
    return mean(picture(areaLight(64, kDisk, "Attribute \"light\" \"shadows\" \"on\"") + "AttributeBegin " +
                            kUnseen + square(-1, half) + "AttributeEnd\n" + kFloor,
                        {{"probe", kMiddle}}));
  };
  EXPECT_NEAR(lit(0.001), 0.2, 2e-3);
  EXPECT_EQ(lit(0.6), 0);
  // Half the disk behind a shutter that ends in the middle.
  const double half =
      mean(picture(areaLight(64, kDisk, "Attribute \"light\" \"shadows\" \"on\"") + "AttributeBegin " +
                       kUnseen + "Polygon \"P\" [0 -9 -1 0 9 -1 9 9 -1 9 -9 -1] AttributeEnd\n" + kFloor,
                   {{"probe", kMiddle}}));
  EXPECT_NEAR(half, 0.1, 2e-3);
}

TEST(AreaLights, SphereIsItsSolidAngle) {
  // Irradiance of a sphere of radius R at distance d, straight above: pi L R^2 / d^2, and intensity = L 4 pi
  // R^2.
  const std::string ball = "Surface \"constant\" Translate 0 0 -3 Sphere 1 -1 1 360\n";
  EXPECT_NEAR(mean(picture(areaLight(16, ball) + kFloor, {{"probe", kMiddle}})), 1.0 / (4 * 9), 2e-4);
  EXPECT_NEAR(mean(picture(areaLight(16, ball, "Attribute \"light\" \"shadows\" \"on\"") + kFloor,
                           {{"probe", kMiddle}})),
              1.0 / (4 * 9), 4e-4);
}

TEST(AreaLights, AreaShadowAsksAboutTheLightsSurface) {
  const std::string spy = "light spy() { illuminate(P, N, PI/2) { Cl = areashadow(Ps, 64); } }\n";
  const std::string sum =
      "surface probe() { P = point \"world\" (0, 0, 0); color c = 0; illuminance(P) { c += Cl; } Ci = c; Oi "
      "= 1; }\n";
  const auto seen = [&](const std::string& shutter) {
    return mean(picture("AttributeBegin " + kUnseen + "AreaLightSource \"spy\" 7\n" + kDisk +
                            "AttributeEnd Illuminate 7 1\n" + "AttributeBegin " + kUnseen + shutter +
                            "AttributeEnd\n" + kFloor,
                        {{"probe", sum}, {"spy", spy}}));
  };
  // Times the cosine at the one sample of the light itself: compared with the unshadowed light.
  const double open = seen("");
  EXPECT_GT(open, 0.85);
  EXPECT_NEAR(seen("Polygon \"P\" [0 -9 -1 0 9 -1 9 9 -1 9 -9 -1]\n") / open, 0.5, 0.02);
}

}  // namespace
}  // namespace fr::test
