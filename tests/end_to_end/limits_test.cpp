// Too little memory, disk or shared memory: one clear message and a status, never a signal.
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>

#include "tests/end_to_end/program.h"

namespace fr::test {
namespace {

const std::string kAsks = "surface asks() { Ci = visibility(P, P + vector(2, 5, 3)) * Cs; Oi = 1; }\n";
const std::string kWorld =
    "Projection \"perspective\" \"fov\" [40]\nTranslate 0 0 5\nWorldBegin\nSurface \"asks\"\nSphere 1 -1 1 "
    "360\n"
    "Polygon \"P\" [-9 -1 -9 -9 -1 9 9 -1 9 9 -1 -9]\nWorldEnd\n";

std::string scene(const std::string& display, int width = 64, int height = 48) {
  return "Display \"" + display + "\" \"openexr\" \"rgba\" \"string compression\" \"none\"\nFormat " +
         std::to_string(width) + " " + std::to_string(height) + " 1\n" + kWorld;
}

void limit(int what, rlim_t value) {
  const rlimit r{value, value};
  setrlimit(__rlimit_resource_t(what), &r);
}

/// A file system of `size` at `folder`, seen by this process and its children only. False: we may not.
bool mountSmall(const std::filesystem::path& folder, const char* size) {
  return unshare(CLONE_NEWNS) == 0 && mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0 &&
         mount("small", folder.c_str(), "tmpfs", 0, (std::string("size=") + size).c_str()) == 0;
}
bool mayMount(const std::filesystem::path& folder) {
  const pid_t p = fork();
  if (p == 0) _exit(mountSmall(folder, "64k") ? 0 : 1);
  int status = 0;
  waitpid(p, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

class Limits : public ::testing::Test {
 protected:
  void SetUp() override { w_.write("asks.sl", kAsks); }
  Outcome render(const std::function<void()>& inChild, const std::string& program = "frankenrender") const {
    return run(program, {"--shm", "scene.rib"}, w_.path(), {}, {}, {}, inChild);
  }
  Workspace w_;
};

#ifdef __SANITIZE_ADDRESS__
constexpr bool kNeedsAllAddresses = true;
#else
constexpr bool kNeedsAllAddresses = false;
#endif

TEST_F(Limits, AFullDiskIsAClearMessage) {
  std::filesystem::create_directory(w_.path() / "small");
  if (!mayMount(w_.path() / "small")) GTEST_SKIP() << "needs the right to mount a file system";
  w_.write("scene.rib", scene("small/out.exr", 400, 300));  // 1 MB in 64 KB
  const Outcome o = render([&] {
    if (!mountSmall(w_.path() / "small", "64k")) _exit(126);
  });
  EXPECT_EQ(o.signal, 0);
  EXPECT_EQ(o.exitCode, 1) << o.err;
  EXPECT_NE(o.err.find("out.exr"), std::string::npos) << o.err;
  EXPECT_NE(o.err.find("No space left"), std::string::npos) << o.err;
}

TEST_F(Limits, ASmallOrFullDevShmDoesNotMatter) {
  if (!mayMount("/dev/shm")) GTEST_SKIP() << "needs the right to mount a file system";
  w_.write("scene.rib", scene("out.exr"));
  for (const char* size : {"64m", "4k"}) {
    const Outcome o = render([&] {
      if (!mountSmall("/dev/shm", size)) _exit(126);
    });
    EXPECT_EQ(o.exitCode, 0) << size << ", signal " << o.signal << ": " << o.err;
  }
}

TEST_F(Limits, FilesMayNotGrow) {
  w_.write("scene.rib", scene("out.exr", 400, 300));
  for (const rlim_t bytes :
       {rlim_t(0), rlim_t(4096), rlim_t(100000), rlim_t(500000), rlim_t(1) << 21, rlim_t(1) << 24}) {
    const Outcome o = render([&] { limit(RLIMIT_FSIZE, bytes); });
    EXPECT_EQ(o.signal, 0) << bytes << ": " << o.err;
    EXPECT_TRUE(o.exitCode == 0 || (o.exitCode == 1 && o.err.find("error:") != std::string::npos))
        << bytes << ": status " << o.exitCode << ", " << o.err;
    if (bytes <= 4096) {
      EXPECT_NE(o.err.find("file size limit"), std::string::npos) << o.err;
    }
  }
}

TEST_F(Limits, TooLittleAddressSpaceIsAClearMessage) {
  if (kNeedsAllAddresses) GTEST_SKIP() << "AddressSanitizer needs terabytes of addresses";
  w_.write("scene.rib", scene("out.exr"));
  int rendered = 0;
  for (const unsigned megabytes : {64u, 96u, 128u, 192u, 256u, 400u, 1000u, 4000u, 16000u}) {
    const Outcome o = render([&] { limit(RLIMIT_AS, rlim_t(megabytes) << 20); });
    EXPECT_EQ(o.signal, 0) << megabytes << ": " << o.err;
    rendered += o.exitCode == 0;
    // 127: the system could not even load the program.
    if (o.exitCode != 0) {
      EXPECT_NE(o.err, "") << megabytes << ": status " << o.exitCode;
    }
    // A small scene needs no more, and it needs no warnings.
    if (megabytes >= 1000) {
      EXPECT_EQ(o.exitCode, 0) << megabytes << ": " << o.err;
      EXPECT_EQ(o.err, "") << megabytes;
    }
  }
  EXPECT_GT(rendered, 0);
}

TEST_F(Limits, ATracerWithoutMemoryIsAClearError) {
  if (kNeedsAllAddresses) GTEST_SKIP() << "AddressSanitizer needs terabytes of addresses";
  // A frankenrender whose rendrib has less.
  const std::filesystem::path built = FR_BINARY_DIR;
  std::filesystem::create_directory(w_.path() / "bin");
  std::filesystem::copy_file(built / "bin/frankenrender", w_.path() / "bin/frankenrender");
  for (const char* folder : {"lib", "share", "shaders"})
    if (std::filesystem::exists(built / folder))
      std::filesystem::create_symlink(built / folder, w_.path() / folder);
  w_.write("scene.rib", scene("out.exr"));
  int rendered = 0, explained = 0;
  for (const unsigned megabytes : {150u, 200u, 260u, 400u, 1000u, 8000u}) {
    const auto script =
        w_.write("bin/rendrib", "#!/bin/sh\nulimit -v " + std::to_string(megabytes * 1024) + "\nexec '" +
                                    (built / "bin/rendrib").string() + "' \"$@\"\n");
    chmod(script.c_str(), 0755);
    const Outcome o = render({}, (w_.path() / "bin/frankenrender").string());
    EXPECT_EQ(o.signal, 0) << megabytes << ": " << o.err;
    rendered += o.exitCode == 0;
    if (o.exitCode != 0) {
      EXPECT_NE(o.err.find("ray tracer process"), std::string::npos) << megabytes << ": " << o.err;
      explained += o.err.find("memory") != std::string::npos;
    }
  }
  EXPECT_GT(rendered, 0);
  EXPECT_GT(explained, 0);
}

}  // namespace
}  // namespace fr::test
