// Textures from the outside: made and used within one RIB, in both processes, by mkmip, and not at all.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

std::string contents(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

/// The modules that a program and its children opened, as the dynamic linker tells.
std::string opened(const Workspace& w, const std::string& rib) {
  w.write("scene.rib", rib);
  const std::filesystem::path log = w.path() / "linker";
  std::filesystem::create_directory(log);
  const Outcome o = run("frankenrender", {"scene.rib"}, w.path(), {},
                        {{"LD_DEBUG", "files"}, {"LD_DEBUG_OUTPUT", (log / "log").string()}});
  EXPECT_EQ(o.exitCode, 0) << o.err;
  std::string all;
  int processes = 0;
  for (const auto& e : std::filesystem::directory_iterator(log)) all += contents(e.path()), ++processes;
  EXPECT_GE(processes, 1);
  std::filesystem::remove_all(log);
  return all;
}

const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\" \"string exrpixeltype\" [\"float\"]\n"
    "Format 96 72 1\nPixelSamples 2 2\nPixelFilter \"box\" 1 1\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\n";

TEST(Textures, ScenesWithoutThemDoNotLoadOpenImageIO) {
  const Workspace w;
  const std::string without =
      opened(w, kHead +
                    "WorldBegin\nLightSource \"pointlight\" 1 \"from\" [0 4 -4] \"intensity\" [30]\n"
                    "Surface \"mirror\"\nSphere 1 -1 1 360\nSurface \"paintedplastic\"\n"
                    "Translate 0 -2 0\nSphere 1 -1 1 360\nWorldEnd\n");
  EXPECT_NE(without.find("fr_display_exr"), std::string::npos) << "the linker's log is there";
  EXPECT_NE(without.find("embree"), std::string::npos) << "and that of the ray tracer's process";
  EXPECT_EQ(without.find("libOpenImageIO"), std::string::npos);
  EXPECT_EQ(without.find("fr_textures"), std::string::npos);
}

TEST(Textures, MadeFromAnImageOfTheSameFile) {
  const Workspace w;
  // The first frame is half red and half blue; the second shows it on a square that fills the view.
  w.write(
      "scene.rib",
      "FrameBegin 1\nDisplay \"first.tif\" \"file\" \"rgb\"\nQuantize \"rgba\" 255 0 255 0\nFormat 64 64 1\n"
      "PixelFilter \"box\" 1 1\nWorldBegin\nSurface \"constant\"\n"
      "Color [1 0 0]\nPolygon \"P\" [-2 -2 1 -2 2 1 0 2 1 0 -2 1]\n"
      "Color [0 0 1]\nPolygon \"P\" [0 -2 1 0 2 1 2 2 1 2 -2 1]\nWorldEnd\nFrameEnd\n"
      "MakeTexture \"first.tif\" \"first.tx\" \"clamp\" \"clamp\" \"gaussian\" 2 2\n"
      "FrameBegin 2\nDisplay \"out.exr\" \"openexr\" \"rgb\"\nFormat 64 64 1\nPixelFilter \"box\" 1 1\n"
      "WorldBegin\nSurface \"paintedplastic\" \"Ka\" [1] \"Kd\" [0] \"Ks\" [0] \"string texturename\" "
      "[\"first.tx\"]\n"
      "LightSource \"ambientlight\" 1\n"
      "Patch \"bilinear\" \"P\" [-1 1 1 1 1 1 -1 -1 1 1 -1 1]\nWorldEnd\nFrameEnd\n");
  const Outcome o = run("frankenrender", {"scene.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  const Picture p = readExr(w.path() / "out.exr");
  ASSERT_EQ(p.width, 64);
  for (const int y : {5, 32, 60}) {
    EXPECT_NEAR(p.at("R", 10, y), 1, 0.02);
    EXPECT_NEAR(p.at("B", 10, y), 0, 0.02);
    EXPECT_NEAR(p.at("R", 54, y), 0, 0.02);
    EXPECT_NEAR(p.at("B", 54, y), 1, 0.02);
  }
}

const std::string kBallOverPlane =
    "Surface \"matte\"\nAttributeBegin\nTranslate 0 0.5 0\nSphere 0.7 -0.7 0.7 360\nAttributeEnd\n"
    "Polygon \"P\" [-4 -1 -4  -4 -1 4  4 -1 4  4 -1 -4]\n";
std::string lightPass(const std::string& name, const std::string& type) {
  return "FrameBegin 1\nFormat 256 256 1\nPixelSamples 2 2\nDisplay \"" + name + "\" \"" + type +
         "\" \"z\"\nProjection \"perspective\" \"fov\" [50]\nRotate -90 1 0 0\nTranslate 0 -5 "
         "0\nWorldBegin\n" +
         kBallOverPlane + "WorldEnd\nFrameEnd\n";
}
std::string beautyPass(const std::string& shadowName, const std::string& out) {
  return "FrameBegin 2\nFormat 160 120 1\nPixelSamples 2 2\nPixelFilter \"box\" 1 1\nDisplay \"" + out +
         "\" \"openexr\" \"rgb\"\nProjection \"perspective\" \"fov\" [40]\nTranslate 0 -0.3 8\nWorldBegin\n"
         "LightSource \"shadowspot\" 1 \"from\" [0 5 0] \"to\" [0 0 0] \"intensity\" [20] \"coneangle\" "
         "[0.4]\n"
         "  \"string shadowname\" [\"" +
         shadowName + "\"] \"blur\" [0]\n" + kBallOverPlane + "WorldEnd\nFrameEnd\n";
}

// The whole chain: depth from the light, MakeShadow, a beauty pass; against shadows by rays.
TEST(Textures, ShadowMapsAgreeWithRays) {
  const Workspace w;
  w.write("rays.rib", beautyPass("raytrace", "rays.exr"));
  EXPECT_EQ(run("frankenrender", {"rays.rib"}, w.path()).exitCode, 0);
  const Picture rays = readExr(w.path() / "rays.exr");
  w.write("none.rib", beautyPass("", "none.exr"));
  EXPECT_EQ(run("frankenrender", {"none.rib"}, w.path()).exitCode, 0);
  const Picture none = readExr(w.path() / "none.exr");
  ASSERT_GT(rmse(rays, none), 0.04) << "there is a shadow to be seen";
  const struct {
    const char *z, *type, *make, *map;
  } cases[] = {{"light.z", "zfile", "MakeShadow \"light.z\" \"light.shd\"\n", "light.shd"},
               {"depth.exr", "openexr", "MakeShadow \"depth.exr\" \"depth.shd\"\n", "depth.shd"},
               {"direct.shd", "shadow", "", "direct.shd"}};
  for (const auto& c : cases) {
    w.write("maps.rib", lightPass(c.z, c.type) + c.make + beautyPass(c.map, "maps.exr"));
    const Outcome o = run("frankenrender", {"maps.rib"}, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.err, "") << c.z;
    const Picture maps = readExr(w.path() / "maps.exr");
    EXPECT_LT(rmse(rays, maps), 0.25 * rmse(rays, none)) << c.z;
    // No acne: what rays call lit is lit, but for the shadow's edge.
    int darker = 0;
    for (size_t i = 0; i < rays.channels.at("R").size(); ++i)
      darker += maps.channels.at("R")[i] < rays.channels.at("R")[i] - 0.05f;
    EXPECT_LT(darker, 160 * 120 / 200) << c.z;
  }
  // One picture on the command line does not take the light's pass away.
  const Outcome o = run("frankenrender", {"-o", "one.exr", "maps.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_TRUE(std::filesystem::exists(w.path() / "one.exr"));
  // rendrib does the same by rays alone.
  w.write("maps.rib", lightPass("light2.z", "zfile") + "MakeShadow \"light2.z\" \"light2.shd\"\n" +
                          beautyPass("light2.shd", "rendrib.exr"));
  EXPECT_EQ(run("rendrib", {"maps.rib"}, w.path()).exitCode, 0);
  EXPECT_LT(rmse(rays, readExr(w.path() / "rendrib.exr")), 0.4 * rmse(rays, none));
}

TEST(Textures, HitsSeeTheSameTextureInBothModes) {
  const Workspace w;
  w.write("ramp.sl", "surface ramp() { Ci = color(s, t, 0.5); Oi = 1; }");
  w.write("image.rib",
          "Display \"ramp.tif\" \"file\" \"rgb\"\nQuantize \"rgba\" 65535 0 65535 0\nFormat 128 128 "
          "1\nWorldBegin\n"
          "Surface \"ramp\"\nPatch \"bilinear\" \"P\" [-1 1 1 1 1 1 -1 -1 1 1 -1 1]\nWorldEnd\n");
  ASSERT_EQ(run("frankenrender", {"image.rib"}, w.path()).exitCode, 0);
  ASSERT_EQ(run("mkmip", {"-mode", "clamp", "ramp.tif", "ramp.tx"}, w.path()).exitCode, 0);
  w.write("tex.sl", "surface tex(string name = \"\";) { Ci = color texture(name); Oi = 1; }");
  w.write("look.sl", "surface look() { Ci = trace(P, vector(0, 0, -1)); Oi = 1; }");
  // A mirror that looks back, at a textured square behind the camera.
  w.write("scene.rib", "Option \"searchpath\" \"string texture\" [\".:@\"]\n" + kHead +
                           "WorldBegin\nSurface \"look\"\nPolygon \"P\" [-3 -3 0 -3 3 0 3 3 0 3 -3 0]\n"
                           "Surface \"tex\" \"string name\" [\"ramp.tx\"]\n"
                           "Patch \"bilinear\" \"P\" [-2 2 -9 2 2 -9 -2 -2 -9 2 -2 -9]\nWorldEnd\n");
  Picture pictures[2];
  for (int k = 0; k < 2; ++k) {
    const Outcome o = run("frankenrender", {k == 0 ? "--shm" : "--inproc", "scene.rib"}, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    EXPECT_EQ(o.err, "");
    pictures[k] = readExr(w.path() / "out.exr");
  }
  EXPECT_EQ(pictures[0], pictures[1]);
  // The point (x, y) of the mirror sees s = (x + 2) / 4, t = (2 - y) / 4; one unit is 36 / tan(20) / 5
  // pixels.
  const double pixels = 36 / std::tan(20 * M_PI / 180) / 5;
  for (const int px : {24, 48, 72})
    for (const int py : {18, 36, 54}) {
      const double x = (px + 0.5 - 48) / pixels, y = (36 - py - 0.5) / pixels;
      EXPECT_NEAR(pictures[0].at("R", px, py), (x + 2) / 4, 0.02);
      EXPECT_NEAR(pictures[0].at("G", px, py), (2 - y) / 4, 0.02);
      EXPECT_NEAR(pictures[0].at("B", px, py), 0.5, 0.01);
    }
}

// Six cameras in the middle of a world of coloured balls, MakeCubeFaceEnvironment, and a mirror that looks
// into the map; against a mirror that traces. The balls are far away, so the place of the mirror's points
// does not matter.
TEST(Textures, CubeFaceEnvironmentsAgreeWithRays) {
  const Workspace w;
  w.write("env.sl",
          "surface env(string map = \"\";) {\n"
          "  vector R = reflect(normalize(I), normalize(N));\n"
          "  if (map == \"\") Ci = trace(P, R); else Ci = environment(map, vtransform(\"world\", R));\n"
          "  Oi = 1;\n}\n");
  std::string world = "Surface \"constant\"\n";
  for (int k = 0; k < 14; ++k) {
    // Directions and colours without any symmetry.
    const double a = 2.4 * k, z = -0.95 + 1.9 * k / 13, r = std::sqrt(1 - z * z);
    world += "AttributeBegin\nColor [" + std::to_string(0.2 + 0.8 * (k % 3) / 2) + " " +
             std::to_string(0.2 + 0.8 * (k % 5) / 4) + " " + std::to_string(0.2 + 0.8 * (k % 7) / 6) +
             "]\nTranslate " + std::to_string(500 * r * std::cos(a)) + " " + std::to_string(500 * z) + " " +
             std::to_string(500 * r * std::sin(a)) + "\nSphere 130 -130 130 360\nAttributeEnd\n";
  }
  const int right[6][3] = {{0, 0, -1}, {0, 0, 1}, {1, 0, 0}, {1, 0, 0}, {1, 0, 0}, {-1, 0, 0}};
  const int up[6][3] = {{0, 1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}, {0, 1, 0}, {0, 1, 0}};
  const int axis[6][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  std::string faces, names;
  std::vector<std::string> files = {"-envcube"};
  for (int k = 0; k < 6; ++k) {
    files.push_back("face" + std::to_string(k) + ".tif");
    names += " \"" + files.back() + "\"";
    faces +=
        "FrameBegin " + std::to_string(k + 1) + "\nDisplay \"" + files.back() +
        "\" \"file\" \"rgb\"\nFormat 256 256 1\nPixelFilter \"box\" 1 1\nProjection \"perspective\" \"fov\" "
        "[90]\nConcatTransform [";
    for (int i = 0; i < 3; ++i)
      faces += std::to_string(right[k][i]) + " " + std::to_string(up[k][i]) + " " +
               std::to_string(axis[k][i]) + " 0 ";
    faces += "0 0 0 1]\nWorldBegin\n" + world + "WorldEnd\nFrameEnd\n";
  }
  const auto mirror = [&](const std::string& map, const std::string& out) {
    return "Display \"" + out +
           "\" \"openexr\" \"rgb\"\nFormat 96 96 1\nPixelSamples 3 3\nPixelFilter \"box\" 1 1\nProjection "
           "\"perspective\" \"fov\" [40]\nTranslate 0 0 3\nRotate 25 1 1 0\nWorldBegin\n" +
           world + "Surface \"env\" \"string map\" [\"" + map + "\"]\nSphere 1 -1 1 360\nWorldEnd\n";
  };
  w.write("all.rib", faces + "MakeCubeFaceEnvironment" + names + " \"room.env\" 90 \"box\" 1 1\n" +
                         mirror("room.env", "map.exr"));
  const Outcome o = run("frankenrender", {"all.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  w.write("rays.rib", mirror("", "rays.exr"));
  EXPECT_EQ(run("frankenrender", {"rays.rib"}, w.path()).exitCode, 0);
  files.push_back("other.env");
  EXPECT_EQ(run("mkmip", files, w.path()).exitCode, 0);
  w.write("other.rib", mirror("other.env", "other.exr"));
  EXPECT_EQ(run("frankenrender", {"other.rib"}, w.path()).exitCode, 0);
  const Picture map = readExr(w.path() / "map.exr"), rays = readExr(w.path() / "rays.exr");
  double mean = 0;
  for (const float v : rays.channels.at("R")) mean += double(v) / double(rays.channels.at("R").size());
  ASSERT_GT(mean, 0.1) << "there is something to be seen";
  EXPECT_LT(rmse(map, rays), 0.06);
  EXPECT_EQ(map, readExr(w.path() / "other.exr"));
}

TEST(Textures, MissingOnesAreOneErrorAndTheFrameIsFinished) {
  const Workspace w;
  w.write(
      "scene.rib",
      kHead +
          "MakeShadow \"nosuch.z\" \"nosuch.shd\"\n"
          "WorldBegin\nLightSource \"ambientlight\" 1\n"
          "Surface \"paintedplastic\" \"string texturename\" [\"nosuch.tx\"]\nSphere 1 -1 1 360\nWorldEnd\n");
  const Outcome o = run("frankenrender", {"scene.rib"}, w.path());
  EXPECT_EQ(o.exitCode, 1);
  const size_t first = o.err.find("nosuch.tx");
  ASSERT_NE(first, std::string::npos) << o.err;
  EXPECT_NE(o.err.find("RIE_NOFILE"), std::string::npos) << o.err;
  EXPECT_EQ(o.err.find("nosuch.tx", first + 1), std::string::npos) << "said once: " << o.err;
  EXPECT_NE(o.err.find("scene.rib:7"), std::string::npos) << "the request's place: " << o.err;
  const Picture p = readExr(w.path() / "out.exr");
  EXPECT_GT(p.at("R", 48, 36), 0.5) << "a missing texture is white";
}

TEST(Textures, SearchPaths) {
  const Workspace w;
  for (const char* folder : {"scene", "option", "variable", "before"})
    std::filesystem::create_directory(w.path() / folder);
  w.write("grey.rib",
          "Display \"grey.tif\" \"file\" \"rgb\"\nFormat 8 8 1\nWorldBegin\nSurface \"constant\"\nColor [.5 "
          ".5 .5]\n"
          "Polygon \"P\" [-9 -9 1 -9 9 1 9 9 1 9 -9 1]\nWorldEnd\n");
  ASSERT_EQ(run("frankenrender", {"grey.rib"}, w.path()).exitCode, 0);
  const auto copy = [&](const std::string& to) {
    std::filesystem::copy_file(w.path() / "grey.tif", w.path() / to);
  };
  copy("scene/beside.tif"), copy("option/option.tif"), copy("variable/variable.tif"),
      copy("before/before.tif");
  const std::string absolute = (w.path() / "grey.tif").string();
  std::string world;
  int column = 0;
  for (const std::string& name : {std::string("beside.tif"), std::string("option.tif"),
                                  std::string("variable.tif"), std::string("before.tif"), absolute}) {
    const std::string x0 = std::to_string(-1 + 0.4 * column), x1 = std::to_string(-0.6 + 0.4 * column);
    ++column;
    world += "Surface \"paintedplastic\" \"Ka\" [1] \"Kd\" [0] \"Ks\" [0] \"string texturename\" [\"" + name +
             "\"]\nPatch \"bilinear\" \"P\" [" + x0 + " 1 1 " + x1 + " 1 1 " + x0 + " -1 1 " + x1 +
             " -1 1]\n";
  }
  w.write("scene/scene.rib",
          "Option \"searchpath\" \"string texture\" [\"" + (w.path() / "before").string() +
              "\"]\nOption \"searchpath\" \"string texture\" [\"" + (w.path() / "option").string() +
              ":&:@\"]\n" +
              "Display \"out.exr\" \"openexr\" \"rgb\"\nFormat 50 50 1\nPixelFilter \"box\" 1 1\nWorldBegin\n"
              "LightSource \"ambientlight\" 1\n" +
              world + "WorldEnd\n");
  const Outcome o = run("frankenrender", {"scene/scene.rib"}, w.path(), {},
                        {{"TEXTURES", (w.path() / "variable").string()}});
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(o.err, "");
  const Picture p = readExr(w.path() / "out.exr");
  for (const int x : {5, 15, 25, 35, 45}) EXPECT_NEAR(p.at("R", x, 25), 0.5, 0.01) << x;
}

TEST(Textures, MkmipTeaches) {
  const Workspace w;
  const Outcome help = run("mkmip", {"--help"}, w.path());
  EXPECT_EQ(help.exitCode, 0);
  for (const char* word :
       {"-mode", "-smode", "-tmode", "-fov", "-envcube", "-envlatl", "-shadow", "-resize", "MakeTexture"})
    EXPECT_NE(help.out.find(word), std::string::npos) << word;
  const std::vector<std::vector<std::string>> wrong = {{},
                                                       {"a"},
                                                       {"-mode", "mirror", "a", "b"},
                                                       {"-nosuch", "a", "b"},
                                                       {"-resize", "big", "a", "b"},
                                                       {"-fov"},
                                                       {"-fov", "x", "a", "b"},
                                                       {"-envcube", "a", "b"},
                                                       {"-shadow", "-envlatl", "a", "b"}};
  for (const auto& a : wrong) {
    const Outcome o = run("mkmip", a, w.path());
    EXPECT_EQ(o.exitCode, 2);
    EXPECT_NE(o.err.find("mkmip -help"), std::string::npos) << o.err;
  }
  const Outcome missing = run("mkmip", {"nosuch.tif", "out.tx"}, w.path());
  EXPECT_EQ(missing.exitCode, 1);
  EXPECT_NE(missing.err.find("nosuch.tif"), std::string::npos);
  w.write("text.tif", "no image");
  EXPECT_EQ(run("mkmip", {"text.tif", "out.tx"}, w.path()).exitCode, 1);
  EXPECT_FALSE(std::filesystem::exists(w.path() / "out.tx"));
}

}  // namespace
}  // namespace fr::test
