// Procedurals from the outside: both renderers see what they expand to; the program that loads shared
// objects.
#include <gtest/gtest.h>

#include <sys/stat.h>
#include <cstdlib>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 48 36 1\nPixelSamples 2 2\nPixelFilter \"box\" 1 1\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nOption \"procedural\" \"patience\" "
    "20\nDeclare \"note\" \"varying float\"\n";
const std::string kBefore =
    "LightSource \"distantlight\" 1\nSurface \"plastic\"\nColor [1 0.5 0.25]\n"
    "Basis \"b-spline\" 1 \"b-spline\" 1\nRotate 20 0 1 0\n";

class Procedural : public ::testing::TestWithParam<const char*> {
 protected:
  Picture render(const std::string& world, Outcome* outcome = nullptr) {
    w_.write("scene.rib", kHead + "WorldBegin\n" + kBefore + world + "WorldEnd\n");
    const Outcome o = run(GetParam(), {"scene.rib"}, w_.path(), {}, {{"HOME", "/nonexistent"}});
    if (outcome) {
      *outcome = o;
    } else {
      EXPECT_EQ(o.exitCode, 0) << o.err;
      EXPECT_EQ(o.err, "");
    }
    Picture p = readExr(w_.path() / "out.exr");
    std::filesystem::remove(w_.path() / "out.exr");
    return p;
  }
  static std::string object() { return FR_TEST_PROCEDURAL; }
  Workspace w_;
};

TEST_P(Procedural, ProgramsArchivesAndSharedObjectsGiveThePictureOfTheirRib) {
  const std::string balls =
      "AttributeBegin Translate -1 0 0 Sphere 0.4 -0.4 0.4 360 AttributeEnd\n"
      "AttributeBegin Translate 0 0 0 Sphere 0.4 -0.4 0.4 360 AttributeEnd\n"
      "AttributeBegin Translate 1 0 0 Sphere 0.4 -0.4 0.4 360 AttributeEnd\n";
  const Picture direct = render(balls);
  ASSERT_GT(direct.at("A", 24, 18), 0.9);
  w_.write("balls.rib", balls);
  w_.write("balls.sh", "while read detail data; do cat balls.rib; printf '\\377'; done\n");
  const std::string bound = " [-1.4 1.4 -.4 .4 -.4 .4]\n";
  EXPECT_EQ(render("Procedural \"DelayedReadArchive\" [\"balls.rib\"]" + bound), direct);
  EXPECT_EQ(render("Procedural \"RunProgram\" [\"sh balls.sh\" \"\"]" + bound), direct);
  EXPECT_EQ(render("Procedural \"DynamicLoad\" [\"" + object() + "\" \"balls 3 0.4\"]" + bound), direct);
  EXPECT_EQ(
      render("Procedural2 \"DynamicLoad\" \"SimpleBound\" \"string dsoname\" [\"" + object() +
             "\"] \"float[6] bound\" [-1.4 1.4 -.4 .4 -.4 .4] \"int count\" 3 \"float radius\" 0.4 \"string "
             "kind\" \"balls\"\n"),
      direct);
}

TEST_P(Procedural, SharedObjectsKnowTheStateOfTheirPlace) {
  // Curves with as many widths as the b-spline basis wants, a variable that only the scene has declared,
  // objects that must not be the scene's own of the same number, and the camera's transformation.
  const std::string curve =
      "Curves \"cubic\" [5] \"nonperiodic\" \"P\" [-1 -1 0 -.5 1 0 0 -1 0 .5 1 0 1 -1 0] \"width\" [.1 .2 "
      ".3] \"note\" "
      "[1 2 3]\n";
  const std::string object = "ObjectBegin 1 Sphere 0.3 -0.3 0.3 360 ObjectEnd\n";
  const std::string instances = "TransformBegin Translate 0 0.8 0 ObjectInstance 1 TransformEnd\n";
  const Picture direct =
      render(object + curve + "TransformBegin Translate 0 -0.8 0 Disk 0 0.3 360 TransformEnd\n" +
             "TransformBegin Translate 1 0 0 Disk 0 0.3 360 TransformEnd\n" + instances);
  EXPECT_EQ(render(object + "Procedural \"DynamicLoad\" [\"" + this->object() +
                   "\" \"state\"] [-2 2 -2 2 -2 2]\n" + instances),
            direct);
}

TEST_P(Procedural, ASharedObjectThatCrashesOrIsNoneCostsItsOwnGeometryAlone) {
#ifdef __SANITIZE_ADDRESS__
  // The crash is meant: it is to look as without the sanitizer.
  const char* before = std::getenv("ASAN_OPTIONS");
  const std::string options = std::string(before ? before : "") + ":handle_segv=0";
  ::setenv("ASAN_OPTIONS", options.c_str(), 1);
#endif
  const std::string rest = "Disk 0 0.3 360\n";
  const Picture direct = render(rest);
  const std::string bound = " [-1 1 -1 1 -1 1]\n";
  w_.write("text.so", "this is no shared object\n");
  Outcome o;
  EXPECT_EQ(render("Procedural \"DynamicLoad\" [\"" + object() + "\" \"crash\"]" + bound + rest, &o), direct);
  EXPECT_EQ(o.exitCode, 1);
  EXPECT_NE(o.err.find("scene.rib:15"), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("killed by signal 11"), std::string::npos) << o.err;
  EXPECT_EQ(render("Procedural \"DynamicLoad\" [\"./text.so\" \"\"]" + bound + rest, &o), direct);
  EXPECT_NE(o.err.find("ended with status 1"), std::string::npos) << o.err;
  EXPECT_EQ(render("Procedural \"DynamicLoad\" [\"gone\" \"\"]" + bound + rest, &o), direct);
  EXPECT_NE(o.err.find("RIE_NOFILE"), std::string::npos) << o.err;
}

TEST_P(Procedural, SharedObjectsMayPrintAndExpandFurther) {
  Outcome o;
  const Picture p =
      render("Procedural \"DynamicLoad\" [\"" + object() + "\" \"nested 2\"] [-2 2 -2 2 -2 2]\n", &o);
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_EQ(
      p, render("AttributeBegin Scale .5 .5 .5 Disk 0 1 360 AttributeEnd\nTranslate 0.5 0 0 Scale .5 .5 .5\n"
                "AttributeBegin Scale .5 .5 .5 Disk 0 1 360 AttributeEnd\nTranslate 0.5 0 0 Scale .5 .5 .5\n"
                "Sphere 1 -1 1 360\n"));
  EXPECT_NE(o.err.find("hello from level 2\nhello from level 1\nhello from level 0\n"), std::string::npos)
      << o.err;
}

INSTANTIATE_TEST_SUITE_P(Both, Procedural, ::testing::Values("frankenrender", "rendrib"));

TEST(ProceduralView, WhatNobodySeesIsNeverOpened) {
  Workspace w;
  w.write("ball.rib", "Sphere 1 -1 1 360\n");
  w.write("mirror.sl", "surface mirror() { Oi = 1; Ci = trace(P, reflect(I, normalize(N))); }\n");
  const std::string archives =
      "Procedural \"DelayedReadArchive\" [\"ball.rib\"] [-1 1 -1 1 -1 1]\n"
      "Translate 0 0 -20\nProcedural \"DelayedReadArchive\" [\"ball.rib\"] [-1 1 -1 1 -1 1]\n";
  for (const char* surface : {"plastic", "mirror"}) {
    w.write("scene.rib", kHead + "WorldBegin\nSurface \"" + surface + "\"\n" + archives + "WorldEnd\n");
    const Outcome o = run("frankenrender", {"--stats", "scene.rib"}, w.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    const std::string expected =
        surface == std::string("plastic") ? "1 expanded, 1 never opened" : "2 expanded, 0 never opened";
    EXPECT_NE(o.out.find(expected), std::string::npos) << o.out;
  }
}

}  // namespace
}  // namespace fr::test
