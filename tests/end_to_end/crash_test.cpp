// kill -9: a clear error, never a hang, nothing left behind.
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <set>
#include <thread>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

// Rays enough to keep the tracer busy for seconds.
const std::string kBusy =
    "surface busy() {\n"
    "  color c = 0;\n"
    "  float i;\n"
    "  for (i = 0; i < 200; i += 1) c += visibility(P, P + vector(noise(i) - 0.5, 1 + i, noise(i + 7) - "
    "0.5));\n"
    "  Ci = c / 200; Oi = 1;\n"
    "}\n";
const std::string kScene =
    "Display \"out.exr\" \"openexr\" \"rgba\"\nFormat 400 300 1\nProjection \"perspective\" \"fov\" "
    "[40]\nTranslate 0 0 5\n"
    "WorldBegin\nSurface \"busy\"\nSphere 1 -1 1 360\nPolygon \"P\" [-9 -1 -9 -9 -1 9 9 -1 9 9 -1 "
    "-9]\nWorldEnd\n";

std::set<std::string> sharedMemoryNames() {
  std::set<std::string> names;
  for (const auto& e : std::filesystem::directory_iterator("/dev/shm")) names.insert(e.path().filename());
  return names;
}

bool alive(int pid) { return kill(pid, 0) == 0; }

TEST(Crash, KillingTheTracerEndsWithAClearErrorAndLeavesNothing) {
  const auto before = sharedMemoryNames();
  Workspace w;
  w.write("busy.sl", kBusy);
  w.write("scene.rib", kScene);
  int tracer = 0;
  std::thread killer;
  const Outcome o = run("frankenrender", {"--shm", "scene.rib"}, w.path(), [&](int pid) {
    killer = std::thread([&tracer, pid] {
      for (int i = 0; i < 20000 && tracer == 0; ++i) {
        for (int child : childrenOf(pid)) tracer = child;
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(150));
      if (tracer != 0) kill(tracer, SIGKILL);
    });
  });
  killer.join();
  ASSERT_NE(tracer, 0) << "no tracer process was seen: " << o.err;
  EXPECT_EQ(o.signal, 0);
  EXPECT_NE(o.exitCode, 0);
  EXPECT_NE(o.err.find("signal 9"), std::string::npos) << o.err;
  EXPECT_FALSE(alive(tracer));
  EXPECT_EQ(sharedMemoryNames(), before);
}

TEST(Crash, TheTracerEndsByItselfWhenTheRendererIsKilled) {
  const auto before = sharedMemoryNames();
  Workspace w;
  w.write("busy.sl", kBusy);
  w.write("scene.rib", kScene);
  int tracer = 0;
  std::thread killer;
  const Outcome o = run("frankenrender", {"--shm", "scene.rib"}, w.path(), [&](int pid) {
    killer = std::thread([&tracer, pid] {
      for (int i = 0; i < 20000 && tracer == 0; ++i) {
        for (int child : childrenOf(pid)) tracer = child;
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(150));
      kill(pid, SIGKILL);
    });
  });
  killer.join();
  ASSERT_NE(tracer, 0);
  EXPECT_EQ(o.signal, SIGKILL);
  for (int i = 0; i < 1000 && alive(tracer); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_FALSE(alive(tracer));
  EXPECT_EQ(sharedMemoryNames(), before);
}

}  // namespace
}  // namespace fr::test
