#include "shm/segment.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <thread>
#include <vector>

#include "shm/fork_for_test.h"

namespace fr::shm {
namespace {

namespace fs = std::filesystem;

constexpr int kSkipped = 77;

// The thread sanitizer leaves no room for terabytes of address space.
#ifdef __SANITIZE_THREAD__
constexpr bool kAddressSpaceIsScarce = true;
#else
constexpr bool kAddressSpaceIsScarce = false;
#endif

class SegmentTest : public ::testing::Test {
 protected:
  void SetUp() override {
    descriptors_ = openDescriptorCount();
    folder_ = fs::temp_directory_path() / fmt::format("fr-segment-{}", ::getpid());
    fs::create_directories(folder_);
  }
  void TearDown() override {
    fs::remove_all(folder_);
    EXPECT_EQ(openDescriptorCount(), descriptors_) << "descriptors leak";
  }
  std::string path(const char* name) const { return (folder_ / name).string(); }
  size_t filesLeft() const { return size_t(std::distance(fs::directory_iterator(folder_), {})); }
  fs::path folder_;
  int descriptors_ = 0;
};

SegmentOptions small() {
  SegmentOptions o;
  o.growStep = 4096;
  o.reserve = 1ull << 30;
  return o;
}

/// Touches every page of [0, size + padding): a page that is not there ends the process with SIGBUS.
uint64_t sumAll(const Segment& s) {
  const volatile uint8_t* p = reinterpret_cast<const volatile uint8_t*>(s.data());
  const uint64_t end = s.size() + kEndPadding;
  uint64_t sum = p[end - 1];
  for (uint64_t i = 0; i < end; i += 61) sum += p[i];
  return sum;
}

TEST_F(SegmentTest, GrowsInPlace) {
  const uint64_t reserve = kAddressSpaceIsScarce ? 1ull << 36 : 1ull << 40;
  Result<Segment> s = Segment::createAnonymous(SegmentOptions{.reserve = reserve}, 100);
  ASSERT_TRUE(s.ok()) << s.error().str();
  std::byte* const start = s->data();
  EXPECT_GE(s->size(), 100u);
  EXPECT_EQ(s->reserved(), reserve);
  start[99] = std::byte(7);
  for (uint64_t want : {5000ull, 1ull << 20, 40ull << 20, 200ull << 20}) {
    ASSERT_TRUE(s->grow(want).ok());
    ASSERT_EQ(s->data(), start);
    ASSERT_GE(s->size(), want);
    start[want - 1] = std::byte(1);
  }
  EXPECT_EQ(start[99], std::byte(7));
  EXPECT_GE(s->allocated(), 200ull << 20) << "really allocated, not promised";
  sumAll(*s);
  const uint64_t size = s->size();
  ASSERT_TRUE(s->grow(10).ok());
  EXPECT_EQ(s->size(), size) << "never shrinks";
}

TEST_F(SegmentTest, ItsEndIsReadableBeyondByThePadding) {
  for (uint64_t bytes : {1ull, 4096ull - kEndPadding, 4096ull - kEndPadding + 1, 4096ull, 8192ull}) {
    Result<Segment> s = Segment::createAnonymous(small(), bytes);
    ASSERT_TRUE(s.ok());
    EXPECT_EQ(sumAll(*s), 0u);
  }
}

TEST_F(SegmentTest, AnotherProcessSeesItGrow) {
  Result<Segment> s = Segment::createAnonymous(small(), 1000);
  ASSERT_TRUE(s.ok());
  Result<FileDescriptor> fd = s->share(Access::kReadWrite);
  ASSERT_TRUE(fd.ok());
  int pipes[2];
  ASSERT_EQ(::pipe(pipes), 0);
  const pid_t child = forkChild([&]() -> int {
    Result<Segment> other = Segment::attach(std::move(*fd), Access::kReadWrite, small());
    CHILD_EXPECT(other.ok());
    CHILD_EXPECT(other->grow(100000).ok());
    std::byte* const start = other->data();
    start[99999] = std::byte(42);
    CHILD_EXPECT(::write(pipes[1], "x", 1) == 1);
    while (other->refresh() < 1000000) ::usleep(100);
    CHILD_EXPECT(start == other->data());
    while (std::atomic_ref<uint8_t>(reinterpret_cast<uint8_t&>(start[999999])).load() != 43) ::usleep(100);
    return 0;
  });
  char c;
  ASSERT_EQ(::read(pipes[0], &c, 1), 1);
  EXPECT_LT(s->size(), 100000u) << "known after refresh only";
  ASSERT_GE(s->refresh(), 100000u);
  EXPECT_EQ(s->data()[99999], std::byte(42));
  ASSERT_TRUE(s->grow(1000000).ok());
  std::atomic_ref<uint8_t>(reinterpret_cast<uint8_t&>(s->data()[999999])).store(43);
  EXPECT_EQ(joinChild(child), 0);
  ::close(pipes[0]);
  ::close(pipes[1]);
}

TEST_F(SegmentTest, TwoProcessesMayGrowAtOnce) {
  Result<Segment> s = Segment::createAnonymous(small(), 1000);
  ASSERT_TRUE(s.ok());
  // Each process fills every second page behind what is there; nothing may be lost.
  auto fill = [&](Segment& seg, uint64_t phase) -> int {
    for (uint64_t page = phase; page < 2000; page += 2) {
      CHILD_EXPECT(seg.grow((page + 1) * 4096).ok());
      seg.data()[page * 4096] = std::byte(1 + page % 200);
    }
    return 0;
  };
  const pid_t child = forkChild([&] { return fill(*s, 1); });
  EXPECT_EQ(fill(*s, 0), 0);
  EXPECT_EQ(joinChild(child), 0);
  s->refresh();
  for (uint64_t page = 0; page < 2000; ++page)
    ASSERT_EQ(s->data()[page * 4096], std::byte(1 + page % 200)) << page;
}

TEST_F(SegmentTest, ReadOnlySharesCannotBeWritten) {
  Result<Segment> s = Segment::createAnonymous(small(), 1000);
  ASSERT_TRUE(s.ok());
  s->data()[10] = std::byte(5);
  Result<FileDescriptor> fd = s->share(Access::kReadOnly);
  ASSERT_TRUE(fd.ok());
  EXPECT_FALSE(Segment::attach(fd->duplicate(), Access::kReadWrite).ok());
  Result<Segment> reader = Segment::attach(std::move(*fd), Access::kReadOnly);
  ASSERT_TRUE(reader.ok()) << reader.error().str();
  EXPECT_EQ(reader->data()[10], std::byte(5));
  EXPECT_FALSE(reader->writable());
  EXPECT_FALSE(reader->grow(1 << 20).ok());
  EXPECT_FALSE(reader->discard(0, 4096).ok());
  EXPECT_FALSE(reader->share(Access::kReadWrite).ok());
  EXPECT_EQ(runInChild([&] {
              ::signal(SIGSEGV, SIG_DFL);
              reader->data()[10] = std::byte(6);
              return 0;
            }) != 0,
            true);
}

TEST_F(SegmentTest, RefusesWhatCouldShrinkUnderUs) {
  FileDescriptor fd(::memfd_create("stranger", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(::ftruncate(fd.get(), 4096), 0);
  EXPECT_FALSE(Segment::attach(fd.duplicate(), Access::kReadWrite).ok());
  ASSERT_EQ(::fcntl(fd.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
  EXPECT_TRUE(Segment::attach(fd.duplicate(), Access::kReadWrite).ok());
  std::ofstream(path("plain")) << std::string(5000, 'x');
  FileDescriptor plain(::open(path("plain").c_str(), O_RDWR | O_CLOEXEC));
  SegmentOptions sealed;
  sealed.sealedOnly = true;
  EXPECT_FALSE(Segment::attach(plain.duplicate(), Access::kReadWrite, sealed).ok());
  EXPECT_TRUE(Segment::attach(plain.duplicate(), Access::kReadWrite).ok());
  // A file on a tmpfs, where /tmp often is: like a memory file that nobody can seal.
  FileDescriptor unsealable(::memfd_create("like a file on a tmpfs", MFD_CLOEXEC));
  ASSERT_EQ(::ftruncate(unsealable.get(), 4096), 0);
  ASSERT_EQ(::fcntl(unsealable.get(), F_GET_SEALS), F_SEAL_SEAL);
  EXPECT_FALSE(Segment::attach(unsealable.duplicate(), Access::kReadWrite, sealed).ok());
  EXPECT_TRUE(Segment::attach(unsealable.duplicate(), Access::kReadWrite).ok());
  int pipes[2];
  ASSERT_EQ(::pipe(pipes), 0);
  ::close(pipes[1]);
  EXPECT_FALSE(Segment::attach(FileDescriptor(pipes[0]), Access::kReadOnly).ok());
  EXPECT_FALSE(Segment::attach(FileDescriptor(), Access::kReadOnly).ok());
}

TEST_F(SegmentTest, DiscardGivesMemoryBackAndCommitTakesItAgain) {
  Result<Segment> s = Segment::createAnonymous(small(), 1 << 20);
  ASSERT_TRUE(s.ok());
  std::memset(s->data(), 9, 1 << 20);
  const uint64_t before = s->allocated();
  // Only whole pages inside go: 4096*10+1 ... 4096*20+100 holds nine of them.
  ASSERT_TRUE(s->discard(4096 * 10 + 1, 4096 * 10 + 99).ok());
  EXPECT_EQ(s->allocated(), before - 9 * 4096);
  EXPECT_EQ(s->data()[4096 * 10 + 4095], std::byte(9));
  EXPECT_EQ(s->data()[4096 * 11], std::byte(0));
  EXPECT_EQ(s->data()[4096 * 20], std::byte(9));
  // The look at a hole may itself have allocated a page, hence at least.
  ASSERT_TRUE(s->commit(4096 * 10, 4096 * 10).ok());
  EXPECT_GE(s->allocated(), before);
  EXPECT_FALSE(s->discard(1 << 20, 1ull << 40).ok());
  EXPECT_FALSE(s->commit(~0ull, 2).ok());
}

TEST_F(SegmentTest, HoldsToItsLimitItsReservationAndTheFreeMemory) {
  SegmentOptions o = small();
  o.limit = 100000;
  Result<Segment> s = Segment::createAnonymous(o, 1000);
  ASSERT_TRUE(s.ok());
  EXPECT_TRUE(s->grow(100000).ok());
  Result<void> r = s->grow(100001 + 8192);
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kLimit);

  o = small();
  o.reserve = 1 << 20;
  s = Segment::createAnonymous(o, 1000);
  ASSERT_TRUE(s.ok());
  r = s->grow(1 << 20);
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kLimit);
  EXPECT_TRUE(s->grow((1 << 20) - kEndPadding).ok());
  EXPECT_EQ(sumAll(*s), 0u);

  if (kAddressSpaceIsScarce) return;
  o = small();
  o.reserve = 1ull << 44;
  s = Segment::createAnonymous(o, 1000);
  ASSERT_TRUE(s.ok());
  r = s->grow(1ull << 43);  // 8 TB: more than there is
  ASSERT_FALSE(r.ok());
  EXPECT_EQ(r.error().code, RiError::kNoMem);
  EXPECT_LT(s->allocated(), 1u << 20) << "nothing was taken";
  o.keepFree = 1ull << 50;
  EXPECT_FALSE(Segment::createAnonymous(o, 1000).ok());
}

TEST_F(SegmentTest, ALowFileSizeLimitIsAnErrorNotASignal) {
  EXPECT_EQ(runInChild([&]() -> int {
              const rlimit limit{1 << 20, 1 << 20};
              CHILD_EXPECT(::setrlimit(RLIMIT_FSIZE, &limit) == 0);
              Result<Segment> s = Segment::createAnonymous(small(), 1000);
              CHILD_EXPECT(s.ok());
              Result<void> r = s->grow(2 << 20);
              CHILD_EXPECT(!r.ok() && r.error().code == RiError::kNoMem);
              CHILD_EXPECT(s->grow(1 << 19).ok());
              Result<Segment> f = Segment::createFile(path("limited"), small(), 2 << 20);
              CHILD_EXPECT(!f.ok() && f.error().code == RiError::kDiskFull);
              return 0;
            }),
            0);
  EXPECT_EQ(filesLeft(), 0u);
}

TEST_F(SegmentTest, LessAddressSpaceMeansASmallerReservation) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer's own terabytes are over any limit";
#endif
  const auto child = [&]() -> int {
    setReportSink([](const Error&) {});
    const rlimit limit{8ull << 30, 8ull << 30};
    CHILD_EXPECT(::setrlimit(RLIMIT_AS, &limit) == 0);
    Result<Segment> s = Segment::createAnonymous(SegmentOptions{.reserve = 1ull << 40}, 1000);
    CHILD_EXPECT(s.ok());
    CHILD_EXPECT(s->reserved() == 1ull << 30);  // an eighth: a process has several segments, and more
    std::vector<Segment> others;
    for (int i = 0; i < 5; ++i) {
      Result<Segment> o = Segment::createAnonymous(SegmentOptions{.reserve = 1ull << 40}, 1000);
      CHILD_EXPECT(o.ok() && o->reserved() == 1ull << 30);
      others.push_back(*std::move(o));
    }
    CHILD_EXPECT(reportCount(Severity::kWarning) == 0);
    const Result<void> grown = s->grow(2ull << 30);
    CHILD_EXPECT(!grown.ok() && grown.error().message.find("ulimit -v") != std::string::npos);
    return 0;
  };
  EXPECT_EQ(runInChild(child), 0);
}

TEST_F(SegmentTest, AFullDiskIsAnErrorNotASigbus) {
  const int status = runInChild([&]() -> int {
    // A disk of one megabyte, which nobody else sees.
    if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("tmpfs", folder_.c_str(), "tmpfs", 0, "size=1m") != 0) {
      return kSkipped;
    }
    {
      Result<Segment> s = Segment::createFile(path("full"), small(), 100000);
      CHILD_EXPECT(s.ok());
      s->data()[99999] = std::byte(3);
      Result<void> r = s->grow(8 << 20);
      CHILD_EXPECT(!r.ok() && r.error().code == RiError::kDiskFull);
      CHILD_EXPECT(s->data()[99999] == std::byte(3));
      CHILD_EXPECT(s->grow(500000).ok());  // still of use, and the failed growth took nothing
      sumAll(*s);
      s->data()[499999] = std::byte(1);
      CHILD_EXPECT(s->finish(500000).ok());
    }
    CHILD_EXPECT(filesLeft() == 1);
    return 0;
  });
  if (status == kSkipped) GTEST_SKIP() << "no right to mount a small tmpfs";
  EXPECT_EQ(status, 0);
}

TEST_F(SegmentTest, AFileAppearsOnlyWhenItIsFinished) {
  const std::string name = path("scene.fsc");
  std::ofstream(name) << "the old one";
  {
    Result<Segment> s = Segment::createFile(name, small(), 10);
    ASSERT_TRUE(s.ok()) << s.error().str();
    ASSERT_TRUE(s->grow(12345).ok());
    std::memset(s->data(), 'x', 12345);
    std::string old;
    std::getline(std::ifstream(name), old);
    EXPECT_EQ(old, "the old one");
    EXPECT_FALSE(s->finish(1 << 29).ok()) << "beyond its end";
    ASSERT_TRUE(s->finish(8192).ok());
    EXPECT_EQ(s->size(), 8192u);
    EXPECT_GT(sumAll(*s), 0u);
    EXPECT_FALSE(s->grow(20000).ok());
    EXPECT_FALSE(s->finish(100).ok());
  }
  EXPECT_EQ(fs::file_size(name), 8192u);
  EXPECT_EQ(filesLeft(), 1u);
  struct stat info {};
  ASSERT_EQ(::stat(name.c_str(), &info), 0);
  const mode_t mask = ::umask(0);
  ::umask(mask);
  EXPECT_EQ(info.st_mode & 0777, 0666 & ~mask);

  Result<Segment> reader = Segment::openFile(name);
  ASSERT_TRUE(reader.ok()) << reader.error().str();
  EXPECT_EQ(reader->size(), 8192u);
  EXPECT_EQ(reader->data()[8191], std::byte('x'));
  EXPECT_EQ(reader->data()[8192], std::byte(0)) << "padding beyond a file that ends with a page";
  EXPECT_FALSE(reader->writable());
}

TEST_F(SegmentTest, AnAbandonedFileLeavesNothing) {
  { ASSERT_TRUE(Segment::createFile(path("never"), small(), 1 << 20).ok()); }
  EXPECT_EQ(filesLeft(), 0u);
}

TEST_F(SegmentTest, OpeningWhatIsNoFileIsAnError) {
  EXPECT_EQ(Segment::openFile(path("missing")).error().code, RiError::kNoFile);
  EXPECT_EQ(Segment::openFile(folder_.string()).error().code, RiError::kBadFile);
  std::ofstream(path("empty"));
  EXPECT_EQ(Segment::openFile(path("empty")).error().code, RiError::kBadFile);
  ASSERT_EQ(::mkfifo(path("pipe").c_str(), 0600), 0);
  EXPECT_EQ(Segment::openFile(path("pipe")).error().code, RiError::kBadFile);
  EXPECT_EQ(Segment::createFile(path("no/such/folder"), small(), 10).error().code, RiError::kNoFile);
}

TEST_F(SegmentTest, ManyThreadsGrowOneSegment) {
  Result<Segment> s = Segment::createAnonymous(small(), 1);
  ASSERT_TRUE(s.ok());
  std::vector<std::thread> threads;
  std::atomic<int> failures{0};
  for (uint64_t t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (uint64_t i = t; i < 400; i += 4) {
        if (!s->grow((i + 1) * 4096).ok()) ++failures;
        s->data()[i * 4096] = std::byte(1);
      }
    });
  }
  for (auto& t : threads) t.join();
  EXPECT_EQ(failures, 0);
  for (uint64_t i = 0; i < 400; ++i) ASSERT_EQ(s->data()[i * 4096], std::byte(1));
}

TEST_F(SegmentTest, SealedMemoryHasItsSizeForEver) {
  Result<FileDescriptor> fd = createSealedMemory("sealed", 8192);
  ASSERT_TRUE(fd.ok());
  EXPECT_NE(::ftruncate(fd->get(), 4096), 0);
  EXPECT_NE(::ftruncate(fd->get(), 16384), 0);
}

}  // namespace
}  // namespace fr::shm
