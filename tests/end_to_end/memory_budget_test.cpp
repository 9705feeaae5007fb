// --memory and --scratch: the same picture in less memory, nothing left behind, and clear words when it
// cannot be.
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <fstream>
#include <thread>

#include "tests/end_to_end/memory_group.h"
#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

// A machine that is busy with other things may look late: the tests allow a quarter more than the budget.

/// Finely diced spheres that see each other: some million micropolygons, several times as much memory as the
/// programs themselves.
std::string scene(const std::string& surface = "mirror", const std::string& rate = "0.012") {
  std::string s =
      "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 240 180 1\nPixelSamples 2 2\nProjection "
      "\"perspective\" "
      "\"fov\" [50]\nTranslate 0 0 6\nWorldBegin\nLightSource \"distantlight\" 1 \"from\" [1 2 -2] \"to\" [0 "
      "0 0]\n"
      "ShadingRate " +
      rate + "\nSurface \"" + surface + "\"\n";
  for (int i = 0; i < 12; ++i)
    s += "AttributeBegin\nTranslate " + std::to_string(1.6 * (i % 4) - 2.4) + " " +
         std::to_string(1.5 * (i / 4) - 1.5) + " " + std::to_string(0.7 * (i % 3)) +
         "\nScale 0.7 0.7 0.7\nSphere 1 -1 1 360\nAttributeEnd\n";
  return s + "WorldEnd\n";
}
const std::string kMirror =
    "surface mirror() { normal Nf = faceforward(normalize(N), I);\n"
    "Ci = 0.4 * diffuse(Nf) + 0.5 * trace(P, reflect(normalize(I), Nf)); Oi = 1; }\n";

/// The proportional share of memory of a process, bytes.
uint64_t pss(int pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/smaps_rollup");
  for (std::string line; std::getline(file, line);)
    if (line.rfind("Pss:", 0) == 0) return 1024 * std::stoull(line.substr(4));
  return 0;
}

/// Watches a program and its children until it is told to stop.
class Watch {
 public:
  void start(int pid) {
    thread_ = std::thread([this, pid] {
      while (!ended_) {
        uint64_t sum = pss(pid);
        for (const int child : childrenOf(pid)) sum += pss(child);
        peak_ = std::max(peak_, sum);
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
    });
  }
  uint64_t stop() {
    ended_ = true;
    if (thread_.joinable()) thread_.join();
    return peak_;
  }
  ~Watch() { stop(); }

 private:
  std::atomic<bool> ended_{false};
  uint64_t peak_ = 0;
  std::thread thread_;
};

class MemoryBudget : public ::testing::Test {
 protected:
  void SetUp() override {
    w_.write("mirror.sl", kMirror);
    w_.write("scene.rib", scene());
    std::filesystem::create_directory(w_.path() / "scratch");
  }
  Outcome render(const std::string& program, std::vector<std::string> arguments,
                 uint64_t* peak = nullptr) const {
    arguments.push_back("scene.rib");
    Watch watch;
    const Outcome o = run(program, arguments, w_.path(), [&](int pid) { watch.start(pid); });
    if (peak) *peak = watch.stop();
    return o;
  }
  Workspace w_;
};

TEST_F(MemoryBudget, TheSamePictureInsideTheBudget) {
  uint64_t free = 0, held = 0;
  ASSERT_EQ(render("frankenrender", {"--shm"}, &free).exitCode, 0);
  const Picture whole = readExr(w_.path() / "out.exr");
  // A budget that the scene does not fit into. Sanitizers take several times the memory that they watch over.
  const uint64_t budget = std::max<uint64_t>(free * 2 / 3 >> 20, 64) << 20;
  const Outcome o = render(
      "frankenrender",
      {"--shm", "--stats", "--scratch", (w_.path() / "scratch").string(), "--memory", std::to_string(budget)},
      &held);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_TRUE(readExr(w_.path() / "out.exr") == whole);
  RecordProperty("free", std::to_string(free));
  RecordProperty("held", std::to_string(held));
  EXPECT_LE(held, budget + budget / 4) << "without a budget: " << free;
  EXPECT_EQ(o.err.find("too small"), std::string::npos) << o.err;
  EXPECT_NE(o.out.find("let go"), std::string::npos) << o.out;
  EXPECT_EQ(o.out.find("0.0 MiB let go"), std::string::npos) << "the scene fits: this tests nothing\n"
                                                             << o.out;
  EXPECT_TRUE(std::filesystem::is_empty(w_.path() / "scratch"));
}

/// The kernel counts, pages of files included, and kills who takes more: a leak past the budget ends the job.
/// Without rays, since what rays need again and again would come from a disk.
TEST_F(MemoryBudget, UnderAHardLimit) {
  w_.write("scene.rib", scene("matte", "0.004"));
  uint64_t free = 0;
  ASSERT_EQ(render("frankenrender", {}, &free).exitCode, 0);
  const Picture whole = readExr(w_.path() / "out.exr");
  const uint64_t budget = std::max<uint64_t>(free / 2 >> 20, 64) << 20, limit = budget + budget / 4;
  ASSERT_GT(free, limit) << "the scene fits: this tests nothing";
  const auto group = MemoryGroup::make(limit);
  if (!group) GTEST_SKIP() << "no memory control group can be made here";
  bool inside = false;
  const Outcome o =
      run("frankenrender", {"--scratch", "scratch", "--memory", std::to_string(budget), "scene.rib"},
          w_.path(), [&](int pid) { inside = group->add(pid); });
  if (!inside) GTEST_SKIP() << "no process can be put into a control group here";
  EXPECT_EQ(o.exitCode, 0) << o.err;
  EXPECT_TRUE(readExr(w_.path() / "out.exr") == whole);
}

TEST_F(MemoryBudget, RaysAloneInsideTheBudget) {
  uint64_t free = 0, held = 0;
  ASSERT_EQ(render("rendrib", {}, &free).exitCode, 0);
  const Picture whole = readExr(w_.path() / "out.exr");
  const uint64_t budget = std::max<uint64_t>(free * 2 / 3 >> 20, 64) << 20;
  const Outcome o = render("rendrib", {"-scratch", "scratch", "-memory", std::to_string(budget)}, &held);
  ASSERT_EQ(o.exitCode, 0) << o.err;
  EXPECT_TRUE(readExr(w_.path() / "out.exr") == whole);
  EXPECT_LE(held, budget + budget / 4) << "without a budget: " << free;
}

TEST_F(MemoryBudget, AKillLeavesNothingInTheScratchFolder) {
  const Outcome o =
      run("frankenrender", {"--shm", "--scratch", "scratch", "scene.rib"}, w_.path(), [](int pid) {
        std::this_thread::sleep_for(std::chrono::milliseconds(700));
        ::kill(pid, SIGKILL);
      });
  EXPECT_EQ(o.signal, SIGKILL);
  EXPECT_TRUE(std::filesystem::is_empty(w_.path() / "scratch"));
}

TEST_F(MemoryBudget, AFullScratchFolderIsAClearMessage) {
  const Outcome o =
      run("frankenrender", {"--shm", "--scratch", "scratch", "scene.rib"}, w_.path(), {}, {}, {}, [] {
        const rlimit small{4 << 20, 4 << 20};
        setrlimit(RLIMIT_FSIZE, &small);
      });
  EXPECT_EQ(o.signal, 0);
  EXPECT_EQ(o.exitCode, 1) << o.err;
  EXPECT_NE(o.err.find("scratch"), std::string::npos) << o.err;
}

TEST_F(MemoryBudget, WrongSizesAndFoldersAreSaid) {
  for (const char* size : {"lots", "-5M", "0", "12Q", "1000", ""}) {
    const Outcome o = render("frankenrender", {"--memory", size});
    EXPECT_EQ(o.exitCode, 2) << size;
    EXPECT_FALSE(o.err.empty()) << size;
    EXPECT_EQ(render("rendrib", {"-memory", size}).exitCode, 2) << size;
  }
  EXPECT_EQ(render("frankenrender", {"--scratch", "nowhere"}).exitCode, 2);
  EXPECT_EQ(render("rendrib", {"-scratch", "nowhere"}).exitCode, 2);
}

}  // namespace
}  // namespace fr::test
