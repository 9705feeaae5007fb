// Procedural primitives on their way into the skeleton: programs, archives, what is never opened.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "scene_cache/procedural_programs.h"
#include "scene_cache/scene_loader.h"
#include "scene_cache/screen_extent.h"
#include "scene_cache/skeleton_image.h"

namespace fr::cache {
namespace {

namespace fs = std::filesystem;

DMat4 translation(DVec3 t) {
  DMat4 m(1);
  m[3] = DVec4(t, 1);
  return m;
}

class Procedurals : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / fmt::format("procedural_test.{}", getpid());
    fs::create_directories(folder_);
    setReportSink([this](const Error& e) { reports_.push_back(e); });
  }
  void TearDown() override {
    setReportSink({});
    setErrorMode(ErrorMode::kPrint);
    fs::remove_all(folder_);
  }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name) << text;
    return (folder_ / name).string();
  }
  /// A program in the language of sh.
  std::string script(const std::string& name, const std::string& text) const {
    const std::string path = write(name, "#!/bin/sh\n" + text);
    ::chmod(path.c_str(), 0755);
    return path;
  }
  std::string read(const std::string& name) const {
    std::stringstream s;
    s << std::ifstream(folder_ / name).rdbuf();
    return s.str();
  }
  static std::string runProgram(const std::string& command, const std::string& data,
                                const std::string& bound = "[-1 1 -1 1 -1 1]") {
    return "Procedural \"RunProgram\" [\"" + command + "\" \"" + data + "\"] " + bound + "\n";
  }

  struct Loaded {
    FrameCounts counts;
    struct Thing {
      DVec3 at;          // where the object's origin is in the world
      std::string name;  // Attribute "identifier" "name"
      Color color;
      uint32_t lights;
      PrimitiveType type;
    };
    std::vector<Thing> things;
  };
  /// One world; `world` stands between WorldBegin and WorldEnd.
  Loaded load(const std::string& world, const std::string& head = {}, LoadOptions options = {}) {
    const std::string scene =
        write("scene.rib", head + (head.empty() ? kCamera : "") + "WorldBegin\n" + world + "WorldEnd\n");
    Loaded all;
    int frames = 0;
    const std::vector<RibInput> inputs{{scene}};
    const auto r = loadScene(inputs, options, [&](Frame&& f) {
      SkeletonImage image(dup(f.skeletonFd()));
      auto s = Skeleton::open(image.bytes(), false);
      EXPECT_TRUE(s.ok());
      all.counts = f.counts();
      ++frames;
      for (const ObjectRecord& o : s->objects()) {
        const AttributeRecord& a = s->attributes()[o.attributes];
        all.things.push_back({DVec3(s->toWorld(o.transform, 0)[3]), std::string(s->string(a.name)), a.color,
                              a.lights.count, o.type});
      }
      return true;
    });
    EXPECT_TRUE(r.ok()) << r.error().str();
    EXPECT_EQ(frames, 1);
    return all;
  }
  bool said(const std::string& text, RiError code, int line = 0) const {
    for (const Error& e : reports_)
      if (e.code == code && e.message.find(text) != std::string::npos && (line == 0 || e.where.line == line))
        return true;
    return false;
  }
  std::string all() const {
    std::string s;
    for (const Error& e : reports_) s += e.str() + '\n';
    return s;
  }

  /// Orthographic: one unit is 50 pixels, the picture is 100 x 100. Four lines.
  const std::string kCamera =
      "Format 100 100 1\nScreenWindow -1 1 -1 1\nProjection \"orthographic\"\nTranslate 0 0 5\n";
  fs::path folder_;
  std::vector<Error> reports_;
};

TEST_F(Procedurals, OneProgramAnswersManyQuestions) {
  const std::string program = script("balls", "echo started >> '" + (folder_ / "log").string() +
                                                  "'\nwhile read detail radius; do\n  echo \"$detail\" >> '" +
                                                  (folder_ / "log").string() +
                                                  "'\n  echo \"Sphere $radius -$radius $radius 360\"\n"
                                                  "  printf '\\377'\ndone\n");
  const Loaded l = load("Color 1 0 0\nTranslate 0.25 0 0\n" + runProgram(program, "1") + "Color 0 1 0\n" +
                        "Translate 0.25 0 0\n" + runProgram(program, "0.5", "[-.5 .5 -.25 .25 -1 1]"));
  EXPECT_TRUE(reports_.empty()) << all();
  ASSERT_EQ(l.things.size(), 2u);
  EXPECT_EQ(l.things[0].at, DVec3(0.25, 0, 0));
  EXPECT_EQ(l.things[0].color, Color(1, 0, 0));
  EXPECT_EQ(l.things[1].at, DVec3(0.5, 0, 0));
  EXPECT_EQ(l.things[1].color, Color(0, 1, 0));
  EXPECT_EQ(l.counts.procedurals, 2u);
  // Pixels of the bound's rectangle: 100 x 100 and 50 x 25.
  EXPECT_EQ(read("log"), "started\n10000\n1250\n");
}

TEST_F(Procedurals, DetailIsScaledAndCutAtTheNearPlane) {
  const std::string program = script("echo", "while read detail data; do echo \"$detail\" >> '" +
                                                 (folder_ / "log").string() + "'; printf '\\377'; done\n");
  load(runProgram(program, "x", "[-.1 .1 -.1 .1 -1 1]"), kCamera + "RelativeDetail 0.5\n");
  load(runProgram(program, "x", "[-.1 .1 -.1 .1 -9 1]"),
       "Format 100 100 1\nProjection \"perspective\"\nClipping 0.5 100\nTranslate 0 0 5\n");
  // At distance 1 with a field of view of 90 degrees, 0.2 units are 10 pixels of 100.
  load(runProgram(program, "x", "[-.1 .1 -.1 .1 0 .5]"),
       "Format 100 100 1\nProjection \"perspective\" \"fov\" 90\nTranslate 0 0 1\n");
  std::istringstream log(read("log"));
  double detail[3] = {};
  for (double& d : detail) log >> d;
  EXPECT_NEAR(detail[0], 50, 1e-3);
  EXPECT_NEAR(detail[1], 400, 1e-2) << "0.2 units at distance 0.5 are 20 pixels";
  EXPECT_NEAR(detail[2], 100, 1e-3);
}

TEST_F(Procedurals, AProgramMayEndInsteadOfTheMark) {
  const std::string program = script("once", "read detail data\necho \"Sphere $data -1 1 360\"\n");
  const Loaded l = load(runProgram(program, "1") + runProgram(program, "2"));
  EXPECT_EQ(l.things.size(), 2u);
  EXPECT_TRUE(reports_.empty()) << all();
}

TEST_F(Procedurals, CommandsHaveArgumentsAndSearchPaths) {
  fs::create_directories(folder_ / "tools");
  script("tools/ball", "while read d data; do echo \"Sphere $1 -1 1 360 #$2\"; printf '\\377'; done\n");
  const std::string path =
      "Option \"searchpath\" \"procedural\" [\"" + (folder_ / "tools").string() + "\"]\n";
  const Loaded l =
      load(runProgram("ball 2 'a b'", "") + runProgram("sh -c 'echo \\\"Sphere 1 -1 1 360\\\"'", ""),
           path + kCamera);
  EXPECT_EQ(l.things.size(), 2u);
  EXPECT_TRUE(reports_.empty()) << all();
}

TEST_F(Procedurals, WhatDiesOrFailsIsReportedWithItsPlaceAndTheRestIsRead) {
  const std::string killed = script("killed", "read x\necho 'Sphere 1 -1 1 360'\nkill -9 $$\n");
  const std::string failed = script("failed", "read x\nexit 3\n");
  const std::string silent = script("silent", "read x\n");
  const Loaded l = load(runProgram(killed, "") + runProgram(failed, "") + runProgram(silent, "") +
                        runProgram("/nowhere/at/all", "") + runProgram("'", "") + "Sphere 2 -2 2 360\n");
  EXPECT_TRUE(said("killed by signal 9", RiError::kSystem, 6)) << all();
  EXPECT_TRUE(said("ended with status 3", RiError::kSystem, 7)) << all();
  EXPECT_TRUE(said("without an answer", RiError::kMissingData, 8)) << all();
  EXPECT_TRUE(said("/nowhere/at/all", RiError::kNoFile, 9)) << all();
  EXPECT_TRUE(said("no command", RiError::kSyntax, 10)) << all();
  EXPECT_EQ(reports_.size(), 5u) << all();
  EXPECT_EQ(l.things.size(), 2u) << "what came before the end counts";
  EXPECT_EQ(l.counts.dropped, 5u);
}

TEST_F(Procedurals, WhatAlwaysFailsIsNotStartedForEver) {
  const std::string failed = script("failed", "echo x >> '" + (folder_ / "log").string() + "'\nexit 1\n");
  std::string world;
  for (int i = 0; i < 9; ++i) world += runProgram(failed, "");
  load(world);
  EXPECT_EQ(read("log").size(), size_t(2 * ProceduralPrograms::kMostFailures));
  EXPECT_TRUE(said("not started again", RiError::kSystem, 14)) << all();
}

TEST_F(Procedurals, AHungProgramIsKilled) {
  const std::string hung = script(
      "hung", "echo $$ > '" + (folder_ / "pid").string() + "'\necho 'Sphere 1 -1 1 360'\nexec sleep 1000\n");
  const Loaded l = load(runProgram(hung, "x") + "Sphere 2 -2 2 360\n",
                        "Option \"procedural\" \"patience\" 0.5\n" + kCamera);
  EXPECT_TRUE(said("said nothing for 0.5 s", RiError::kSystem, 7)) << all();
  EXPECT_EQ(l.things.size(), 2u);
  const int pid = std::stoi(read("pid"));
  EXPECT_NE(::kill(pid, 0), 0) << "it lives on";
}

TEST_F(Procedurals, AHungProgramThatReadsNothingIsKilledToo) {
  const std::string hung = script("hung", "exec sleep 1000\n");
  // More than a pipe holds.
  load(runProgram(hung, std::string(1 << 18, 'x')), "Option \"procedural\" \"patience\" 0.5\n" + kCamera);
  EXPECT_TRUE(said("said nothing", RiError::kSystem)) << all();
}

TEST_F(Procedurals, ProgramsLeaveWithTheScene) {
  const std::string stubborn =
      script("stubborn", "trap '' TERM\necho $$ > '" + (folder_ / "pid").string() +
                             "'\nread x\nprintf 'Sphere 1 -1 1 360\\377'\nwhile :; do sleep 1; done\n");
  load(runProgram(stubborn, ""));
  EXPECT_TRUE(reports_.empty()) << all();
  EXPECT_NE(::kill(std::stoi(read("pid")), 0), 0);
}

TEST_F(Procedurals, AProgramMayAskForItself) {
  // A ball and two smaller procedurals of the same program, which still speaks when they come up.
  const std::string program = script(
      "tree",
      "while read detail level; do\n  echo 'Sphere 1 -1 1 360'\n  if [ $level -gt 0 ]; then\n"
      "    for x in -1 1; do\n      echo \"AttributeBegin Translate $x 0 0 Scale .5 .5 .5\"\n"
      "      echo \"Procedural \\\"RunProgram\\\" [\\\"$0\\\" \\\"$((level-1))\\\"] [-2 2 -2 2 -2 2]\"\n"
      "      echo AttributeEnd\n    done\n  fi\n  printf '\\377'\ndone\n");
  EXPECT_EQ(load(runProgram(program, "3")).things.size(), 15u);
  EXPECT_TRUE(reports_.empty()) << all();
  // Inside a solid everything is expanded at its place.
  const Loaded l = load("SolidBegin \"primitive\"\n" + runProgram(program, "2") + "SolidEnd\n");
  EXPECT_EQ(l.things.size(), 7u);
  EXPECT_TRUE(reports_.empty()) << all();
}

TEST_F(Procedurals, BinaryAnswersMayHoldTheMarkAsData) {
  // A matrix whose last float is NaN-free but holds bytes 0377: -1.99999988 is bf ff ff ff.
  std::string rib = "ConcatTransform ";
  rib += '\310';
  rib += char(16);
  for (int i = 0; i < 16; ++i) {
    const unsigned char one[4] = {0x3f, 0x80, 0, 0}, zero[4] = {}, big[4] = {0xbf, 0xff, 0xff, 0xff};
    rib.append(reinterpret_cast<const char*>(i == 12 ? big : i % 5 == 0 ? one : zero), 4);
  }
  write("answer", rib + " Sphere 1 -1 1 360 \377");
  const std::string program =
      script("binary", "while read x; do cat '" + (folder_ / "answer").string() + "'; done\n");
  for (const char* solid : {"", "SolidBegin \"primitive\"\n"}) {
    const Loaded l =
        load(solid + runProgram(program, "") + runProgram(program, "") + (*solid ? "SolidEnd\n" : ""));
    ASSERT_EQ(l.things.size(), 2u) << all();
    EXPECT_NEAR(l.things[1].at.x, -2, 1e-6);
  }
  EXPECT_TRUE(reports_.empty()) << all();
}

TEST_F(Procedurals, ArchivesAreReadInTheStateOfTheirPlace) {
  write("part.rib",
        "Sphere 1 -1 1 360\nAttribute \"identifier\" \"name\" \"inside\"\nColor 0 0 1\nDisk 0 1 360\n");
  const Loaded l = load(
      "LightSource \"ambientlight\" 1\nTransformBegin\nTranslate 0.5 0 0\nColor 1 0 0\n"
      "Procedural \"DelayedReadArchive\" [\"part.rib\"] [-1 1 -1 1 -1 1]\nTransformEnd\n"
      "Color 0 1 0\nLightSource \"ambientlight\" 2\n"
      "Procedural2 \"DelayedReadArchive2\" \"SimpleBound\" \"string filename\" [\"part.rib\"] \"float[6] "
      "bound\" [-1 "
      "1 -1 1 -1 1]\nDisk 0 1 360\n");
  EXPECT_TRUE(reports_.empty()) << all();
  ASSERT_EQ(l.things.size(), 5u);
  EXPECT_EQ(l.things[0].type, PrimitiveType::kDisk) << "procedurals wait for the end of the world";
  EXPECT_EQ(l.things[0].color, Color(0, 1, 0));
  EXPECT_EQ(l.things[0].name, "") << "what an archive sets ends with it";
  EXPECT_EQ(l.things[1].at, DVec3(0.5, 0, 0));
  EXPECT_EQ(l.things[1].color, Color(1, 0, 0));
  EXPECT_EQ(l.things[1].lights, 1u) << "a light that was declared later does not shine back";
  EXPECT_EQ(l.things[2].name, "inside");
  EXPECT_EQ(l.things[3].at, DVec3(0));
  EXPECT_EQ(l.things[3].color, Color(0, 1, 0));
  EXPECT_EQ(l.things[3].lights, 2u);
}

TEST_F(Procedurals, AnArchiveCannotEndWhatIsOpenAroundIt) {
  write("rude.rib",
        "AttributeEnd\nWorldEnd\nFrameEnd\nAttributeBegin\nTranslate 1 0 0\nMotionBegin [0 1]\nSphere 1 -1 "
        "1 360\n");
  const Loaded l = load(
      "Procedural \"DelayedReadArchive\" [\"rude.rib\"] [-1 1 -1 1 -1 1]\n"
      "Procedural \"DelayedReadArchive\" [\"rude.rib\"] [-1 1 -1 1 -1 1]\nSphere 1 -1 1 360\n",
      "FrameBegin 1\n" + kCamera);
  ASSERT_EQ(l.things.size(), 3u);
  EXPECT_EQ(l.things[1].at, DVec3(1, 0, 0));
  EXPECT_EQ(l.things[2].at, DVec3(1, 0, 0));
  EXPECT_TRUE(said("AttributeEnd", RiError::kNesting, 1)) << all();
  EXPECT_TRUE(said("WorldEnd", RiError::kNesting, 2)) << all();
  EXPECT_TRUE(said("FrameEnd", RiError::kNesting, 3)) << all();
  EXPECT_TRUE(said("AttributeBegin without", RiError::kNesting)) << all();
}

TEST_F(Procedurals, LoopsEnd) {
  write("loop.rib",
        "Sphere 1 -1 1 360\nProcedural \"DelayedReadArchive\" [\"loop.rib\"] [-1 1 -1 1 -1 1]\n"
        "Procedural \"DelayedReadArchive\" [\"loop.rib\"] [-1 1 -1 1 -1 1]\n");
  const Loaded l = load("Procedural \"DelayedReadArchive\" [\"loop.rib\"] [-1 1 -1 1 -1 1]\n");
  EXPECT_EQ(l.things.size(), 1u);
  EXPECT_TRUE(said("reads itself", RiError::kLimit)) << all();
  // A program that asks for itself with the same bound and data for ever.
  const std::string endless = script(
      "endless",
      "while read d x; do echo \"Procedural \\\"RunProgram\\\" [\\\"$0\\\" \\\"\\\"] [-1 1 -1 1 -1 1]\"; "
      "printf '\\377'; done\n");
  load(runProgram(endless, ""));
  EXPECT_TRUE(said("nested deeper", RiError::kLimit)) << all();
}

TEST_F(Procedurals, MissingOrNamelessOnesAreReported) {
  load(
      "Procedural \"DelayedReadArchive\" [\"gone.rib\"] [-1 1 -1 1 -1 1]\n"
      "Procedural \"DynamicLoad\" [\"gone\" \"\"] [-1 1 -1 1 -1 1]\n"
      "Procedural \"Nonsense\" [\"x\"] [-1 1 -1 1 -1 1]\n"
      "Procedural2 \"DelayedReadArchive2\" \"SimpleBound\"\nProcedural2 \"Nonsense\" \"SimpleBound\"\n");
  EXPECT_TRUE(said("gone.rib", RiError::kNoFile, 6)) << all();
  EXPECT_TRUE(said("was not found", RiError::kNoFile, 7)) << all();
  EXPECT_TRUE(said("Nonsense", RiError::kBadToken, 8)) << all();
  EXPECT_TRUE(said("filename", RiError::kMissingData, 9)) << all();
  EXPECT_TRUE(said("Nonsense", RiError::kBadToken, 10)) << all();
}

TEST_F(Procedurals, WhatNobodyCanSeeIsNeverOpened) {
  write("ball.rib", "Sphere 1 -1 1 360\n");
  write("mirror.rib", "Surface \"mirror\"\nSphere 1 -1 1 360\n");
  const auto archive = [](const std::string& file, double x) {
    return fmt::format(
        "TransformBegin Translate {} 0 0 Procedural \"DelayedReadArchive\" [\"{}\"] [-1 1 -1 1 -1 1] "
        "TransformEnd\n",
        x, file);
  };
  LoadOptions noRays;
  noRays.asksRays = [](const std::string& name, const auto&) { return name == "mirror"; };
  // The picture ends at 1 and the filter reaches one pixel, 0.02, further.
  const std::string world = archive("ball.rib", 0) + archive("ball.rib", 2.01) + archive("ball.rib", 2.03) +
                            archive("missing.rib", -5);
  Loaded l = load(world, "Surface \"matte\"\n" + kCamera, noRays);
  EXPECT_EQ(l.things.size(), 2u);
  EXPECT_EQ(l.counts.procedurals, 2u);
  EXPECT_EQ(l.counts.proceduralsUnopened, 2u);
  EXPECT_TRUE(reports_.empty()) << "a file that nobody needs may be missing: " << all();

  // A shader that asks for rays, even one that an archive brings along, opens everything.
  l = load(archive("ball.rib", 5) + archive("mirror.rib", 0), "Surface \"matte\"\n" + kCamera, noRays);
  EXPECT_EQ(l.things.size(), 2u);
  EXPECT_EQ(l.counts.proceduralsUnopened, 0u);
  // A mirror that nobody sees does not.
  l = load(archive("mirror.rib", 5) + archive("ball.rib", 0), "Surface \"matte\"\n" + kCamera, noRays);
  EXPECT_EQ(l.counts.proceduralsUnopened, 1u);
  // Lights with ray-traced shadows ask too.
  l = load("Attribute \"light\" \"shadows\" \"on\"\nLightSource \"pointlight\" 1\n" + archive("ball.rib", 5) +
               "Sphere 1 -1 1 360\n",
           kCamera, noRays);
  EXPECT_EQ(l.counts.proceduralsUnopened, 0u);
  // On request, and for guests who ask about the whole scene.
  l = load("Attribute \"procedural\" \"integer immediatesubdivide\" 1\n" + archive("ball.rib", 5), kCamera,
           noRays);
  EXPECT_EQ(l.counts.proceduralsUnopened, 0u);
  l = load(archive("ball.rib", 5), kCamera);
  EXPECT_EQ(l.counts.proceduralsUnopened, 0u);
}

TEST(ScreenExtent, ViewIsCertain) {
  ScreenCamera c;
  c.record.projection = ProjectionType::kPerspective;
  c.record.fov = 90;
  c.record.resolution[0] = c.record.resolution[1] = 100;
  const float window[4] = {-1, 1, -1, 1};
  std::copy(window, window + 4, c.record.screenWindow);
  const int crop[4] = {0, 99, 0, 99};
  std::copy(crop, crop + 4, c.record.cropPixels);
  c.record.clipping[0] = 0.1f, c.record.clipping[1] = 100;
  c.record.dof[0] = kRiInfinity;
  c.filterRadius[0] = c.filterRadius[1] = 0;
  const std::vector<DMat4> identity{DMat4(1)};
  c.worldToCamera = identity;
  const auto inView = [&](ri::Bound b, std::vector<DMat4> toWorld = {DMat4(1)}) {
    return screenExtent(c, toWorld, b).inView;
  };
  EXPECT_TRUE(inView({-1, 1, -1, 1, 4, 5}));
  EXPECT_TRUE(inView({-1, 1, -1, 1, -4, 5})) << "around the eye";
  EXPECT_FALSE(inView({-1, 1, -1, 1, -4, 0.05})) << "behind the near plane";
  EXPECT_FALSE(inView({-1, 1, -1, 1, 101, 105})) << "behind the far plane";
  EXPECT_TRUE(inView({4.9, 6, -1, 1, 4, 5})) << "the side of the picture is at x = z";
  EXPECT_FALSE(inView({5.1, 6, -1, 1, 4, 5}));
  EXPECT_FALSE(inView({-1, 1, -7, -5.1, 4, 5}));
  EXPECT_TRUE(inView({-kRiInfinity, kRiInfinity, -1, 1, -4, -3})) << "an infinite bound is everywhere";
  // A mover that crosses the picture between its keys.
  EXPECT_TRUE(inView({-1, 1, -1, 1, 4, 5}, {translation({-20, 0, 0}), translation({20, 0, 0})}));
  EXPECT_FALSE(inView({-1, 1, -1, 1, 4, 5}, {translation({20, 0, 0}), translation({40, 0, 0})}));
  // A lens of radius 0.5 in focus at 1 sees x up to z + 0.5 |1 - z|.
  c.record.dof[0] = 1, c.record.dof[1] = 1, c.record.dof[2] = 1;
  EXPECT_TRUE(inView({6.9, 8, -1, 1, 4, 5}));
  EXPECT_FALSE(inView({7.1, 8, -1, 1, 4, 5}));
  // Only the crop window's part of the picture.
  c.record.dof[0] = kRiInfinity;
  c.record.cropPixels[0] = 50;
  EXPECT_FALSE(inView({-3, -0.1, -1, 1, 4, 5}));
  EXPECT_TRUE(inView({-3, 0.1, -1, 1, 4, 5}));
  // A camera that moves may see anything.
  const std::vector<DMat4> moving{DMat4(1), translation({1, 0, 0})};
  c.worldToCamera = moving;
  EXPECT_TRUE(inView({50, 60, -1, 1, 4, 5}));
}

TEST(CommandWords, AsAShellSplitsThem) {
  using Words = std::vector<std::string>;
  EXPECT_EQ(commandWords("perl  gen.pl\t-x"), (Words{"perl", "gen.pl", "-x"}));
  EXPECT_EQ(commandWords("a 'b c' \"d \\\" e\" f\\ g ''"), (Words{"a", "b c", "d \" e", "f g", ""}));
  EXPECT_EQ(commandWords("  "), Words{});
  EXPECT_EQ(commandWords("a 'b"), Words{});
}

}  // namespace
}  // namespace fr::cache
