#include "tests/stability/scenes.h"

#include <fmt/format.h>

#include "tests/stability/models.h"

namespace fr::test {
namespace {

const std::string kPatch =
    "Patch \"bicubic\" \"P\" [-1.5 -1.5 0 -0.5 -1.5 1 0.5 -1.5 -1 1.5 -1.5 0  -1.5 -0.5 1 -0.5 -0.5 2 0.5 "
    "-0.5 -2 1.5 -0.5 0  -1.5 0.5 0 -0.5 0.5 -1 0.5 0.5 1 1.5 0.5 0  -1.5 1.5 0 -0.5 1.5 0 0.5 1.5 0 1.5 1.5 "
    "1]\n";
const std::string kCube =
    "SubdivisionMesh \"catmull-clark\" [4 4 4 4 4 4] [0 1 3 2 4 6 7 5 0 4 5 1 2 3 7 6 0 2 6 4 1 5 7 3] "
    "[\"crease\"] [5 1] [0 1 3 2 0] [2.5] \"P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 "
    "1]\n";

std::string nurbs() {
  std::string p;
  for (int j = 0; j < 5; ++j)
    for (int i = 0; i < 6; ++i)
      p += fmt::format("{:.5f} {:.5f} {:.5f} ", -1.2 + 0.48 * i, -1.2 + 0.6 * j,
                       0.4 * (i % 2 ? 1 : -1) * (j % 2 ? 0.5 : 1));
  return "NuPatch 6 4 [0 0 0 0 1 3 4 4 4 4] 0 4 5 4 [0 0 0 0 1 2 2 2 2] 0 2 \"P\" [" + p + "]\n";
}

std::string curves() {
  std::string counts, p;
  for (int i = 0; i < 40; ++i) {
    counts += "4 ";
    const double x = -1 + 0.05 * i;
    for (int k = 0; k < 4; ++k)
      p += fmt::format("{:.5f} {:.5f} {:.5f} ", x + 0.07 * ((i * 7 + k * 3) % 5), -0.5 + 0.35 * k,
                       0.1 * ((i * 3 + k) % 4));
  }
  return "Curves \"cubic\" [" + counts + "] \"nonperiodic\" \"P\" [" + p + "] \"constantwidth\" [0.03]\n";
}

std::string points() {
  std::string p;
  for (int i = 0; i < 60; ++i)
    p += fmt::format("{:.3f} {:.3f} {:.3f} ", -1 + 0.03 * ((i * 37) % 60), -0.4 + 0.015 * ((i * 23) % 60),
                     0.01 * ((i * 11) % 60));
  return "Points \"P\" [" + p + "] \"constantwidth\" [0.05]\n";
}

/// At one of 4 x 3 places.
std::string at(int column, int row, const std::string& what) {
  return fmt::format("AttributeBegin Translate {} {} 0 Scale .4 .4 .4 {} AttributeEnd\n",
                     -1.65 + 1.1 * column, 1.05 - 1.05 * row, what);
}

}  // namespace

const std::map<std::string, std::string>& everythingsShaders() {
  static const std::map<std::string, std::string> shaders = {
      // Heights in object space, so that they grow with the object.
      {"waves",
       "displacement waves() { normal n = normalize(ntransform(\"shader\", N));\n"
       "  point p = transform(\"shader\", P) + 0.1 * sin(20 * u) * sin(20 * v) * n;\n"
       "  P = transform(\"shader\", \"current\", p); N = calculatenormal(P); }\n"},
      {"raymirror",
       "surface raymirror() { normal Nf = faceforward(normalize(N), I); Oi = Os;\n"
       "  Ci = Os * Cs * 0.8 * trace(P, reflect(normalize(I), Nf)) + 0.05; }\n"},
      {"spots",
       "surface spots() { point p = transform(\"shader\", P); normal n = normalize(faceforward(N, I));\n"
       "  Oi = Os; Ci = Os * Cs * (0.3 + 0.5 * noise(7 * p)) * (0.2 + diffuse(n)); }\n"}};
  return shaders;
}

std::string everything(const Placement& t, const std::string& options) {
  const double s = t.scale;
  const auto f = [](double x) { return fmt::format("{:.17g}", x); };
  std::string world = "Surface \"spots\"\n";
  world += at(0, 0, "Rotate 40 1 1 0 Sphere 1 -1 1 360");
  world += at(1, 0, "Rotate 60 1 1 0 Torus 0.8 0.3 0 360 300");
  world += at(2, 0, "Rotate 40 1 0.2 0 Scale .7 .7 .7 " + kPatch);
  world += at(3, 0, "Rotate 30 1 1 0 " + nurbs());
  world += at(0, 1, "Rotate 30 1 1 0 " + kCube);
  world += at(1, 1, "Rotate 20 1 1 0 " + ballOfPolygons(48));
  world +=
      at(2, 1,
         "Displacement \"waves\" Attribute \"displacementbound\" \"float sphere\" [0.2] Sphere 1 -1 1 360");
  world += at(3, 1, "Surface \"raymirror\" Sphere 1 -1 1 360");
  world += at(0, 2, curves());
  world += at(1, 2, points());
  world +=
      at(2, 2,
         "Rotate 30 1 1 0 Blobby 2 [1001 0 1001 16 0 2 0 1] [2 0 0 0 0 2 0 0 0 0 2 0 -0.5 0 0 1  1.6 0 0 0 0 "
         "1.6 0 0 0 0 1.6 0 0.7 0.2 0 1] [\"\"]");
  world += at(3, 2,
              "Rotate 35 1 1 0 SolidBegin \"difference\" SolidBegin \"primitive\" Sphere 1 -1 1 360 SolidEnd "
              "SolidBegin \"primitive\" Translate 0.6 0 -0.5 Sphere 0.8 -0.8 0.8 360 SolidEnd SolidEnd");
  world += "ObjectBegin \"it\" Cone 0.4 0.2 360 ObjectEnd\n";
  for (int i = 0; i < 3; ++i)
    world += fmt::format(
        "TransformBegin Translate {} 0.5 -0.6 Rotate {} 1 1 0 ObjectInstance \"it\" "
        "TransformEnd\n",
        -1.1 + 1.1 * i, 30 * i - 100);
  world +=
      "AttributeBegin Opacity [0.3 0.4 0.5] Color [1 0.5 0.2] Translate 0.5 -0.5 -0.8 Disk 0 0.35 360 "
      "AttributeEnd\n"
      "AttributeBegin Surface \"matte\" Translate 0 0 0.9 Polygon \"P\" [-3 -3 0 -3 3 0 3 3 0 3 -3 0] "
      "AttributeEnd\n";
  return "Format 160 120 1\nPixelSamples 2 2\nPixelFilter \"box\" 1 1\nShadingRate 1\n" + options +
         "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 " + f(5.5 * s) +
         "\nRotate 12 1 0.4 0\nTranslate " + f(-t.x) + " " + f(-t.y) + " " + f(-t.z) +
         "\nWorldBegin\nTranslate " + f(t.x) + " " + f(t.y) + " " + f(t.z) + "\nScale " + f(s) + " " + f(s) +
         " " + f(s) +
         "\nAttribute \"light\" \"string shadows\" [\"on\"]\nLightSource \"distantlight\" 1 \"from\" [1 1 "
         "-2] "
         "\"to\" [0 0 0]\nLightSource \"pointlight\" 2 \"from\" [-2 2 -3] \"intensity\" [" +
         f(5 * s * s) + "]\n" + world + "WorldEnd\n";
}

}  // namespace fr::test
