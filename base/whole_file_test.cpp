#include "base/whole_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>

namespace fr {
namespace {

namespace fs = std::filesystem;

class WholeFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "whole-file-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
    path_ = (folder_ / "file").string();
  }
  void TearDown() override { fs::remove_all(folder_); }
  size_t files() const {
    return size_t(std::distance(fs::directory_iterator(folder_), fs::directory_iterator{}));
  }
  std::string contents() const {
    std::ifstream in(path_);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  fs::path folder_;
  std::string path_;
};

TEST_F(WholeFileTest, AppearsWhenItIsWhole) {
  for (const std::string text : {"first", "second"}) {
    WholeFile f;
    ASSERT_EQ(f.open(path_), 0);
    const std::string before = contents();
    std::ofstream(f.temporaryPath()) << text;  // as libraries do that open by name
    EXPECT_EQ(contents(), before);
    ASSERT_EQ(f.finish(), 0);
    EXPECT_EQ(contents(), text);
    EXPECT_EQ(files(), 1u);
  }
  const mode_t mask = umask(0);
  umask(mask);
  struct stat info {};
  ASSERT_EQ(stat(path_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0666 & ~mask);
}

TEST_F(WholeFileTest, NothingIsLeftOfWhatWasNotFinished) {
  {
    WholeFile f;
    ASSERT_EQ(f.open(path_), 0);
    ASSERT_EQ(write(f.descriptor(), "x", 1), 1);
  }
  EXPECT_EQ(files(), 0u);
  WholeFile f;
  EXPECT_EQ(f.open((folder_ / "nowhere" / "file").string()), ENOENT);
  EXPECT_EQ(f.finish(), EBADF);
  // The name was taken by a folder meanwhile.
  ASSERT_EQ(f.open(path_), 0);
  fs::create_directory(path_);
  EXPECT_NE(f.finish(), 0);
  EXPECT_EQ(files(), 1u);
}

TEST_F(WholeFileTest, NothingIsLeftByAKill) {
  const pid_t p = fork();
  if (p == 0) {
    WholeFile f;
    if (f.open(path_) == 0 && write(f.descriptor(), "x", 1) == 1) raise(SIGKILL);
    _exit(1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(p, &status, 0), p);
  ASSERT_TRUE(WIFSIGNALED(status));
  // A file system without nameless files keeps one whose name says what it is.
  for (const auto& e : fs::directory_iterator(folder_))
    EXPECT_NE(e.path().string().find("file.partial-"), std::string::npos);
  EXPECT_FALSE(fs::exists(path_));
}

}  // namespace
}  // namespace fr
