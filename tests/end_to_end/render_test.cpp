// frankenrender from the outside: pictures, both modes, bad input.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\"\n"
    "Format 96 72 1\nPixelSamples 4 4\nPixelFilter \"box\" 1 1\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n";

/// Renders `world` (what stands between WorldBegin and WorldEnd) and returns the picture.
Picture render(const Workspace& w, const std::string& world, const std::vector<std::string>& options = {},
               Outcome* outcome = nullptr, const std::string& head = kHead) {
  w.write("scene.rib", head + "WorldBegin\n" + world + "WorldEnd\n");
  std::vector<std::string> arguments = options;
  arguments.push_back("scene.rib");
  const Outcome o = run("frankenrender", arguments, w.path());
  if (outcome) {
    *outcome = o;
  } else {
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.err, "");
  }
  if (!std::filesystem::exists(w.path() / "out.exr")) {
    ADD_FAILURE() << "no picture was written: " << o.err;
    return {};
  }
  return readExr(w.path() / "out.exr");
}

double sum(const Picture& p, const std::string& channel) {
  double s = 0;
  for (float v : p.channels.at(channel)) s += double(v);
  return s;
}

const std::string kMirrorScene =
    "Attribute \"light\" \"string shadows\" [\"on\"]\n"
    "LightSource \"pointlight\" 1 \"intensity\" [20] \"from\" [2 3 -3]\n"
    "LightSource \"ambientlight\" 2 \"intensity\" [0.2]\n"
    "AttributeBegin\nSurface \"raymirror\"\nTranslate -0.8 0 0\nSphere 0.7 -0.7 0.7 360\nAttributeEnd\n"
    "AttributeBegin\nColor [1 0.3 0.2]\nSurface \"plastic\"\nTranslate 0.9 -0.1 -0.3\nRotate 90 1 0 0\n"
    "Torus 0.5 0.2 0 360 360\nAttributeEnd\n"
    "AttributeBegin\nOpacity [0.5 0.5 0.5]\nColor [0.2 0.4 1]\nSurface \"matte\"\nTranslate 0.1 0.6 -1\n"
    "Sphere 0.3 -0.3 0.3 360\nAttributeEnd\n"
    "AttributeBegin\nSurface \"matte\"\nPolygon \"P\" [-4 -0.8 -3 -4 -0.8 6 4 -0.8 6 4 -0.8 "
    "-3]\nAttributeEnd\n";

const std::string kRayMirror =
    "surface raymirror(float Kr = 0.8) {\n"
    "  normal Nf = faceforward(normalize(N), I);\n"
    "  Oi = Os;\n"
    "  Ci = Os * Cs * Kr * trace(P, reflect(normalize(I), Nf)) + 0.05;\n"
    "}\n";

// Points where two walls meet lie on both: their rays must not slip out between them.
TEST(Render, NoRayLeavesAClosedRoom) {
  Workspace w;
  w.write(
      "inroom.sl",
      "surface inroom() { normal Nf = faceforward(normalize(N), I); Ci = occlusion(P, Nf, 16); Oi = 1; }");
  const std::string quads =
      "Surface \"inroom\"\nRotate 10 0 1 0\n"
      "Polygon \"P\" [-6 -4 -8  6 -4 -8  6 -4 6  -6 -4 6]\nPolygon \"P\" [-6 5 -8  6 5 -8  6 5 6  -6 5 6]\n"
      "Polygon \"P\" [-6 -4 -8  -6 5 -8  -6 5 6  -6 -4 6]\nPolygon \"P\" [6 -4 -8  6 5 -8  6 5 6  6 -4 6]\n";
  const std::string patches =
      "Patch \"bilinear\" \"P\" [-6 -4 6  6 -4 6  -6 5 6  6 5 6]\n"
      "PointsPolygons [3 3] [0 1 2 1 2 3] \"P\" [-6 -4 -8  6 -4 -8  -6 5 -8  6 5 -8]\n";
  const Picture p = render(w, quads + patches);
  // Rounding lets a few through, where they go along an edge.
  double escaped = 0;
  for (const float v : p.channels.at("R")) escaped += 1 - double(v);
  EXPECT_LT(escaped, 6);
}

TEST(Render, AnEmptyWorldIsABlackTransparentPicture) {
  Workspace w;
  const Picture p = render(w, "");
  EXPECT_EQ(p.width, 96);
  EXPECT_EQ(p.height, 72);
  for (const auto& [name, values] : p.channels)
    for (float v : values) ASSERT_EQ(v, 0.f) << name;
}

TEST(Render, SphereCoversTheDiskThatPerspectiveSays) {
  Workspace w;
  const Picture p = render(w, "Surface \"constant\"\nColor [1 0.5 0.25]\nSphere 1 -1 1 360\n");
  // A unit sphere 5 away: silhouette of angular radius asin(1/5); on the image plane at distance 1 the radius
  // is tan(asin(0.2)); pixels per unit: 36 / tan(20 degrees).
  const double r = std::tan(std::asin(0.2)) * 36 / std::tan(20 * M_PI / 180);
  const double area = M_PI * r * r;
  // The error of 16 stratified samples a pixel along the circumference is far below one pixel row: allow 0.5
  // %.
  EXPECT_NEAR(sum(p, "A"), area, 0.005 * area);
  EXPECT_NEAR(sum(p, "R"), area, 0.005 * area);
  EXPECT_NEAR(sum(p, "B"), 0.25 * area, 0.005 * area);
  EXPECT_EQ(p.at("A", 48, 36), 1.f);
}

TEST(Render, LambertSphereUnderADistantLightIsItsCosine) {
  Workspace w;
  // Orthographic view along +z, light along +z: the cosine at (x, y) of a unit sphere is sqrt(1 - x^2 - y^2).
  const Picture p = render(w,
                           "LightSource \"distantlight\" 1 \"from\" [0 0 -1] \"to\" [0 0 0]\n"
                           "Surface \"matte\" \"Ka\" [0] \"Kd\" [1]\nSphere 1 -1 1 360\n",
                           {}, nullptr,
                           "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 64 64 1\nPixelSamples 4 4\n"
                           "PixelFilter \"box\" 1 1\nShadingRate 0.25\nProjection \"orthographic\"\n"
                           "ScreenWindow -1.25 1.25 -1.25 1.25\nTranslate 0 0 5\n");
  for (int y = 16; y < 48; ++y) {
    for (int x = 16; x < 48; ++x) {
      const double px = (x + 0.5) / 64 * 2.5 - 1.25, py = (y + 0.5) / 64 * 2.5 - 1.25;
      const double expected = std::sqrt(1 - px * px - py * py);
      // Flat micropolygons of half a pixel: colour is off by at most half a micropolygon's gradient, 0.02.
      ASSERT_NEAR(p.at("R", x, y), expected, 0.02) << x << "," << y;
    }
  }
}

TEST(Render, OpacityCompositesFrontToBack) {
  Workspace w;
  const std::string square = "Polygon \"P\" [-3 -3 0 -3 3 0 3 3 0 3 -3 0]\n";
  const Picture p = render(w,
                           "Surface \"constant\"\n"
                           "AttributeBegin\nColor [0 1 0]\nTranslate 0 0 1\n" +
                               square +
                               "AttributeEnd\n"
                               "AttributeBegin\nColor [1 0 0]\nOpacity [0.25 0.25 0.25]\n" +
                               square +
                               "AttributeEnd\n"
                               "AttributeBegin\nColor [0 0 1]\nOpacity [0.5 0.5 0.5]\nTranslate 0 0 -1\n" +
                               square + "AttributeEnd\n");
  const float tolerance = 1e-5f;  // three products of exact fractions
  EXPECT_NEAR(p.at("B", 48, 36), 0.5f, tolerance);
  EXPECT_NEAR(p.at("R", 48, 36), 0.5f * 0.25f, tolerance);
  EXPECT_NEAR(p.at("G", 48, 36), 0.5f * 0.75f, tolerance);
  EXPECT_NEAR(p.at("A", 48, 36), 1.f, tolerance);
}

TEST(Render, ClosedObjectsHaveNoHoles) {
  const char* const objects[] = {
      "Sphere 1.2 -1.2 1.2 360\n",
      "Rotate 50 1 1 0\nTorus 0.9 0.4 0 360 360\n",
      "Rotate 70 1 0.3 0\nTranslate 0 0 -1\nParaboloid 1.2 0 2 360\n",
      "Translate 0 -1 0\nRotate -90 1 0 0\nScale 0.6 0.6 0.6\nReadArchive \"teapot.rib\"\n",
  };
  for (const char* object : objects) {
    Workspace w;
    std::filesystem::copy_file(FR_SOURCE_DIR "/examples/models/teapot.rib", w.path() / "teapot.rib");
    const Picture p =
        render(w, std::string("Surface \"constant\"\n") + object, {}, nullptr,
               "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 160 120 1\nPixelSamples 4 4\n"
               "PixelFilter \"box\" 1 1\nProjection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n");
    // A pixel whose eight neighbours are all covered may not show the background (silhouettes of these shapes
    // are wider).
    for (int y = 1; y + 1 < p.height; ++y) {
      for (int x = 1; x + 1 < p.width; ++x) {
        float around = 1;
        for (int j = -1; j <= 1; ++j)
          for (int i = -1; i <= 1; ++i)
            if (i != 0 || j != 0) around = std::min(around, p.at("A", x + i, y + j));
        if (around == 1.f) {
          ASSERT_EQ(p.at("A", x, y), 1.f) << object << " at " << x << "," << y;
        }
      }
    }
  }
}

TEST(Render, BothModesAndAnyThreadsGiveTheSameBits) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  const Picture shm = render(w, kMirrorScene, {"--shm"});
  const Picture inproc = render(w, kMirrorScene, {"--inproc"});
  EXPECT_EQ(worst(shm, inproc), 0.0);
  EXPECT_EQ(worst(shm, render(w, kMirrorScene, {"--inproc", "--threads", "1"})), 0.0);
  EXPECT_EQ(worst(shm, render(w, kMirrorScene, {"--shm", "--threads", "3"})), 0.0);
  EXPECT_GT(sum(shm, "R"), 100.0);
}

// Volumes, area lights and every kind of ray call: the tracer process must understand a block as the library
// does.
TEST(Render, RayCallsSayTheSameInBothModes) {
  Workspace w;
  w.write("asks.sl",
          "surface asks() {\n"
          "  normal n = normalize(faceforward(N, I)); color c = 0, told = 0, through = 0; float s0 = 0;\n"
          "  if (raylevel() == 0) {\n"
          "    c = 0.2 * occlusion(P, n, 4, \"maxdist\", 3) + 0.2 * indirectdiffuse(P, n, 4);\n"
          "    c += 0.2 * trace(P, reflect(normalize(I), n), \"label\", \"mirror\", \"excludesubset\", "
          "\"hidden\",\n"
          "                     \"samples\", 2, \"samplecone\", 0.1, \"transmission\", through) + 0.1 * "
          "through;\n"
          "    gather(\"illuminance\", P, n, 0.6, 3, \"surface:told\", told, \"primitive:s\", s0) { c += "
          "0.05 * told + 0.01 * s0; }\n"
          "  }\n"
          "  Ci = Cs * (c + diffuse(n)); Oi = 1;\n"
          "}\n");
  w.write("tells.sl",
          "surface tells(output varying color told = 0) {\n"
          "  told = color(u, v, raylevel()); Oi = 0.5 * Os; Ci = Oi * Cs;\n"
          "  if (raylabel() == \"mirror\") Ci *= 0.5;\n"
          "}\n");
  const std::string world =
      "Atmosphere \"fog\" \"distance\" [40]\n"
      "AttributeBegin Attribute \"light\" \"int nsamples\" [4] \"string shadows\" [\"on\"]\n"
      "AreaLightSource \"arealight\" 3 \"intensity\" [9] Surface \"constant\" Translate 0 3 0 Rotate 90 1 0 "
      "0\n"
      "Disk 0 1 360 AttributeEnd Illuminate 3 1\n"
      "AttributeBegin Surface \"tells\" Interior \"fog\" \"distance\" [2] Sphere 1 -1 1 360 AttributeEnd\n"
      "AttributeBegin Attribute \"grouping\" \"string membership\" [\"hidden\"] Surface \"tells\" Translate "
      "1.5 0 1\n"
      "Sphere 0.5 -0.5 0.5 360 AttributeEnd\n"
      "Surface \"asks\" Polygon \"P\" [-5 -1 -5 -5 -1 5 5 -1 5 5 -1 -5]\n";
  const Picture shm = render(w, world, {"--shm"});
  EXPECT_GT(sum(shm, "R"), 10.0);
  EXPECT_EQ(worst(shm, render(w, world, {"--inproc"})), 0.0);
  EXPECT_EQ(worst(shm, render(w, world, {"--shm", "--threads", "3"})), 0.0);
}

// Lines of sight and rays resolve solids apart, on meshes of several strides: every process must find the
// same.
TEST(Render, SolidsAreTheSameInBothModes) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  const std::string world =
      "LightSource \"pointlight\" 1 \"from\" [-2 3 -3] \"intensity\" [20]\n"
      "Attribute \"light\" \"string shadows\" [\"on\"] LightSource \"distantlight\" 2 \"from\" [1 4 -2]\n"
      "SolidBegin \"difference\"\n"
      "SolidBegin \"union\" Surface \"raymirror\" Sphere 1 -1 1 360\n"
      "SolidBegin \"primitive\" Surface \"matte\" Opacity [0.5 0.5 0.5] Rotate 40 1 1 0 Torus 1 0.35 0 360 "
      "360 "
      "SolidEnd SolidEnd\n"
      "SolidBegin \"primitive\" Surface \"raymirror\" Translate 0.3 0.3 0 Cylinder 0.4 -2 2 360 Disk 2 0.4 "
      "360 "
      "Disk -2 0.4 360 SolidEnd SolidEnd\n"
      "Surface \"matte\" Polygon \"P\" [-5 -1.2 -5 -5 -1.2 5 5 -1.2 5 5 -1.2 -5]\n";
  const Picture shm = render(w, world, {"--shm"});
  EXPECT_GT(sum(shm, "R"), 10.0);
  EXPECT_EQ(worst(shm, render(w, world, {"--inproc"})), 0.0);
  EXPECT_EQ(worst(shm, render(w, world, {"--inproc", "--threads", "1"})), 0.0);
  EXPECT_EQ(worst(shm, render(w, world, {"--shm", "--threads", "3"})), 0.0);
}

TEST(Render, APrebuiltCacheChangesNothing) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  const Picture direct = render(w, kMirrorScene);
  Outcome built = run("scenecache", {"build", "scene.rib", "-o", "scene.fsc"}, w.path());
  ASSERT_EQ(built.exitCode, 0) << built.err;
  EXPECT_EQ(run("scenecache", {"info", "scene.fsc"}, w.path()).exitCode, 0);
  // From another folder too: the cache remembers where its shaders stand.
  const std::filesystem::path elsewhere = w.path() / "elsewhere";
  std::filesystem::create_directory(elsewhere);
  const Outcome o = run("frankenrender", {"../scene.fsc"}, elsewhere);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(worst(direct, readExr(elsewhere / "out.exr")), 0.0);
}

TEST(Render, DisplacementMovesTheSilhouetteForBothRenderers) {
  Workspace w;
  w.write("swell.sl",
          "displacement swell(float by = 0.25) { P += by * normalize(N); N = calculatenormal(P); }\n");
  const std::string displaced =
      "Attribute \"displacementbound\" \"float sphere\" [0.25] \"string coordinatesystem\" [\"shader\"]\n"
      "Surface \"constant\"\nDisplacement \"swell\" \"float by\" [0.25]\nSphere 0.75 -0.75 0.75 360\n";
  const double moved = sum(render(w, displaced), "A");
  const double plain = sum(render(w, "Surface \"constant\"\nSphere 1 -1 1 360\n"), "A");
  EXPECT_NEAR(moved, plain, 0.01 * plain);  // the same sphere, tessellated for radius 0.75
}

TEST(Render, DisplacementBoundTooSmallNamesTheNeededValue) {
  Workspace w;
  w.write("swell.sl", "displacement swell(float by = 0.25) { P += by * normalize(N); }\n");
  Outcome o;
  render(w,
         "Surface \"constant\"\nAttribute \"displacementbound\" \"float sphere\" [0.1]\n"
         "Displacement \"swell\" \"float by\" [0.25]\nSphere 0.75 -0.75 0.75 360\n",
         {}, &o);
  EXPECT_NE(o.err.find("displacement"), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("0.25"), std::string::npos) << o.err;
}

TEST(Render, RaysSeeWhatIsBehindTheCamera) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  // A mirror that faces the camera; behind the camera stands a red wall.
  const Picture p = render(w,
                           "AttributeBegin\nSurface \"raymirror\" \"Kr\" [1]\n"
                           "Polygon \"P\" [-1 -1 0 -1 1 0 1 1 0 1 -1 0]\nAttributeEnd\n"
                           "AttributeBegin\nSurface \"constant\"\nColor [1 0 0]\n"
                           "Polygon \"P\" [-50 -50 -9 -50 50 -9 50 50 -9 50 -50 -9]\nAttributeEnd\n");
  // The file holds half floats: 11 bits.
  EXPECT_NEAR(p.at("R", 48, 36), 1.05f, 1.05f / 2048);
  EXPECT_NEAR(p.at("G", 48, 36), 0.05f, 0.05f / 2048);
}

TEST(Render, FilesForOneSideAreSeenByThatSideOnly) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  w.write("head.rib", kHead + "WorldBegin\n");
  w.write("mirror.rib",
          "AttributeBegin\nSurface \"raymirror\" \"Kr\" [1]\nPolygon \"P\" [-1 -1 0 -1 1 0 1 1 0 1 -1 0]\n"
          "AttributeEnd\n");
  w.write("wall.rib",
          "AttributeBegin\nSurface \"constant\"\nColor [1 0 0]\n"
          "Polygon \"P\" [-50 -50 -9 -50 50 -9 50 50 -9 50 -50 -9]\nAttributeEnd\n");
  w.write("tail.rib", "WorldEnd\n");
  const auto withWall = [&](const char* side) {
    std::vector<std::string> a{"head.rib", "mirror.rib"};
    a.insert(a.end(), {side, "wall.rib"});
    a.insert(a.end(), {"-common", "tail.rib"});
    const Outcome o = run("frankenrender", a, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return readExr(w.path() / "out.exr").at("R", 48, 36);
  };
  EXPECT_NEAR(withWall("-bmrt"), 1.05f, 1.05f / 2048);
  EXPECT_NEAR(withWall("-prman"), 0.05f, 0.05f / 2048);
}

TEST(Render, CropTilesAbut) {
  Workspace w;
  const std::string world = "Surface \"constant\"\nSphere 1 -1 1 360\n";
  const Picture whole = render(w, world);
  const Picture left = render(w, world, {"--crop", "0", "0.4", "0", "1"});
  const Picture right = render(w, world, {"--crop", "0.4", "1", "0", "1"});
  ASSERT_EQ(left.width + right.width, whole.width);
  for (int y = 0; y < whole.height; ++y)
    for (int x = 0; x < whole.width; ++x)
      ASSERT_EQ(whole.at("A", x, y), x < left.width ? left.at("A", x, y) : right.at("A", x - left.width, y));
}

TEST(Render, CommandLineOverridesResolutionAndOutput) {
  Workspace w;
  w.write("scene.rib", kHead + "WorldBegin\nSurface \"constant\"\nSphere 1 -1 1 360\nWorldEnd\n");
  const Outcome o =
      run("frankenrender", {"--res", "40", "30", "--samples", "2", "2", "-o", "other.exr", "scene.rib"},
          w.path());
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(readExr(w.path() / "other.exr").width, 40);
  EXPECT_FALSE(std::filesystem::exists(w.path() / "out.exr"));
}

TEST(Render, NoRaysNoOracle) {
  Workspace w;
  Outcome o;
  render(w, "Surface \"constant\"\nSphere 1 -1 1 360\n", {"--stats"}, &o);
  EXPECT_EQ(o.exitCode, 0);
  EXPECT_NE((o.out + o.err).find("no ray tracer was started"), std::string::npos) << o.out << o.err;
}

TEST(Render, UndeclaredParametersGetTheTypesOfTheShader) {
  Workspace w;
  w.write(
      "typed.sl",
      "surface typed(color tint = 0; point where = 0; float weights[3] = {0, 0, 0}; string mode = \"\";) {\n"
      "  Ci = mode == \"on\" ? tint + color(0, 0, weights[2]) : color(1, 1, 1);\n"
      "  if (zcomp(transform(\"shader\", where)) != 3) Ci = 1;\n"
      "}\n");
  const Picture p = render(w,
                           "Translate 0 0 2\nSurface \"typed\" \"tint\" [0.5 0.25 0] \"where\" [1 2 3] "
                           "\"weights\" [0 0 0.125] \"mode\" \"on\"\nSphere 1 -1 1 360\n");
  EXPECT_EQ(p.at("R", 48, 36), 0.5f);
  EXPECT_EQ(p.at("G", 48, 36), 0.25f);
  EXPECT_EQ(p.at("B", 48, 36), 0.125f);
}

TEST(Render, ImagerFillsTheBackground) {
  Workspace w;
  const Picture p = render(w, "Surface \"constant\"\nColor [0 1 0]\nSphere 0.5 -0.5 0.5 360\n", {}, nullptr,
                           kHead + "Imager \"background\" \"bgcolor\" [0.25 0.5 0.75]\n");
  EXPECT_EQ(p.at("R", 2, 2), 0.25f);
  EXPECT_EQ(p.at("B", 2, 2), 0.75f);
  EXPECT_EQ(p.at("A", 2, 2), 1.f);
  EXPECT_EQ(p.at("R", 48, 36), 0.f);
  EXPECT_EQ(p.at("G", 48, 36), 1.f);
}

TEST(Render, AMirroredSceneIsTheMirroredPicture) {
  Workspace w;
  const std::string objects =
      "LightSource \"distantlight\" 1 \"from\" [0 1 -1] \"to\" [0 0 0]\nSurface \"matte\"\nSides 1\n"
      "Translate 0.6 0 0\nSphere 0.6 -0.6 0.6 360\nTranslate 0.4 0.7 -0.5\nRotate 40 1 0 0\n"
      "Torus 0.3 0.1 0 360 270\n";
  const std::string noJitter = kHead + "Hider \"hidden\" \"jitter\" 0\n";
  const Picture straight = render(w, objects, {}, nullptr, noJitter);
  const Picture mirrored = render(w, "Scale -1 1 1\n" + objects, {}, nullptr, noJitter);
  ASSERT_GT(sum(straight, "A"), 100);
  double worstDifference = 0;
  for (int y = 0; y < straight.height; ++y)
    for (int x = 0; x < straight.width; ++x)
      worstDifference =
          std::max(worstDifference,
                   double(std::abs(straight.at("R", x, y) - mirrored.at("R", straight.width - 1 - x, y))));
  // Shading at micropolygon corners that rounding may place differently; a wrong side would be black (~1).
  EXPECT_LT(worstDifference, 0.05);
}

TEST(Render, OpacityOfAPrimitiveVariable) {
  Workspace w;
  const Picture p = render(w,
                           "Surface \"constant\"\nPolygon \"P\" [-3 -3 0 -3 3 0 3 3 0 3 -3 0] "
                           "\"constant color Os\" [0.25 0.25 0.25] \"constant color Cs\" [1 0.5 0]\n");
  EXPECT_NEAR(p.at("A", 48, 36), 0.25f, 1e-5f);
  EXPECT_NEAR(p.at("R", 48, 36), 0.25f, 1e-5f);
  EXPECT_NEAR(p.at("G", 48, 36), 0.125f, 1e-5f);
}

// ---- bad input ----

/// A texture's name, most often: one shader, and each primitive says its own.
TEST(Render, StringsIntegersAndWeightedPointsOfPrimitivesReachTheShader) {
  Workspace w;
  w.write("says.sl",
          "surface says(uniform string what = \"none\"; varying float number = 0; varying point at = 0;\n"
          "             uniform string two[2] = {\"\", \"\"}) {\n"
          "  float red = 0;\n"
          "  if (what == \"red\") red = 1; else if (what == \"half\") red = 0.5;\n"
          "  if (two[1] == \"b\") red += 0.25;\n"
          "  Ci = color(red, number / 8, max(0, ycomp(transform(\"object\", at)) / 4)); Oi = 1;\n"
          "}\n");
  const auto patch = [](const std::string& place, const std::string& variables) {
    return "TransformBegin\nTranslate " + place +
           " 0 0\nPatch \"bilinear\" \"P\" [-0.4 -0.4 0 0.4 -0.4 0 -0.4 0.4 0 0.4 0.4 0] " + variables +
           "\nTransformEnd\n";
  };
  const std::string world =
      "Surface \"says\" \"string what\" \"half\"\n" + patch("-1", "\"uniform string what\" [\"red\"]") +
      patch("0",
            "\"constant string what\" [\"red\"] \"uniform int number\" [4] \"string unknown\" [\"x\"] "
            "\"constant hpoint at\" [0 4 0 2]") +
      patch("1", "\"constant string[2] two\" [\"a\" \"b\"] \"constant int number\" [2]") +
      "ObjectBegin 1\nPatch \"bilinear\" \"P\" [-0.4 -0.4 0 0.4 -0.4 0 -0.4 0.4 0 0.4 0.4 0] \"string what\" "
      "[\"red\"]\nObjectEnd\n"
      "TransformBegin\nTranslate -1 1 0\nObjectInstance 1\nTransformEnd\n"
      "TransformBegin\nTranslate 1 1 0\nObjectInstance 1\nTransformEnd\n"
      // One value for all of it: what differs from face to face is said.
      "Translate 0 1 0\nPointsPolygons [3 3] [0 1 2 0 2 3] \"P\" [-0.4 -0.4 0 0.4 -0.4 0 0.4 0.4 0 -0.4 0.4 "
      "0] "
      "\"uniform string what\" [\"red\" \"none\"]\n";
  w.write("scene.rib",
          "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 90 60 1\nPixelFilter \"box\" 1 1\nProjection "
          "\"orthographic\"\nScreenWindow -1.5 1.5 -0.5 1.5\nTranslate 0 0 5\nWorldBegin\n" +
              world + "WorldEnd\n");
  const auto expectIt = [&](const Outcome& o) {
    EXPECT_EQ(o.exitCode, 0) << o.err;
    const Picture p = readExr(w.path() / "out.exr");
    const struct {
      int x, y;
      double r, g, b;
    } wanted[] = {{15, 45, 1, 0, 0}, {45, 45, 1, 0.5, 0.5}, {75, 45, 0.75, 0.25, 0},
                  {15, 15, 1, 0, 0}, {75, 15, 1, 0, 0},     {45, 15, 0.5, 0, 0}};
    for (const auto& x : wanted) {
      EXPECT_NEAR(p.at("R", x.x, x.y), x.r, 1e-3) << x.x << " " << x.y;
      EXPECT_NEAR(p.at("G", x.x, x.y), x.g, 1e-3) << x.x << " " << x.y;
      EXPECT_NEAR(p.at("B", x.x, x.y), x.b, 1e-3) << x.x << " " << x.y;
    }
  };
  const Outcome o = run("frankenrender", {"scene.rib"}, w.path());
  EXPECT_NE(o.err.find("string \"what\" of a primitive has 2 values"), std::string::npos) << o.err;
  EXPECT_EQ(o.err.find("unknown"), std::string::npos) << o.err;
  expectIt(o);
  expectIt(run("rendrib", {"scene.rib"}, w.path()));
  ASSERT_EQ(run("scenecache", {"build", "scene.rib", "-o", "scene.fsc", "-q"}, w.path()).exitCode, 0);
  expectIt(run("frankenrender", {"scene.fsc"}, w.path()));
}

TEST(Render, ASceneWithoutADisplayHasADefaultPicture) {
  Workspace w;
  const std::string world = "Format 16 12 1\nWorldBegin\nSphere 1 -1 1 360\nWorldEnd\n";
  w.write("scene.rib", world);
  const auto picture = w.path() / "ri.tif";
  for (const char* program : {"frankenrender", "rendrib"}) {
    const Outcome o = run(program, {"scene.rib"}, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_NE(o.err.find("no Display: the picture goes to ri.tif"), std::string::npos) << o.err;
    EXPECT_TRUE(std::filesystem::remove(picture)) << program;
  }
  ASSERT_EQ(run("scenecache", {"build", "scene.rib", "-o", "s.fsc"}, w.path()).exitCode, 0);
  EXPECT_EQ(run("frankenrender", {"s.fsc"}, w.path()).exitCode, 0);
  EXPECT_TRUE(std::filesystem::remove(picture));
  // A cache may be rendered to another file, like RIB.
  for (const char* program : {"frankenrender", "rendrib"}) {
    const Outcome other = run(program, {"-o", "other.png", "s.fsc"}, w.path());
    EXPECT_EQ(other.exitCode, 0);
    EXPECT_EQ(other.err, "");
    EXPECT_TRUE(std::filesystem::remove(w.path() / "other.png")) << program;
    EXPECT_FALSE(std::filesystem::exists(picture));
  }
  EXPECT_NE(run("frankenrender", {"--res", "9", "9", "s.fsc"}, w.path()).err.find("do not change it"),
            std::string::npos);
  EXPECT_TRUE(std::filesystem::remove(picture));
  // Files for the ray tracer alone say nothing about pictures, and nothing is said of them.
  w.write("rays.rib", "Option \"trace\" \"integer maxdepth\" [2]\n");
  const Outcome o =
      run("frankenrender", {"-o", "a.png", "-bmrt", "rays.rib", "-common", "scene.rib"}, w.path());
  EXPECT_EQ(o.err, "");
  EXPECT_FALSE(std::filesystem::exists(picture));
}

TEST(BadInput, FramesThatAreNotThereAreNamed) {
  Workspace w;
  w.write("scene.rib", "FrameBegin 3\nWorldBegin\nSphere 1 -1 1 360\nWorldEnd\nFrameEnd\n");
  const Outcome o = run("frankenrender", {"--frames", "4", "9", "scene.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err.find("no world of frames 4 to 9"), std::string::npos) << o.err;
  EXPECT_EQ(run("frankenrender", {"-o", "", "scene.rib"}, w.path()).exitCode, 2);
}

TEST(BadInput, MissingShaderIsOneMessageAndTheDefaultSurface) {
  Workspace w;
  Outcome o;
  const Picture p =
      render(w, "Surface \"nosuchshader\"\nSphere 1 -1 1 360\nSphere 0.5 -0.5 0.5 360\n", {}, &o);
  EXPECT_GT(p.at("R", 48, 36), 0.3f);
  EXPECT_NE(o.err.find("nosuchshader"), std::string::npos);
  EXPECT_EQ(o.err.find("nosuchshader"), o.err.rfind("nosuchshader")) << o.err;
  EXPECT_NE(o.err.find("RIE_NOSHADER"), std::string::npos) << o.err;
}

TEST(BadInput, MissingArchiveIsReportedWithItsPlaceAndTheRestIsRendered) {
  Workspace w;
  Outcome o;
  const Picture p =
      render(w, "Surface \"constant\"\nReadArchive \"nosuch.rib\"\nSphere 1 -1 1 360\n", {}, &o);
  EXPECT_EQ(p.at("R", 48, 36), 1.f);
  EXPECT_NE(o.err.find("nosuch.rib"), std::string::npos);
  EXPECT_NE(o.err.find("scene.rib:10"), std::string::npos) << o.err;
}

TEST(BadInput, MissingSceneIsOneMessageAndExitOne) {
  Workspace w;
  const Outcome o = run("frankenrender", {"nosuch.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err.find("nosuch.rib"), std::string::npos);
}

TEST(BadInput, UnknownOptionIsAUsageError) {
  Workspace w;
  EXPECT_EQ(run("frankenrender", {"--nosuchoption"}, w.path()).exitCode, 2);
  EXPECT_EQ(run("frankenrender", {"--help"}, w.path()).exitCode, 0);
}

TEST(BadInput, ATruncatedSceneNeverCrashesOrHangs) {
  Workspace w;
  w.write("raymirror.sl", kRayMirror);
  const std::string text = kHead + "WorldBegin\n" + kMirrorScene + "WorldEnd\n";
  for (size_t n = 0; n < text.size(); n += 97) {
    w.write("cut.rib", text.substr(0, n));
    const Outcome o = run("frankenrender", {"--res", "16", "12", "cut.rib"}, w.path());
    ASSERT_EQ(o.signal, 0) << "cut at " << n << ": " << o.err;
    if (n > kHead.size() + 20) {
      ASSERT_NE(o.err, "") << "cut at " << n;
    }
  }
}

TEST(BadInput, APictureThatCannotBeHeldIsRefused) {
  Workspace w;
  w.write(
      "scene.rib",
      "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 2000000000 2000000000 1\nPixelSamples 100000 100000\n"
      "PixelFilter \"box\" 1e9 1e9\nWorldBegin\nWorldEnd\n");
  const Outcome o = run("frankenrender", {"scene.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err.find("RIE_NOMEM"), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("RIE_LIMIT"), std::string::npos) << o.err;
  EXPECT_FALSE(std::filesystem::exists(w.path() / "out.exr"));
}

TEST(BadInput, NonFiniteGeometryIsDroppedWithAMessage) {
  Workspace w;
  Outcome o;
  const Picture p =
      render(w, "Surface \"constant\"\nPolygon \"P\" [0 0 1e999 1 0 0 1 1 0]\nSphere 1 -1 1 360\n", {}, &o);
  EXPECT_EQ(p.at("R", 48, 36), 1.f);
  EXPECT_NE(o.err, "");
}

TEST(BadInput, ADamagedCacheIsRefused) {
  Workspace w;
  render(w, "Surface \"constant\"\nSphere 1 -1 1 360\n");
  ASSERT_EQ(run("scenecache", {"build", "scene.rib", "-o", "good.fsc"}, w.path()).exitCode, 0);
  std::ifstream in(w.path() / "good.fsc", std::ios::binary);
  std::stringstream bytes;
  bytes << in.rdbuf();
  const std::string good = bytes.str();
  ASSERT_GT(good.size(), 1000u);
  for (const double cut : {0.0, 0.01, 0.5, 0.999}) {
    w.write("cut.fsc", good.substr(0, size_t(double(good.size()) * cut)));
    const Outcome o = run("frankenrender", {"cut.fsc"}, w.path());
    EXPECT_EQ(o.exitCode, 1) << cut << ": " << o.err;
    EXPECT_NE(o.err.find("cut.fsc"), std::string::npos) << o.err;
  }
  for (int i = 0; i < 24; ++i) {
    std::string bad = good;
    const size_t at = size_t(double(good.size() - 1) * i / 23.0);
    bad[at] = char(bad[at] ^ 0x10);
    w.write("flip.fsc", bad);
    const Outcome o = run("frankenrender", {"flip.fsc"}, w.path());
    EXPECT_EQ(o.signal, 0) << "byte " << at;
    EXPECT_EQ(o.exitCode, 1) << "byte " << at << ": " << o.err;
    EXPECT_NE(o.err.find("flip.fsc"), std::string::npos) << o.err;
  }
}

}  // namespace
}  // namespace fr::test
