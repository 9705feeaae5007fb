// Input without area, direction, inverse or end: no crash, no NaN in a pixel, no more time than it is worth,
// and a message where something was left out.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <chrono>
#include <cmath>

#include "tests/hiders/hider_pair.h"

namespace fr::test {
namespace {

struct Degenerate {
  const char* name;
  std::string world;
  std::string options = "Projection \"perspective\" \"fov\" [40] Translate 0 0 5\n";
  bool mustTell = false;  // something is dropped
};
std::ostream& operator<<(std::ostream& out, const Degenerate& d) { return out << d.name; }

std::string repeated(const std::string& what, int n, const std::string& between = "") {
  std::string all;
  for (int i = 0; i < n; ++i) all += what + between;
  return all;
}

const std::string kPerspective = "Projection \"perspective\" \"fov\" [40] Translate 0 0 5\n";
const std::string kSphere = "Sphere 1 -1 1 360\n";
const std::string kPatchOf = "Patch \"bicubic\" \"P\" [";
const std::string kFlat =
    "-1.5 -1.5 0 -0.5 -1.5 1 0.5 -1.5 -1 1.5 -1.5 0  -1.5 -0.5 1 -0.5 -0.5 2 0.5 "
    "-0.5 -2 1.5 -0.5 0  -1.5 0.5 0 -0.5 0.5 -1 0.5 0.5 1 1.5 0.5 0 ";

std::vector<Degenerate> inputs() {
  std::vector<Degenerate> all = {
      {"ZeroAreaPolygons",
       "Polygon \"P\" [0 0 0 1 1 0 2 2 0]\nPolygon \"P\" [0 0 0 0 0 0 0 0 0]\n"
       "PointsPolygons [4 3] [0 1 1 0 2 2 2] \"P\" [0 0 0 1 0 0 0 1 0]\n"},
      {"CoincidentVertices",
       "Polygon \"P\" [-1 -1 0 -1 -1 0 1 -1 0 1 -1 0 1 1 0 -1 1 0 -1 1 0]\n"
       "Patch \"bilinear\" \"P\" [0 0 0 0 0 0 1 1 0 1 1 0]\n" +
           kPatchOf + repeated("0.5 0.5 0 ", 16) + "]\n" +
           "SubdivisionMesh \"catmull-clark\" [4 4] [0 1 2 3 2 1 0 3] [] [] [] [] \"P\" [" +
           repeated("1 0 0 ", 4) + "]\n"},
      {"RepeatedKnots", "NuPatch 4 4 [0 0 0 0 0 0 0 0] 0 1 4 4 [0 0 0 0 1 1 1 1] 0 1 \"P\" [" + kFlat +
                            "-1.5 1.5 0 -0.5 1.5 0 0.5 1.5 0 1.5 1.5 1]\n"
                            "NuPatch 4 2 [0 0 0.5 0.5 1 1] 0 1 4 2 [0 0 0.5 0.5 1 1] 0 1 \"P\" [" +
                            kFlat + "-1.5 1.5 0 -0.5 1.5 0 0.5 1.5 0 1.5 1.5 1]\n"},
      {"ZeroLengthNormals", "Surface \"plastic\"\nPolygon \"P\" [-1 -1 0 1 -1 0 1 1 0 -1 1 0] \"N\" [" +
                                repeated("0 0 0 ", 4) + "]\n"},
      {"NotANumber",
       kSphere + "Polygon \"P\" [-1 -1 0 nan -1 0 1 1 0 -1 1 0]\n" + kPatchOf + kFlat +
           "-1.5 1.5 0 -0.5 nan 0 0.5 1.5 0 1.5 1.5 1]\n",
       kPerspective, true},
      {"InfiniteControlPoints",
       kSphere + "Polygon \"P\" [-1 -1 0 inf -1 0 1 1 0 -1 1 0]\n" + kPatchOf + kFlat +
           "-1.5 1.5 0 -0.5 1e39 0 0.5 1.5 0 1.5 1.5 1]\n",
       kPerspective, true},
      {"HugeControlPoints", kSphere + kPatchOf + kFlat +
                                "-1.5 1.5 0 -0.5 1e38 0 0.5 1.5 0 1.5 1.5 1]\n"
                                "Polygon \"P\" [-1 -1 0 3e38 -1 0 3e38 3e38 0 -1 3e38 0]\n"},
      {"ScaleOfZero", "TransformBegin Scale 0 0 0 " + kSphere + "TransformEnd TransformBegin Scale 1 0 1 " +
                          kSphere + "TransformEnd TransformBegin Scale 1 1e-30 1 " + kSphere +
                          "TransformEnd\n"},
      {"SingularAndMirrored",
       "AttributeBegin ConcatTransform [1 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1] " + kSphere +
           "AttributeEnd AttributeBegin Scale -1 1 1 Translate 1 0 0 " + kSphere +
           "AttributeEnd AttributeBegin ConcatTransform [0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0] " + kSphere +
           "AttributeEnd AttributeBegin ConcatTransform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 0] " + kSphere +
           "AttributeEnd\n"},
      {"NonManifoldMesh",
       "SubdivisionMesh \"catmull-clark\" [4 4 4 4] [0 1 2 3 0 1 4 5 0 1 6 7 1 0 3 2] [] [] [] [] \"P\" [0 0 "
       "0 1 0 0 1 "
       "1 0 0 1 0 1 0 1 0 0 1 1 -1 1 0 -1 1]\n"
       "SubdivisionMesh \"catmull-clark\" [3 5 7] [0 1 2 0 0 0 1 2 7 6 5 4 3 2 1] [\"hole\" \"crease\"] [1 0 "
       "3 1] [0 0 1 "
       "9] [1e30] \"P\" [0 0 0 1 0 0 1 1 0 0 1 0 1 0 1 0 0 1 1 -1 1 0 -1 1]\n"},
      {"SelfIntersectingMesh",
       "Polygon \"P\" [-1 -1 0 1 1 0 1 -1 0 -1 1 0]\n"
       "GeneralPolygon [4 4] \"P\" [-1 -1 0 1 -1 0 1 1 0 -1 1 0 -2 0 0 2 0 0 2 0.5 0 -2 0.5 0]\n"},
      {"TinyFieldOfView", kSphere, "Projection \"perspective\" \"fov\" [0.001] Translate 0 0 5\n"},
      {"WideFieldOfView", kSphere + "Translate 0 0 2 Scale 1e4 1e4 1 Disk 0 1 360\n",
       "Projection \"perspective\" \"fov\" [179.9] Translate 0 0 5\n"},
      {"FieldOfViewOf180", kSphere, "Projection \"perspective\" \"fov\" [180] Translate 0 0 5\n"},
      {"NearPlaneAtNothing", kSphere + "Translate 0 0 -5 Scale 0.01 0.01 1 Cylinder 1 -1 1 360\n",
       "Clipping 1e-30 1e30 " + kPerspective},
      {"ClippingReversed", kSphere, "Clipping 10 1 " + kPerspective},
      {"OnePixel", kSphere, "Format 1 1 1 " + kPerspective},
      {"OneColumn", kSphere, "Format 1 64 1 PixelFilter \"sinc\" 20 20 " + kPerspective},
      {"LongThinMicropolygons",
       "Scale 1e6 1 1 " + kSphere + "Scale 1e-12 1 1 Polygon \"P\" [-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1]\n"},
      {"TinyCells", "Scale 1e-20 1e-20 1e-20 " + kSphere},
      {"Denormals", "Scale 1e-42 1e-42 1e-42 " + kSphere +
                        "Identity Polygon \"P\" [0 0 0 1e-42 0 0 1e-42 1e-42 0 0 1e-42 0]\n"},
      {"CoincidentSurfaces",
       repeated("Surface \"plastic\" Polygon \"P\" [-1 -1 0 1 -1 0 1 1 0 -1 1 0]\n", 20) +
           repeated(kSphere, 8)},
      {"TenThousandLayers",
       "Opacity [.01 .01 .01] " +
           repeated("Polygon \"P\" [-.3 -.3 0 .3 -.3 0 .3 .3 0 -.3 .3 0]\n", 10'000, "Translate 0 0 .0001\n"),
       "Format 16 16 1 " + kPerspective},
      {"ZeroWidths",
       "Curves \"linear\" [2 2] \"nonperiodic\" \"P\" [-1 0 0 1 0 0 0 0 0 0 0 0] \"constantwidth\" [0]\n"
       "Points \"P\" [0 0 0 1 0 0] \"constantwidth\" [0]\nPoints \"P\" [0 0 0 1 0 0] \"width\" [-1 1e30]\n"
       "Curves \"cubic\" [4] \"nonperiodic\" \"P\" [" +
           repeated("0 0 0 ", 4) + "] \"constantwidth\" [1e-30]\n"},
      {"QuadricsOfNothing",
       "Sphere 0 0 0 360 Sphere 1 -1 1 0 Cylinder 0 -1 1 360 Cylinder 1 0 0 360 Cone 0 0 360 Cone 0 1 360 "
       "Disk 0 0 "
       "360 Torus 0 0 0 360 360 Torus 1 0 0 360 360 Paraboloid 0 0 1 360 Paraboloid 1 1 1 360 Hyperboloid 0 "
       "0 0 "
       "0 0 0 360 Hyperboloid 0 0 0 1 0 0 360\n"},
      {"BlobsOfNothing",
       "Blobby 1 [1001 0] [0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1] [\"\"]\n"
       "Blobby 1 [1001 0] [1e-30 0 0 0 0 1e-30 0 0 0 0 1e-30 0 0 0 0 1] [\"\"]\n"},
      {"CameraInsideEverything", "Translate 0 0 -5 " + kSphere + "Sphere 1e-3 -1e-3 1e-3 360\n"},
      {"DisplacedByNaN",
       "Displacement \"broken\" Attribute \"displacementbound\" \"float sphere\" [1] " + kSphere},
      {"ShadedToNaN", "Surface \"nan\" " + kSphere},
  };
  return all;
}

const std::map<std::string, std::string> kShaders = {
    {"broken",
     "displacement broken() { float z = u - u; P += (log(z - 1) * 1e38 + 1 / z) * 1e38 * normalize(N); N = N "
     "* 0; }\n"},
    {"nan",
     "surface nan() { float big = 1e38 * 1e38 * (1 + u); Oi = 1; Ci = color (big - big, big, -big) * noise(P "
     "* big);\n"
     "  Ci += trace(P * big, N * big) + visibility(P, P * big) + trace(P, N * 0); }\n"}};

class DegenerateInput : public ::testing::TestWithParam<Degenerate> {};

TEST_P(DegenerateInput, IsSurvived) {
  const Degenerate& d = GetParam();
  const std::string rib = "Format 64 64 1\nPixelSamples 2 2\n" + d.options +
                          "WorldBegin\nLightSource \"distantlight\" 1\nLightSource \"pointlight\" 2 \"from\" "
                          "[0 0 0]\nSurface \"plastic\"\n" +
                          d.world + "WorldEnd\n";
  std::vector<Error> reports;
  const auto start = std::chrono::steady_clock::now();
  const HiderPair pair = renderBoth(rib, kShaders, &reports);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::map<std::string, int> messages;
  for (const Error& e : reports) {
    EXPECT_FALSE(e.message.empty());
    ++messages[e.str()];
  }
  for (const Channels* c : {&pair.reyes, &pair.rays})
    for (size_t channel = 0; channel < std::min<size_t>(4, c->values.size()); ++channel)
      for (size_t i = 0; i < c->values[channel].size(); ++i)
        ASSERT_TRUE(std::isfinite(c->at(channel, i)))
            << (c == &pair.reyes ? "REYES" : "rays") << ", channel " << channel << ", pixel " << i;
  EXPECT_TRUE(!d.mustTell || !reports.empty());
  // Each hider reads the scene for itself: a message comes twice.
  EXPECT_LE(messages.size(), 8u);
  for (const auto& [text, times] : messages) EXPECT_LE(times, 4) << text;
  EXPECT_LT(seconds, 60);
  std::printf("%-24s %6.2f s, %zu messages%s%s\n", d.name, seconds, reports.size(),
              reports.empty() ? "" : ": ", reports.empty() ? "" : reports[0].str().c_str());
}

INSTANTIATE_TEST_SUITE_P(Inputs, DegenerateInput, ::testing::ValuesIn(inputs()),
                         [](const auto& p) { return std::string(p.param.name); });

}  // namespace
}  // namespace fr::test
