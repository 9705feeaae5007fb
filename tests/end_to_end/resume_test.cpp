// Frames that are stopped or killed half way, and go on with --resume: the picture is that of one undisturbed
// run.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <thread>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

namespace fs = std::filesystem;

// Slow to shade, in many buckets.
const std::string kSlow =
    "surface slow() {\n"
    "  float i, x = 0;\n"
    "  for (i = 0; i < 3000; i += 1) x += noise(P * i);\n"
    "  Ci = color(mod(x, 1), xcomp(N), 0.5); Oi = 1;\n"
    "}\n";
const std::string kScene =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 160 120 1\nPixelSamples 2 2\n"
    "Option \"limits\" \"bucketsize\" [16 16]\nPixelFilter \"gaussian\" 3 3\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nWorldBegin\n"
    "Surface \"slow\"\nSphere 1.4 -1.4 1.4 360\nWorldEnd\n";

struct Frame {
  Workspace w;
  fs::path picture = w.path() / "out.exr", journal = w.path() / "out.exr.unfinished";
  Frame() { w.write("slow.sl", kSlow), w.write("s.rib", kScene); }
  Outcome render(bool resume, int signal = 0) {
    std::vector<std::string> arguments{"--inproc", "--quiet", "--threads", "1", "s.rib"};
    if (resume) arguments.insert(arguments.begin(), "--resume");
    return run("frankenrender", arguments, w.path(), [&](int pid) {
      if (signal == 0) return;
      // As soon as some buckets are kept; without a journal, after a moment.
      for (int i = 0; i < 20000; ++i) {
        std::error_code none;
        const auto size = fs::file_size(journal, none);
        if (!none && size > 20000) break;
        if (!resume && i > 150) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      ::kill(pid, signal);
    });
  }
};

Picture undisturbed() {
  Frame f;
  EXPECT_EQ(f.render(false).exitCode, 0);
  return readExr(f.picture);
}

TEST(Progressive, ShowsTheWholeFrameEarlyAndEndsWithThePicture) {
  const Picture whole = undisturbed();
  Frame f;
  Picture early;
  const Outcome o = run("frankenrender", {"--progressive", "--inproc", "--quiet", "--threads", "1", "s.rib"},
                        f.w.path(), [&](int) {
                          for (int i = 0; i < 20000 && early.channels.empty(); ++i) {
                            std::this_thread::sleep_for(std::chrono::milliseconds(1));
                            // Pictures get their names when they are complete.
                            if (fs::exists(f.picture)) early = readExr(f.picture);
                          }
                        });
  EXPECT_EQ(o.exitCode, 0) << o.err;
  ASSERT_FALSE(early.channels.empty());
  EXPECT_FALSE(early == whole);
  // The ball is there, as a whole: its middle, its corners.
  EXPECT_EQ(early.at("A", 80, 60), 1);
  EXPECT_GT(early.at("A", 80, 18), 0.9f);
  EXPECT_GT(early.at("A", 80, 102), 0.9f);
  EXPECT_EQ(early.at("A", 2, 2), 0);
  EXPECT_EQ(readExr(f.picture), whole);
  // What can be read once is rendered once.
  const Outcome piped = run("frankenrender", {"--progressive", "--inproc", "/dev/null"}, f.w.path());
  EXPECT_NE(piped.err.find("rendered in one pass"), std::string::npos) << piped.err;
}

TEST(Resume, AKilledFrameGoesOnWhereItWas) {
  const Picture whole = undisturbed();
  Frame f;
  int kills = 0;
  for (; kills < 3; ++kills) {
    const Outcome killed = f.render(true, SIGKILL);
    if (killed.signal != SIGKILL) break;
    EXPECT_FALSE(fs::exists(f.picture));
    EXPECT_TRUE(fs::exists(f.journal));
  }
  EXPECT_GE(kills, 1);
  const Outcome last = f.render(true);
  EXPECT_EQ(last.exitCode, 0) << last.err;
  EXPECT_EQ(readExr(f.picture), whole);
  EXPECT_FALSE(fs::exists(f.journal));
}

TEST(Resume, CtrlCKeepsTheFinishedBucketsInThePicture) {
  const Picture whole = undisturbed();
  Frame f;
  const Outcome stopped = f.render(true, SIGINT);
  EXPECT_EQ(stopped.exitCode, 130);
  EXPECT_NE(stopped.err.find("--resume goes on"), std::string::npos) << stopped.err;
  EXPECT_EQ(stopped.err.find("ErrorHandler"), std::string::npos) << stopped.err;  // one message, not two
  const Picture part = readExr(f.picture);
  size_t equal = 0, empty = 0;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x) {
      const bool same =
          part.at("R", x, y) == whole.at("R", x, y) && part.at("A", x, y) == whole.at("A", x, y);
      const bool nothing = part.at("R", x, y) == 0 && part.at("A", x, y) == 0;
      EXPECT_TRUE(same || nothing) << x << " " << y;
      equal += same && !nothing, empty += nothing && !same;
    }
  EXPECT_GT(equal + empty, 0u);
  EXPECT_GT(empty, 0u);
  EXPECT_EQ(f.render(true).exitCode, 0);
  EXPECT_EQ(readExr(f.picture), whole);
  EXPECT_FALSE(fs::exists(f.journal));
}

/// A changed scene is no continuation.
TEST(Resume, AnotherSceneStartsFromTheBeginning) {
  Frame f;
  ASSERT_EQ(f.render(true, SIGKILL).signal, SIGKILL);
  std::string changed = kScene;
  changed.replace(changed.find("1.4 -1.4 1.4"), 12, "1.1 -1.1 1.1");
  f.w.write("s.rib", changed);
  EXPECT_EQ(f.render(true).exitCode, 0);
  Frame fresh;
  fresh.w.write("s.rib", changed);
  EXPECT_EQ(fresh.render(false).exitCode, 0);
  EXPECT_EQ(readExr(f.picture), readExr(fresh.picture));
}

}  // namespace
}  // namespace fr::test
