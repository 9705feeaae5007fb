// Two independent hiders over one cache: what REYES draws and what camera rays see must be the same.
//
// Both place their samples alike, and these scenes have one sample a pixel and a box filter, so a pixel is a
// sample and the comparison is sample by sample. REYES snaps vertices to 1/1024 pixel: an edge moves by at
// most half a step's diagonal, 1/1448 pixel. Only samples within that of an outline may differ: on average
// 2 * sqrt(2) / 1448 = 0.002 of the pixels along outlines. Their number is Poisson distributed.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

struct Scene {
  const char* name;
  std::string options, world;
  std::map<std::string, std::string> shaders = {};
  double colorRms = 0.004;
};

std::ostream& operator<<(std::ostream& out, const Scene& s) { return out << s.name; }

const std::string kPerspective = "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n";
const std::string kLit =
    "LightSource \"distantlight\" 1 \"from\" [1 1 -2] \"to\" [0 0 0]\nSurface \"matte\"\n";

std::string rib(const Scene& s, const std::string& more = "") {
  return "Format 240 240 1\nPixelSamples 1 1\nPixelFilter \"box\" 1 1\nShadingRate 0.5\n" + more + s.options +
         "WorldBegin\n" + kLit + s.world + "WorldEnd\n";
}

/// A wavy height field of n x n quads, dense enough to become meshlets.
std::string denseMesh(int n) {
  std::string faces, vertices, points;
  for (int i = 0; i < n * n; ++i) {
    const int x = i % n, y = i / n, a = y * (n + 1) + x;
    faces += "4 ";
    vertices += fmt::format("{} {} {} {} ", a, a + 1, a + n + 2, a + n + 1);
  }
  for (int y = 0; y <= n; ++y)
    for (int x = 0; x <= n; ++x)
      points += fmt::format("{} {} {} ", 2.4 * x / n - 1.2, 2.4 * y / n - 1.2,
                            0.1 * std::sin(17.0 * x / n) * std::cos(13.0 * y / n));
  return "PointsPolygons [" + faces + "] [" + vertices + "] \"P\" [" + points + "]\n";
}

const std::string kCube =
    "SubdivisionMesh \"catmull-clark\" [4 4 4 4 4 4] [0 1 3 2 4 6 7 5 0 4 5 1 2 3 7 6 0 2 6 4 1 5 7 3] [] [] "
    "[] [] \"P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1]\n";
const std::string kWave =
    "Patch \"bicubic\" \"P\" [-1.5 -1.5 0 -0.5 -1.5 1 0.5 -1.5 -1 1.5 -1.5 0  -1.5 -0.5 1 -0.5 -0.5 2 0.5 "
    "-0.5 -2 1.5 -0.5 0  -1.5 0.5 0 -0.5 0.5 -1 0.5 0.5 1 1.5 0.5 0  -1.5 1.5 0 -0.5 1.5 0 0.5 1.5 0 1.5 1.5 "
    "1]\n";
/// A cubic sheet of six spans, 2.4 wide.
const std::string kNurbs = [] {
  std::string p;
  for (int j = 0; j < 5; ++j)
    for (int i = 0; i < 6; ++i)
      p += fmt::format("{} {} {:.5f} ", -1.2 + 0.48 * i, -1.2 + 0.6 * j, 0.4 * std::sin(2.0 * i + j));
  return "NuPatch 6 4 [0 0 0 0 1 3 4 4 4 4] 0 4 5 4 [0 0 0 0 1 2 2 2 2] 0 2 \"P\" [" + p + "]\n";
}();
/// A diamond and a round loop within it.
const std::string kTrim =
    "TrimCurve [1 1] [2 4] [0 0 1 2 3 4 4  0 1 2 3 4 5 6 7 8 9 10] [0 3] [4 7] [5 7] "
    "[0.3 2 3.7 2 0.3  1.5 2.5 2.5 1.5 1.5 2.5 2.5] [1 0.1 1 1.9 1  0.7 0.7 1.4 1.4 0.7 0.7 1.4] [1 1 1 1 1 "
    "1 1 1 "
    "1 1 1 1]\n";

double pseudoRandom(int i, int k) {
  const double x = std::sin(i * 12.9898 + k * 78.233) * 43758.5453;
  return x - std::floor(x);
}
std::string manyPoints(int n) {
  std::string p, w;
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 3; ++k) p += fmt::format("{:.5f} ", 3 * pseudoRandom(i, k) - 1.5);
    w += fmt::format("{:.5f} ", 0.005 + 0.1 * std::pow(pseudoRandom(i, 3), 4));
  }
  return "Points \"P\" [" + p + "] \"width\" [" + w + "]\n";
}
std::string manyCurves(int n) {
  std::string counts, p;
  for (int i = 0; i < n; ++i) {
    counts += "4 ";
    const double x = 3 * pseudoRandom(i, 5) - 1.5, z = pseudoRandom(i, 6);
    for (int k = 0; k < 4; ++k)
      p += fmt::format("{:.5f} {:.5f} {:.5f} ", x + 0.4 * (pseudoRandom(i, 7 + k) - 0.5), -1.3 + 0.7 * k, z);
  }
  return "Curves \"cubic\" [" + counts + "] \"nonperiodic\" \"P\" [" + p + "] \"constantwidth\" [0.02]\n";
}
const std::map<std::string, std::string> kBumps = {
    {"bumps",
     "displacement bumps() { normal n = normalize(N); P += 0.1 * sin(20 * u) * sin(20 * v) * n;"
     " N = calculatenormal(P); }\n"}};
const std::string kDisplace =
    "Attribute \"displacementbound\" \"float sphere\" [0.2]\nDisplacement \"bumps\"\n";

std::string solid(const std::string& operation, const std::string& parts) {
  return "SolidBegin \"" + operation + "\"\n" + parts + "SolidEnd\n";
}
std::string closed(const std::string& surfaces) { return solid("primitive", surfaces); }
const std::string kRod = closed("Cylinder 0.4 -2 2 360 Disk 2 0.4 360 Disk -2 0.4 360\n");
/// A ball with a bore and a torus cut into it.
const std::string kBored =
    "Rotate 25 1 1 0\n" + solid("difference", closed("Sphere 1 -1 1 360\n") + kRod +
                                                  closed("Translate 0.3 0 0 Torus 0.9 0.25 0 360 360\n"));

/// An object four times: once by itself, three times as prototypes show it, one of them mirrored.
std::string fourTimes(const std::string& object) {
  const auto instance = [](const char* place) {
    return std::string("TransformBegin ") + place + " ObjectInstance \"it\" TransformEnd\n";
  };
  return "ObjectBegin \"it\"\n" + object + "ObjectEnd\n" +
         instance("Translate -0.8 0.8 0.3 Scale .55 .55 .55") +
         instance("Translate 0.8 0.8 0 Rotate 30 1 1 0 Scale .5 .55 .6") +
         instance("Translate -0.8 -0.8 -0.2 Rotate 70 0 1 1 Scale -.55 .55 .55") +
         instance("Translate 0.8 -0.8 0.5 Scale .6 .6 .6");
}

const std::vector<Scene> kScenes = {
    {"Quadrics", kPerspective,
     "AttributeBegin Translate -0.8 0.8 0 Sphere 0.6 -0.6 0.6 360 AttributeEnd\n"
     "AttributeBegin Translate 0.8 0.8 0 Rotate 50 1 1 0 Torus 0.5 0.2 0 360 360 AttributeEnd\n"
     "AttributeBegin Translate -0.8 -0.8 0 Rotate 70 1 0.3 0 Cylinder 0.4 -0.5 0.5 300 AttributeEnd\n"
     "AttributeBegin Translate 0.8 -0.8 0 Rotate -70 1 0.3 0 Cone 1 0.5 360 AttributeEnd\n"
     "AttributeBegin Translate 0 0 0.4 Rotate 30 1 1 0 Disk 0 0.5 360 AttributeEnd\n"
     "AttributeBegin Rotate 80 1 0 0 Hyperboloid 0.2 0 -0.4 0 0.3 0.5 360 AttributeEnd\n"},
    {"Polygons", kPerspective,
     "Rotate 30 1 1 1\nPolygon \"P\" [-1 -1 0 1 -1 0 1 1 0 -1 1 0]\n"
     "Translate 0 0 0.3 Polygon \"P\" [-1.2 -1 0 1 -1 0.5 0 1 0]\n"
     "GeneralPolygon [4 3] \"P\" [-1 -1 -0.5 1 -1 -0.5 1 1 -0.5 -1 1 -0.5  0 -0.5 -0.5 0.5 0.5 -0.5 -0.5 0.5 "
     "-0.5]\n"},
    // Faceted: a meshlet's vertex has one normal in REYES, that of one of its faces, and a hit its face's.
    {"DensePolygons", kPerspective, "Rotate 50 1 0.4 0\n" + denseMesh(150), {}, 0.012},
    {"Patches", kPerspective, "Rotate 40 1 0.2 0\n" + kWave},
    {"Subdivision", kPerspective, "Rotate 30 1 1 0\n" + kCube},
    {"Displaced", kPerspective, kDisplace + "Sphere 1 -1 1 360\n", kBumps, 0.008},
    {"Deformed",
     kPerspective,
     "Attribute \"displacementbound\" \"sphere\" [2]\nDeformation \"twist\" \"float by\" [0.9]\n"
     "Rotate 20 1 0 0 Scale 0.6 1.2 0.6\n" +
         kCube,
     {{"twist",
       "transformation twist(float by = 0) { point p = transform(\"object\", P);"
       " P = transform(\"object\", \"current\", rotate(p, by * ycomp(p), point(0, 0, 0), point(0, 1, 0))); "
       "}"}},
     0.02},
    {"DisplacedPatches", kPerspective, kDisplace + "Rotate 40 1 0.2 0\n" + kWave, kBumps, 0.008},
    {"LongFloor", kPerspective,
     "AttributeBegin Rotate -60 1 0 0 Patch \"bilinear\" \"P\" [-50 -50 1 50 -50 1 -50 50 1 50 50 1] "
     "AttributeEnd Sphere 0.7 -0.7 0.7 360\n"},
    {"Transparent", kPerspective,
     "Opacity [0.5 0.3 0.7] Sphere 1 -1 1 360\nOpacity [0.2 0.2 0.2] Rotate 30 1 1 0 Torus 1 0.3 0 360 "
     "360\n" +
         kCube},
    {"NearAndFarPlanes", "Clipping 4.3 5.2\n" + kPerspective, "Rotate 20 1 1 0 Sphere 1 -1 1 360\n" + kCube},
    {"ClippingPlanes",
     "ClippingPlane 0 0 4.7 0.3 0.2 -1\n" + kPerspective + "ClippingPlane 0.5 0 0 1 0 0.4\n",
     "Rotate 20 1 1 0 Sphere 1 -1 1 360\nOpacity [0.6 0.6 0.6]\n" + kCube},
    {"ClippingPlanesOrthographic",
     "Projection \"orthographic\" ScreenWindow -1.5 1.2 -1.4 1.6 Translate 0 0 5 ClippingPlane 0 0.4 0 0 1 "
     "-0.5 ClippingPlane -1 0 0 -1 0 0\n",
     "Rotate 20 1 1 0 Sphere 1 -1 1 360\n"},
    {"ClippingPlaneThroughASolid", "ClippingPlane 0 0 4.8 0.4 0.2 -1\n" + kPerspective, kBored},
    // Samples see one of the two or the other; where both are, never nothing.
    {"InTransition", kPerspective,
     "Detail [-0.5 0.5 -0.5 0.5 0 0] DetailRange [0 0 100 4000] Sphere 1 -1 1 360\n"
     "DetailRange [100 4000 1e38 1e38] Rotate 30 1 1 0\n" +
         kCube},
    {"TransparentInTransition", kPerspective,
     "Opacity [0.5 0.5 0.5] Detail [-0.5 0.5 -0.5 0.5 0 0] DetailRange [0 0 100 4000] Sphere 1 -1 1 360\n"
     "DetailRange [100 4000 1e38 1e38] Rotate 30 1 1 0\n" +
         kCube},
    {"Nurbs", kPerspective, "Rotate 30 1 0.5 0\n" + kNurbs},
    {"TrimmedNurbs", kPerspective, "Rotate 20 1 0.5 0\n" + kTrim + kNurbs, {}, 0.01},
    {"TrimmedTransparentNurbs",
     kPerspective,
     "Opacity [0.5 0.5 0.5] Rotate 20 1 0.5 0\nAttribute \"trimcurve\" \"sense\" \"outside\"\n" + kTrim +
         kNurbs + "Translate 0 0 0.4\n" + kNurbs,
     {},
     0.01},
    {"Blobby",
     kPerspective,
     "Blobby 3 [1001 0 1001 16 1002 32 0 2 0 1 4 2 3] [1 0 0 0 0 1 0 0 0 0 1 0 -0.5 0 0 1  1 0 0 0 0 1 0 0 0 "
     "0 1 0 0.5 "
     "0.2 0 1  -1 0 -0.5 1 0 -0.6 0.4 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1] [\"\"] \"varying color Cs\" [1 0 0 0 "
     "1 0 0 0 1]\n",
     {},
     0.012},
    {"Points", kPerspective, manyPoints(3000), {}, 0.01},
    {"Curves", kPerspective, manyCurves(400), {}, 0.01},
    {"OneSidedThin",
     kPerspective + "Scale -1 1 1\n",
     "Sides 1\n" + manyPoints(300) + manyCurves(100),
     {},
     0.01},
    {"OneSided", kPerspective,
     "Sides 1 Sphere 1 -1 0.3 300\nRotate 70 1 0 0 ReverseOrientation Sphere 1.2 -0.2 0.3 300\n"
     "Scale -1 1 1 Torus 1 0.2 0 360 200\n"},
    {"Mirrored", kPerspective + "Scale -1 1.3 0.8\n", "Sides 1 Rotate 30 1 1 0 Torus 0.9 0.4 0 360 300\n"},
    {"Orthographic", "Projection \"orthographic\"\nScreenWindow -1.5 1.2 -1.4 1.6\nTranslate 0 0 5\n",
     "Rotate 40 1 0.2 0\n" + kCube + "Atmosphere \"fog\" \"distance\" [6] " + kWave},
    {"OddFormat", "Format 300 200 1.3\nScreenWindow -1 0.7 -0.5 0.9\n" + kPerspective,
     "Rotate 50 1 1 0 Torus 0.9 0.4 0 360 360\n"},
    {"Matte", kPerspective,
     "AttributeBegin Matte 1 Translate 0.4 0 -1 Sphere 0.5 -0.5 0.5 360 AttributeEnd\n"
     "AttributeBegin Matte 1 Opacity [0.5 0.5 0.5] Translate -0.5 0 -1 Sphere 0.5 -0.5 0.5 360 AttributeEnd\n"
     "Sphere 1 -1 1 360\n"},
    {"Smooth", kPerspective, "ShadingInterpolation \"smooth\" Rotate 50 1 1 0 Torus 0.9 0.4 0 360 360\n"},
    {"Fog", kPerspective, "Atmosphere \"fog\" \"distance\" [4] \"background\" [0.2 0.3 0.6]\n" + kCube, {}},
    {"Midpoint", kPerspective + "Hider \"hidden\" \"string depthfilter\" [\"midpoint\"]\n",
     kCube + "Opacity [0.5 0.5 0.5] Translate 0 0.5 3 Torus 0.9 0.4 0 360 360\n"},
    {"CameraVisibility", kPerspective,
     "AttributeBegin Attribute \"render\" \"integer visibility\" [6] Sphere 1 -1 1 360 AttributeEnd\n"
     "Translate 0.4 0 0 Sphere 0.8 -0.8 0.8 360\n"},
    {"Shadows",
     kPerspective,
     "Attribute \"light\" \"string shadows\" [\"on\"] LightSource \"pointlight\" 2 \"intensity\" [9] "
     "\"from\" "
     "[-1.5 2 -2]\n"
     "AttributeBegin Translate 0 0 0.8 Polygon \"P\" [-2 -2 0 -2 2 0 2 2 0 2 -2 0] AttributeEnd\n"
     "Sphere 0.6 -0.6 0.6 360\n",
     {},
     0.02},
    // Shared grids have micropolygons up to twice as wide: their colours are off by twice as much.
    {"InstancesOfQuadrics",
     kPerspective,
     fourTimes("Sphere 0.8 -0.8 0.8 360\nRotate 60 1 0 0\nTorus 1 0.25 0 360 300\n"),
     {},
     0.008},
    {"InstancesOfPatches", kPerspective, fourTimes("Rotate 40 1 0.2 0\n" + kWave)},
    {"InstancesOfSubdivision", kPerspective, fourTimes("Rotate 30 1 1 0\n" + kCube)},
    {"InstancesOfMeshes", kPerspective, fourTimes("Rotate 50 1 0.4 0\n" + denseMesh(60)), {}, 0.02},
    {"InstancesOfNurbs",
     kPerspective,
     kTrim + "Opacity [0.5 0.6 0.4]\n" + fourTimes("Rotate 20 1 0.5 0\n" + kNurbs),
     {},
     0.02},
    {"InstancesOneSided",
     kPerspective,
     "Sides 1\n" + fourTimes("Rotate 40 1 0 0\nTorus 0.9 0.4 0 360 300\n"),
     {},
     0.008},
    {"InstancesInShadow",
     kPerspective,
     "Attribute \"light\" \"string shadows\" [\"on\"] LightSource \"pointlight\" 2 \"intensity\" [9] "
     "\"from\" "
     "[-1.5 2 -2]\nPolygon \"P\" [-2 -2 1 -2 2 1 2 2 1 2 -2 1]\n" +
         fourTimes("Rotate 60 1 0 0\nTorus 0.7 0.3 0 360 360\n"),
     {},
     0.03},
    {"Solids", kPerspective,
     kBored + "Translate 0.9 0.4 -0.4\n" +
         solid("intersection", closed(kCube) + closed("Sphere 1.1 -1.1 1.1 360\n") +
                                   solid("difference", closed("Sphere 1.5 -1.5 1.5 360\n") + kRod))},
    {"SolidsTransparent", kPerspective, "Opacity [0.5 0.3 0.7]\n" + kBored + "Torus 1 0.3 0 360 360\n"},
    {"SolidsOneSided", kPerspective, "Sides 1\n" + kBored},
    {"SolidsNearAndFarPlanes", "Clipping 4.3 5.4\n" + kPerspective, kBored},
    {"SolidsDisplaced", kPerspective,
     kDisplace + solid("difference", closed("Sphere 1 -1 1 360\n") +
                                         closed("Translate 0.2 0 -0.9 Sphere 0.6 -0.6 0.6 360\n")),
     kBumps, 0.02},
    {"SolidsInside", "Clipping 0.01 100\n" + kPerspective + "Translate 0 0 -5.05\n",
     solid("difference", closed("Sphere 3 -3 3 360\n") + closed("Sphere 0.9 -0.9 0.9 360\n") + kRod)},
    {"SolidsMidpoint", kPerspective + "Hider \"hidden\" \"string depthfilter\" [\"midpoint\"]\n", kBored},
    // Faces without area, of two vertices or one, beside one that has some.
    {"DegenerateFaces", kPerspective,
     "PointsPolygons [3 3 4 3] [0 1 2 2 1 3 3 0 0 1 1 1 1] \"P\" [-1 -1 0 1 -1 0 -1 1 0 1 1 0]\n"
     "PointsPolygons [3] [0 0 0] \"P\" [-1 -1 0 1 -1 0 -1 1 0]\n"
     "Polygon \"P\" [-1 -1 -1 -1 -1 -1 0 -1 -1 0 0 -1]\n"},
    {"Mirror",
     kPerspective,
     "AttributeBegin Surface \"raymirror\" Translate -0.7 0 0 Sphere 0.7 -0.7 0.7 360 AttributeEnd\n"
     "AttributeBegin Color [1 0.3 0.2] Translate 0.9 -0.1 -0.3 Rotate 90 1 0 0 Torus 0.5 0.2 0 360 360 "
     "AttributeEnd\n",
     {{"raymirror",
       "surface raymirror() { normal Nf = faceforward(normalize(N), I); Oi = Os;\n"
       "  Ci = Os * Cs * 0.8 * trace(P, reflect(normalize(I), Nf)) + 0.05; }\n"}},
     0.02},
};

class Hiders : public testing::TestWithParam<Scene> {};
INSTANTIATE_TEST_SUITE_P(Scenes, Hiders, testing::ValuesIn(kScenes),
                         [](const auto& i) { return std::string(i.param.name); });

TEST_P(Hiders, Agree) {
  const Difference d = compare(renderBoth(rib(GetParam()), GetParam().shaders), 1e-3);
  const double expected = 0.002 * double(d.outline), allowed = expected + 4 * std::sqrt(expected) + 2;
  EXPECT_GT(d.covered, d.pixels / 20);
  EXPECT_LT(double(d.alpha), allowed) << "coverage differs in so many samples; outline: " << d.outline;
  EXPECT_LT(double(d.depth), allowed) << "depth differs in so many samples; outline: " << d.outline;
  // Micropolygons of a pixel have one colour, rays the colour at the sample.
  EXPECT_LT(d.colorRms, GetParam().colorRms);
  RecordProperty("colorRms", std::to_string(d.colorRms));
}

TEST(HiderColors, ConvergeWithTheShadingRate) {
  const Scene& torus = *std::find_if(kScenes.begin(), kScenes.end(),
                                     [](const Scene& s) { return s.name == std::string("OddFormat"); });
  const double coarse = compare(renderBoth(rib(torus, "ShadingRate 4\n")), 1e-2).colorRms;
  const double fine = compare(renderBoth(rib(torus, "ShadingRate 0.25\n")), 1e-2).colorRms;
  // Micropolygons a quarter as wide: their colours are off by a quarter.
  EXPECT_LT(fine, 0.4 * coarse);
}

// Two walls, one before the other, three to one in transition, and a light behind the eye: each sample sees
// one of them, and rays from its shading points do not see the other.
TEST(Transition, RepresentationsShareTheSamplesAndDoNotShadowEachOther) {
  const HiderPair pair = renderBoth(
      "Format 64 64 1 PixelSamples 4 4 PixelFilter \"box\" 1 1 Projection \"orthographic\" ScreenWindow -1 1 "
      "-1 1\n"
      "WorldBegin\nAttribute \"light\" \"string shadows\" \"on\"\n"
      "LightSource \"distantlight\" 1 \"from\" [0 0 -1] \"to\" [0 0 0] Surface \"matte\"\n"
      "Detail [0 1 0 1 0 0] Color 1 0 0 DetailRange 0 0 0 4096\n"
      "Polygon \"P\" [-2 -2 2 2 -2 2 2 2 2 -2 2 2]\n"
      "Color 0 1 0 DetailRange 0 4096 1e38 1e38\n"
      "Polygon \"P\" [-2 -2 1.9 2 -2 1.9 2 2 1.9 -2 2 1.9]\nWorldEnd\n");
  for (const Channels* c : {&pair.reyes, &pair.rays}) {
    double red = 0, green = 0;
    for (size_t i = 0; i < 64 * 64; ++i) {
      EXPECT_EQ(c->at(3, i), 1.0f);
      red += double(c->at(0, i)) / 4096, green += double(c->at(1, i)) / 4096;
      // Sixteen samples of a pixel have sixteen chances, one in each sixteenth.
      EXPECT_NEAR(c->at(0, i), 0.75, 0.001);
    }
    EXPECT_NEAR(red, 0.75, 0.001);
    EXPECT_NEAR(green, 0.25, 0.001);
  }
}

}  // namespace
}  // namespace fr::test
