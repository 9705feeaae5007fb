#include "imaging/frame_journal.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace fr {
namespace {

namespace fs = std::filesystem;

class FrameJournalTest : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("fr-journal-" + std::to_string(::getpid()));
    fs::create_directory(folder_);
    path_ = (folder_ / "a.exr.unfinished").string();
    setReportSink([this](const Error& e) { reports_.push_back(e.str()); });
  }
  void TearDown() override {
    setReportSink({});
    fs::remove_all(folder_);
  }
  static FilmTile tile(int x, int y, float value) {
    FilmTile t;
    t.rect = {x, y, x + 4, y + 3};
    t.channels.assign(2, std::vector<float>(12, value));
    t.channels[1][11] = -value;
    return t;
  }
  std::vector<FilmTile> finished(uint64_t frame) {
    auto j = FrameJournal::open(path_, frame, 2);
    EXPECT_TRUE(j) << (j ? "" : j.error().str());
    return j ? (*j)->takeFinished() : std::vector<FilmTile>();
  }
  void write(uint64_t frame, int tiles) {
    auto j = FrameJournal::open(path_, frame, 2);
    ASSERT_TRUE(j);
    for (int i = 0; i < tiles; ++i) (*j)->add(tile(4 * i, 6, float(i)));
  }

  fs::path folder_;
  std::string path_;
  std::vector<std::string> reports_;
};

TEST_F(FrameJournalTest, KeepsWhatWasFinishedAcrossRuns) {
  write(7, 2);
  {
    auto j = FrameJournal::open(path_, 7, 2);
    ASSERT_TRUE(j);
    EXPECT_EQ((*j)->takeFinished().size(), 2u);
    (*j)->add(tile(40, 6, 9));
  }
  const std::vector<FilmTile> all = finished(7);
  ASSERT_EQ(all.size(), 3u);
  EXPECT_EQ(all[1].rect, (PixelRect{4, 6, 8, 9}));
  EXPECT_EQ(all[1].channels, tile(4, 6, 1).channels);
  EXPECT_EQ(all[2].channels, tile(40, 6, 9).channels);
  EXPECT_TRUE(reports_.empty());
  auto j = FrameJournal::open(path_, 7, 2);
  ASSERT_TRUE(j);
  (*j)->remove();
  EXPECT_FALSE(fs::exists(path_));
}

/// Cut or damaged anywhere: what stands before is kept, the rest is rendered again, nothing crashes.
TEST_F(FrameJournalTest, AnyDamageCostsWhatFollowsIt) {
  write(7, 3);
  std::ifstream in(path_, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(in)), {});
  const auto put = [&](const std::string& bytes) {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << bytes;
  };
  const size_t header = 24, record = (whole.size() - header) / 3;
  for (size_t n = 0; n < whole.size(); ++n) {
    put(whole.substr(0, n));
    EXPECT_EQ(finished(7).size(), n < header ? 0 : (n - header) / record) << n;
  }
  for (size_t n = 0; n < whole.size(); ++n) {
    std::string bad = whole;
    bad[n] = char(bad[n] ^ 0x40);
    put(bad);
    EXPECT_EQ(finished(7).size(), n < header ? 0 : (n - header) / record) << n;
  }
  // What comes after the damage is written over it.
  put(whole.substr(0, header + record + 5));
  {
    auto j = FrameJournal::open(path_, 7, 2);
    ASSERT_TRUE(j);
    (*j)->add(tile(80, 6, 5));
  }
  EXPECT_EQ(finished(7).size(), 2u);
}

TEST_F(FrameJournalTest, AnotherFramesJournalIsReplacedWithAWarning) {
  write(7, 3);
  EXPECT_TRUE(finished(8).empty());
  EXPECT_EQ(reports_.size(), 1u);
  EXPECT_TRUE(finished(7).empty());
}

TEST_F(FrameJournalTest, OnlyOneProgramAtATime) {
  auto first = FrameJournal::open(path_, 7, 2);
  ASSERT_TRUE(first);
  auto second = FrameJournal::open(path_, 7, 2);
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().str().find("another program"), std::string::npos);
}

}  // namespace
}  // namespace fr
