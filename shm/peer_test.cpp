#include "shm/peer.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/socket.h>

#include <cstring>
#include <thread>

#include "shm/fork_for_test.h"

namespace fr::shm {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

std::span<const std::byte> bytesOf(std::string_view s) {
  return std::as_bytes(std::span(s.data(), s.size()));
}
std::string textOf(const PeerMessage& m) {
  return {reinterpret_cast<const char*>(m.bytes.data()), m.bytes.size()};
}

class PeerTest : public ::testing::Test {
 protected:
  void SetUp() override { descriptors_ = openDescriptorCount(); }
  void TearDown() override {
    EXPECT_EQ(openDescriptorCount(), descriptors_) << "descriptors leak";
    EXPECT_EQ(::waitpid(-1, nullptr, WNOHANG), -1) << "a zombie or a child is left";
  }
  int descriptors_ = 0;
};

TEST_F(PeerTest, MessagesKeepTheirBorders) {
  auto ends = PeerSocket::pair();
  ASSERT_TRUE(ends.ok());
  auto& [a, b] = *ends;
  ASSERT_TRUE(a.send(bytesOf("one"), {}).ok());
  ASSERT_TRUE(a.send(bytesOf("two and more"), {}).ok());
  auto first = b.receive(seconds(1));
  ASSERT_TRUE(first.ok() && *first);
  EXPECT_EQ(textOf(**first), "one");
  auto second = b.receive(seconds(1));
  ASSERT_TRUE(second.ok() && *second);
  EXPECT_EQ(textOf(**second), "two and more");
  auto none = b.receive(milliseconds(1));
  ASSERT_TRUE(none.ok());
  EXPECT_FALSE(*none);
}

TEST_F(PeerTest, DescriptorsTravel) {
  auto ends = PeerSocket::pair();
  ASSERT_TRUE(ends.ok());
  auto& [a, b] = *ends;
  const FileDescriptor memory(::memfd_create("m", MFD_CLOEXEC));
  ASSERT_EQ(::pwrite(memory.get(), "hello", 5, 0), 5);
  const int fds[] = {memory.get(), memory.get()};
  ASSERT_TRUE(a.send(bytesOf("two"), fds).ok());
  auto m = b.receive(seconds(1));
  ASSERT_TRUE(m.ok() && *m);
  ASSERT_EQ((*m)->descriptors.size(), 2u);
  char text[6] = {};
  EXPECT_EQ(::pread((*m)->descriptors[1].get(), text, 5, 0), 5);
  EXPECT_STREQ(text, "hello");
  EXPECT_NE(::fcntl((*m)->descriptors[0].get(), F_GETFD) & FD_CLOEXEC, 0);
}

TEST_F(PeerTest, RefusesMessagesThatAreTooLarge) {
  auto ends = PeerSocket::pair();
  ASSERT_TRUE(ends.ok());
  auto& [a, b] = *ends;
  const std::string large(kMaxMessageBytes + 1, 'x');
  EXPECT_FALSE(a.send(bytesOf(large), {}).ok());
  EXPECT_FALSE(a.send({}, {}).ok());
  const std::vector<int> many(kMaxMessageDescriptors + 1, 0);
  EXPECT_FALSE(a.send(bytesOf("x"), many).ok());
  // From a peer that does not hold to it: more bytes, then more descriptors than we take.
  ASSERT_EQ(::send(a.descriptor(), large.data(), large.size(), 0), ssize_t(large.size()));
  auto r = b.receive(seconds(1));
  EXPECT_FALSE(r.ok());
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int) * 100)] = {};
  char byte = 'x';
  iovec part{&byte, 1};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  cmsghdr* h = CMSG_FIRSTHDR(&message);
  h->cmsg_level = SOL_SOCKET;
  h->cmsg_type = SCM_RIGHTS;
  h->cmsg_len = CMSG_LEN(sizeof(int) * 100);
  std::memset(CMSG_DATA(h), 0, sizeof(int) * 100);  // a hundred times stdin
  ASSERT_EQ(::sendmsg(a.descriptor(), &message, 0), 1);
  r = b.receive(seconds(1));
  EXPECT_FALSE(r.ok());
  ASSERT_TRUE(a.send(bytesOf("still good"), {}).ok());
  r = b.receive(seconds(1));
  ASSERT_TRUE(r.ok() && *r);
}

TEST_F(PeerTest, APeerThatLeavesIsNoticedAfterItsLastWords) {
  auto ends = PeerSocket::pair();
  ASSERT_TRUE(ends.ok());
  auto& [a, b] = *ends;
  EXPECT_TRUE(b.alive());
  ASSERT_TRUE(a.send(bytesOf("farewell"), {}).ok());
  a.close();
  EXPECT_FALSE(b.alive());
  auto m = b.receive(seconds(1));
  ASSERT_TRUE(m.ok() && *m);
  EXPECT_EQ(textOf(**m), "farewell");
  EXPECT_FALSE(b.receive(seconds(1)).ok());
  EXPECT_FALSE(b.send(bytesOf("x"), {}).ok());
  EXPECT_FALSE(a.alive());
  EXPECT_FALSE(a.send(bytesOf("x"), {}).ok());
}

TEST_F(PeerTest, ASenderDoesNotWaitForEverForAReader) {
  auto ends = PeerSocket::pair();
  ASSERT_TRUE(ends.ok());
  Result<void> r;
  for (int i = 0; i < 100000 && r.ok(); ++i)
    r = ends->first.send(bytesOf(std::string(4000, 'x')), {}, milliseconds(5));
  EXPECT_FALSE(r.ok());
}

TEST_F(PeerTest, AChildAnswersThroughItsSocket) {
  SpawnOptions o;
  o.program = "/bin/sh";
  // A shell cannot speak SEQPACKET messages, but it can write to a descriptor and show what it was given.
  o.arguments = {"-c", "ls /proc/self/fd | wc -l >&$FR_PEER_SOCKET; exit 3"};
  auto child = ChildProcess::spawn(o);
  ASSERT_TRUE(child.ok()) << child.error().str();
  auto m = child->socket().receive(seconds(20));
  ASSERT_TRUE(m.ok() && *m);
  // stdin, stdout, stderr, the socket, ls's own folder; everything else is close-on-exec.
  EXPECT_LE(std::atoi(textOf(**m).c_str()), 5 + descriptors_ - 3);
  EXPECT_TRUE(child->wait(seconds(20)));
  EXPECT_EQ(child->exitStatus(), 3);
  EXPECT_EQ(child->statusText(), "ended with status 3");
  EXPECT_FALSE(child->alive());
}

TEST_F(PeerTest, AMissingProgramIsAnError) {
  SpawnOptions o;
  o.program = "/no/such/program";
  auto child = ChildProcess::spawn(o);
  ASSERT_FALSE(child.ok());
  EXPECT_EQ(child.error().code, RiError::kNoFile);
  EXPECT_NE(child.error().message.find("/no/such/program"), std::string::npos);
}

TEST_F(PeerTest, AKilledChildIsNoticedAndNamed) {
  SpawnOptions o;
  o.program = "sleep";
  o.arguments = {"1000"};
  auto child = ChildProcess::spawn(o);
  ASSERT_TRUE(child.ok());
  EXPECT_TRUE(child->alive());
  EXPECT_EQ(child->statusText(), "running");
  EXPECT_FALSE(child->exitStatus());
  EXPECT_FALSE(child->wait(milliseconds(1)));
  ::kill(child->pid(), SIGKILL);
  EXPECT_TRUE(child->wait(seconds(20)));
  EXPECT_FALSE(child->alive());
  EXPECT_EQ(child->exitStatus(), -SIGKILL);
  EXPECT_EQ(child->statusText(), "killed by signal 9 (Killed)");
  child->signal(SIGTERM);  // too late, harmless
}

TEST_F(PeerTest, ADestroyedChildEndsEvenWhenItDoesNotListen) {
  pid_t pid = -1;
  {
    SpawnOptions o;
    o.program = "sleep";
    o.arguments = {"1000"};
    auto child = ChildProcess::spawn(o);
    ASSERT_TRUE(child.ok());
    pid = child->pid();
  }
  EXPECT_EQ(::kill(pid, 0), -1);
}

TEST_F(PeerTest, ChildrenDoNotKeepEachOthersSocketsOpen) {
  SpawnOptions sleeper;
  sleeper.program = "sleep";
  sleeper.arguments = {"1000"};
  auto first = ChildProcess::spawn(sleeper);
  auto second = ChildProcess::spawn(sleeper);
  ASSERT_TRUE(first.ok() && second.ok());
  first->signal(SIGKILL);
  EXPECT_TRUE(first->wait(seconds(20)));
  EXPECT_FALSE(first->socket().alive()) << "the second child holds the first one's end";
  second->signal(SIGKILL);
  EXPECT_TRUE(second->wait(seconds(20)));
}

TEST_F(PeerTest, WorksWhereTheHostIgnoresItsChildren) {
  EXPECT_EQ(runInChild([]() -> int {
              ::signal(SIGCHLD, SIG_IGN);
              SpawnOptions o;
              o.program = "true";
              auto child = ChildProcess::spawn(o);
              CHILD_EXPECT(child.ok());
              CHILD_EXPECT(child->wait(seconds(20)));
              CHILD_EXPECT(child->statusText() == "ended");
              CHILD_EXPECT(!child->exitStatus());
              return 0;
            }),
            0);
}

TEST_F(PeerTest, TheParentSocketIsCheckedBeforeItIsTrusted) {
  EXPECT_EQ(runInChild([]() -> int {
              CHILD_EXPECT(!parentSocket("FR_TEST_SOCKET").ok());
              for (const char* bad : {"", "x", "-1", "999999", "0x3", "3 ", "1"}) {
                ::setenv("FR_TEST_SOCKET", bad, 1);
                CHILD_EXPECT(!parentSocket("FR_TEST_SOCKET").ok());
              }
              auto ends = PeerSocket::pair();
              CHILD_EXPECT(ends.ok());
              const int fd = ::dup(ends->second.descriptor());
              ::setenv("FR_TEST_SOCKET", std::to_string(fd).c_str(), 1);
              auto socket = parentSocket("FR_TEST_SOCKET");
              CHILD_EXPECT(socket.ok());
              CHILD_EXPECT(socket->send(bytesOf("x"), {}).ok());
              CHILD_EXPECT(::getenv("FR_TEST_SOCKET") == nullptr);
              CHILD_EXPECT(::fcntl(fd, F_GETFD) & FD_CLOEXEC);
              return 0;
            }),
            0);
}

}  // namespace
}  // namespace fr::shm
