#include "shm/memory_info.h"

#include <gtest/gtest.h>

#include <cstring>
#include <vector>

#include "shm/fork_for_test.h"

namespace fr::shm {
namespace {

TEST(MemoryInfo, SeesMemoryThatWeTouch) {
  const Result<ProcessMemory> before = processMemory();
  ASSERT_TRUE(before.ok()) << before.error().str();
  constexpr size_t kBytes = 32 << 20;
  std::vector<char> block(kBytes);
  std::memset(block.data(), 1, block.size());
  const Result<ProcessMemory> after = processMemory(::getpid());
  ASSERT_TRUE(after.ok());
  EXPECT_GE(after->rss, before->rss + kBytes * 9 / 10);
  EXPECT_GE(after->privateDirty, before->privateDirty + kBytes * 9 / 10);
  EXPECT_LE(after->pss, after->rss);
  EXPECT_LE(after->privateDirty, after->privateBytes);
  EXPECT_EQ(after->privateBytes + after->sharedBytes, after->rss);
}

TEST(MemoryInfo, SaysWhenAProcessIsGone) {
  const pid_t pid = forkChild([] { return 0; });
  ASSERT_EQ(joinChild(pid), 0);
  EXPECT_FALSE(processMemory(pid).ok());
  EXPECT_FALSE(processCpuTime(pid).ok());
}

TEST(MemoryInfo, KnowsWhatIsFree) {
  const AvailableMemory m = availableMemory();
  EXPECT_GT(m.usable(), 0u);
  EXPECT_LT(m.free, m.physical);
  EXPECT_LE(m.usable(), m.free);
}

TEST(MemoryInfo, ReadsTheKernelsTexts) {
  EXPECT_EQ(parseMemAvailable("MemTotal:  10 kB\nMemAvailable:   23 kB\n"), 23u * 1024);
  EXPECT_EQ(parseMemAvailable("MemTotal:  10 kB"), AvailableMemory::kUnlimited);
  EXPECT_EQ(parseMemAvailable("MemAvailable: x kB\n"), AvailableMemory::kUnlimited);
  EXPECT_EQ(parseMemAvailable("MemAvailable: 18446744073709551615 kB\n"), AvailableMemory::kUnlimited);
  EXPECT_EQ(parseGroupLimit("1048576\n"), 1048576u);
  EXPECT_EQ(parseGroupLimit("max\n"), AvailableMemory::kUnlimited);
  EXPECT_EQ(parseGroupLimit("9223372036854771712\n"), AvailableMemory::kUnlimited);
  EXPECT_EQ(parseGroupLimit(""), AvailableMemory::kUnlimited);
}

TEST(MemoryInfo, ProcessorTimeAdvancesWithWork) {
  const Result<CpuTime> before = processCpuTime();
  ASSERT_TRUE(before.ok());
  volatile double x = 1;
  CpuTime now = *before;
  while (now.user + now.system < before->user + before->system + 0.05) {
    for (int i = 0; i < 1000000; ++i) x = x * 1.0000001;
    now = *processCpuTime();
  }
  EXPECT_GT(now.user, before->user);
}

}  // namespace
}  // namespace fr::shm
