// scenecache: what each subcommand says and leaves behind, with bad input, full disks and kill -9.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::string bytesOf(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::stringstream s;
  s << in.rdbuf();
  return s.str();
}

const std::string kHead =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 96 72 1\nProjection \"perspective\" \"fov\" [40]\n";

/// A ball, a mesh of small faces, two instances, something behind the camera.
std::string scene(double ballX = 0, double eye = 5) {
  return kHead + "Translate 0 0 " + std::to_string(eye) +
         "\nObjectBegin 1\nScale 0.2 0.2 0.2\nTorus 1 0.4 0 360 360\nObjectEnd\nWorldBegin\nSurface "
         "\"constant\"\n"
         "AttributeBegin\nAttribute \"identifier\" \"name\" [\"ball\"]\nTranslate " +
         std::to_string(ballX) +
         " 0 0\nSphere 0.7 -0.7 0.7 360\nAttributeEnd\n"
         "AttributeBegin\nAttribute \"identifier\" \"name\" [\"sheet\"]\nPatch \"bilinear\" \"P\" [-1 -1 1  "
         "1 -1 1  -1 1 1  1 1 1]\n"
         "AttributeEnd\nAttributeBegin\nTranslate 1 1 0\nObjectInstance 1\nTranslate -2 0 0\nObjectInstance "
         "1\n"
         "Translate 0 -2 0\nObjectInstance 1\nAttributeEnd\n"
         "AttributeBegin\nAttribute \"identifier\" \"name\" [\"behind\"]\nTranslate 0 0 -20\nSphere 1 -1 1 "
         "360\nAttributeEnd\n"
         "PointsPolygons [3 3] [0 1 2 1 3 2] \"P\" [0 0 0  0.004 0 0  0 0.004 0  0.004 0.004 0]\nWorldEnd\n";
}

class SceneCacheTool : public ::testing::Test {
 protected:
  Outcome tool(const std::vector<std::string>& arguments, const std::function<void(int)>& whileRunning = {},
               const std::function<void()>& inChild = {}) const {
    return run("scenecache", arguments, w_.path(), whileRunning, {}, {}, inChild);
  }
  Outcome build(const std::string& text, const std::string& output,
                std::vector<std::string> more = {}) const {
    w_.write("scene.rib", text);
    more.insert(more.begin(), {"build", "scene.rib", "-o", output});
    const Outcome o = tool(more);
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return o;
  }
  json jsonOf(const std::vector<std::string>& arguments, int status = 0) const {
    const Outcome o = tool(arguments);
    EXPECT_EQ(o.exitCode, status) << o.err;
    return json::parse(o.out, nullptr, false);
  }
  Picture render(const std::string& what) const {
    const Outcome o = run("frankenrender", {what}, w_.path());
    EXPECT_EQ(o.exitCode, 0) << o.err;
    return readExr(w_.path() / "out.exr");
  }
  /// Names in the folder but for what the test itself wrote.
  std::vector<std::string> files() const {
    std::vector<std::string> names;
    for (const auto& e : fs::directory_iterator(w_.path())) names.push_back(e.path().filename());
    std::sort(names.begin(), names.end());
    return names;
  }
  Workspace w_;
};

TEST_F(SceneCacheTool, EverySubcommandTeachesItself) {
  const Outcome all = tool({"--help"});
  EXPECT_EQ(all.exitCode, 0);
  for (const char* sub : {"build", "info", "ls", "verify", "dump", "diff", "prune"}) {
    EXPECT_NE(all.out.find(sub), std::string::npos) << sub;
    const Outcome o = tool({sub, "--help"});
    EXPECT_EQ(o.exitCode, 0);
    EXPECT_GT(o.out.size(), 200u) << sub;
    EXPECT_EQ(tool({sub, "--nonsense"}).exitCode, 2);
    EXPECT_EQ(tool({sub}).exitCode, 2);
  }
  EXPECT_EQ(tool({}).exitCode, 2);
}

TEST_F(SceneCacheTool, AllRefuseWhatIsNoCache) {
  w_.write("empty.fsc", "");
  w_.write("text.fsc", "Sphere 1 -1 1 360\n");
  w_.write("old.fsc", std::string("FSCFILE1\x05\0\0\0", 12) + std::string(5000, '\0'));
  fs::create_directory(w_.path() / "folder.fsc");
  for (const char* file : {"missing.fsc", "empty.fsc", "text.fsc", "folder.fsc", "old.fsc"}) {
    for (const std::vector<std::string>& a :
         std::vector<std::vector<std::string>>{{"info", file},
                                               {"ls", file},
                                               {"verify", file},
                                               {"dump", file},
                                               {"prune", file, "-o", "x.fsc"}}) {
      const Outcome o = tool(a);
      EXPECT_EQ(o.exitCode, 1) << a[0] << " " << file << ", signal " << o.signal;
      EXPECT_NE(o.err.find(file), std::string::npos) << o.err;
    }
    EXPECT_EQ(tool({"diff", file, file}).exitCode, 2);
  }
  EXPECT_NE(tool({"info", "old.fsc"}).err.find("version 5"), std::string::npos);
  EXPECT_FALSE(fs::exists(w_.path() / "x.fsc"));
}

TEST_F(SceneCacheTool, BuildRefusesBadInput) {
  w_.write("scene.rib", scene());
  w_.write("none.rib", "# nothing\n");
  for (const std::vector<std::string>& a : std::vector<std::vector<std::string>>{
           {"build", "missing.rib", "-o", "x.fsc"},
           {"build", "none.rib", "-o", "x.fsc"},
           {"build", "scene.rib", "-o", "x.fsc", "--frame", "7"},
           {"build", "scene.rib", "-o", "no/such/folder/x.fsc"},
           {"build", "scene.rib", "-o", "x.fsc", "--scratch", "no/such"},
           {"build", "scene.rib", "-o", "x.fsc", "--reuse", "missing.fsc"}}) {
    const Outcome o = tool(a);
    EXPECT_EQ(o.exitCode, 1) << a.back() << ": " << o.err;
    EXPECT_NE(o.err, "") << a.back();
  }
  EXPECT_EQ(tool({"build", "scene.rib", "-o", "x.fsc", "--memory", "much"}).exitCode, 2);
  EXPECT_EQ(tool({"build", "scene.rib", "-o", "x.fsc", "--rate", "-1"}).exitCode, 2);
  EXPECT_FALSE(fs::exists(w_.path() / "x.fsc"));
}

TEST_F(SceneCacheTool, ListsWhatTheSceneHas) {
  build(scene(), "a.fsc");
  const json info = jsonOf({"info", "a.fsc", "--json"});
  EXPECT_EQ(info["resolution"][0], 96);
  EXPECT_EQ(info["notDiced"], 0);
  const json all = jsonOf({"ls", "a.fsc", "--json"});
  ASSERT_EQ(all.size(), info["objects"]);
  uint64_t faces = 0, bytes = 0, levels = 0;
  for (const json& o : all) {
    faces += o["micropolygons"].get<uint64_t>() + o["triangles"].get<uint64_t>();
    bytes += o["bytes"].get<uint64_t>();
    for (const json& n : o["gridsByLevels"]) levels += n.get<uint64_t>();
  }
  EXPECT_EQ(faces, info["micropolygons"].get<uint64_t>() + info["triangles"].get<uint64_t>());
  EXPECT_EQ(levels, info["grids"]);
  EXPECT_LE(bytes, info["bytes"]["nodes"].get<uint64_t>() + info["bytes"]["arena"].get<uint64_t>());
  const json ball = jsonOf({"ls", "a.fsc", "--object", "ball", "--json"});
  ASSERT_EQ(ball.size(), 1u);
  EXPECT_EQ(ball[0]["type"], "sphere");
  EXPECT_EQ(ball[0]["file"], "scene.rib");
  EXPECT_NE(tool({"ls", "a.fsc"}).out.find("sheet"), std::string::npos);
  EXPECT_EQ(tool({"ls", "a.fsc", "--object", "nobody"}).exitCode, 1);
}

TEST_F(SceneCacheTool, TheMemoryBudgetChangesNothing) {
  build(scene(), "a.fsc", {"--threads", "1"});
  build(scene(), "b.fsc", {"--memory", "64M", "--scratch", ".", "--threads", "1"});
  EXPECT_EQ(bytesOf(w_.path() / "a.fsc"), bytesOf(w_.path() / "b.fsc"));
  EXPECT_EQ(tool({"diff", "a.fsc", "b.fsc"}).exitCode, 0);
}

TEST_F(SceneCacheTool, ManyObjectsStayInsideTheBudget) {
  // Each with a transformation of its own: tables of some hundred bytes an object.
  constexpr int kObjects = 200000;
  std::string text = kHead + "ShadingRate 16\nTranslate 0 0 300\nWorldBegin\n";
  for (int i = 0; i < kObjects; ++i)
    text += "AttributeBegin\nTranslate " + std::to_string(i % 400) + " " + std::to_string(i / 400) +
            " 0\nPolygon \"P\" [0 0 0 1 0 0 1 1 0]\nAttributeEnd\n";
  text += "WorldEnd\n";
  const auto peak = [&](const std::string& output, std::vector<std::string> more) {
    more.insert(more.end(), {"--json", "--threads", "1"});
    return json::parse(build(text, output, std::move(more)).out)["peakResidentBytes"].get<uint64_t>();
  };
  const uint64_t free = peak("free.fsc", {});
  constexpr uint64_t kBudget = uint64_t(64) << 20;
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  EXPECT_GT(free, kBudget * 2) << "the scene fits: this tests nothing";
#endif
  const uint64_t held = peak("held.fsc", {"--memory", "64M", "--scratch", "."});
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  // Between two looks of the pager a table that is checked comes in at gigabytes a second.
  EXPECT_LE(held, kBudget + kBudget / 2) << "without a budget: " << free;
#endif
  EXPECT_EQ(tool({"diff", "free.fsc", "held.fsc"}).exitCode, 0);
}

TEST_F(SceneCacheTool, RateAndMultiplierScaleTheGrids) {
  build(scene(), "a.fsc");
  build(scene(), "coarse.fsc", {"--rate", "16"});
  build(scene(), "fine.fsc", {"--patch-multiplier", "2"});
  const auto ball = [&](const char* file) {
    return jsonOf({"ls", file, "--object", "ball", "--json"})[0]["micropolygons"].get<double>();
  };
  // Powers of two in each direction: 4 x fewer and more there, give or take one rounding.
  EXPECT_LE(ball("coarse.fsc") * 4, ball("a.fsc"));
  EXPECT_GE(ball("fine.fsc"), ball("a.fsc") * 2);
}

TEST_F(SceneCacheTool, DumpShowsTheSurface) {
  build(scene(), "a.fsc");
  for (const int level : {0, 2}) {
    const Outcome o = tool({"dump", "a.fsc", "--object", "ball", "--level", std::to_string(level)});
    ASSERT_EQ(o.exitCode, 0) << o.err;
    std::istringstream in(o.out);
    std::string word;
    uint64_t vertices = 0, faces = 0;
    for (std::string line; std::getline(in, line);) {
      double x, y, z;
      if (std::sscanf(line.c_str(), "v %lf %lf %lf", &x, &y, &z) == 3) {
        ++vertices;
        // World space, and the radius that the RIB gave; float rounding only.
        EXPECT_NEAR(std::sqrt(x * x + y * y + z * z), 0.7, 1e-5);
      }
      faces += line.rfind("f ", 0) == 0;
    }
    EXPECT_GT(vertices, faces);
    if (level == 0) {
      EXPECT_EQ(faces,
                jsonOf({"ls", "a.fsc", "--object", "ball", "--json"})[0]["micropolygons"].get<uint64_t>());
    }
  }
  EXPECT_EQ(tool({"dump", "a.fsc", "--object", "nobody"}).exitCode, 1);
  EXPECT_EQ(tool({"dump", "a.fsc", "--patch", "999999"}).exitCode, 1);
  EXPECT_EQ(tool({"dump", "a.fsc", "--level", "9"}).exitCode, 2);
  EXPECT_EQ(tool({"dump", "a.fsc", "--patch", "0"}).exitCode, 0);
}

TEST_F(SceneCacheTool, ADumpedRibLooksLikeTheScene) {
  build(scene(), "a.fsc");
  ASSERT_EQ(tool({"dump", "a.fsc", "-o", "look.rib"}).exitCode, 0);
  const Picture original = render("scene.rib");
  const Outcome o = run("frankenrender", {"-o", "look.exr", "look.rib"}, w_.path());
  ASSERT_EQ(o.exitCode, 0) << o.err;
  const Picture look = readExr(w_.path() / "look.exr");
  ASSERT_EQ(look.width, original.width);
  // The same silhouettes: coverage differs at most where micropolygons of another grid round an outline.
  double differs = 0, covered = 0;
  for (size_t i = 0; i < look.channels.at("A").size(); ++i) {
    differs += std::abs(look.channels.at("A")[i] - original.channels.at("A")[i]);
    covered += original.channels.at("A")[i];
  }
  EXPECT_GT(covered, 500);
  EXPECT_LT(differs, 0.01 * covered);
}

TEST_F(SceneCacheTool, DiffNamesWhatChanged) {
  build(scene(0), "a.fsc");
  build(scene(0.5), "b.fsc");
  const json d = jsonOf({"diff", "a.fsc", "b.fsc", "--json"}, 1);
  ASSERT_EQ(d["changed"].size(), 1u);
  EXPECT_EQ(d["changed"][0]["name"], "ball");
  EXPECT_EQ(d["changed"][0]["what"], "shape");
  EXPECT_TRUE(d["added"].empty() && d["removed"].empty() && d["frame"].empty()) << d;
  build(scene(0, 6), "moved.fsc");
  EXPECT_EQ(jsonOf({"diff", "a.fsc", "moved.fsc", "--json"}, 1)["frame"][0], "camera position");
  std::string without = scene();
  without.erase(without.find("Attribute \"identifier\" \"name\" [\"sheet\"]"),
                without.find("AttributeEnd\nAttributeBegin\nTranslate 1") -
                    without.find("Attribute \"identifier\" \"name\" [\"sheet\"]"));
  build(without, "c.fsc");
  const json r = jsonOf({"diff", "a.fsc", "c.fsc", "--json"}, 1);
  ASSERT_EQ(r["removed"].size(), 1u) << r;
  EXPECT_EQ(r["removed"][0]["name"], "sheet");
  std::string red = scene();
  red.insert(red.find("Sphere 0.7"), "Color 1 0 0\n");
  build(red, "red.fsc");
  const json look = jsonOf({"diff", "a.fsc", "red.fsc", "--json"}, 1);
  ASSERT_EQ(look["changed"].size(), 1u) << look;
  EXPECT_EQ(look["changed"][0]["what"], "look");
  EXPECT_NE(tool({"diff", "a.fsc", "red.fsc"}).out.find("~ ball (look"), std::string::npos);
}

TEST_F(SceneCacheTool, ReuseCopiesWhatIsTheSame) {
  build(scene(0), "one.fsc");
  build(scene(0.5), "fresh.fsc");
  const json made = json::parse(build(scene(0.5), "two.fsc", {"--reuse", "one.fsc", "--json"}).out);
  const json all = jsonOf({"info", "two.fsc", "--json"});
  const uint64_t ball = jsonOf({"ls", "two.fsc", "--object", "ball", "--json"})[0]["grids"];
  // Instances' records are made again from their prototypes.
  EXPECT_EQ(made["gridsReused"].get<uint64_t>() + ball + all["gridsShared"].get<uint64_t>(),
            all["grids"].get<uint64_t>() + all["meshlets"].get<uint64_t>());
  EXPECT_GT(made["gridsReused"], 0);
  EXPECT_EQ(tool({"diff", "two.fsc", "fresh.fsc"}).exitCode, 0);
  EXPECT_EQ(tool({"verify", "two.fsc"}).exitCode, 0);
  EXPECT_EQ(tool({"dump", "two.fsc", "-o", "two.obj"}).exitCode, 0);
  EXPECT_EQ(tool({"dump", "fresh.fsc", "-o", "fresh.obj"}).exitCode, 0);
  EXPECT_EQ(bytesOf(w_.path() / "two.obj"), bytesOf(w_.path() / "fresh.obj"));
}

TEST_F(SceneCacheTool, ReuseWithAnotherCameraIsWhatDicingWouldMake) {
  const std::string before = scene(0, 5), after = scene(0, 5.03);
  build(before, "one.fsc");
  build(after, "fresh.fsc");
  const json made = json::parse(build(after, "two.fsc", {"--reuse", "one.fsc", "--json"}).out);
  EXPECT_GT(made["gridsReused"], 0);
  for (const char* file : {"two", "fresh"}) {
    const std::string name(file);
    ASSERT_EQ(tool({"dump", name + ".fsc", "-o", name + ".obj"}).exitCode, 0);
  }
  EXPECT_EQ(bytesOf(w_.path() / "two.obj"), bytesOf(w_.path() / "fresh.obj"));
  // Into the same file, as the next frame of a shot would.
  build(before, "shot.fsc");
  build(after, "shot.fsc", {"--reuse", "shot.fsc"});
  EXPECT_EQ(tool({"diff", "shot.fsc", "fresh.fsc"}).exitCode, 0);
}

TEST_F(SceneCacheTool, DisplacedGridsAreReusedWhileTheirShaderIsTheSame) {
  const auto shader = [&](const char* height) {
    w_.write("bumps.sl", std::string("displacement bumps() { P += ") + height +
                             " * normalize(N) * noise(10 * P); N = calculatenormal(P); }\n");
  };
  const std::string text =
      kHead +
      "Translate 0 0 5\nWorldBegin\nAttribute \"displacementbound\" \"float sphere\" [0.2] \"string "
      "coordinatesystem\" [\"shader\"]\nDisplacement \"bumps\"\nSphere 1 -1 1 360\nWorldEnd\n";
  shader("0.1");
  build(text, "one.fsc");
  EXPECT_GT(json::parse(build(text, "same.fsc", {"--reuse", "one.fsc", "--json"}).out)["gridsReused"], 0);
  shader("0.2");
  EXPECT_EQ(json::parse(build(text, "other.fsc", {"--reuse", "one.fsc", "--json"}).out)["gridsReused"], 0);
  build(text, "fresh.fsc");
  ASSERT_EQ(tool({"dump", "other.fsc", "-o", "other.obj"}).exitCode, 0);
  ASSERT_EQ(tool({"dump", "fresh.fsc", "-o", "fresh.obj"}).exitCode, 0);
  EXPECT_EQ(bytesOf(w_.path() / "other.obj"), bytesOf(w_.path() / "fresh.obj"));
}

TEST_F(SceneCacheTool, PruneKeepsThePicture) {
  build(scene(), "a.fsc");
  const Picture whole = render("a.fsc");
  ASSERT_EQ(tool({"prune", "a.fsc", "-o", "same.fsc"}).exitCode, 0);
  EXPECT_EQ(jsonOf({"info", "same.fsc", "--json"})["grids"], jsonOf({"info", "a.fsc", "--json"})["grids"]);
  const json p = jsonOf({"prune", "a.fsc", "-o", "b.fsc", "--drop", "ball", "--no-rays", "--json"});
  EXPECT_LT(p["grids"], p["gridsBefore"]);
  EXPECT_LT(p["bytes"], p["bytesBefore"]);
  for (const char* gone : {"ball", "behind"})
    EXPECT_EQ(jsonOf({"ls", "b.fsc", "--object", gone, "--json"})[0]["grids"], 0) << gone;
  EXPECT_GT(jsonOf({"ls", "b.fsc", "--object", "sheet", "--json"})[0]["grids"], 0);
  EXPECT_EQ(tool({"verify", "b.fsc"}).exitCode, 0);
  EXPECT_EQ(worst(whole, render("same.fsc")), 0.0);
  EXPECT_EQ(worst(whole, render("b.fsc")), 0.0);
}

TEST_F(SceneCacheTool, VerifyFindsEveryDamagedByte) {
  build(scene(), "good.fsc");
  EXPECT_EQ(jsonOf({"verify", "good.fsc", "--json"})["sound"], true);
  const std::string good = bytesOf(w_.path() / "good.fsc");
  for (int i = 0; i < 32; ++i) {
    std::string bad = good;
    const size_t at = size_t(double(good.size() - 1) * i / 31.0);
    bad[at] = char(bad[at] ^ 0x10);
    w_.write("bad.fsc", bad);
    for (const char* sub : {"verify", "info", "ls", "dump"}) {
      const Outcome o = tool({sub, "bad.fsc"});
      EXPECT_EQ(o.signal, 0) << sub << ", byte " << at;
      if (std::string(sub) == "verify") {
        EXPECT_EQ(o.exitCode, 1) << "byte " << at;
      }
    }
  }
  for (const double cut : {0.1, 0.5, 0.9, 0.9999}) {
    w_.write("bad.fsc", good.substr(0, size_t(double(good.size()) * cut)));
    EXPECT_EQ(tool({"verify", "bad.fsc"}).exitCode, 1);
  }
}

/// Finely diced: some seconds of work.
std::string longScene() {
  return kHead +
         "Translate 0 0 5\nShadingRate 0.0005\nWorldBegin\nSphere 1 -1 1 360\nSphere 2 -2 2 360\nWorldEnd\n";
}

/// Until some file that the process has open holds more than a few megabytes.
void waitUntilItWrites(int pid) {
  for (int i = 0; i < 6000; ++i, usleep(5000)) {
    std::error_code ignored;
    for (const auto& e : fs::directory_iterator("/proc/" + std::to_string(pid) + "/fd", ignored)) {
      const auto size = fs::file_size(e.path(), ignored);  // of a file without a name too
      if (!ignored && size > (4u << 20)) return;
    }
  }
}

TEST_F(SceneCacheTool, NothingIsLeftBehindByKillAndCtrlC) {
  build(scene(), "x.fsc");
  const std::string before = bytesOf(w_.path() / "x.fsc");
  w_.write("long.rib", longScene());
  const std::vector<std::string> names = files();
  for (const int signal : {SIGKILL, SIGINT, SIGTERM}) {
    const Outcome o = tool({"build", "long.rib", "-o", "x.fsc"}, [&](int pid) {
      waitUntilItWrites(pid);
      kill(pid, signal);
    });
    if (signal == SIGKILL) {
      EXPECT_EQ(o.signal, SIGKILL);
    } else {
      EXPECT_EQ(o.exitCode, 130) << o.err;
      EXPECT_NE(o.err.find("x.fsc was not written"), std::string::npos) << o.err;
    }
    EXPECT_EQ(bytesOf(w_.path() / "x.fsc"), before);
    EXPECT_EQ(files(), names);
  }
}

TEST_F(SceneCacheTool, AFileThatMayNotGrowIsAClearMessage) {
  w_.write("long.rib", longScene());
  const std::vector<std::string> names = files();
  for (const rlim_t bytes : {rlim_t(4096), rlim_t(3) << 20, rlim_t(20) << 20}) {
    const Outcome o = tool({"build", "long.rib", "-o", "x.fsc"}, {}, [&] {
      const rlimit r{bytes, bytes};
      setrlimit(RLIMIT_FSIZE, &r);
    });
    EXPECT_EQ(o.signal, 0) << bytes;
    EXPECT_EQ(o.exitCode, 1) << bytes;
    // Of the scene's memory file the first time, of the cache the others.
    EXPECT_NE(o.err.find(bytes == 4096 ? "file size limit" : "x.fsc: error: no room"), std::string::npos)
        << o.err;
    EXPECT_EQ(files(), names);
  }
}

}  // namespace
}  // namespace fr::test
