// kill -9 of the programs, at random moments spread over their whole run: the picture comes out the same, or
// nothing is left behind.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <random>
#include <set>
#include <thread>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::microseconds;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr int kKills = 10;  // programs run ten times as long
#else
constexpr int kKills = 100;
#endif

// Everything that a tracer does: dicing (displaced: by the same process that traces), building, visibility,
// and hits that are shaded and ask themselves.
const std::string kMirror =
    "surface mirror() {\n"
    "  normal n = normalize(faceforward(N, I));\n"
    "  color c = 0.2 + 0.5 * visibility(P, P + vector(2, 5, 3));\n"
    "  c += 0.3 * trace(P, reflect(normalize(I), n));\n"
    "  Ci = c * Cs; Oi = 1;\n"
    "}\n";
const std::string kDent =
    "displacement dent() {\n"
    "  P += 0.05 * noise(5 * transform(\"object\", P)) * normalize(N);\n"
    "  N = calculatenormal(P);\n"
    "}\n";
const std::string kScene =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 64 48 1\nPixelSamples 2 2\n"
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nWorldBegin\n"
    "Surface \"mirror\"\nAttribute \"displacementbound\" \"sphere\" [0.1]\n"
    "AttributeBegin\nDisplacement \"dent\"\nColor [1 0.5 0.2]\nSphere 1 -1 1 360\nAttributeEnd\n"
    "AttributeBegin\nDisplacement \"dent\"\nTranslate 1.5 0 1\nSphere 0.7 -0.7 0.7 360\nAttributeEnd\n"
    "Color [0.4 0.6 1]\nPolygon \"P\" [-9 -1 -9 -9 -1 9 9 -1 9 9 -1 -9]\nWorldEnd\n";

std::set<std::string> namesIn(const std::filesystem::path& folder) {
  std::set<std::string> names;
  for (const auto& e : std::filesystem::directory_iterator(folder)) names.insert(e.path().filename());
  return names;
}

std::string contents(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// A folder with the scene, and what an undisturbed run makes of it.
class Crash : public ::testing::Test {
 protected:
  void SetUp() override {
    // Orphans become our children, so that none can escape.
    ASSERT_EQ(prctl(PR_SET_CHILD_SUBREAPER, 1), 0);
    sharedMemory_ = namesIn("/dev/shm");
    w_.write("mirror.sl", kMirror);
    w_.write("dent.sl", kDent);
    w_.write("scene.rib", kScene);
    std::filesystem::create_directory(w_.path() / "tmp");
    // Twice: the first one warms the disk's cache.
    for (int i = 0; i < 2; ++i) {
      const auto start = Clock::now();
      const Outcome o = render();
      ASSERT_EQ(o.exitCode, 0) << o.err;
      ASSERT_EQ(o.err, "");
      undisturbed_ = std::chrono::duration_cast<microseconds>(Clock::now() - start);
    }
    image_ = contents(output());
    ASSERT_FALSE(image_.empty());
    files_ = namesIn(w_.path());
    ASSERT_EQ(render().exitCode, 0);
    ASSERT_EQ(contents(output()), image_) << "the scene is no good for this test: its picture changes";
  }

  std::filesystem::path output() const { return w_.path() / "out.exr"; }
  Outcome render(const std::function<void(int)>& whileRunning = {}) const {
    return run("frankenrender", {"--shm", "scene.rib"}, w_.path(), whileRunning,
               {{"TMPDIR", (w_.path() / "tmp").string()}});
  }

  /// Waits until no process of ours is left. Seconds; 10 when there still was one (it is then killed).
  static double waitForOrphans() {
    const auto start = Clock::now();
    for (;;) {
      const pid_t p = waitpid(-1, nullptr, WNOHANG);
      const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
      if (p < 0) return seconds;
      if (p > 0) continue;
      if (seconds > 10) {
        for (const int orphan : childrenOf(getpid())) kill(orphan, SIGKILL);
        while (waitpid(-1, nullptr, 0) > 0) {
        }
        return 10;
      }
      std::this_thread::sleep_for(microseconds(100));
    }
  }

  void expectNothingLeft(const std::string& when) const {
    EXPECT_EQ(namesIn("/dev/shm"), sharedMemory_) << when;
    EXPECT_EQ(namesIn(w_.path() / "tmp"), std::set<std::string>{}) << when;
    EXPECT_EQ(namesIn(w_.path()), files_) << when;
  }

  Workspace w_;
  std::set<std::string> sharedMemory_, files_;
  std::string image_;  // the file's bytes
  microseconds undisturbed_{};
};

/// The newest process that `parent` started, other than `known`, or 0 when `parent` has ended.
int nextChild(int parent, int known, const std::atomic<bool>& ended) {
  while (!ended) {
    for (const int child : childrenOf(parent))
      if (child != known) return child;
    std::this_thread::sleep_for(microseconds(100));
  }
  return 0;
}

TEST_F(Crash, AKilledTracerChangesNothing) {
  std::mt19937 random(1998);
  int kills = 0, runs = 0, restarts = 0;
  double seconds = 0;
  while (kills < kKills) {
    std::atomic<bool> ended{false};
    std::thread killer;
    const auto start = Clock::now();
    const Outcome o = render([&](int pid) {
      // Three in a row at most: four that answer nothing and a fifth that dies by itself would be an error.
      killer = std::thread([&, pid] {
        for (int i = 0, known = 0; i < 3; ++i) {
          // While it starts, or anywhere.
          const auto longest = random() % 3 == 0 ? undisturbed_ / 10 : undisturbed_;
          const int child = nextChild(pid, known, ended);
          if (child == 0) return;
          std::this_thread::sleep_for(longest * (random() % 1000) / 1000);
          if (ended) return;
          if (kill(child, SIGKILL) == 0) ++kills;
          known = child;
        }
      });
    });
    ended = true;
    killer.join();
    seconds += std::chrono::duration<double>(Clock::now() - start).count();
    ++runs;
    const std::string when = "run " + std::to_string(runs);
    ASSERT_EQ(o.exitCode, 0) << when << ", signal " << o.signal << ": " << o.err;
    ASSERT_TRUE(contents(output()) == image_) << when << ": another picture; " << o.err;
    int warnings = 0;
    for (size_t at = 0;
         (at = o.err.find("another one is started, the picture is not affected", at)) != o.err.npos; ++at)
      ++warnings;
    restarts += warnings;
    EXPECT_EQ(warnings, std::count(o.err.begin(), o.err.end(), '\n')) << o.err;
    EXPECT_LT(waitForOrphans(), 1) << when;
    expectNothingLeft(when);
  }
  // Most kills must have met a tracer that was still needed.
  EXPECT_GE(restarts, kKills / 2);
  std::printf("%d kills in %d runs, %d restarts; undisturbed %.0f ms, lost for each restart %.0f ms\n", kills,
              runs, restarts, 1e-3 * double(undisturbed_.count()),
              1e3 * (seconds - runs * 1e-6 * double(undisturbed_.count())) / std::max(restarts, 1));
}

TEST_F(Crash, NothingIsLeftOfAKilledRenderer) {
  std::mt19937 random(1987);
  int kills = 0, alone = 0, finished = 0;
  double longest = 0;
  for (int i = 0; kills < kKills; ++i) {
    std::filesystem::remove(output());
    Clock::time_point killed;
    std::thread killer;
    std::atomic<bool> ended{false};
    const bool both = i % 4 == 0;
    const auto delay = undisturbed_ * (random() % 1000) / 1000;
    const Outcome o = render([&](int pid) {
      killer = std::thread([&, pid] {
        std::this_thread::sleep_for(delay);
        if (ended) return;
        const std::vector<int> children = childrenOf(pid);
        alone += children.empty();
        killed = Clock::now();
        if (both)
          for (const int child : children) kill(child, SIGKILL);
        kill(pid, SIGKILL);
      });
    });
    // All pipes are closed, so nobody writes any more; the tracer may still be on its way out.
    ended = true;
    killer.join();
    waitForOrphans();
    const std::string when = "run " + std::to_string(i);
    if (o.signal == SIGKILL) {
      ++kills;
      const double seconds = std::chrono::duration<double>(Clock::now() - killed).count();
      longest = std::max(longest, seconds);
      EXPECT_LT(seconds, 2) << when << ": the tracer did not end by itself";
    } else {
      ASSERT_EQ(o.exitCode, 0) << when << ": " << o.err;
    }
    if (std::filesystem::exists(output())) {
      ++finished;
      EXPECT_TRUE(contents(output()) == image_) << when << ": half a picture under the name of a whole one";
    }
    std::set<std::string> left = namesIn(w_.path());
    left.insert("out.exr");
    EXPECT_EQ(left, files_) << when;
    EXPECT_EQ(namesIn("/dev/shm"), sharedMemory_) << when;
    EXPECT_EQ(namesIn(w_.path() / "tmp"), std::set<std::string>{}) << when;
    // Between the two kills, or when the renderer was done, it may have missed its tracer.
    if (o.err.find("another one is started") == std::string::npos) {
      EXPECT_EQ(o.err, "") << when;
    }
  }
  std::printf(
      "%d kills, %d before there was a tracer, %d pictures were finished; gone after %.1f ms at the latest\n",
      kills, alone, finished, 1e3 * longest);
}

}  // namespace
}  // namespace fr::test
