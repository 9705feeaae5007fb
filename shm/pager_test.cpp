// Pages that are let go come back as they were.
#include "shm/pager.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <thread>

#include "shm/scratch_file.h"
#include "shm/segment.h"

namespace fr::shm {
namespace {

uint64_t pattern(uint64_t i) { return i * 0x9e3779b97f4a7c15ull + 1; }

TEST(Pager, LetsPagesGoAndLosesNothing) {
  constexpr uint64_t kBytes = uint64_t(96) << 20;
  SegmentOptions o;
  o.reserve = uint64_t(1) << 30;
  auto made = Segment::createScratch(scratchFolder({}), o, kBytes);
  ASSERT_TRUE(made.ok()) << made.error().str();
  Segment segment = *std::move(made);
  auto* words = reinterpret_cast<uint64_t*>(segment.data());
  const ResidentBytes before = residentBytes(0);
  ASSERT_GT(before.total, 0u);
  const PagedMapping mapping({segment.data(), [] { return kBytes; }, segment.descriptor(), 0});
  auto pager = Pager::start(before.total + (uint64_t(64) << 20));
  ASSERT_TRUE(pager.ok());
  for (uint64_t i = 0; i < kBytes / 8; ++i) words[i] = pattern(i);
  for (int wait = 0; wait < 500 && (*pager)->statistics().letGo == 0; ++wait)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_GT((*pager)->statistics().letGo, 0u);
  EXPECT_GT((*pager)->statistics().peak, before.total);
  uint64_t wrong = 0;
  for (uint64_t i = 0; i < kBytes / 8; ++i) wrong += words[i] != pattern(i);
  EXPECT_EQ(wrong, 0u);
}

TEST(Pager, AsksForPrivateMemoryWhenFilesAreNotEnough) {
  std::atomic<uint64_t> wanted{0};
  PagerHooks hooks;
  hooks.giveBack = [&](uint64_t bytes) {
    wanted = bytes;
    return bytes;
  };
  auto pager = Pager::start(std::max<uint64_t>(residentBytes(0).total / 3, 1 << 20), hooks);  // too little
  ASSERT_TRUE(pager.ok());
  for (int wait = 0; wait < 500 && wanted == 0; ++wait)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_GT(wanted.load(), 0u);
}

TEST(ScratchFile, HasNoName) {
  const std::string folder = scratchFolder({});
  const auto count = [&] {
    size_t n = 0;
    for (const auto& e : std::filesystem::directory_iterator(folder))
      n += e.path().filename().string().rfind("frankenrender-", 0) == 0;
    return n;
  };
  const size_t before = count();
  auto fd = createScratchFile(folder);
  ASSERT_TRUE(fd.ok()) << fd.error().str();
  EXPECT_EQ(count(), before);
}

TEST(ScratchFile, SaysWhichFolderCannotBeUsed) {
  auto fd = createScratchFile("/nowhere/at/all");
  ASSERT_FALSE(fd.ok());
  EXPECT_EQ(fd.error().code, RiError::kNoFile);
  EXPECT_NE(fd.error().message.find("/nowhere/at/all"), std::string::npos);
}

}  // namespace
}  // namespace fr::shm
